//! Updates of REINFORCE.

use std::io;

use burn::module::Module;
use burn::optim::{AdamConfig, GradientsParams, ModuleOptimizer};
use burn::tensor::{Tensor, activation};

use crate::agent::Reinforce;
use crate::agent::burn::state::{restore_module, restore_optimizer, save_module, save_optimizer};
use crate::agent::burn::{ADAM_EPSILON, PolicyNetwork, column, device, input, matrix};
use crate::agent::reinforce::{ReinforceEngine, Trajectories};
use crate::agent::{Weights, WeightsError};
use crate::state::{Resumable, StateError, StateReader, StateWriter};

/// A policy network with its optimiser.
pub struct BurnReinforce {
    network: PolicyNetwork,
    optimizer: ModuleOptimizer,
    learning_rate: f64,
    loss_divisor: f64,
}

impl BurnReinforce {
    /// An engine that starts from these weights, for observations of `inputs` entries.
    ///
    /// **Errors**: the weights do not fit the network.
    pub fn new(
        parameters: &Reinforce,
        inputs: usize,
        weights: &Weights,
    ) -> Result<Self, WeightsError> {
        Ok(BurnReinforce {
            network: PolicyNetwork::from_weights(parameters, inputs, weights, &device::training())?,
            optimizer: AdamConfig::new().with_epsilon(ADAM_EPSILON).init(),
            learning_rate: parameters.learning_rate,
            loss_divisor: parameters.loss_divisor,
        })
    }

    /// −(1/divisor) Σ G_t log π(a_t | s_t); a tensor of one element.
    pub fn loss(network: &PolicyNetwork, trajectories: &Trajectories, divisor: f64) -> Tensor<1> {
        let device = device::training();
        let rows = trajectories.actions.len();
        let returns = matrix(trajectories.returns_to_go.clone(), rows, &device);
        let logits = network.forward(input(&trajectories.observations, &device));
        let taken = column(&trajectories.actions, &device);
        let chosen = activation::log_softmax(logits, 1).gather(1, taken);
        (chosen * returns).sum().neg().div_scalar(divisor)
    }
}

impl ReinforceEngine for BurnReinforce {
    type Network = PolicyNetwork;

    fn update(&mut self, trajectories: &Trajectories) -> f32 {
        let loss = BurnReinforce::loss(&self.network, trajectories, self.loss_divisor);
        let value: f32 = loss.clone().into_scalar();
        if value.is_finite() {
            let gradients = GradientsParams::from_grads(loss.backward(), &self.network);
            // The optimiser consumes the module and returns the updated one.
            self.network = self.optimizer.step(self.learning_rate, self.network.clone(), gradients);
        }
        value
    }

    fn network(&self) -> PolicyNetwork {
        self.network.valid()
    }

    fn weights(&self) -> Weights {
        self.network.weights()
    }
}

impl Resumable for BurnReinforce {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        save_module(&self.network, out)?;
        save_optimizer(&self.optimizer, out)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        restore_module(&mut self.network, from)?;
        restore_optimizer(&mut self.optimizer, from)
    }
}
