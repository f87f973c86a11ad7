//! Observations: rows of numbers that agents see, and their specification.

use std::collections::TryReserveError;
use std::ops::Range;

use crate::state::resumable;

/// The specification of an observation: features, and an optional one-hot of time.
#[derive(Clone, Debug, PartialEq)]
pub struct ObservationSpec {
    /// The features, in the order of an observation's entries.
    pub features: Vec<FeatureSpec>,
    /// The number of entries in the one-hot of time after the features; 0 without a one-hot.
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
    /// Features from their names and smallest and largest values, without a one-hot of time.
    pub fn of<const N: usize>(features: [(&str, f32, f32); N]) -> Self {
        let feature = |(name, low, high): (&str, f32, f32)| {
            let name = name.to_owned();
            FeatureSpec { name, low, high }
        };
        ObservationSpec { features: features.into_iter().map(feature).collect(), one_hot: 0 }
    }

    /// The number of entries of an observation, with its one-hot expanded.
    pub fn inputs(&self) -> usize {
        self.features.len() + self.one_hot
    }

    /// Empty observations of this shape.
    pub fn observations(&self) -> Observations {
        Observations::new(self.features.len(), self.one_hot)
    }
}

/// Observations of an agent, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct Observations {
    width: usize,
    one_hot: usize,
    /// \[rows, width\]: the scenario's features, in the scenario's order.
    pub(super) features: Vec<f32>,
    /// \[rows\]: the index of the one-hot entry that is 1; empty without a one-hot.
    pub(super) moments: Vec<u32>,
}

impl Observations {
    /// Empty observations of `width` features and a one-hot of time with `one_hot` entries; 0 for no one-hot.
    pub fn new(width: usize, one_hot: usize) -> Self {
        Observations { width, one_hot, features: Vec::new(), moments: Vec::new() }
    }

    /// The number of rows.
    pub fn rows(&self) -> usize {
        self.features.len().checked_div(self.width).unwrap_or(0)
    }

    /// The number of features per row, without the one-hot.
    pub fn width(&self) -> usize {
        self.width
    }

    /// The number of entries in the one-hot of time; 0 without a one-hot.
    pub fn one_hot(&self) -> usize {
        self.one_hot
    }

    /// \[rows, width\]: the features, row-major.
    pub fn features(&self) -> &[f32] {
        &self.features
    }

    /// \[rows\]: the index of the one-hot entry that is 1; empty without a one-hot.
    pub fn moments(&self) -> &[u32] {
        &self.moments
    }

    /// The features of a row.
    pub fn row(&self, row: usize) -> &[f32] {
        &self.features[row * self.width..(row + 1) * self.width]
    }

    /// The index of the entry that is 1 in a row's one-hot; `None` without a one-hot.
    pub fn moment(&self, row: usize) -> Option<u32> {
        self.moments.get(row).copied()
    }

    /// Reserves room for `rows` more rows.
    ///
    /// **Errors**: there is not enough memory.
    #[inline]
    pub fn try_reserve(&mut self, rows: usize) -> Result<(), TryReserveError> {
        self.features.try_reserve(rows * self.width)?;
        self.moments.try_reserve(if self.one_hot > 0 { rows } else { 0 })
    }

    /// Removes all rows.
    pub fn clear(&mut self) {
        self.features.clear();
        self.moments.clear();
    }

    /// Appends a row; `moment` must be given if and only if there is a one-hot.
    pub fn push(&mut self, features: &[f32], moment: Option<u32>) {
        assert_eq!(features.len(), self.width, "a row of features");
        assert_eq!(moment.is_some(), self.one_hot > 0, "a moment for the one-hot");
        self.features.extend_from_slice(features);
        self.moments.extend(moment);
    }

    /// Appends a range of rows from other observations of the same shape.
    #[inline]
    pub fn extend(&mut self, others: &Observations, rows: Range<usize>) {
        assert_eq!((self.width, self.one_hot), (others.width, others.one_hot), "rows as wide");
        let features = rows.start * self.width..rows.end * self.width;
        self.features.extend_from_slice(&others.features[features]);
        self.moments.extend_from_slice(others.moments.get(rows).unwrap_or_default());
    }

    /// Replaces a row by the same row of other observations of the same shape.
    pub fn copy_row(&mut self, row: usize, others: &Observations) {
        let features = row * self.width..(row + 1) * self.width;
        self.features[features].copy_from_slice(others.row(row));
        if let Some(moment) = others.moment(row) {
            self.moments[row] = moment;
        }
    }

    /// Removes and returns all rows with their one-hots expanded: \[rows, width + one_hot\]. Copies nothing
    /// if there is no one-hot.
    pub fn take_written_out(&mut self) -> Vec<f32> {
        let rows =
            if self.one_hot == 0 { std::mem::take(&mut self.features) } else { self.written_out() };
        self.clear();
        rows
    }

    /// The rows with their one-hots expanded: \[rows, width + one_hot\].
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

resumable!([] Observations { grown features, moments; check fits, "observations" });

impl Observations {
    /// Whether the arrays are of whole rows, with moments of the one-hot.
    fn fits(&self) -> bool {
        let moments = if self.one_hot > 0 { self.rows() } else { 0 };
        self.features.len().is_multiple_of(self.width)
            && self.moments.len() == moments
            && self.moments.iter().all(|moment| (*moment as usize) < self.one_hot)
    }
}
