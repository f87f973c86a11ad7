//! Updates of the dueling DQN.

use std::io;

use burn::module::Module;
use burn::optim::{AdamConfig, GradientsParams, ModuleOptimizer};
use burn::tensor::Tensor;

use crate::agent::DuelingDqn;
use crate::agent::burn::state::{restore_module, restore_optimizer, save_module, save_optimizer};
use crate::agent::burn::{ADAM_EPSILON, DuelingQNetwork, column, device, input, matrix};
use crate::agent::dueling_dqn::DuelingDqnEngine;
use crate::agent::policy::ActionNetwork;
use crate::agent::replay::Batch;
use crate::agent::{Weights, WeightsError};
use crate::env::Observations;
use crate::state::{Resumable, StateError, StateReader, StateWriter};

/// A dueling network with its target network and its optimiser.
pub struct BurnDuelingDqn {
    network: DuelingQNetwork,
    target: DuelingQNetwork,
    optimizer: ModuleOptimizer,
    learning_rate: f64,
}

impl BurnDuelingDqn {
    /// An engine that starts from these weights, for observations of `inputs` entries.
    ///
    /// **Errors**: the weights do not fit the network.
    pub fn new(
        parameters: &DuelingDqn,
        inputs: usize,
        weights: &Weights,
    ) -> Result<Self, WeightsError> {
        let network =
            DuelingQNetwork::from_weights(parameters, inputs, weights, &device::training())?;
        Ok(BurnDuelingDqn {
            target: network.valid(),
            network,
            optimizer: AdamConfig::new().with_epsilon(ADAM_EPSILON).init(),
            learning_rate: parameters.learning_rate,
        })
    }

    /// Mean squared difference of Q(s, a) from the targets; a tensor of one element.
    pub fn loss(network: &DuelingQNetwork, batch: &Batch) -> Tensor<1> {
        let device = device::training();
        let targets = matrix(batch.targets.clone(), batch.targets.len(), &device);
        let values = network.forward(input(&batch.observations, &device));
        (values.gather(1, column(&batch.actions, &device)) - targets).square().mean()
    }
}

impl DuelingDqnEngine for BurnDuelingDqn {
    type Network = DuelingQNetwork;

    fn values(&mut self, observations: &Observations, out: &mut Vec<f32>) {
        self.network.valid().evaluate(observations, out);
    }

    fn target_values(&mut self, observations: &Observations, out: &mut Vec<f32>) {
        self.target.evaluate(observations, out);
    }

    fn renew_target(&mut self) {
        self.target = self.network.valid();
    }

    fn update(&mut self, batch: &Batch) -> f32 {
        let loss = BurnDuelingDqn::loss(&self.network, batch);
        let value: f32 = loss.clone().into_scalar();
        if value.is_finite() {
            let gradients = GradientsParams::from_grads(loss.backward(), &self.network);
            // The optimiser consumes the module and returns the updated one.
            self.network = self.optimizer.step(self.learning_rate, self.network.clone(), gradients);
        }
        value
    }

    fn network(&self) -> DuelingQNetwork {
        self.network.valid()
    }

    fn weights(&self) -> Weights {
        self.network.weights()
    }
}

impl Resumable for BurnDuelingDqn {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        save_module(&self.network, out)?;
        save_module(&self.target, out)?;
        save_optimizer(&self.optimizer, out)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        restore_module(&mut self.network, from)?;
        restore_module(&mut self.target, from)?;
        restore_optimizer(&mut self.optimizer, from)
    }
}
