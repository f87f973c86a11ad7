//! Updates of the dueling DQN with a GRU.

use burn::module::Module;
use burn::tensor::{Device, Tensor};

use crate::agent::burn::recurrent::{RecurrentDuelingQNetwork, Unrolled};
use crate::agent::burn::trainer::BurnDqn;
use crate::agent::burn::{column, device, matrix, numbers};
use crate::agent::dueling_dqn::{RecurrentDqnEngine, SequenceBatch};
use crate::agent::layers::Shape;
use crate::agent::policy::ActionNetwork;
use crate::agent::{DuelingDqn, Weights, WeightsError};
use crate::env::Observations;

/// A dueling network with a GRU, its optimiser and its target network.
pub type BurnRecurrentDqn = BurnDqn<RecurrentDuelingQNetwork>;

impl BurnRecurrentDqn {
    /// An engine that starts from these weights, of this shape.
    ///
    /// **Errors**: the weights do not fit the network.
    pub fn new(
        parameters: &DuelingDqn,
        shape: Shape,
        weights: &Weights,
    ) -> Result<Self, WeightsError> {
        let device = device::training();
        let network = RecurrentDuelingQNetwork::from_weights(parameters, shape, weights, &device)?;
        Ok(BurnDqn::of(network, parameters.learning_rate))
    }

    /// Mean squared difference of Q(s, a) from the targets over the rows that count; a tensor of one
    /// element.
    pub fn loss(network: &RecurrentDuelingQNetwork, batch: &SequenceBatch) -> Tensor<1> {
        let device = device::training();
        let rows = batch.rows();
        let values = along(network, batch, &device).gather(1, column(&batch.actions, &device));
        let errors = values - matrix(batch.targets.clone(), rows, &device);
        let learned = batch.learned.iter().map(|learned| f32::from(*learned)).collect();
        let squares = errors.square() * matrix(learned, rows, &device);
        squares.sum().div_scalar(batch.steps() as f64)
    }
}

/// Action values along the sequences of a batch, \[rows, actions\].
fn along(network: &RecurrentDuelingQNetwork, batch: &SequenceBatch, device: &Device) -> Tensor<2> {
    let SequenceBatch { observations, lanes, firsts, cuts, .. } = batch;
    let sequences = Unrolled { observations, lanes: *lanes, memory: None, firsts, cuts };
    network.values(network.unroll(&sequences, device))
}

impl ActionNetwork for RecurrentDuelingQNetwork {
    fn evaluate(&mut self, observations: &Observations, out: &mut Vec<f32>) {
        self.recall(observations, &mut vec![0.0; observations.rows() * self.units()], out);
    }

    fn memory(&self) -> usize {
        self.units()
    }

    fn recall(&mut self, observations: &Observations, memory: &mut [f32], out: &mut Vec<f32>) {
        let states = self.recalled(observations, memory);
        *out = numbers(RecurrentDuelingQNetwork::values(self, states));
    }
}

impl RecurrentDqnEngine for BurnRecurrentDqn {
    type Network = RecurrentDuelingQNetwork;

    fn memory(&self) -> usize {
        self.network.module().units()
    }

    fn values(&mut self, observations: &Observations, memory: &mut [f32], out: &mut Vec<f32>) {
        self.network.evaluated().recall(observations, memory, out);
    }

    fn target_values(&mut self, batch: &SequenceBatch, out: &mut Vec<f32>) {
        *out = numbers(along(&self.target, batch, &device::inference()));
    }

    fn renew_target(&mut self) {
        self.copy_to_target();
    }

    fn update(&mut self, batch: &SequenceBatch) -> f32 {
        let loss = BurnRecurrentDqn::loss(self.network.module(), batch);
        self.learn(&loss)
    }

    fn network(&self) -> RecurrentDuelingQNetwork {
        self.network.module().valid()
    }

    fn weights(&self) -> Weights {
        self.network.module().weights()
    }
}
