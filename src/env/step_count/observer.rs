//! Observations of a scenario from the simulation's state.

use crate::env::observation::{FeatureSpec, ObservationSpec, Observations};
use crate::env::scenario::Scenario;
use crate::env::step_count::filter::Beliefs;
use crate::env::step_count::intervention::OPTIONS;
use crate::env::step_count::parameters::{StepCount, TimeIndicator};
use crate::env::step_count::scenario::Feature;
use crate::env::vector::Action;

/// The states of the lanes of the simulation; every array is \[lanes\].
#[derive(Clone, Copy, Debug)]
pub struct LaneStates<'a> {
    /// Steps taken in the episode.
    pub times: &'a [u32],
    /// True contexts, 0 or 1.
    pub contexts: &'a [u8],
    /// Inferred probabilities of context 0.
    pub probabilities: &'a [f64],
    /// Most likely contexts, 0 or 1.
    pub likely: &'a [u8],
    /// Habituation, in [0, 1].
    pub habituation: &'a [f64],
    /// Disengagement risk, in [0, 1].
    pub disengagement: &'a [f64],
    /// Whether a message can be sent.
    pub available: &'a [bool],
    /// Messages sent in the episode.
    pub messages: &'a [u32],
    /// The action taken in the last step; `None` in the first.
    pub actions: &'a [Option<Action>],
    /// The steps walked in the last step.
    pub steps: &'a [f64],
    /// What the letters of beliefs show.
    pub beliefs: Beliefs<'a>,
}

/// The unit of the feature S, in steps.
const STEPS_UNIT: f64 = 100.0;

/// One entry of an observation.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Entry {
    /// A feature with a single entry.
    Of(Feature),
    /// Whether this action was taken in the last step.
    PreviousAction(Action),
    /// One number of an estimate.
    Estimate(Feature, Estimate),
}

/// A number of an estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Estimate {
    Mean,
    Deviation,
    /// The probability that a wrong message would end the episode.
    Near,
}

impl Estimate {
    /// The name of the entry behind the letter, and its largest value. A number between 0 and 1 deviates by 1/2 at most.
    fn described(self) -> (&'static str, f32) {
        match self {
            Estimate::Mean => ("mean", 1.0),
            Estimate::Deviation => ("sd", 0.5),
            Estimate::Near => ("near", 1.0),
        }
    }
}

/// The entries of a scenario, in the scenario's order.
fn entries(scenario: &Scenario) -> Vec<Entry> {
    let list_entries = |feature: &Feature| match feature {
        Feature::PreviousAction => {
            (0..OPTIONS).filter_map(Action::from_index).map(Entry::PreviousAction).collect()
        }
        Feature::EstimatedHabituation | Feature::EstimatedRisk => {
            [Estimate::Mean, Estimate::Deviation, Estimate::Near][..feature.width()]
                .iter()
                .map(|estimate| Entry::Estimate(*feature, *estimate))
                .collect()
        }
        feature => vec![Entry::Of(*feature)],
    };
    scenario.features().iter().flat_map(list_entries).collect()
}

/// Turns the states of lanes into observations of a scenario.
#[derive(Clone, Debug)]
pub struct Observer {
    entries: Vec<Entry>,
    observed_probability: u8,
    time_indicator: TimeIndicator,
    period: u32,
    budget: u32,
    /// The number of entries in the one-hot of time after the features; 0 without a one-hot.
    one_hot: usize,
}

impl Observer {
    /// The observer of a scenario in an environment.
    pub fn new(environment: &StepCount, scenario: &Scenario) -> Self {
        Observer {
            entries: entries(scenario),
            observed_probability: environment.observed_probability,
            time_indicator: environment.time_indicator,
            period: environment.time_indicator_period,
            budget: environment.message_budget,
            one_hot: if environment.time_one_hot { environment.horizon as usize } else { 0 },
        }
    }

    /// The specification of the observations.
    pub fn spec(&self) -> ObservationSpec {
        let spec = |entry: &Entry| match entry {
            Entry::Of(feature) => {
                let name = feature.letter().to_string();
                let (low, high) = self.bounds(*feature);
                FeatureSpec { name, low, high }
            }
            Entry::PreviousAction(action) => FeatureSpec {
                name: format!("{}{}", Feature::PreviousAction.letter(), action.index()),
                low: 0.0,
                high: 1.0,
            },
            Entry::Estimate(feature, estimate) => {
                let (suffix, high) = estimate.described();
                FeatureSpec { name: format!("{}_{suffix}", feature.letter()), low: 0.0, high }
            }
        };
        ObservationSpec { features: self.entries.iter().map(spec).collect(), one_hot: self.one_hot }
    }

