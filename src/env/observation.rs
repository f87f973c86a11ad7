//! What an agent sees of the episodes.

use std::collections::TryReserveError;
use std::iter;
use std::ops::Range;

use crate::env::Episodes;
use crate::env::{Environment, Feature, Scenario, TimeIndicator};

/// Observations of an agent, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct Observations {
    width: usize,
    one_hot: usize,
    /// \[rows, width\]: the scenario's features, in its order.
    features: Vec<f32>,
    /// \[rows\]: which entry of the one-hot of time is 1; empty where there is no one-hot.
    moments: Vec<u32>,
}

impl Observations {
    /// No rows, for `width` features and a one-hot of time of `one_hot` entries (0 for none).
    pub fn new(width: usize, one_hot: usize) -> Self {
        Observations { width, one_hot, features: Vec::new(), moments: Vec::new() }
    }

    /// How many there are.
    pub fn rows(&self) -> usize {
        self.features.len() / self.width
    }

    /// Features of a row, the one-hot aside.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Entries of the one-hot of time; 0 without one.
    pub fn one_hot(&self) -> usize {
        self.one_hot
    }

    /// \[rows, width\]: the features, row by row.
    pub fn features(&self) -> &[f32] {
        &self.features
    }

    /// \[rows\]: which entry of the one-hot is 1; empty where there is no one-hot.
    pub fn moments(&self) -> &[u32] {
        &self.moments
    }

    /// The features of a row.
    pub fn row(&self, row: usize) -> &[f32] {
        &self.features[row * self.width..(row + 1) * self.width]
    }

    /// Which entry of a row's one-hot is 1; `None` where there is no one-hot.
    pub fn moment(&self, row: usize) -> Option<u32> {
        self.moments.get(row).copied()
    }

    /// Makes room for so many more rows.
    ///
    /// **Errors**: there is no memory for them.
    pub fn try_reserve(&mut self, rows: usize) -> Result<(), TryReserveError> {
        self.features.try_reserve(rows * self.width)?;
        self.moments.try_reserve(if self.one_hot > 0 { rows } else { 0 })
    }

    /// Removes every row.
    pub fn clear(&mut self) {
        self.features.clear();
        self.moments.clear();
    }

    /// Adds a row; `moment` is given exactly where there is a one-hot.
    pub fn push(&mut self, features: &[f32], moment: Option<u32>) {
        assert_eq!(features.len(), self.width, "a row of features");
        assert_eq!(moment.is_some(), self.one_hot > 0, "a moment for the one-hot");
        self.features.extend_from_slice(features);
        self.moments.extend(moment);
    }

    /// Adds a range of the rows of others as wide as these.
    pub fn extend(&mut self, others: &Observations, rows: Range<usize>) {
        assert_eq!((self.width, self.one_hot), (others.width, others.one_hot), "rows as wide");
        let features = rows.start * self.width..rows.end * self.width;
        self.features.extend_from_slice(&others.features[features]);
        self.moments.extend_from_slice(others.moments.get(rows).unwrap_or_default());
    }

    /// The rows with their one-hots written out: \[rows, width + one_hot\].
    pub fn written_out(&self) -> Vec<f32> {
        let mut all = Vec::with_capacity(self.rows() * (self.width + self.one_hot));
        for row in 0..self.rows() {
            all.extend_from_slice(self.row(row));
            let one_hot = all.len();
            all.resize(one_hot + self.one_hot, 0.0);
            if let Some(moment) = self.moment(row) {
                all[one_hot + moment as usize] = 1.0;
            }
        }
        all
    }
}

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

    /// Entries of an observation with its one-hot written out.
    pub fn inputs(&self) -> usize {
        self.features.len() + self.one_hot
    }

    /// Observations without a row, as wide as this observer's.
    pub fn observations(&self) -> Observations {
        Observations::new(self.features.len(), self.one_hot)
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

    /// Replaces the rows of `out` by the observation of every lane.
    ///
    /// The last entry of the one-hot of time also stands for the horizon itself.
    pub fn observe(&self, episodes: &Episodes, out: &mut Observations) {
        let lanes = episodes.lanes();
        let width = self.features.len();
        let shown = match self.time_indicator {
            TimeIndicator::Lagged => episodes.time().saturating_sub(1),
            TimeIndicator::Exact => episodes.time(),
        };
        out.features.resize(lanes * width, 0.0);
        for (column, feature) in self.features.iter().enumerate() {
            let entries = out.features.chunks_exact_mut(width).map(|row| &mut row[column]);
            let probabilities = episodes.probabilities();
            match feature {
                Feature::Context => fill(entries, episodes.contexts().iter().map(|&c| c.into())),
                Feature::Probability if self.observed_probability == 0 => {
                    fill(entries, probabilities.iter().copied());
                }
                Feature::Probability => fill(entries, probabilities.iter().map(|p| 1.0 - p)),
                Feature::Likely => fill(entries, episodes.likely().iter().map(|&l| l.into())),
                Feature::Habituation => fill(entries, episodes.habituation().iter().copied()),
                Feature::Disengagement => fill(entries, episodes.disengagement().iter().copied()),
                Feature::Time => {
                    fill(entries, iter::repeat_n(f64::from(shown % self.period), lanes));
                }
            }
        }
        out.moments.clear();
        if let Some(last) = self.one_hot.checked_sub(1) {
            out.moments.resize(lanes, shown.min(last as u32));
        }
    }
}

fn fill<'a>(entries: impl Iterator<Item = &'a mut f32>, values: impl Iterator<Item = f64>) {
    entries.zip(values).for_each(|(entry, value)| *entry = value as f32);
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
                let mut row = observer.observations();
                observer.observe(&episodes, &mut row);
                episodes.respond(&[Action::UNTAILORED], &mut [0.0]);
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
