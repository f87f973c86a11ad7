//! Networks with one hidden layer of rectified linear units and four outputs, without storing the
//! hidden units.
//!
//! The results are those of [`crate::kernel::Product`], the activation and [`crate::kernel::dot`]
//! one after the other, to the bit.

mod backward;
mod forward;

use crate::kernel::{Isa, LANES};
use backward::Backward;
use forward::Forward;

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
    fn check(&self) {
        assert!(self.rows > 0, "at least one row");
        assert_eq!(self.bias.len() % LANES, 0, "rows are padded");
        assert_eq!(self.head.len(), OUTPUTS * self.bias.len(), "a row for every output");
        assert_eq!(self.inputs.len() % self.rows, 0, "as many inputs in every row");
        assert!([0, self.rows].contains(&self.moments.len()), "a moment for every row, or none");
    }

    /// Writes the outputs, \[rows, outputs\], row by row, with `start`, \[outputs\], added.
    pub fn forward(self, isa: Isa, start: &[f32], out: &mut [f32]) {
        self.check();
        assert_eq!(out.len(), self.rows * OUTPUTS, "outputs for every row");
        match self.inputs.len() / self.rows {
            1 => isa.run(Forward::<1> { network: self, start, out }),
            2 => isa.run(Forward::<2> { network: self, start, out }),
            3 => isa.run(Forward::<3> { network: self, start, out }),
            4 => isa.run(Forward::<4> { network: self, start, out }),
            5 => isa.run(Forward::<5> { network: self, start, out }),
            6 => isa.run(Forward::<6> { network: self, start, out }),
            inputs => panic!("{inputs} inputs are more than {MOST_INPUTS}"),
        }
    }

    /// Adds the gradient that the derivatives by the outputs make: \[rows, outputs\], row by row.
    pub fn backward(self, isa: Isa, by_outputs: &[f32], gradient: ShallowGradient<'_>) {
        self.check();
        assert_eq!(by_outputs.len(), self.rows * OUTPUTS, "derivatives for every row");
        match self.inputs.len() / self.rows {
            1 => isa.run(Backward::<1> { network: self, by_outputs, gradient }),
            2 => isa.run(Backward::<2> { network: self, by_outputs, gradient }),
            3 => isa.run(Backward::<3> { network: self, by_outputs, gradient }),
            4 => isa.run(Backward::<4> { network: self, by_outputs, gradient }),
            5 => isa.run(Backward::<5> { network: self, by_outputs, gradient }),
            6 => isa.run(Backward::<6> { network: self, by_outputs, gradient }),
            inputs => panic!("{inputs} inputs are more than {MOST_INPUTS}"),
        }
    }
}
