//! What a scenario shows of the simulation's state.

use crate::env::observation::{FeatureSpec, ObservationSpec, Observations};
use crate::env::parameters::{Environment, TimeIndicator};
use crate::env::scenario::{Feature, Scenario};

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
}

/// Turns the states of lanes into the observations of a scenario.
#[derive(Clone, Debug)]
pub struct Observer {
    features: Vec<Feature>,
    observed_probability: u8,
    time_indicator: TimeIndicator,
    period: u32,
    /// Entries of the one-hot of time behind the features; 0 without one.
    one_hot: usize,
}

impl Observer {
    /// The observer of a scenario in an environment.
    pub fn new(environment: &Environment, scenario: &Scenario) -> Self {
        Observer {
            features: scenario.features().to_vec(),
            observed_probability: environment.observed_probability,
            time_indicator: environment.time_indicator,
            period: environment.time_indicator_period,
            one_hot: if environment.time_one_hot { environment.horizon as usize } else { 0 },
        }
    }

    /// What its observations consist of.
    pub fn spec(&self) -> ObservationSpec {
        let spec = |feature: &Feature| FeatureSpec {
            name: feature.letter().to_string(),
            low: 0.0,
            high: match feature {
                Feature::Time => self.period.saturating_sub(1) as f32,
                Feature::Context
                | Feature::Probability
                | Feature::Likely
                | Feature::Habituation
                | Feature::Disengagement => 1.0,
            },
        };
        ObservationSpec {
            features: self.features.iter().map(spec).collect(),
            one_hot: self.one_hot,
        }
    }

    /// Whether the same state gives the same observation here and there, entry by entry.
    pub fn shows_the_same_as(&self, other: &Observer) -> bool {
        let has = |feature| self.features.contains(&feature);
        let has_clock = has(Feature::Time) || self.one_hot > 0;
        self.features == other.features
            && self.one_hot == other.one_hot
            && (self.observed_probability == other.observed_probability
                || !has(Feature::Probability))
            && (self.period == other.period || !has(Feature::Time))
            && (self.time_indicator == other.time_indicator || !has_clock)
    }

    /// The time that an observation shows at a time.
    #[inline]
    fn shown(&self, time: u32) -> u32 {
        match self.time_indicator {
            TimeIndicator::Lagged => time.saturating_sub(1),
            TimeIndicator::Exact => time,
        }
    }

    /// Replaces the rows of `out` by the observation of every lane.
    ///
    /// The last entry of the one-hot of time also stands for the horizon itself.
    #[inline]
    pub fn observe(&self, lanes: LaneStates<'_>, out: &mut Observations) {
        let LaneStates { times, contexts, probabilities, likely, habituation, disengagement } =
            lanes;
        let width = self.features.len();
        if let [time] = times {
            // Columns of one entry are not worth the strides.
            out.features.clear();
            out.features.extend(self.features.iter().map(|feature| match feature {
                Feature::Context => f32::from(contexts[0]),
                Feature::Probability if self.observed_probability == 0 => probabilities[0] as f32,
                Feature::Probability => (1.0 - probabilities[0]) as f32,
                Feature::Likely => f32::from(likely[0]),
                Feature::Habituation => habituation[0] as f32,
                Feature::Disengagement => disengagement[0] as f32,
                Feature::Time => (self.shown(*time) % self.period) as f32,
            }));
            out.moments.clear();
            if let Some(last) = self.one_hot.checked_sub(1) {
                out.moments.push(self.shown(*time).min(last as u32));
            }
            return;
        }
        let shown = times.iter().map(|time| self.shown(*time));
        out.features.resize(times.len() * width, 0.0);
        for (column, feature) in self.features.iter().enumerate() {
            let entries = out.features.chunks_exact_mut(width).map(|row| &mut row[column]);
            match feature {
                Feature::Context => fill(entries, contexts.iter().map(|&c| c.into())),
                Feature::Probability if self.observed_probability == 0 => {
                    fill(entries, probabilities.iter().copied());
                }
                Feature::Probability => fill(entries, probabilities.iter().map(|p| 1.0 - p)),
                Feature::Likely => fill(entries, likely.iter().map(|&l| l.into())),
                Feature::Habituation => fill(entries, habituation.iter().copied()),
                Feature::Disengagement => fill(entries, disengagement.iter().copied()),
                Feature::Time => fill(entries, shown.clone().map(|t| (t % self.period).into())),
            }
        }
        out.moments.clear();
        if let Some(last) = self.one_hot.checked_sub(1) {
            out.moments.extend(shown.map(|time| time.min(last as u32)));
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
        let paper = Environment::paper(0.6);
        let one_hot = Environment { time_one_hot: true, ..paper.clone() };
        type Change = fn(&mut Environment);
        let changes: [(&str, Change, [bool; 4]); 6] = [
            // Of P-H-D, L-T, H with and D without the one-hot of time.
            ("sigma", |e| e.sigma = 2.0, [true, true, true, true]),
            ("observed_probability", |e| e.observed_probability = 1, [false, true, true, true]),
            ("time_indicator_period", |e| e.time_indicator_period = 3, [true, false, true, true]),
            (
                "time_indicator",
                |e| e.time_indicator = TimeIndicator::Exact,
                [true, false, false, true],
            ),
            ("time_one_hot", |e| e.time_one_hot ^= true, [false, false, false, false]),
            ("horizon", |e| e.horizon = 40, [true, true, false, true]),
        ];
        for (key, change, expected) in changes {
            let cases = [(&paper, "P-H-D"), (&paper, "L-T"), (&one_hot, "H"), (&paper, "D")];
            for ((environment, scenario), same) in cases.into_iter().zip(expected) {
                let mut changed = environment.clone();
                change(&mut changed);
                let observer = |e: &Environment| Observer::new(e, &scenario.parse().unwrap());
                let shows = observer(&changed).shows_the_same_as(&observer(environment));
                assert_eq!(shows, same, "{key} for {scenario}");
            }
        }
    }
}
