//! The network of the dueling DQN with a GRU.

use crate::agent::dueling_dqn::{Episodes, SequenceBatch};
use crate::agent::fused::dueling_dqn::{FusedQNetwork, action_value, action_values};
use crate::agent::fused::network::FusedNetwork;
use crate::agent::fused::recurrent_network::RecurrentNetwork;
use crate::agent::fused::sequences::{Between, Through};
use crate::agent::layers::{self, Shape};
use crate::agent::policy::ActionNetwork;
use crate::agent::{DuelingDqn, Weights, WeightsError};
use crate::env::Observations;
use crate::kernel::{Aligned, Isa};
use crate::state::resumable;

/// A dueling network with a GRU, in a flat array.
#[derive(Clone, Debug)]
pub struct FusedRecurrentDuelingNetwork(RecurrentNetwork);

impl FusedRecurrentDuelingNetwork {
    /// Computes the forward pass through the sequences of a batch and leaves the heads' outputs in
    /// `between`.
    fn forward(&mut self, batch: &SequenceBatch) {
        let RecurrentNetwork { isa, layers, parameters, between } = &mut self.0;
        layers.forward(*isa, parameters, through(batch), between);
    }
}

/// The sequences of a batch. Each begins with a memory of zeros.
fn through(batch: &SequenceBatch) -> Through<'_> {
    let SequenceBatch { lanes, observations, firsts, cuts, .. } = batch;
    Through { observations, lanes: *lanes, memory: &[], firsts, cuts }
}

impl ActionNetwork for FusedRecurrentDuelingNetwork {
    fn evaluate(&mut self, observations: &Observations, out: &mut Vec<f32>) {
        let mut memory = vec![0.0; observations.rows() * self.memory()];
        self.recall(observations, &mut memory, out);
    }

    fn memory(&self) -> usize {
        self.0.units()
    }

    fn recall(&mut self, observations: &Observations, memory: &mut [f32], out: &mut Vec<f32>) {
        out.clear();
        self.0.step(observations, memory, |advantages, value| {
            out.extend(action_values((value, advantages)));
        });
    }
}

resumable!([] FusedRecurrentDuelingNetwork { fixed 0.parameters });

impl FusedNetwork for FusedRecurrentDuelingNetwork {
    type Parameters = DuelingDqn;

    fn from_weights(
        parameters: &DuelingDqn,
        shape: Shape,
        weights: &Weights,
        isa: Isa,
    ) -> Result<Self, WeightsError> {
        let layers = layers::Recurrent::dueling(parameters, shape);
        RecurrentNetwork::new(layers, parameters.activation, weights, isa)
            .map(FusedRecurrentDuelingNetwork)
    }

    fn isa(&self) -> Isa {
        self.0.isa
    }

    fn parameters(&self) -> &Aligned {
        &self.0.parameters
    }

    fn parameters_mut(&mut self) -> &mut Aligned {
        &mut self.0.parameters
    }

    fn named(&self, flat: &[f32]) -> Weights {
        self.0.layers.store(flat)
    }
}

impl FusedQNetwork for FusedRecurrentDuelingNetwork {
    type Experience = Episodes;

    fn values(&mut self, batch: &SequenceBatch, out: &mut Vec<f32>) {
        self.forward(batch);
        let RecurrentNetwork { layers, between, .. } = &self.0;
        let width = layers.width();
        out.clear();
        for row in between.heads.known(batch.rows() * width).chunks_exact(width) {
            let (advantages, value) = layers.outputs(row);
            out.extend(action_values((value, advantages)));
        }
    }

    fn differentiate(&mut self, batch: &SequenceBatch, gradient: &mut [f32]) -> f32 {
        self.forward(batch);
        let RecurrentNetwork { isa, layers, parameters, between } = &mut self.0;
        let (rows, steps, width) = (batch.rows(), batch.steps(), layers.width());
        let Between { heads, by_heads, .. } = &mut *between;
        let (heads, by_heads) = (heads.known(rows * width), by_heads.of(rows * width));
        let mut squares = 0.0;
        let each = heads.chunks_exact(width).zip(by_heads.chunks_exact_mut(width));
        for (row, (heads, by_heads)) in each.enumerate() {
            by_heads.fill(0.0);
            if !batch.learned[row] {
                continue;
            }
            let (advantages, value) = layers.outputs(heads);
            let action = batch.actions[row].index();
            let error = action_value((value, advantages), action) - batch.targets[row];
            squares += f64::from(error) * f64::from(error);
            let by_value = 2.0 * error / steps as f32;
            let (by_advantages, by_state) = layers.outputs_mut(by_heads);
            by_advantages.fill(-by_value / by_advantages.len() as f32);
            by_advantages[action] += by_value;
            *by_state = by_value;
        }
        layers.backward(*isa, parameters, through(batch), between, gradient);
        (squares / steps as f64) as f32
    }
}
