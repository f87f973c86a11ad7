//! The physical-activity simulation of Karine et al. (2023), section 3.1.

use std::hint::select_unpredictable;
use std::io;

use pulp::{Simd, WithSimd};

use crate::env::context::{ContextDraw, ContextDrawsAhead, Draws};
use crate::env::observation::{ObservationSpec, Observations};
use crate::env::observer::{LaneStates, Observer};
use crate::env::parameters::{Environment, FirstContext};
use crate::env::scenario::Scenario;
use crate::env::vector::{
    Action, ActionSpec, EpisodeStatus, LaneSet, LaneStreams, VectorEnvironment,
};
use crate::kernel::{Isa, LINE};
use crate::state::{Resumable, StateError, StateReader, StateWriter};

/// `f64`s in the widest register.
const REGISTER: usize = LINE / size_of::<f64>();

/// Many episodes of the simulation; entry i of every array belongs to lane i.
///
/// A step of the simulation draws one word per lane. With a shared stream it draws for every lane in
/// lane order, ended lanes included; with one stream per lane it draws for the running lanes. A reset
/// draws one word for each lane that it resets if the first context is sampled, and none otherwise.
#[derive(Clone, Debug)]
pub struct PhysicalActivity {
    parameters: Environment,
    observer: Observer,
    times: Vec<u32>,
    /// As `probabilities` and `likely` padded, so that draws fill whole registers.
    contexts: Vec<u8>,
    probabilities: Vec<f64>,
    likely: Vec<u8>,
    habituation: Vec<f64>,
    disengagement: Vec<f64>,
    statuses: Vec<EpisodeStatus>,
    /// Which lanes get a new context: those that were running before the step, or are being reset.
    drawn: Vec<bool>,
    /// Words of the streams for the next contexts.
    words: Vec<u64>,
    /// Contexts for the steps of a single lane.
    ahead: ContextDrawsAhead,
    isa: Isa,
}

impl PhysicalActivity {
    /// As many lanes as `lanes`, all ended, with the observations of a scenario.
    pub fn new(parameters: &Environment, scenario: &Scenario, lanes: usize) -> Self {
        PhysicalActivity::observed(parameters, Observer::new(parameters, scenario), lanes)
    }

    /// The same simulation with another number of lanes, all ended.
    pub fn with_lanes(&self, lanes: usize) -> Self {
        PhysicalActivity::observed(&self.parameters, self.observer.clone(), lanes)
    }

    fn observed(parameters: &Environment, observer: Observer, lanes: usize) -> Self {
        let padded = lanes.next_multiple_of(REGISTER);
        PhysicalActivity {
            parameters: parameters.clone(),
            observer,
            times: vec![0; lanes],
            contexts: vec![0; padded],
            probabilities: vec![0.0; padded],
            likely: vec![0; padded],
            habituation: vec![0.0; lanes],
            disengagement: vec![0.0; lanes],
            statuses: vec![EpisodeStatus::Truncated; lanes],
            drawn: vec![false; padded],
            words: vec![0; padded],
            ahead: ContextDrawsAhead::new(parameters.sigma),
            isa: Isa::chosen(),
        }
    }

    /// The deterministic half of a step: rewards, habituation, disengagement risk, clocks and
    /// statuses. The contexts stay as they are.
    ///
    /// **Shapes**: `actions` and `rewards` are \[lanes\].
    pub fn apply_actions(&mut self, actions: &[Action], rewards: &mut [f64]) {
        assert_eq!(actions.len(), self.lanes(), "one action per lane");
        assert_eq!(rewards.len(), self.lanes(), "one reward per lane");
        self.isa.run(Transitions {
            parameters: &self.parameters,
            contexts: &self.contexts,
            actions,
            times: &mut self.times,
            habituation: &mut self.habituation,
            disengagement: &mut self.disengagement,
            statuses: &mut self.statuses,
            rewards,
        });
    }

