//! The simulation: people who brush in the morning and in the evening, one per lane.

use std::io;
use std::sync::Arc;

use pulp::{Simd, WithSimd};

use crate::env::history::History;
use crate::env::observation::{ObservationSpec, Observations};
use crate::env::oralytics::feature::{Feature, Weights};
use crate::env::oralytics::parameters::{CostScale, Oralytics, PER_DAY, TestBed};
use crate::env::oralytics::person::{MOST_SECONDS, Person};
use crate::env::simulation::{Simulated, Simulation, StateColumn};
use crate::env::variates::Expansion;
use crate::env::vector::{
    Action, ActionSpec, EpisodeStatus, LaneSet, LaneStreams, VectorEnvironment,
};
use crate::kernel::Isa;
use crate::rng::open_unit_from_bits;
use crate::state::resumable;

/// The meaning of the actions, by number.
pub(super) const ACTIONS: [&str; 2] = ["nothing", "a prompt"];

/// What the algorithm can see, in the order of an observation of every feature.
pub(super) const SEEN: [(&str, f32, f32); 6] = [
    ("time_of_day", 0.0, 1.0),
    ("brushing", -(CENTRE / SPREAD) as f32, 1.0),
    ("dosage", -1.0, 1.0),
    ("app", 0.0, 1.0),
    ("weekend", 0.0, 1.0),
    // Until the days of a person are known.
    ("day", -1.0, f32::INFINITY),
];

/// The names of the recorded state: the averages before the decision, responsiveness, whether the app was opened on the
/// day and on the day before, and the number of the person's row in the file, from 0.
pub(super) const STATE: [&str; 6] =
    ["average_brushing", "average_prompts", "responsiveness", "app_today", "app_before", "person"];

/// The number of decisions that averages reach back.
const WINDOW: usize = 14;
/// The factor of a decision's weight in the averages, relative to the next decision's.
const DISCOUNT: f64 = 13.0 / 14.0;
/// Centre and spread of the normalised average of brushing, in seconds.
const CENTRE: f64 = 90.5;
const SPREAD: f64 = 89.5;
/// Centre and spread of the brushings of the day before, in seconds.
const PREVIOUS: [f64; 2] = [154.0, 163.0];
/// Centre and spread of the day in the study.
const DAYS: [f64; 2] = [35.5, 34.5];
/// The average of brushing, in seconds, above which a person brushes well.
const GOOD_BRUSHING: f64 = 111.0;
/// The averages of prompts above which prompts are many, and very many.
const MANY: f64 = 0.5;
const VERY_MANY: f64 = 0.8;

/// The people in the lanes of an environment; entry i of every array belongs to lane i.
///
/// A step draws one word per running lane, which is expanded into the numbers that are needed. People are drawn from the
/// participants of a lane's stream.
#[derive(Clone, Debug)]
pub struct Brushing {
    parameters: Oralytics,
    people: Arc<Vec<Person>>,
    /// The indices in [`SEEN`] that observations show.
    shown: Vec<usize>,
    history: Option<History>,
    /// The weights of the last decisions in an average, oldest first.
    weights: [f64; WINDOW],
    times: Vec<u32>,
    /// Indices in `people`.
    rows: Vec<u32>,
    /// The rows of the people in the lanes; empty if people are drawn.
    assigned: Vec<u32>,
    /// \[lanes, horizon\].
    seconds: Vec<f64>,
    prompts: Vec<f64>,
    responsiveness: Vec<f64>,
    /// How often responsiveness has shrunk and not grown again.
    excesses: Vec<u32>,
    /// Whether the app was opened today, and yesterday.
    app_today: Vec<bool>,
    app_before: Vec<bool>,
    /// The average of brushing when the app was last opened, normalised.
    reported: Vec<f64>,
    statuses: Vec<EpisodeStatus>,
    /// The averages before the next decision; follow from the arrays above.
    average_brushing: Vec<f64>,
    average_prompts: Vec<f64>,
    /// The seconds of the last step, and buffers for the words and lanes of a draw.
    brushed: Vec<f64>,
    words: Vec<u64>,
    drawn: Vec<bool>,
}

