//! Observations: rows of numbers that agents see, and the specification of what they consist of.

use std::collections::TryReserveError;
use std::io;
use std::ops::Range;

use crate::state::{Resumable, StateError, StateReader, StateWriter};

/// What an observation consists of: features, and perhaps a one-hot of time.
#[derive(Clone, Debug, PartialEq)]
pub struct ObservationSpec {
    /// The features, in the order of an observation's entries.
    pub features: Vec<FeatureSpec>,
    /// Entries of the one-hot of time behind the features; 0 without one.
    pub one_hot: usize,
}

/// One feature of an observation.
#[derive(Clone, Debug, PartialEq)]
pub struct FeatureSpec {
    /// Its name.
    pub name: String,
    /// The smallest value.
    pub low: f32,
    /// The largest value.
    pub high: f32,
}

impl ObservationSpec {
    /// Features by their names with their smallest and largest values, without a one-hot of time.
    pub fn of<const N: usize>(features: [(&str, f32, f32); N]) -> Self {
        let feature = |(name, low, high): (&str, f32, f32)| {
            let name = name.to_owned();
            FeatureSpec { name, low, high }
        };
        ObservationSpec { features: features.into_iter().map(feature).collect(), one_hot: 0 }
    }

    /// Entries of an observation with its one-hot written out.
    pub fn inputs(&self) -> usize {
        self.features.len() + self.one_hot
    }

    /// Observations without a row, of this shape.
    pub fn observations(&self) -> Observations {
        Observations::new(self.features.len(), self.one_hot)
    }
}

/// Observations of an agent, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct Observations {
    width: usize,
    one_hot: usize,
    /// \[rows, width\]: the scenario's features, in its order.
    pub(super) features: Vec<f32>,
    /// \[rows\]: which entry of the one-hot of time is 1; empty where there is no one-hot.
    pub(super) moments: Vec<u32>,
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
    #[inline]
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

impl Resumable for Observations {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        out.many(self.features())?;
        out.many(self.moments())
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        const WHAT: &str = "observations";
        let features: Vec<f32> = from.many(usize::MAX, WHAT)?;
        let moments: Vec<u32> = from.many(usize::MAX, WHAT)?;
        let rows = features.len() / self.width();
        let expected = if self.one_hot() > 0 { rows } else { 0 };
        let whole = features.len().is_multiple_of(self.width()) && moments.len() == expected;
        if !whole || moments.iter().any(|moment| *moment as usize >= self.one_hot()) {
            return Err(StateError::Misfit(WHAT));
        }
        self.clear();
        for (row, features) in features.chunks_exact(self.width()).enumerate() {
            self.push(features, moments.get(row).copied());
        }
        Ok(())
    }
}
