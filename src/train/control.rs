//! Control of a training: progress reports, requests to stop, checkpoints.

use std::time::Duration;

use crate::train::checkpoint::{Checkpoints, KeptNowhere};
use crate::train::progress::TrainingProgress;

/// Takes the progress reports of a training, may stop it, and keeps its checkpoints.
pub trait TrainingControl {
    /// Takes the progress, after every span of the learner: an episode, or an update.
    fn report(&self, progress: TrainingProgress);

    /// Whether the training should end at the next occasion, without a result.
    fn stop_requested(&self) -> bool;

    /// Working time spent on it in this process, which its checkpoints record.
    fn worked(&self) -> Duration;

    /// The keeper of its checkpoints; none are kept by default.
    fn checkpoints(&self) -> &dyn Checkpoints {
        &KeptNowhere
    }
}

/// A control that ignores reports and never stops a training.
#[derive(Clone, Copy, Debug)]
pub struct Uncontrolled;

impl TrainingControl for Uncontrolled {
    fn report(&self, _: TrainingProgress) {}

    fn stop_requested(&self) -> bool {
        false
    }

    fn worked(&self) -> Duration {
        Duration::ZERO
    }
}
