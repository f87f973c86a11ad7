//! Updates of PPO.

use crate::agent::fused::actor_critic::FusedActorCritic;
use crate::agent::fused::ppo_loss::{Objective, PpoLoss};
use crate::agent::fused::ppo_network::FusedPpoNetwork;
use crate::agent::ppo::{ADAM_EPSILON, Losses, Minibatch, Ppo, PpoEngine};
use crate::agent::{Shape, Weights, WeightsError};
use crate::env::Observations;
use crate::kernel::{Adam, Aligned, Isa, clip_norm};
use crate::state::resumable;

/// The policy and value networks with their optimiser.
#[derive(Clone, Debug)]
pub struct FusedPpo<N = FusedActorCritic> {
    network: N,
    gradient: Aligned,
    adam: Adam,
    objective: Objective,
    max_grad_norm: f32,
    /// Buffers for the loss of a block of rows.
    loss: Box<PpoLoss>,
}

impl<N: FusedPpoNetwork> FusedPpo<N> {
    /// An engine that starts from these weights, of this shape.
    ///
    /// **Errors**: the weights do not fit the networks.
    pub fn new(
        parameters: &Ppo,
        shape: Shape,
        weights: &Weights,
        isa: Isa,
    ) -> Result<Self, WeightsError> {
        let network = N::from_weights(parameters, shape, weights, isa)?;
        let numbers = network.parameters().len();
        Ok(FusedPpo {
            gradient: Aligned::zeros(numbers),
            adam: Adam::with_epsilon(parameters.learning_rate, ADAM_EPSILON.into(), numbers),
            network,
            objective: Objective::of(parameters),
            max_grad_norm: parameters.max_grad_norm as f32,
            loss: Box::new(PpoLoss::new(shape.actions)),
        })
    }

    /// The gradient of the loss of a minibatch, before it is clipped, by the names of the weights.
    pub fn gradient(&mut self, minibatch: &Minibatch) -> Weights {
        self.gradient.fill(0.0);
        self.differentiate(minibatch);
        let gradient = self.network.named(&self.gradient);
        self.gradient.fill(0.0);
        gradient
    }

    /// Returns the losses of a minibatch and adds the gradient to the stored gradient.
    fn differentiate(&mut self, minibatch: &Minibatch) -> Losses {
        let FusedPpo { network, gradient, objective, loss, .. } = self;
        network.differentiate(minibatch, objective, loss, gradient)
    }
}

impl<N: FusedPpoNetwork> PpoEngine for FusedPpo<N> {
    type Network = N;

    fn isa(&self) -> Isa {
        self.network.isa()
    }

    fn memory(&self) -> usize {
        self.network.memory()
    }

    fn evaluate(
        &mut self,
        observations: &Observations,
        memory: &mut [f32],
        logits: &mut Vec<f32>,
        values: &mut Vec<f32>,
    ) {
        self.network.outputs(observations, memory, logits, values);
    }

    fn update(&mut self, minibatch: &Minibatch, learning_rate: f64) -> Losses {
        let losses = self.differentiate(minibatch);
        let isa = self.network.isa();
        clip_norm(isa, &mut self.gradient, self.max_grad_norm);
        self.adam.set_learning_rate(learning_rate);
        self.adam.update(isa, self.network.parameters_mut(), &mut self.gradient);
        losses
    }

    fn network(&self) -> N {
        self.network.clone()
    }

    fn weights(&self) -> Weights {
        self.network.weights()
    }
}

// The gradient is not saved, because it is 0 between updates.
resumable!([N: FusedPpoNetwork] FusedPpo<N> { parts network, adam });