impl Brushing {
    /// Ended lanes with these people, which show the features at these indices of all features.
    pub(super) fn new(
        parameters: &Oralytics,
        people: Arc<Vec<Person>>,
        shown: Vec<usize>,
        (history, lanes): (usize, usize),
    ) -> Brushing {
        let mut weights = [0.0; WINDOW];
        let all = (1.0 - DISCOUNT) / (1.0 - DISCOUNT.powi(WINDOW as i32));
        let ages = (0..WINDOW as i32).rev();
        weights.iter_mut().zip(ages).for_each(|(weight, age)| *weight = all * DISCOUNT.powi(age));
        let decisions = lanes * parameters.horizon() as usize;
        let mut brushing = Brushing {
            parameters: parameters.clone(),
            people,
            shown,
            history: None,
            weights,
            times: vec![0; lanes],
            rows: vec![0; lanes],
            assigned: Vec::new(),
            seconds: vec![0.0; decisions],
            prompts: vec![0.0; decisions],
            responsiveness: vec![1.0; lanes],
            excesses: vec![0; lanes],
            app_today: vec![false; lanes],
            app_before: vec![false; lanes],
            reported: vec![0.0; lanes],
            statuses: vec![EpisodeStatus::Truncated; lanes],
            average_brushing: vec![0.0; lanes],
            average_prompts: vec![0.0; lanes],
            brushed: vec![0.0; lanes],
            words: vec![0; lanes],
            drawn: vec![false; lanes],
        };
        brushing.history = History::new(history, lanes, &spec(parameters, &brushing.shown));
        brushing
    }

    fn is_morning(&self, lane: usize) -> bool {
        self.times[lane].is_multiple_of(PER_DAY)
    }

    /// The average of the last decisions before a lane's decision, of seconds or prompts. In the evening, the same
    /// morning is left out, except on the first day.
    #[inline(always)]
    fn average(&self, lane: usize, of: &[f64]) -> f64 {
        let time = self.times[lane] as usize;
        let count = if self.is_morning(lane) || time == 1 { time } else { time - 1 };
        let first = lane * self.parameters.horizon() as usize;
        let before = &of[first..first + count];
        match before.len().checked_sub(WINDOW) {
            _ if before.is_empty() => 0.0,
            None => before.iter().sum::<f64>() / before.len() as f64,
            Some(older) => before[older..].iter().zip(&self.weights).map(|(x, w)| x * w).sum(),
        }
    }

    /// Computes the averages before a lane's decision.
    #[inline(always)]
    fn derive(&mut self, lane: usize) {
        self.average_brushing[lane] = self.average(lane, &self.seconds);
        self.average_prompts[lane] = self.average(lane, &self.prompts);
    }

    fn derive_all(&mut self) {
        (0..self.times.len()).for_each(|lane| self.derive(lane));
    }

    /// Begins a day, on which the app is opened or not.
    fn begin_day(&mut self, lane: usize, opens: bool) {
        self.app_before[lane] = self.app_today[lane];
        self.app_today[lane] = opens;
        if self.is_reporting(lane) {
            self.reported[lane] = normalised_brushing(self.average_brushing[lane]);
        }
    }

    /// Whether the app has sent the state of the day.
    fn is_reporting(&self, lane: usize) -> bool {
        self.app_today[lane]
    }

    fn normalised_dosage(&self, lane: usize) -> f64 {
        2.0 * (self.average_prompts[lane] - 0.5)
    }

    fn is_weekend(&self, lane: usize) -> f64 {
        f64::from(u8::from(self.times[lane] % 14 >= 10))
    }

    fn day(&self, lane: usize) -> f64 {
        // After the last decision, the last day.
        normalised_day((1 + self.times[lane] / PER_DAY).min(self.parameters.days))
    }

