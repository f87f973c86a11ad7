//! The interface that the networks of PPO share.

use crate::agent::fused::network::FusedNetwork;
use crate::agent::fused::ppo_loss::{Objective, PpoLoss};
use crate::agent::ppo::{Losses, Minibatch, Ppo};
use crate::env::Observations;

/// Networks that PPO trains, in a flat array.
pub trait FusedPpoNetwork: FusedNetwork<Parameters = Ppo> {
    /// Logits and values; see [`crate::agent::PpoEngine::evaluate`].
    fn outputs(
        &mut self,
        observations: &Observations,
        memory: &mut [f32],
        logits: &mut Vec<f32>,
        values: &mut Vec<f32>,
    );

    /// Returns the losses of a minibatch and adds their gradient to `gradient`. `loss` holds
    /// buffers for a block of rows.
    fn differentiate(
        &mut self,
        minibatch: &Minibatch,
        objective: &Objective,
        loss: &mut PpoLoss,
        gradient: &mut [f32],
    ) -> Losses;
}