    /// The smallest and largest values of a feature.
    fn bounds(&self, feature: Feature) -> (f32, f32) {
        match feature {
            Feature::Time => (0.0, self.period.saturating_sub(1) as f32),
            Feature::PreviousSteps => (f32::NEG_INFINITY, f32::INFINITY),
            Feature::Context
            | Feature::Probability
            | Feature::Likely
            | Feature::Habituation
            | Feature::Disengagement
            | Feature::Available
            | Feature::Budget
            | Feature::PreviousAction
            | Feature::Filtered
            | Feature::EstimatedHabituation
            | Feature::EstimatedRisk => (0.0, 1.0),
        }
    }

    /// Whether both observers show every state as the same observation, entry by entry.
    pub fn shows_the_same_as(&self, other: &Observer) -> bool {
        let has = |feature| self.entries.contains(&Entry::Of(feature));
        let has_clock = has(Feature::Time) || self.one_hot > 0;
        self.entries == other.entries
            && self.one_hot == other.one_hot
            && (self.observed_probability == other.observed_probability
                || !(has(Feature::Probability) || has(Feature::Filtered)))
            && (self.period == other.period || !has(Feature::Time))
            && (self.budget == other.budget || !has(Feature::Budget))
            && (self.time_indicator == other.time_indicator || !has_clock)
    }

    /// The time that the observation at `time` shows.
    #[inline]
    fn shown(&self, time: u32) -> u32 {
        match self.time_indicator {
            TimeIndicator::Lagged => time.saturating_sub(1),
            TimeIndicator::Exact => time,
        }
    }

    /// The remaining share of the budget after `messages` messages.
    #[inline]
    fn budget_left(&self, messages: u32) -> f64 {
        if self.budget == 0 {
            return 0.0;
        }
        f64::from(self.budget.saturating_sub(messages)) / f64::from(self.budget)
    }

    /// Replaces the rows of `out` by the observations of all lanes.
    ///
    /// The last entry of the one-hot of time also covers the horizon itself.
    #[inline]
    pub fn observe(&self, lanes: LaneStates<'_>, out: &mut Observations) {
        if lanes.times.len() == 1 {
            // For a single lane, filling rows is cheaper than filling columns.
            out.features.clear();
            out.features.extend(self.entries.iter().map(|entry| self.value(&lanes, *entry, 0)));
        } else {
            self.fill_columns(&lanes, &mut out.features);
        }
        out.moments.clear();
        if let Some(last) = self.one_hot.checked_sub(1) {
            let shown = lanes.times.iter().map(|time| self.shown(*time));
            out.moments.extend(shown.map(|time| time.min(last as u32)));
        }
    }

    /// An entry of the observation of a lane.
    #[inline(always)]
    fn value(&self, lanes: &LaneStates<'_>, entry: Entry, lane: usize) -> f32 {
        match entry {
            Entry::Of(Feature::Context) => f32::from(lanes.contexts[lane]),
            Entry::Of(Feature::Probability) if self.observed_probability == 0 => {
                lanes.probabilities[lane] as f32
            }
            Entry::Of(Feature::Probability) => (1.0 - lanes.probabilities[lane]) as f32,
            Entry::Of(Feature::Likely) => f32::from(lanes.likely[lane]),
            Entry::Of(Feature::Habituation) => lanes.habituation[lane] as f32,
            Entry::Of(Feature::Disengagement) => lanes.disengagement[lane] as f32,
            Entry::Of(Feature::Time) => (self.shown(lanes.times[lane]) % self.period) as f32,
            Entry::Of(Feature::Available) => f32::from(u8::from(lanes.available[lane])),
            Entry::Of(Feature::Budget) => self.budget_left(lanes.messages[lane]) as f32,
            Entry::Of(Feature::PreviousSteps) => (lanes.steps[lane] / STEPS_UNIT) as f32,
            Entry::Of(Feature::Filtered) if self.observed_probability == 0 => {
                lanes.beliefs.zero[lane] as f32
            }
            Entry::Of(Feature::Filtered) => (1.0 - lanes.beliefs.zero[lane]) as f32,
            Entry::Of(
                Feature::PreviousAction | Feature::EstimatedHabituation | Feature::EstimatedRisk,
            ) => unreachable!("it has entries of its own"),
            Entry::Estimate(feature, estimate) => {
                let Beliefs { habituation, risk, near, .. } = &lanes.beliefs;
                let of = if feature == Feature::EstimatedRisk { risk } else { habituation };
                let [mean, deviation] = of;
                match estimate {
                    Estimate::Mean => mean[lane] as f32,
                    Estimate::Deviation => deviation[lane] as f32,
                    Estimate::Near => near[lane] as f32,
                }
            }
            Entry::PreviousAction(action) => {
                f32::from(u8::from(lanes.actions[lane] == Some(action)))
            }
        }
    }

