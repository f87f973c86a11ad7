//! What an agent sees of the episodes.

use crate::env::Episodes;
use crate::manifest::{Environment, Feature, Scenario, TimeIndicator};

/// Turns the state of episodes into observations of a scenario.
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

    /// Entries of one observation.
    pub fn width(&self) -> usize {
        self.features.len() + self.one_hot
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

    /// Writes the observation of every lane.
    ///
    /// **Shapes**: `out` is \[lanes, width\], row by row; entries in the scenario's order, then the
    /// one-hot of time, whose last entry also stands for the horizon itself.
    pub fn observe(&self, episodes: &Episodes, out: &mut [f32]) {
        assert_eq!(out.len(), episodes.lanes() * self.width(), "an observation a lane");
        let shown = match self.time_indicator {
            TimeIndicator::Lagged => episodes.time().saturating_sub(1),
            TimeIndicator::Exact => episodes.time(),
        };
        for (lane, row) in out.chunks_exact_mut(self.width()).enumerate() {
            let (entries, one_hot) = row.split_at_mut(self.features.len());
            for (entry, feature) in entries.iter_mut().zip(&self.features) {
                *entry = self.entry(*feature, episodes, lane, shown) as f32;
            }
            one_hot.fill(0.0);
            if let Some(last) = self.one_hot.checked_sub(1) {
                one_hot[(shown as usize).min(last)] = 1.0;
            }
        }
    }

    fn entry(&self, feature: Feature, episodes: &Episodes, lane: usize, shown: u32) -> f64 {
        let signal = episodes.signal(lane);
        match feature {
            Feature::Context => f64::from(signal.context),
            Feature::Probability if self.observed_probability == 0 => signal.probability_of_zero,
            Feature::Probability => 1.0 - signal.probability_of_zero,
            Feature::Likely => f64::from(signal.likely),
            Feature::Habituation => episodes.habituation()[lane],
            Feature::Disengagement => episodes.disengagement()[lane],
            Feature::Time => f64::from(shown % self.period),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::{Action, Signal};
    use crate::rng::{Purpose, Stream};

    fn observations(environment: &Environment, scenario: &str, steps: usize) -> Vec<Vec<f32>> {
        let observer = Observer::new(environment, &scenario.parse().unwrap());
        let mut stream = Stream::new(1, Purpose::Environment);
        let mut episodes = Episodes::start(environment, 1, &mut stream);
        (0..steps)
            .map(|_| {
                episodes.show(0, Signal::new(1, 0.25));
                let mut row = vec![f32::NAN; observer.width()];
                observer.observe(&episodes, &mut row);
                episodes.respond(&[Action::UNTAILORED], &mut [0.0]);
                row
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
