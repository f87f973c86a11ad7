//! Updates of the dueling DQN.

use burn::tensor::{Device, Tensor};

use crate::agent::burn::network::BurnNetwork;
use crate::agent::burn::recurrent::Unrolled;
use crate::agent::burn::trainer::BurnDqn;
use crate::agent::burn::{
    DuelingQNetwork, RecurrentDuelingQNetwork, column, device, input, matrix, numbers,
};
use crate::agent::dueling_dqn::{
    DuelingDqnEngine, Episodes, Experience, SequenceBatch, Transitions,
};
use crate::agent::policy::ActionNetwork;
use crate::agent::replay::Batch;
use crate::agent::{DuelingDqn, Shape, Weights, WeightsError};
use crate::env::Observations;

/// A module that the dueling DQN trains.
pub trait BurnQNetwork: BurnNetwork<Parameters = DuelingDqn> {
    /// What the network learns from.
    type Experience: Experience;

    /// Action values in the states of a batch, \[rows, actions\].
    fn along(&self, states: &StatesOf<Self>, device: &Device) -> Tensor<2>;

    /// Mean squared difference of Q(s, a) from the targets over the rows that count; a tensor of one
    /// element.
    fn loss(&self, batch: &BatchOf<Self>) -> Tensor<1>;
}

type BatchOf<N> = <<N as BurnQNetwork>::Experience as Experience>::Batch;
type StatesOf<N> = <<N as BurnQNetwork>::Experience as Experience>::States;

/// A dueling network with its optimiser and its target network.
pub type BurnDuelingDqn = BurnDqn<DuelingQNetwork>;
/// A dueling network with a GRU, its optimiser and its target network.
pub type BurnRecurrentDqn = BurnDqn<RecurrentDuelingQNetwork>;

impl<N: BurnQNetwork> BurnDqn<N> {
    /// An engine that starts from these weights, of this shape.
    ///
    /// **Errors**: the weights do not fit the network.
    pub fn new(
        parameters: &DuelingDqn,
        shape: Shape,
        weights: &Weights,
    ) -> Result<Self, WeightsError> {
        let network = N::from_weights(parameters, shape, weights, &device::training())?;
        Ok(BurnDqn::of(network, parameters.learning_rate))
    }
}

impl<N: BurnQNetwork> DuelingDqnEngine for BurnDqn<N> {
    type Network = N;
    type Experience = N::Experience;

    fn memory(&self) -> usize {
        self.network.module().memory()
    }

    fn values(&mut self, observations: &Observations, memory: &mut [f32], out: &mut Vec<f32>) {
        self.network.evaluated().recall(observations, memory, out);
    }

    fn target_values(&mut self, states: &StatesOf<N>, out: &mut Vec<f32>) {
        *out = numbers(self.target.along(states, &device::inference()));
    }

    fn renew_target(&mut self) {
        self.copy_to_target();
    }

    fn update(&mut self, batch: &BatchOf<N>) -> f32 {
        let loss = self.network.module().loss(batch);
        self.learn(&loss)
    }

    fn network(&self) -> N {
        self.network.module().valid()
    }

    fn weights(&self) -> Weights {
        self.network.module().weights()
    }
}

impl BurnQNetwork for DuelingQNetwork {
    type Experience = Transitions;

    fn along(&self, states: &Observations, device: &Device) -> Tensor<2> {
        self.forward(input(states, device))
    }

    fn loss(&self, batch: &Batch) -> Tensor<1> {
        let device = device::training();
        let targets = matrix(batch.targets.clone(), batch.targets.len(), &device);
        let values = self.along(&batch.observations, &device);
        (values.gather(1, column(&batch.actions, &device)) - targets).square().mean()
    }
}

impl BurnQNetwork for RecurrentDuelingQNetwork {
    type Experience = Episodes;

    fn along(&self, batch: &SequenceBatch, device: &Device) -> Tensor<2> {
        let SequenceBatch { observations, lanes, firsts, cuts, .. } = batch;
        let sequences = Unrolled { observations, lanes: *lanes, memory: None, firsts, cuts };
        self.values(self.layers.unroll(&sequences, device))
    }

    fn loss(&self, batch: &SequenceBatch) -> Tensor<1> {
        let device = device::training();
        let rows = batch.rows();
        let values = self.along(batch, &device).gather(1, column(&batch.actions, &device));
        let errors = values - matrix(batch.targets.clone(), rows, &device);
        let learned = batch.learned.iter().map(|learned| f32::from(*learned)).collect();
        let squares = errors.square() * matrix(learned, rows, &device);
        squares.sum().div_scalar(batch.steps() as f64)
    }
}

impl ActionNetwork for RecurrentDuelingQNetwork {
    fn evaluate(&mut self, observations: &Observations, out: &mut Vec<f32>) {
        self.recall(observations, &mut vec![0.0; observations.rows() * self.layers.units()], out);
    }

    fn memory(&self) -> usize {
        self.layers.units()
    }

    fn recall(&mut self, observations: &Observations, memory: &mut [f32], out: &mut Vec<f32>) {
        let states = self.layers.recalled(observations, memory);
        *out = numbers(self.values(states));
    }
}