    /// The random half of a step, or of a reset: draws a context for the lanes marked in `drawn`.
    /// From a shared stream, all of `lanes` take a word, marked or not.
    fn sample_contexts(&mut self, lanes: LaneSet<'_>, streams: &mut LaneStreams) {
        let count = self.lanes();
        if count == 1 {
            let takes = match streams {
                LaneStreams::Shared(_) => lanes.contains(0),
                LaneStreams::PerLane(_) => self.drawn[0],
            };
            if takes {
                let draw = self.ahead.take(self.isa, streams.of(0));
                if self.drawn[0] {
                    self.set_context(0, draw);
                }
            }
            return;
        }
        match (streams, lanes) {
            (LaneStreams::Shared(stream), LaneSet::All) => stream.fill(&mut self.words[..count]),
            (LaneStreams::Shared(stream), LaneSet::Masked(mask)) => {
                let words = self.words.iter_mut().zip(mask).filter(|(_, takes)| **takes);
                words.for_each(|(word, _)| *word = stream.bits());
            }
            (LaneStreams::PerLane(streams), _) => {
                let lanes = self.words.iter_mut().zip(&self.drawn).zip(streams);
                let drawn = lanes.filter(|((_, drawn), _)| **drawn);
                drawn.for_each(|((word, _), stream)| *word = stream.bits());
            }
        }
        self.isa.run(Draws {
            drawn: &self.drawn,
            sigma: self.parameters.sigma,
            words: &self.words,
            contexts: &mut self.contexts,
            probabilities: &mut self.probabilities,
            likely: &mut self.likely,
        });
    }

    /// Sets the context of a lane, as a replay does.
    pub fn set_context(&mut self, lane: usize, draw: ContextDraw) {
        self.contexts[lane] = draw.context;
        self.probabilities[lane] = draw.probability_of_zero;
        self.likely[lane] = draw.likely;
    }

    /// The context of a lane with its inference.
    pub fn context(&self, lane: usize) -> ContextDraw {
        ContextDraw {
            context: self.contexts[lane],
            probability_of_zero: self.probabilities[lane],
            likely: self.likely[lane],
        }
    }

    /// The parameters of the simulation.
    pub fn parameters(&self) -> &Environment {
        &self.parameters
    }

    /// Steps taken in the episode of every lane, \[lanes\].
    pub fn times(&self) -> &[u32] {
        &self.times
    }

    /// Habituation in [0, 1], \[lanes\].
    pub fn habituation(&self) -> &[f64] {
        &self.habituation
    }

    /// Disengagement risk in [0, 1], \[lanes\].
    pub fn disengagement(&self) -> &[f64] {
        &self.disengagement
    }
}

impl VectorEnvironment for PhysicalActivity {
    fn lanes(&self) -> usize {
        self.statuses.len()
    }

    fn action_spec(&self) -> ActionSpec {
        let Environment { rho_1, rho_2, mu, .. } = self.parameters;
        ActionSpec {
            count: Action::COUNT,
            lowest_reward: mu[0].min(mu[1]) + rho_1.min(rho_2).min(0.0),
            highest_reward: mu[0].max(mu[1]) + rho_1.max(rho_2).max(0.0),
        }
    }

    fn observation_spec(&self) -> ObservationSpec {
        self.observer.spec()
    }

    fn reset(&mut self, lanes: LaneSet<'_>, streams: &mut LaneStreams) {
        let count = self.lanes();
        self.drawn.fill(false);
        for lane in (0..count).filter(|lane| lanes.contains(*lane)) {
            self.drawn[lane] = true;
            self.times[lane] = 0;
            self.habituation[lane] = self.parameters.initial_habituation;
            self.disengagement[lane] = self.parameters.initial_disengagement;
            self.statuses[lane] = EpisodeStatus::Running;
        }
        match self.parameters.first_context {
            FirstContext::Fixed => {
                for lane in (0..count).filter(|lane| lanes.contains(*lane)) {
                    self.set_context(lane, ContextDraw::FIXED_FIRST);
                }
            }
            FirstContext::Sampled => self.sample_contexts(lanes, streams),
        }
    }

    fn step(&mut self, actions: &[Action], rewards: &mut [f64], streams: &mut LaneStreams) {
        for (drawn, status) in self.drawn.iter_mut().zip(&self.statuses) {
            *drawn = *status == EpisodeStatus::Running;
        }
        self.apply_actions(actions, rewards);
        self.sample_contexts(LaneSet::All, streams);
    }

    fn statuses(&self) -> &[EpisodeStatus] {
        &self.statuses
    }

