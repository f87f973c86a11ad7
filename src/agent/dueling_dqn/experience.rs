//! What a dueling DQN has experienced, and the batches that it learns from.

use crate::agent::dueling_dqn::DuelingDqn;
use crate::agent::memory::OutOfMemory;
use crate::agent::replay::Transition;
use crate::env::Observations;
use crate::rng::Stream;
use crate::state::Resumable;

/// The experience of a learner: its replay buffer, and buffers that make a batch without allocation.
pub trait Experience: Resumable {
    /// What an update learns from.
    type Batch;
    /// The states that the target network evaluates for a batch.
    type States;

    /// No experience. `none` has the shape of the observations.
    fn new(parameters: &DuelingDqn, none: &Observations) -> Self;

    /// Stores the next transition of the running episode.
    ///
    /// **Errors**: memory is short; the buffer cannot be used afterwards.
    fn push(
        &mut self,
        before: &Observations,
        transition: Transition,
        after: &Observations,
    ) -> Result<(), OutOfMemory>;

    /// The number of transitions, or of whole episodes, that a batch can be drawn from.
    fn stored(&self) -> usize;

    /// Whether all stored actions are among the first `count`.
    fn fits(&self, count: usize) -> bool;

    /// Forgets what the previous target network computed.
    fn forget_targets(&mut self);

    /// Draws a batch and sets its targets. `target_values` replaces a buffer by the action values of
    /// the target network, \[rows, actions\].
    ///
    /// **Errors**: memory is short.
    fn draw(
        &mut self,
        parameters: &DuelingDqn,
        stream: &mut Stream,
        target_values: impl FnMut(&Self::States, &mut Vec<f32>),
    ) -> Result<&Self::Batch, OutOfMemory>;
}
