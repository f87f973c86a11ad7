//! Agents in training.

use crate::agent::actor::{Actor, StepObserver};
pub use crate::agent::learner_error::{Diverged, LearnerError};
use crate::agent::weights::Weights;
use crate::env::{Simulated, VectorEnvironment};
use crate::state::{Resumable, resumable};

/// A training episode that has just ended.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TrainedEpisode {
    /// Number of the episode in the order in which episodes began, from 1. Episodes that began
    /// together are numbered by lane. `None` from a learner that reports episodes in this order
    /// anyway.
    pub number: Option<u32>,
    /// Undiscounted return.
    pub total_reward: f64,
    /// Number of steps of the simulation.
    pub length: u32,
    /// Whether the episode ended in a terminal state.
    pub terminated: bool,
    /// Sum of the losses of the updates since the previous episode.
    pub loss_sum: f64,
    /// Number of updates since the previous episode.
    pub updates: u32,
    /// Exploration rate at the end of the episode, if the algorithm has one.
    pub epsilon: Option<f64>,
}

resumable!([] TrainedEpisode { parts number, total_reward, length, terminated, loss_sum, updates, epsilon });

/// How a span of training ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SpanEnd {
    /// The span was completed.
    Whole,
    /// The span was suspended, because a pause was requested.
    BrokenOff,
}

/// An agent in training. Its state can be saved between two calls.
pub trait Learner<Env: VectorEnvironment = Simulated>: Resumable {
    /// Trains for the shortest span the algorithm has (an episode, or the episodes of one update)
    /// and appends the episodes that ended. `pause` is called at every step. When it returns true,
    /// the span is suspended, and the next call resumes it with bit-identical results. An
    /// `observer` sees every step and changes nothing.
    ///
    /// **Errors**: as [`LearnerError`]. The learner cannot be used afterwards.
    fn advance(
        &mut self,
        finished: &mut Vec<TrainedEpisode>,
        observer: Option<&mut dyn StepObserver<Env>>,
        pause: &dyn Fn() -> bool,
    ) -> Result<SpanEnd, LearnerError>;

    /// Trains until at least `episodes` more episodes have ended, and returns them.
    ///
    /// **Errors**: as [`Learner::advance`].
    fn train(&mut self, episodes: usize) -> Result<Vec<TrainedEpisode>, LearnerError> {
        let mut finished = Vec::new();
        while finished.len() < episodes {
            self.advance(&mut finished, None, &|| false)?;
        }
        Ok(finished)
    }

    /// The current policy, with the exploration of training or greedy.
    fn policy(&self, actions: Actions) -> Box<dyn Actor<Env>>;

    /// The current weights.
    fn weights(&self) -> Weights;
}

/// How a trained agent chooses actions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Actions {
    /// As in training, with exploration.
    AsTrained,
    /// Always the best action.
    Greedy,
}
