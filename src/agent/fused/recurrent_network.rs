//! A network with a GRU, evaluated one step at a time.

use crate::agent::fused::recurrent::RecurrentLayers;
use crate::agent::fused::sequences::{Between, Through};
use crate::agent::{Activation, Weights, WeightsError, layers};
use crate::env::Observations;
use crate::kernel::{Aligned, Isa};

/// Outputs for the actions and a value that share a GRU, in a flat array.
#[derive(Clone, Debug)]
pub(super) struct RecurrentNetwork {
    pub(super) isa: Isa,
    pub(super) layers: RecurrentLayers,
    pub(super) parameters: Aligned,
    pub(super) between: Between,
}

impl RecurrentNetwork {
    /// A network with these weights.
    ///
    /// **Errors**: an array is missing or of another shape.
    pub(super) fn new(
        layers: layers::Recurrent,
        activation: Activation,
        weights: &Weights,
        isa: Isa,
    ) -> Result<Self, WeightsError> {
        let layers = RecurrentLayers::new(layers, activation);
        let mut parameters = Aligned::zeros(layers.len());
        layers.load(weights, &mut parameters)?;
        Ok(RecurrentNetwork { isa, between: layers.between(), layers, parameters })
    }

    /// Size of the network's memory of an episode, in numbers.
    pub(super) fn units(&self) -> usize {
        self.layers.units
    }

    /// Advances the memory, \[rows, units\], by one step, and calls `each` with the action outputs
    /// and the value of every row.
    pub(super) fn step(
        &mut self,
        observations: &Observations,
        memory: &mut [f32],
        mut each: impl FnMut(&[f32], f32),
    ) {
        let RecurrentNetwork { isa, layers, parameters, between } = self;
        let lanes = observations.rows();
        let through = Through { observations, lanes, memory, firsts: &[], cuts: &[] };
        layers.forward(*isa, parameters, through, between);
        layers.last_states(lanes, between, memory);
        let width = layers.width();
        for row in between.heads.known(lanes * width).chunks_exact(width) {
            let (of_actions, value) = layers.outputs(row);
            each(of_actions, value);
        }
    }
}