    /// Replaces `features`, \[lanes, entries\], column by column.
    #[inline]
    fn fill_columns(&self, lanes: &LaneStates<'_>, features: &mut Vec<f32>) {
        let width = self.entries.len();
        features.resize(lanes.times.len() * width, 0.0);
        for (column, entry) in self.entries.iter().enumerate() {
            let entries = features.chunks_exact_mut(width).map(|row| &mut row[column]);
            match entry {
                Entry::Of(Feature::Context) => {
                    fill(entries, lanes.contexts.iter().map(|&c| c.into()));
                }
                Entry::Of(Feature::Probability) if self.observed_probability == 0 => {
                    fill(entries, lanes.probabilities.iter().copied());
                }
                Entry::Of(Feature::Probability) => {
                    fill(entries, lanes.probabilities.iter().map(|p| 1.0 - p));
                }
                Entry::Of(Feature::Likely) => fill(entries, lanes.likely.iter().map(|&l| l.into())),
                Entry::Of(Feature::Habituation) => {
                    fill(entries, lanes.habituation.iter().copied());
                }
                Entry::Of(Feature::Disengagement) => {
                    fill(entries, lanes.disengagement.iter().copied());
                }
                entry => {
                    let entries = entries.enumerate();
                    entries.for_each(|(lane, value)| *value = self.value(lanes, *entry, lane));
                }
            }
        }
    }
}

fn fill<'a>(entries: impl Iterator<Item = &'a mut f32>, values: impl Iterator<Item = f64>) {
    entries.zip(values).for_each(|(entry, value)| *entry = value as f32);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn observers_differ_where_an_entry_of_theirs_does() {
        let paper = StepCount::paper(0.6);
        let one_hot = StepCount { time_one_hot: true, ..paper.clone() };
        type Change = fn(&mut StepCount);
        let changes: [(&str, Change, [bool; 5]); 7] = [
            // Columns: P-H-D, L-T, H with and D without the one-hot of time, and the letters about messages.
            ("sigma", |e| e.sigma = 2.0, [true, true, true, true, true]),
            (
                "observed_probability",
                |e| e.observed_probability = 1,
                [false, true, true, true, true],
            ),
            (
                "time_indicator_period",
                |e| e.time_indicator_period = 3,
                [true, false, true, true, true],
            ),
            (
                "time_indicator",
                |e| e.time_indicator = TimeIndicator::Exact,
                [true, false, false, true, true],
            ),
            ("time_one_hot", |e| e.time_one_hot ^= true, [false, false, false, false, false]),
            ("horizon", |e| e.horizon = 40, [true, true, false, true, true]),
            ("message_budget", |e| e.message_budget = 5, [true, true, true, true, false]),
        ];
        for (key, change, expected) in changes {
            let cases = [
                (&paper, "P-H-D"),
                (&paper, "L-T"),
                (&one_hot, "H"),
                (&paper, "D"),
                (&paper, "A-B-M-S"),
            ];
            for ((environment, scenario), same) in cases.into_iter().zip(expected) {
                let mut changed = environment.clone();
                change(&mut changed);
                let observer = |e: &StepCount| Observer::new(e, &scenario.parse().unwrap());
                let shows = observer(&changed).shows_the_same_as(&observer(environment));
                assert_eq!(shows, same, "{key} for {scenario}");
            }
        }
    }
}