    /// The features of the outcome of a lane's decision.
    #[inline(always)]
    fn features(&self, lane: usize) -> Weights {
        let time = self.times[lane] as usize;
        let first = lane * self.parameters.horizon() as usize;
        let before = &self.seconds[first..first + time];
        let is_morning = self.is_morning(lane);
        // In the evening, the brushing of the same morning is left out.
        let two = time.saturating_sub(if is_morning { 2 } else { 3 });
        let previous = if time <= 1 { 0.0 } else { before[two] + before[two + 1] };
        let share = match time.checked_sub(WINDOW) {
            None => 0.0,
            Some(older) => {
                let brushed = before[older..].iter().filter(|seconds| **seconds > 0.0).count();
                brushed as f64 / WINDOW as f64
            }
        };
        Feature::ALL.map(|feature| match feature {
            Feature::TimeOfDay => f64::from(u8::from(!is_morning)),
            Feature::Previous => (previous - PREVIOUS[0]) / PREVIOUS[1],
            Feature::Brushing => normalised_brushing(self.average_brushing[lane]),
            Feature::Dosage => self.normalised_dosage(lane),
            Feature::App => f64::from(u8::from(self.app_before[lane])),
            Feature::Day => self.day(lane),
            Feature::BrushedShare => share,
            Feature::Weekend => self.is_weekend(lane),
            Feature::One => 1.0,
        })
    }

    /// The cost of a prompt at a lane's decision, in seconds.
    fn cost(&self, lane: usize) -> f64 {
        let (raw, prompts) = (self.average_brushing[lane], self.average_prompts[lane]);
        let (brushing, prompts) = match self.parameters.cost_scale {
            CostScale::Raw => (raw, prompts),
            CostScale::Normalised => (normalised_brushing(raw), self.normalised_dosage(lane)),
        };
        let good = brushing > GOOD_BRUSHING && prompts > MANY;
        let cost = if good { self.parameters.cost_of_good_brushing } else { 0.0 };
        let frequent = prompts > VERY_MANY;
        cost + if frequent { self.parameters.cost_of_frequent_prompts } else { 0.0 }
    }

    /// Shrinks or restores the responsiveness of a lane, once a week of decisions.
    fn habituate(&mut self, lane: usize) {
        let Oralytics { habituation_factor, test_bed, .. } = self.parameters;
        let habituates = habituation_factor < 1.0 && test_bed != TestBed::V4;
        let time = self.times[lane] as usize;
        if !habituates || time == 0 || !time.is_multiple_of(WINDOW) {
            return;
        }
        let (brushing, prompts) = (self.average_brushing[lane], self.average_prompts[lane]);
        let is_excess = (brushing > GOOD_BRUSHING && prompts > MANY) || prompts > VERY_MANY;
        let (k, excesses) = (&mut self.responsiveness[lane], &mut self.excesses[lane]);
        if is_excess {
            *k *= habituation_factor;
            *excesses += 1;
        } else if *excesses > 0 {
            // A person who has stopped responding responds fully again, however often that has happened.
            *k = if habituation_factor == 0.0 { 1.0 } else { *k / habituation_factor };
            *excesses -= 1;
        }
    }

    /// The responsiveness of the person in a lane to prompts, 0 to 1.
    pub fn responsiveness(&self, lane: usize) -> f64 {
        self.responsiveness[lane]
    }

    /// Takes a decision whose outcome and next day are given: the seconds, and whether the app is opened on the next
    /// day if it begins. Returns the reward to learn from.
    #[inline(always)]
    pub fn force(&mut self, lane: usize, is_prompted: bool, seconds: f64, opens: bool) -> f64 {
        let cost = if is_prompted { self.cost(lane) } else { 0.0 };
        self.habituate(lane);
        let horizon = self.parameters.horizon();
        let index = lane * horizon as usize + self.times[lane] as usize;
        self.seconds[index] = seconds;
        self.prompts[index] = f64::from(u8::from(is_prompted));
        self.brushed[lane] = seconds;
        self.times[lane] += 1;
        self.derive(lane);
        if self.times[lane] == horizon {
            self.statuses[lane] = EpisodeStatus::Truncated;
        } else if self.is_morning(lane) {
            self.begin_day(lane, opens);
        }
        seconds - cost
    }

    /// Begins an episode of the person in this row of the file.
    pub fn begin(&mut self, lane: usize, row: u32) {
        self.rows[lane] = row;
        self.times[lane] = 0;
        self.responsiveness[lane] = 1.0;
        self.excesses[lane] = 0;
        self.app_today[lane] = false;
        self.statuses[lane] = EpisodeStatus::Running;
        self.derive(lane);
        // The first day counts as one on which the app was opened.
        self.begin_day(lane, true);
    }

