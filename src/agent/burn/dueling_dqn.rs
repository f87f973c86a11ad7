//! Updates of the dueling DQN.

use burn::module::Module;
use burn::tensor::Tensor;

use crate::agent::DuelingDqn;
use crate::agent::burn::trainer::BurnDqn;
use crate::agent::burn::{DuelingQNetwork, column, device, input, matrix};
use crate::agent::dueling_dqn::DuelingDqnEngine;
use crate::agent::policy::ActionNetwork;
use crate::agent::replay::Batch;
use crate::agent::{Shape, Weights, WeightsError};
use crate::env::Observations;

/// A dueling network with its optimiser and its target network.
pub type BurnDuelingDqn = BurnDqn<DuelingQNetwork>;

impl BurnDuelingDqn {
    /// An engine that starts from these weights, of this shape.
    ///
    /// **Errors**: the weights do not fit the network.
    pub fn new(
        parameters: &DuelingDqn,
        shape: Shape,
        weights: &Weights,
    ) -> Result<Self, WeightsError> {
        let network =
            DuelingQNetwork::from_weights(parameters, shape, weights, &device::training())?;
        Ok(BurnDqn::of(network, parameters.learning_rate))
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
        self.network.evaluated().evaluate(observations, out);
    }

    fn target_values(&mut self, observations: &Observations, out: &mut Vec<f32>) {
        self.target.evaluate(observations, out);
    }

    fn renew_target(&mut self) {
        self.copy_to_target();
    }

    fn update(&mut self, batch: &Batch) -> f32 {
        let loss = BurnDuelingDqn::loss(self.network.module(), batch);
        self.learn(&loss)
    }

    fn network(&self) -> DuelingQNetwork {
        self.network.module().valid()
    }

    fn weights(&self) -> Weights {
        self.network.module().weights()
    }
}
