//! Updates of the dueling DQN with a GRU.

use crate::agent::dueling_dqn::{RecurrentDqnEngine, SequenceBatch};
use crate::agent::fused::dueling_dqn::{action_value, action_values};
use crate::agent::fused::recurrent_network::RecurrentNetwork;
use crate::agent::fused::sequences::{Between, Through};
use crate::agent::layers::{self, Shape};
use crate::agent::policy::ActionNetwork;
use crate::agent::{DuelingDqn, Weights, WeightsError};
use crate::env::Observations;
use crate::kernel::{Adam, Aligned, Isa};
use crate::state::resumable;

/// A dueling network with a GRU, in a flat array.
#[derive(Clone, Debug)]
pub struct FusedRecurrentDuelingNetwork(RecurrentNetwork);

impl FusedRecurrentDuelingNetwork {
    /// A network with these weights, of this shape.
    ///
    /// **Errors**: an array is missing or of another shape.
    pub fn new(
        parameters: &DuelingDqn,
        shape: Shape,
        weights: &Weights,
        isa: Isa,
    ) -> Result<Self, WeightsError> {
        let layers = layers::Recurrent::dueling(parameters, shape);
        RecurrentNetwork::new(layers, parameters.activation, weights, isa)
            .map(FusedRecurrentDuelingNetwork)
    }

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

/// A dueling network with a GRU, its target network and its optimiser.
#[derive(Clone, Debug)]
pub struct FusedRecurrentDqn {
    network: FusedRecurrentDuelingNetwork,
    target: FusedRecurrentDuelingNetwork,
    gradient: Aligned,
    adam: Adam,
}

impl FusedRecurrentDqn {
    /// An engine that starts from these weights, of this shape.
    ///
    /// **Errors**: the weights do not fit the network.
    pub fn new(
        parameters: &DuelingDqn,
        shape: Shape,
        weights: &Weights,
        isa: Isa,
    ) -> Result<Self, WeightsError> {
        let network = FusedRecurrentDuelingNetwork::new(parameters, shape, weights, isa)?;
        let numbers = network.0.parameters.len();
        Ok(FusedRecurrentDqn {
            gradient: Aligned::zeros(numbers),
            adam: Adam::new(parameters.learning_rate, numbers),
            target: network.clone(),
            network,
        })
    }

    /// The gradient of the loss of a batch, by the names of the weights.
    pub fn gradient(&mut self, batch: &SequenceBatch) -> Weights {
        self.gradient.fill(0.0);
        self.differentiate(batch);
        let gradient = self.network.0.layers.store(&self.gradient);
        self.gradient.fill(0.0);
        gradient
    }

    /// Returns the loss of a batch and adds its gradient to the stored gradient.
    fn differentiate(&mut self, batch: &SequenceBatch) -> f32 {
        let FusedRecurrentDqn { network, gradient, .. } = self;
        network.forward(batch);
        let RecurrentNetwork { isa, layers, parameters, between } = &mut network.0;
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

impl RecurrentDqnEngine for FusedRecurrentDqn {
    type Network = FusedRecurrentDuelingNetwork;

    fn memory(&self) -> usize {
        self.network.memory()
    }

    fn values(&mut self, observations: &Observations, memory: &mut [f32], out: &mut Vec<f32>) {
        self.network.recall(observations, memory, out);
    }

    fn target_values(&mut self, batch: &SequenceBatch, out: &mut Vec<f32>) {
        self.target.forward(batch);
        let RecurrentNetwork { layers, between, .. } = &self.target.0;
        let width = layers.width();
        out.clear();
        for row in between.heads.known(batch.rows() * width).chunks_exact(width) {
            let (advantages, value) = layers.outputs(row);
            out.extend(action_values((value, advantages)));
        }
    }

    fn renew_target(&mut self) {
        self.target.0.parameters.copy_from_slice(&self.network.0.parameters);
    }

    fn update(&mut self, batch: &SequenceBatch) -> f32 {
        let loss = self.differentiate(batch);
        let network = &mut self.network.0;
        self.adam.update(network.isa, &mut network.parameters, &mut self.gradient);
        loss
    }

    fn network(&self) -> FusedRecurrentDuelingNetwork {
        self.network.clone()
    }

    fn weights(&self) -> Weights {
        self.network.0.layers.store(&self.network.0.parameters)
    }
}

// The gradient is not saved, because it is 0 between updates.
resumable!([] FusedRecurrentDqn { parts adam; fixed network.0.parameters, target.0.parameters });