    /// What the algorithm can see of a lane, every feature.
    pub fn seen(&self, lane: usize) -> [f64; SEEN.len()] {
        let is_fresh = !self.parameters.stale_state || self.is_reporting(lane);
        let brushing = match is_fresh {
            true => normalised_brushing(self.average_brushing[lane]),
            false => self.reported[lane],
        };
        let is_evening = !self.is_morning(lane);
        [
            f64::from(u8::from(is_evening)),
            brushing,
            self.normalised_dosage(lane),
            f64::from(u8::from(is_fresh && self.app_before[lane])),
            self.is_weekend(lane),
            self.day(lane),
        ]
    }

    /// The people of the file.
    pub fn people(&self) -> usize {
        self.people.len()
    }

    /// Takes one step in a running lane, with this word.
    #[inline(always)]
    fn take(&mut self, lane: usize, is_prompted: bool, word: u64) -> f64 {
        let mut words = Expansion(word);
        let person = &self.people[self.rows[lane] as usize];
        // Drawn first, so that it depends neither on the action nor on the outcome.
        let opens = words.open_unit() < person.opens_app;
        let Oralytics { test_bed, rounding, .. } = self.parameters;
        let responsiveness = self.parameters.effect_factor * self.responsiveness(lane);
        let features = self.features(lane);
        let how = (test_bed, rounding);
        let seconds = person.brushes(&features, is_prompted, responsiveness, how, &mut words);
        self.force(lane, is_prompted, seconds, opens)
    }
}

/// A step of the lanes that have drawn a word.
struct Step<'a> {
    lanes: &'a mut Brushing,
    actions: &'a [Action],
    rewards: &'a mut [f64],
}

impl WithSimd for Step<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Step { lanes, actions, rewards } = self;
        for (lane, (action, reward)) in actions.iter().zip(rewards).enumerate() {
            *reward = 0.0;
            if lanes.drawn[lane] {
                *reward = lanes.take(lane, action.index() > 0, lanes.words[lane]);
            } else {
                lanes.brushed[lane] = 0.0;
            }
        }
    }
}

/// What observations show: the features at these indices of [`SEEN`].
pub(super) fn spec(parameters: &Oralytics, shown: &[usize]) -> ObservationSpec {
    let mut spec = ObservationSpec::of(SEEN);
    let [first, last] = [1, parameters.days].map(|day| normalised_day(day) as f32);
    let day = &mut spec.features[SEEN.len() - 1];
    (day.low, day.high) = (first, last);
    spec.features = shown.iter().map(|index| spec.features[*index].clone()).collect();
    spec
}

/// The average of brushing as the algorithm sees it.
fn normalised_brushing(average: f64) -> f64 {
    (average - CENTRE) / SPREAD
}

/// A day in the study, from 1, as models see it.
fn normalised_day(day: u32) -> f64 {
    (f64::from(day) - DAYS[0]) / DAYS[1]
}

impl VectorEnvironment for Brushing {
    fn action_spec(&self) -> ActionSpec {
        let Oralytics { cost_of_good_brushing, cost_of_frequent_prompts, .. } = self.parameters;
        ActionSpec {
            count: ACTIONS.len(),
            lowest_reward: -cost_of_good_brushing - cost_of_frequent_prompts,
            highest_reward: MOST_SECONDS,
        }
    }

    fn observation_spec(&self) -> ObservationSpec {
        let spec = spec(&self.parameters, &self.shown);
        spec.stacked(self.history.as_ref().map_or(1, History::length))
    }

    fn reset(&mut self, lanes: LaneSet<'_>, streams: &mut LaneStreams) {
        if let Some(history) = &mut self.history {
            history.reset(lanes);
        }
        for lane in (0..self.lanes()).filter(|lane| lanes.contains(*lane)) {
            let [word, ..] = streams.of(lane).next_participant();
            let row = (open_unit_from_bits(word) * self.people.len() as f64) as usize;
            let row = row.min(self.people.len() - 1);
            let row = self.assigned.get(lane).map_or(row, |row| *row as usize);
            self.begin(lane, row as u32);
        }
    }

