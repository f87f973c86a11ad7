//! The interface that the networks of PPO share.

use crate::agent::fused::ppo_loss::{Objective, PpoLoss};
use crate::agent::policy::ActionNetwork;
use crate::agent::ppo::{Losses, Minibatch, Ppo};
use crate::agent::{Shape, Weights, WeightsError};
use crate::env::Observations;
use crate::kernel::{Aligned, Isa};
use crate::state::Resumable;

/// Networks that PPO trains, in a flat array.
pub trait FusedPpoNetwork: ActionNetwork + Resumable + Clone + Send + 'static {
    /// Networks with these weights, of this shape.
    ///
    /// **Errors**: an array is missing or of another shape.
    fn from_weights(
        parameters: &Ppo,
        shape: Shape,
        weights: &Weights,
        isa: Isa,
    ) -> Result<Self, WeightsError>;

    /// The instruction set of their kernels.
    fn isa(&self) -> Isa;

    /// All parameters.
    fn parameters(&self) -> &Aligned;

    /// All parameters, mutable.
    fn parameters_mut(&mut self) -> &mut Aligned;

    /// The values of a flat array laid out like the parameters, by the names of the weights.
    fn named(&self, flat: &[f32]) -> Weights;

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
