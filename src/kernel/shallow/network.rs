//! The arguments of both directions: the parameters of a network and its inputs.

use crate::kernel::LANES;

/// The number of outputs of the network.
pub const OUTPUTS: usize = 4;
/// The most inputs of the network, without its one-hot.
pub const MOST_INPUTS: usize = 6;

/// The parameters of a network and its inputs.
#[derive(Clone, Copy, Debug)]
pub struct Shallow<'a> {
    /// \[inputs and entries of the one-hot, units\], row-major.
    pub weight: &'a [f32],
    /// \[units\]; a multiple of [`LANES`].
    pub bias: &'a [f32],
    /// \[outputs, units\], row-major.
    pub head: &'a [f32],
    /// \[rows, inputs\], row-major; 1 to [`MOST_INPUTS`] inputs.
    pub inputs: &'a [f32],
    /// \[rows\]: the index of the one-hot entry that is 1; empty without a one-hot.
    pub moments: &'a [u32],
    /// The number of rows.
    pub rows: usize,
}

/// The gradient with respect to the parameters, in the same layout; new gradients are added to it.
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
    /// Checks the sizes. **Panics** if they do not match.
    pub(super) fn check(&self) {
        assert!(self.rows > 0, "at least one row");
        assert_eq!(self.bias.len() % LANES, 0, "rows are padded");
        assert_eq!(self.head.len(), OUTPUTS * self.bias.len(), "a row for every output");
        assert_eq!(self.inputs.len() % self.rows, 0, "as many inputs in every row");
        assert!([0, self.rows].contains(&self.moments.len()), "a moment for every row, or none");
    }
}