    fn step(&mut self, actions: &[Action], rewards: &mut [f64], streams: &mut LaneStreams) {
        let lanes = self.lanes();
        assert_eq!(
            (actions.len(), rewards.len()),
            (lanes, lanes),
            "one action and reward per lane"
        );
        if let Some(mut history) = self.history.take() {
            history.remember(&self.statuses, |out| self.observe_now(out));
            self.history = Some(history);
        }
        for (drawn, status) in self.drawn.iter_mut().zip(&self.statuses) {
            *drawn = *status == EpisodeStatus::Running;
        }
        streams.fill(LaneSet::All, &self.drawn, &mut self.words);
        Isa::chosen().run(Step { lanes: self, actions, rewards });
    }

    fn statuses(&self) -> &[EpisodeStatus] {
        &self.statuses
    }

    fn observe(&self, out: &mut Observations) {
        self.observe_now(out);
        if let Some(history) = &self.history {
            history.stack(&mut out.features);
        }
    }

    /// The seconds of brushing, without the cost of prompts.
    fn outcomes<'a>(&'a self, _: &'a [f64]) -> &'a [f64] {
        &self.brushed
    }
}

impl Brushing {
    fn observe_now(&self, out: &mut Observations) {
        out.clear();
        for lane in 0..self.times.len() {
            let seen = self.seen(lane);
            out.features.extend(self.shown.iter().map(|index| seen[*index] as f32));
        }
    }

    /// Whether rows are of the file, and times within episodes.
    fn fits(&self) -> bool {
        let horizon = self.parameters.horizon();
        self.rows.iter().all(|row| (*row as usize) < self.people.len())
            && self.times.iter().all(|time| *time <= horizon)
    }
}

impl Simulation for Brushing {
    fn with_lanes(&self, lanes: usize) -> Simulated {
        let history = self.history.as_ref().map_or(1, History::length);
        let (people, shown) = (Arc::clone(&self.people), self.shown.clone());
        Box::new(Brushing::new(&self.parameters, people, shown, (history, lanes)))
    }

    fn copied(&self) -> io::Result<Simulated> {
        Ok(Box::new(self.clone()))
    }

    fn times(&self) -> &[u32] {
        &self.times
    }

    fn message_cost(&self, lane: usize) -> f64 {
        self.cost(lane)
    }

    fn exact_features(&self, lane: usize, observations: &Observations, out: &mut Vec<f64>) {
        out.clear();
        // Earlier observations are kept in the precision of observations.
        if self.history.is_some() {
            let earlier = observations.width() - self.shown.len();
            out.extend(observations.row(lane)[..earlier].iter().copied().map(f64::from));
        }
        let seen = self.seen(lane);
        out.extend(self.shown.iter().map(|index| seen[*index]));
    }

    fn exact_features_read_observations(&self) -> bool {
        self.history.is_some()
    }

    fn assign(&mut self, rows: &[u32]) {
        self.assigned = rows.to_vec();
    }

    fn leave(&mut self, lane: usize) {
        self.statuses[lane] = EpisodeStatus::Truncated;
    }

    fn show_state<'s>(&'s self, show: &mut dyn FnMut(&'s str, StateColumn<'s>)) {
        let columns = [
            StateColumn::Reals(&self.average_brushing),
            StateColumn::Reals(&self.average_prompts),
            StateColumn::Reals(&self.responsiveness),
            StateColumn::Flags(&self.app_today),
            StateColumn::Flags(&self.app_before),
            StateColumn::Counts(&self.rows),
        ];
        STATE.into_iter().zip(columns).for_each(|(name, column)| show(name, column));
    }
}