    fn observe(&self, out: &mut Observations) {
        let lanes = self.lanes();
        let states = LaneStates {
            times: &self.times,
            contexts: &self.contexts[..lanes],
            probabilities: &self.probabilities[..lanes],
            likely: &self.likely[..lanes],
            habituation: &self.habituation,
            disengagement: &self.disengagement,
        };
        self.observer.observe(states, out);
    }
}

impl Resumable for PhysicalActivity {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        out.each(0..self.lanes(), |out, lane| {
            out.one(self.times[lane])?;
            out.one(self.contexts[lane])?;
            out.one(self.probabilities[lane])?;
            out.one(self.habituation[lane])?;
            out.one(self.disengagement[lane])?;
            out.one(self.statuses[lane].number())
        })
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        const WHAT: &str = "lanes";
        let mut lanes = 0..self.lanes();
        from.each(self.lanes(), WHAT, |from| {
            let lane = lanes.next().ok_or(StateError::Misfit(WHAT))?;
            self.times[lane] = from.one()?;
            let context = from.one::<u8>()? & 1;
            self.set_context(lane, ContextDraw::new(context, from.one()?));
            self.habituation[lane] = from.one()?;
            self.disengagement[lane] = from.one()?;
            let status = EpisodeStatus::from_number(from.one()?);
            self.statuses[lane] = status.ok_or(StateError::Misfit("statuses"))?;
            Ok(())
        })?;
        if lanes.is_empty() { Ok(()) } else { Err(StateError::Misfit(WHAT)) }
    }
}

/// The deterministic half of a step, lane by lane; every array is \[lanes\] or longer.
///
/// The loop has no branches, because their directions could not be predicted.
struct Transitions<'a> {
    parameters: &'a Environment,
    contexts: &'a [u8],
    actions: &'a [Action],
    times: &'a mut [u32],
    habituation: &'a mut [f64],
    disengagement: &'a mut [f64],
    statuses: &'a mut [EpisodeStatus],
    rewards: &'a mut [f64],
}

impl WithSimd for Transitions<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        // A copy, so that the compiler knows that the writes below do not change it.
        let parameters = self.parameters.clone();
        for (time, status) in self.times.iter_mut().zip(&*self.statuses) {
            *time += u32::from(*status == EpisodeStatus::Running);
        }
        let (habituation, disengagement) = (self.habituation.iter_mut(), self.disengagement);
        let states = habituation.zip(disengagement).zip(self.statuses).zip(&*self.times);
        let given = self.contexts.iter().zip(self.actions);
        for ((((habituation, disengagement), status), time), ((context, action), reward)) in
            states.zip(given.zip(self.rewards))
        {
            let effect = apply_action(&parameters, *context, *action, *habituation, *disengagement);
            let running = *status == EpisodeStatus::Running;
            let last = *time >= parameters.horizon;
            let next = select_unpredictable(last, EpisodeStatus::Truncated, EpisodeStatus::Running);
            let disengaged = effect.disengagement >= parameters.disengagement_threshold;
            let next = select_unpredictable(disengaged, EpisodeStatus::Terminated, next);
            *habituation = select_unpredictable(running, effect.habituation, *habituation);
            *disengagement = select_unpredictable(running, effect.disengagement, *disengagement);
            *reward = select_unpredictable(running, effect.reward, 0.0);
            *status = select_unpredictable(running, next, *status);
        }
    }
}

/// The state after an action, and its reward.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Effect {
    /// Habituation after the step, in [0, 1].
    pub habituation: f64,
    /// Disengagement risk after the step, in [0, 1]; from the threshold on it ends the episode.
    pub disengagement: f64,
    /// The reward, in steps walked.
    pub reward: f64,
}

