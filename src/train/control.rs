//! The outside of a training, as the training knows it.

use std::time::Duration;

use crate::train::checkpoint::{Checkpoints, KeptNowhere};
use crate::train::progress::TrainingProgress;

/// The outside of a training: takes its reports, may stop it, and keeps its checkpoints.
pub trait TrainingControl {
    /// Takes the progress, after every span of the learner: an episode, or an update.
    fn report(&self, progress: TrainingProgress);

    /// Whether the training should end at the next occasion, without a result.
    fn stop_requested(&self) -> bool;

    /// Time at work on it in this process, which its checkpoints tell.
    fn worked(&self) -> Duration;

    /// Who keeps its checkpoints; nobody, unless there is someone.
    fn checkpoints(&self) -> &dyn Checkpoints {
        &KeptNowhere
    }
}

/// A control that reports to nobody and never stops a training.
#[derive(Clone, Copy, Debug)]
pub struct Unwatched;

impl TrainingControl for Unwatched {
    fn report(&self, _: TrainingProgress) {}

    fn stop_requested(&self) -> bool {
        false
    }

    fn worked(&self) -> Duration {
        Duration::ZERO
    }
}
