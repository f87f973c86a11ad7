//! Updates of REINFORCE.

use burn::module::Module;
use burn::tensor::{Tensor, activation};

use crate::agent::Reinforce;
use crate::agent::burn::network::BurnNetwork;
use crate::agent::burn::trainer::Trainer;
use crate::agent::burn::{PolicyNetwork, column, device, input, matrix};
use crate::agent::reinforce::{ReinforceEngine, Trajectories};
use crate::agent::{Shape, Weights, WeightsError};
use crate::state::resumable;

/// A policy network with its optimiser.
pub struct BurnReinforce {
    network: Trainer<PolicyNetwork>,
    loss_divisor: f64,
}

impl BurnReinforce {
    /// An engine that starts from these weights, of this shape.
    ///
    /// **Errors**: the weights do not fit the network.
    pub fn new(
        parameters: &Reinforce,
        shape: Shape,
        weights: &Weights,
    ) -> Result<Self, WeightsError> {
        let network = PolicyNetwork::from_weights(parameters, shape, weights, &device::training())?;
        Ok(BurnReinforce {
            network: Trainer::new(network, parameters.learning_rate),
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
        let loss = BurnReinforce::loss(self.network.module(), trajectories, self.loss_divisor);
        let value: f32 = loss.clone().into_scalar();
        if value.is_finite() {
            self.network.step(&loss, None);
        }
        value
    }

    fn network(&self) -> PolicyNetwork {
        self.network.module().valid()
    }

    fn weights(&self) -> Weights {
        self.network.module().weights()
    }
}

resumable!([] BurnReinforce { parts network });