/// The effect of an action in a context, from the habituation and disengagement risk before it.
///
/// **Source**: Karine et al. (2023), section 3.1, "Dynamics". The disengagement risk is capped at 1
/// before it is compared with the threshold.
#[inline(always)]
pub fn apply_action(
    e: &Environment,
    context: u8,
    action: Action,
    habituation: f64,
    disengagement: f64,
) -> Effect {
    let sends = action != Action::NONE;
    let untailored = action == Action::UNTAILORED;
    let suits = action == Action::tailored_to(context);

    let (rest, habit) = ((1.0 - e.delta_h) * habituation, habituation + e.epsilon_h);
    let habit = if habit < 1.0 { habit } else { 1.0 };
    let habituation = if sends { habit } else { rest };

    let (calm, annoyed) = ((1.0 - e.delta_d) * disengagement, disengagement + e.epsilon_d);
    let annoyed = if annoyed < 1.0 { annoyed } else { 1.0 };
    let unwelcome = if sends { annoyed } else { disengagement };
    let disengagement = if untailored | suits { calm } else { unwelcome };

    let base = if untailored { e.rho_1 } else { 0.0 };
    let base = if suits { e.rho_2 } else { base };
    let mu = if context == 0 { e.mu[0] } else { e.mu[1] };
    Effect { habituation, disengagement, reward: mu + (1.0 - habituation) * base }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::TimeIndicator;
    use crate::rng::{Purpose, Stream};

    fn stream() -> Stream {
        Stream::new(1, Purpose::Environment)
    }

    fn shared() -> LaneStreams {
        LaneStreams::Shared(stream())
    }

    fn action(index: usize) -> Action {
        Action::from_index(index).unwrap()
    }

    /// Lanes at their first step.
    fn begun(
        parameters: &Environment,
        lanes: usize,
        streams: &mut LaneStreams,
    ) -> PhysicalActivity {
        let mut lanes = PhysicalActivity::new(parameters, &"P-H-D".parse().unwrap(), lanes);
        lanes.reset(LaneSet::All, streams);
        lanes
    }

    #[test]
    fn rewards_follow_the_paper_by_hand() {
        let mut lanes = begun(&Environment::paper(0.0), 4, &mut shared());
        let mut rewards = [0.0; 4];
        // Context 0 in every lane: nothing, untailored, right, wrong.
        lanes.apply_actions(&[action(0), action(1), action(2), action(3)], &mut rewards);
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a} {b}");
        for (ours, hand) in
            rewards.into_iter().zip([0.1, 0.1 + 0.85 * 50.0, 0.1 + 0.85 * 200.0, 0.1])
        {
            close(ours, hand);
        }
        for (ours, hand) in lanes.habituation().iter().zip([0.09, 0.15, 0.15, 0.15]) {
            close(*ours, hand);
        }
        for (ours, hand) in lanes.disengagement().iter().zip([0.1, 0.09, 0.09, 0.5]) {
            close(*ours, hand);
        }
    }

    #[test]
    fn disengagement_terminates_and_the_horizon_truncates() {
        let parameters = Environment { horizon: 3, ..Environment::paper(0.0) };
        let mut lanes = begun(&parameters, 2, &mut shared());
        let mut rewards = [0.0; 2];
        let mut step = |lanes: &mut PhysicalActivity, wrong_for_zero: usize| {
            lanes.apply_actions(&[action(wrong_for_zero), action(0)], &mut rewards);
            rewards
        };
        step(&mut lanes, 3);
        step(&mut lanes, 3);
        assert_eq!(lanes.statuses(), [EpisodeStatus::Running; 2]);
        assert_eq!(step(&mut lanes, 3), [0.1, 0.1]);
        assert_eq!(lanes.statuses(), [EpisodeStatus::Terminated, EpisodeStatus::Truncated]);
        assert_eq!(step(&mut lanes, 1), [0.0, 0.0]);
        assert!(!lanes.any_running());
    }

    #[test]
    fn many_lanes_pay_what_the_same_actions_pay_alone() {
        let parameters =
            Environment { first_context: FirstContext::Sampled, ..Environment::paper(0.7) };
        let mut streams = shared();
        let mut together = begun(&parameters, 5, &mut streams);
        let mut rewards = [0.0; 5];
        for t in 0..parameters.horizon as usize {
            let alone: Vec<f64> = (0..5)
                .map(|lane| {
                    let mut single = together.with_lanes(1);
                    single.times = vec![together.times[lane]];
                    single.set_context(0, together.context(lane));
                    single.habituation = vec![together.habituation[lane]];
                    single.disengagement = vec![together.disengagement[lane]];
                    single.statuses = vec![together.statuses[lane]];
                    let mut reward = [0.0];
                    single.apply_actions(&[action((t + lane) % 4)], &mut reward);
                    reward[0]
                })
                .collect();
            let actions: Vec<Action> = (0..5).map(|lane| action((t + lane) % 4)).collect();
            together.step(&actions, &mut rewards, &mut streams);
            assert_eq!(alone, rewards);
        }
        assert!(!together.any_running());
    }

    #[test]
    fn a_sampled_first_context_draws_and_a_fixed_one_does_not() {
        let mut fixed = shared();
        begun(&Environment::paper(0.6), 3, &mut fixed);
        assert_eq!(fixed.of(0).bits(), stream().bits());
        let parameters =
            Environment { first_context: FirstContext::Sampled, ..Environment::paper(0.6) };
        let mut lanes = begun(&parameters, 3, &mut shared());
        let mut again = stream();
        for lane in 0..3 {
            assert_eq!(lanes.context(lane), ContextDraw::draw(0.6, &mut again));
        }
        // A partial reset draws for the lanes that it resets, in lane order.
        let mut streams = shared();
        let kept = lanes.context(1);
        lanes.reset(LaneSet::Masked(&[true, false, true]), &mut streams);
        let mut again = stream();
        for lane in [0, 2] {
            assert_eq!(lanes.context(lane), ContextDraw::draw(0.6, &mut again));
        }
        assert_eq!(lanes.context(1), kept);
        assert_eq!(streams.of(0).position(), 2);
    }

    #[test]
    fn a_shared_stream_gives_a_word_to_every_lane_in_every_step() {
        let parameters = Environment { horizon: 2, ..Environment::paper(0.6) };
        let mut streams = shared();
        let mut lanes = begun(&parameters, 3, &mut streams);
        let mut rewards = [0.0; 3];
        lanes.step(&[action(0); 3], &mut rewards, &mut streams);
        lanes.reset(LaneSet::Masked(&[false, true, false]), &mut streams);
        for words in [6, 9, 12] {
            lanes.step(&[action(0); 3], &mut rewards, &mut streams);
            assert_eq!(streams.of(0).position(), words);
        }
    }

    fn observations(parameters: &Environment, scenario: &str, steps: usize) -> Vec<Vec<f32>> {
        let mut lane = PhysicalActivity::new(parameters, &scenario.parse().unwrap(), 1);
        lane.reset(LaneSet::All, &mut shared());
        (0..steps)
            .map(|_| {
                lane.set_context(0, ContextDraw::new(1, 0.25));
                let mut row = lane.observation_spec().observations();
                lane.observe(&mut row);
                lane.apply_actions(&[Action::UNTAILORED], &mut [0.0]);
                row.written_out()
            })
            .collect()
    }

    #[test]
    fn features_stand_in_the_order_written() {
        let environment = Environment::paper(0.6);
        assert_eq!(observations(&environment, "P-H-D", 1), [[0.25, 0.1, 0.1]]);
        assert_eq!(observations(&environment, "D-C-L", 1), [[0.1, 1.0, 1.0]]);
        let other = Environment { observed_probability: 1, ..environment };
        assert_eq!(observations(&other, "P", 1), [[0.75]]);
    }

    #[test]
    fn the_lagged_clock_shows_steps_zero_and_one_alike() {
        let times = |indicator| {
            let environment = Environment { time_indicator: indicator, ..Environment::paper(0.6) };
            observations(&environment, "T", 5).concat()
        };
        assert_eq!(times(TimeIndicator::Lagged), [0.0, 0.0, 1.0, 0.0, 1.0]);
        assert_eq!(times(TimeIndicator::Exact), [0.0, 1.0, 0.0, 1.0, 0.0]);
    }

    #[test]
    fn the_one_hot_follows_the_same_clock_and_stops_at_the_horizon() {
        let environment = Environment {
            time_one_hot: true,
            time_indicator: TimeIndicator::Exact,
            horizon: 3,
            ..Environment::paper(0.6)
        };
        let rows = observations(&environment, "L", 4);
        assert_eq!(rows[0], [1.0, 1.0, 0.0, 0.0]);
        assert_eq!(rows[1], [1.0, 0.0, 1.0, 0.0]);
        assert_eq!(rows[3], [1.0, 0.0, 0.0, 1.0]);
    }
}