resumable!([] Brushing {
    fixed times, rows, seconds, prompts, responsiveness, excesses, reported, brushed;
    each app_today, app_before, statuses, history;
    check fits, "people";
    then derive_all
});

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::oralytics::feature::FEATURES;
    use crate::key::Content;

    fn lane(change: impl FnOnce(&mut Oralytics)) -> Brushing {
        let mut parameters = Oralytics::of_people(Content::default());
        change(&mut parameters);
        let person = Person {
            sigma: None,
            opens_app: 0.7,
            bernoulli: [0.0; FEATURES],
            amount: [0.0; FEATURES],
            bernoulli_effect: [0.0; FEATURES],
            amount_effect: [0.0; FEATURES],
        };
        let mut lane = Brushing::new(&parameters, Arc::new(vec![person]), vec![0], (1, 1));
        lane.begin(0, 0);
        lane
    }

    #[test]
    fn features_leave_out_the_same_morning() {
        let mut lane = lane(|_| {});
        let feature = |lane: &Brushing, of: Feature| lane.features(0)[of as usize];
        for (time, seconds) in [100.0, 80.0, 60.0, 0.0, 120.0].into_iter().enumerate() {
            assert_eq!(feature(&lane, Feature::TimeOfDay), (time % 2) as f64);
            let previous = match time {
                2 | 3 => 180.0,
                4 => 60.0,
                _ => 0.0,
            };
            assert_eq!(feature(&lane, Feature::Previous), (previous - 154.0) / 163.0);
            lane.force(0, time % 2 == 0, seconds, time > 2);
        }
        // The evening of the third day leaves out its morning: (100 + 80 + 60 + 0) / 4, and two prompts of four.
        assert_eq!(lane.average_brushing[0], 60.0);
        assert_eq!(lane.average_prompts[0], 0.5);
        assert_eq!(feature(&lane, Feature::BrushedShare), 0.0);
        (5..14).for_each(|_| _ = lane.force(0, false, 90.0, false));
        assert_eq!(feature(&lane, Feature::BrushedShare), 13.0 / 14.0);
        assert_eq!(feature(&lane, Feature::Weekend), 0.0);
        assert_eq!(feature(&lane, Feature::Day), (8.0 - 35.5) / 34.5);
    }

    #[test]
    fn people_habituate_to_many_prompts_and_recover() {
        let responsiveness = |bed, factor: f64, prompts: [bool; 4]| {
            let mut lane = lane(|parameters| {
                (parameters.habituation_factor, parameters.test_bed) = (factor, bed);
            });
            let weeks = prompts.into_iter().map(|is_prompted| {
                (0..14).for_each(|_| _ = lane.force(0, is_prompted, 90.0, true));
                // It changes after the decision at the beginning of the next week.
                lane.clone().force(0, false, 90.0, true);
                lane.responsiveness(0)
            });
            weeks.collect::<Vec<f64>>()
        };
        let weeks = [true, true, false, false];
        assert_eq!(responsiveness(TestBed::V2, 0.5, weeks), [1.0, 0.5, 0.25, 0.5]);
        assert_eq!(responsiveness(TestBed::V3, 0.0, weeks), [1.0, 0.0, 0.0, 1.0]);
        assert_eq!(responsiveness(TestBed::V2, 1.0, weeks), [1.0; 4]);
        assert_eq!(responsiveness(TestBed::V4, 0.5, weeks), [1.0; 4]);
    }

    #[test]
    fn a_prompt_costs_where_brushing_is_good_or_prompts_are_frequent() {
        let cost = |scale, seconds, prompts: usize| {
            let mut lane = lane(|parameters| {
                parameters.cost_scale = scale;
                (parameters.cost_of_good_brushing, parameters.cost_of_frequent_prompts) =
                    (7.0, 50.0);
            });
            (0..10).for_each(|time| _ = lane.force(0, time < prompts, seconds, true));
            seconds - lane.force(0, true, seconds, true)
        };
        use CostScale::{Normalised, Raw};
        assert_eq!(cost(Raw, 120.0, 6), 7.0);
        assert_eq!(cost(Raw, 120.0, 5), 0.0);
        assert_eq!(cost(Raw, 111.0, 6), 0.0);
        assert_eq!(cost(Raw, 120.0, 9), 57.0);
        assert_eq!(cost(Raw, 60.0, 9), 50.0);
        // Normalised, 9 of 10 prompts are 0.8, and no brushing is above 111.
        assert_eq!(cost(Normalised, 120.0, 9), 0.0);
        assert_eq!(cost(Normalised, 120.0, 10), 50.0);
    }
}
