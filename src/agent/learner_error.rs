//! The reasons why an agent cannot learn, in training or in a trial.

use crate::agent::memory::OutOfMemory;

/// A loss that became infinite or NaN.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("the loss of update {update} is {loss}")]
pub struct Diverged {
    /// Number of updates, this one included.
    pub update: u64,
    /// The loss.
    pub loss: f32,
}

/// Why a training failed.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum LearnerError {
    /// The loss or a weight is not finite.
    #[error(transparent)]
    Diverged(#[from] Diverged),
    /// A regression has no posterior in floating-point arithmetic.
    #[error(
        "after {steps} steps the precision of a regression is not positive definite; choose a \
         prior_sd closer to noise_sd, and with partial pooling a smaller person_sd"
    )]
    Singular {
        /// Number of steps learned from.
        steps: u64,
    },
    /// There is not enough memory.
    #[error(transparent)]
    OutOfMemory(#[from] OutOfMemory),
}
