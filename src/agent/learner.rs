//! Agents in training.

use std::io;

use crate::agent::actor::{Actor, StepObserver};
use crate::agent::memory::OutOfMemory;
use crate::agent::weights::Weights;
use crate::env::{PhysicalActivity, VectorEnvironment};
use crate::state::{Resumable, StateError, StateReader, StateWriter};

/// A training episode that has just ended.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TrainedEpisode {
    /// Undiscounted return, in steps walked.
    pub total_reward: f64,
    /// Steps of the simulation.
    pub length: u32,
    /// Whether it ended in a terminal state.
    pub terminated: bool,
    /// Sum of the losses of the updates since the episode before.
    pub loss_sum: f64,
    /// Number of those updates.
    pub updates: u32,
    /// Exploration rate at its end, where the algorithm has one.
    pub epsilon: Option<f64>,
}

impl Resumable for TrainedEpisode {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        out.one(self.total_reward)?;
        out.one(self.length)?;
        out.one(u8::from(self.terminated))?;
        out.one(self.loss_sum)?;
        out.one(self.updates)?;
        out.many(self.epsilon.as_slice())
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        *self = TrainedEpisode {
            total_reward: from.one()?,
            length: from.one()?,
            terminated: from.one::<u8>()? != 0,
            loss_sum: from.one()?,
            updates: from.one()?,
            epsilon: from.many(1, "exploration rates")?.first().copied(),
        };
        Ok(())
    }
}

/// A loss that became infinite or not a number.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("the loss of update {update} is {loss}")]
pub struct Diverged {
    /// Updates made, this one included.
    pub update: u64,
    /// The loss.
    pub loss: f32,
}

/// Why a training cannot go on.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum LearnerError {
    /// Its loss is of no use.
    #[error(transparent)]
    Diverged(#[from] Diverged),
    /// There is no memory for what it has to remember.
    #[error(transparent)]
    OutOfMemory(#[from] OutOfMemory),
}

/// How a span of training ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Span {
    /// At its end.
    Whole,
    /// Broken off, because a pause was asked for.
    BrokenOff,
}

/// An agent in training. Its state can be written down whenever it is not at work.
pub trait Learner<Env: VectorEnvironment = PhysicalActivity>: Resumable {
    /// Trains for the shortest span the algorithm has (an episode, or the episodes of one update)
    /// and appends the episodes that ended. `pause` is asked at every step; once it says yes the
    /// span is broken off, and the next call goes on with it, to the same bits. An `observer` sees
    /// every step and changes nothing.
    ///
    /// **Errors**: the loss is not finite, or memory is short; the learner is then of no further use.
    fn advance(
        &mut self,
        finished: &mut Vec<TrainedEpisode>,
        observer: Option<&mut dyn StepObserver<Env>>,
        pause: &dyn Fn() -> bool,
    ) -> Result<Span, LearnerError>;

    /// Trains until at least so many more episodes have ended, and returns them.
    ///
    /// **Errors**: as [`Learner::advance`].
    fn train(&mut self, episodes: usize) -> Result<Vec<TrainedEpisode>, LearnerError> {
        let mut finished = Vec::new();
        while finished.len() < episodes {
            self.advance(&mut finished, None, &|| false)?;
        }
        Ok(finished)
    }

    /// The policy as it would act now in training, or greedily.
    fn policy(&self, actions: Actions) -> Box<dyn Actor<Env>>;

    /// The weights as they are now.
    fn weights(&self) -> Weights;
}

/// How a trained agent chooses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Actions {
    /// As in training: with its exploration.
    AsTrained,
    /// The best action, always.
    Greedy,
}
