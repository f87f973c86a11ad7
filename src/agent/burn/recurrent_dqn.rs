//! Updates of the dueling DQN with a GRU.

use std::io;

use burn::module::Module;
use burn::optim::{AdamConfig, GradientsParams, ModuleOptimizer};
use burn::tensor::{Device, Tensor};

use crate::agent::burn::recurrent::{RecurrentDuelingQNetwork, Unrolled};
use crate::agent::burn::state::{restore_module, restore_optimizer, save_module, save_optimizer};
use crate::agent::burn::{ADAM_EPSILON, column, device, input, matrix, numbers};
use crate::agent::dueling_dqn::{RecurrentDqnEngine, SequenceBatch};
use crate::agent::policy::ActionNetwork;
use crate::agent::{DuelingDqn, Weights, WeightsError};
use crate::env::Observations;
use crate::state::{Resumable, StateError, StateReader, StateWriter};

/// A dueling network with a GRU, its target network and its optimiser.
pub struct BurnRecurrentDqn {
    network: RecurrentDuelingQNetwork,
    target: RecurrentDuelingQNetwork,
    /// The network without gradients; set by the first evaluation after an update.
    evaluated: Option<RecurrentDuelingQNetwork>,
    optimizer: ModuleOptimizer,
    learning_rate: f64,
}

impl BurnRecurrentDqn {
    /// An engine that starts from these weights, for observations of `inputs` entries.
    ///
    /// **Errors**: the weights do not fit the network.
    pub fn new(
        parameters: &DuelingDqn,
        inputs: usize,
        weights: &Weights,
    ) -> Result<Self, WeightsError> {
        let device = device::training();
        let network = RecurrentDuelingQNetwork::from_weights(parameters, inputs, weights, &device)?;
        Ok(BurnRecurrentDqn {
            target: network.valid(),
            network,
            evaluated: None,
            optimizer: AdamConfig::new().with_epsilon(ADAM_EPSILON).init(),
            learning_rate: parameters.learning_rate,
        })
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
        let device = device::inference();
        let states = matrix(memory.to_vec(), observations.rows(), &device);
        let states = self.step(input(observations, &device), states);
        memory.copy_from_slice(&numbers(states.clone()));
        *out = numbers(RecurrentDuelingQNetwork::values(self, states));
    }
}

impl RecurrentDqnEngine for BurnRecurrentDqn {
    type Network = RecurrentDuelingQNetwork;

    fn memory(&self) -> usize {
        self.network.units()
    }

    fn values(&mut self, observations: &Observations, memory: &mut [f32], out: &mut Vec<f32>) {
        let network = self.evaluated.get_or_insert_with(|| self.network.valid());
        network.recall(observations, memory, out);
    }

    fn target_values(&mut self, batch: &SequenceBatch, out: &mut Vec<f32>) {
        *out = numbers(along(&self.target, batch, &device::inference()));
    }

    fn renew_target(&mut self) {
        self.target = self.network.valid();
    }

    fn update(&mut self, batch: &SequenceBatch) -> f32 {
        let loss = BurnRecurrentDqn::loss(&self.network, batch);
        let value: f32 = loss.clone().into_scalar();
        if value.is_finite() {
            let gradients = GradientsParams::from_grads(loss.backward(), &self.network);
            self.evaluated = None;
            // The optimiser consumes the module and returns the updated one.
            self.network = self.optimizer.step(self.learning_rate, self.network.clone(), gradients);
        }
        value
    }

    fn network(&self) -> RecurrentDuelingQNetwork {
        self.network.valid()
    }

    fn weights(&self) -> Weights {
        self.network.weights()
    }
}

impl Resumable for BurnRecurrentDqn {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        save_module(&self.network, out)?;
        save_module(&self.target, out)?;
        save_optimizer(&self.optimizer, out)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.evaluated = None;
        restore_module(&mut self.network, from)?;
        restore_module(&mut self.target, from)?;
        restore_optimizer(&mut self.optimizer, from)
    }
}
