//! What both directions are given: the parameters of a network, and its inputs.

use crate::kernel::LANES;

/// Outputs of such a network.
pub const OUTPUTS: usize = 4;
/// Most inputs of such a network, its one-hot aside.
pub const MOST_INPUTS: usize = 6;

/// The parameters of a network, and what it is given.
#[derive(Clone, Copy, Debug)]
pub struct Shallow<'a> {
    /// \[inputs and entries of the one-hot, units\], row by row.
    pub weight: &'a [f32],
    /// \[units\]; a multiple of [`LANES`].
    pub bias: &'a [f32],
    /// \[outputs, units\], row by row.
    pub head: &'a [f32],
    /// \[rows, inputs\], row by row; at least one and at most [`MOST_INPUTS`] inputs.
    pub inputs: &'a [f32],
    /// \[rows\]: which entry of the one-hot is 1; empty where there is none.
    pub moments: &'a [u32],
    /// How many rows there are.
    pub rows: usize,
}

/// The gradient by the parameters, laid out as they are; it is added to.
#[derive(Debug)]
pub struct ShallowGradient<'a> {
    /// See [`Shallow::weight`].
    pub weight: &'a mut [f32],
    /// See [`Shallow::bias`].
    pub bias: &'a mut [f32],
    /// See [`Shallow::head`].
    pub head: &'a mut [f32],
}

impl Shallow<'_> {
    /// **Panics**: sizes do not fit each other.
    pub(super) fn check(&self) {
        assert!(self.rows > 0, "at least one row");
        assert_eq!(self.bias.len() % LANES, 0, "rows are padded");
        assert_eq!(self.head.len(), OUTPUTS * self.bias.len(), "a row for every output");
        assert_eq!(self.inputs.len() % self.rows, 0, "as many inputs in every row");
        assert!([0, self.rows].contains(&self.moments.len()), "a moment for every row, or none");
    }
}
