//! Input sequences of a network with a GRU, and buffers for the values between its layers.

use crate::env::Observations;
use crate::kernel::Aligned;

/// Values between the layers for every row of some sequences: \[rows, width\] of each layer.
#[derive(Clone, Debug, Default)]
pub(super) struct Between {
    pub(super) input: Room,
    /// Units of the hidden layers in front of the GRU (`before`) and behind it (`after`).
    pub(super) before: Vec<Room>,
    pub(super) after: Vec<Room>,
    /// The gates, and the contribution of the state to them. The gates start as the contribution of
    /// the input. The backward pass replaces `from_state` by derivatives.
    pub(super) gates: Room,
    pub(super) from_state: Room,
    pub(super) states_before: Room,
    pub(super) states_after: Room,
    pub(super) heads: Room,
    /// Derivatives by the heads' outputs.
    pub(super) by_heads: Room,
    pub(super) by_input: Room,
    pub(super) by_units: Room,
    pub(super) by_active: Room,
    pub(super) by_states: Room,
    pub(super) ones: Room,
    /// The transposed weights of every layer but the first, in the order of the layers.
    pub(super) transposed: Vec<Room>,
}

/// A buffer that only grows.
#[derive(Clone, Debug)]
pub(super) struct Room(Aligned);

impl Default for Room {
    fn default() -> Self {
        Room(Aligned::zeros(0))
    }
}

impl Room {
    /// The first `len` values; their content is unspecified.
    pub(super) fn of(&mut self, len: usize) -> &mut [f32] {
        if self.0.len() < len {
            self.0 = Aligned::zeros(len);
        }
        &mut self.0[..len]
    }

    /// The first `len` values, which must have been written before.
    pub(super) fn known(&self, len: usize) -> &[f32] {
        &self.0[..len]
    }
}

/// `lanes` sequences, side by side.
#[derive(Clone, Copy)]
pub(super) struct Through<'a> {
    pub(super) observations: &'a Observations,
    pub(super) lanes: usize,
    /// \[lanes, units\]: the states before the first step.
    pub(super) memory: &'a [f32],
    /// \[rows\]: whether a step is the first of an episode; empty if no episode begins.
    pub(super) firsts: &'a [bool],
    /// \[rows\]: whether no gradient passes from a step to the step before; empty if all gradients
    /// pass.
    pub(super) cuts: &'a [bool],
}

impl Through<'_> {
    /// Number of rows: steps times lanes.
    pub(super) fn rows(&self) -> usize {
        self.observations.rows()
    }
}
