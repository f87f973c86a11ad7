//! Control of a training: progress reports, requests to stop, checkpoints.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use crate::job::{CurvePoint, EstimateDeclaration};
use crate::train::checkpoint::{Checkpoints, KeptNowhere};
use crate::train::progress::TrainingProgress;

/// A copy of [`TrainingControl::stop_requested`] that outlives the control.
pub type StopHandle = Arc<dyn Fn() -> bool + Send + Sync>;

/// Receives the progress reports of a training, may stop it, and keeps its checkpoints.
pub trait TrainingControl {
    /// Receives the progress and the points of the learning curve so far, after every span of the learner: an
    /// episode or an update.
    fn report(&self, progress: TrainingProgress, curve: &[CurvePoint]);

    /// Whether a long span should pause, so that its progress is reported; queried at every step.
    fn report_is_due(&self) -> bool {
        false
    }

    /// Whether the training should end at the next opportunity, without a result.
    fn stop_requested(&self) -> bool;

    /// The working time spent on the training in this process; checkpoints record it.
    fn worked(&self) -> Duration;

    /// Ends waits on the program of an environment. By default, these waits never end early.
    fn stop_handle(&self) -> StopHandle {
        Arc::new(|| false)
    }

    /// The folder in which an outside program starts; the current folder by default.
    fn folder(&self) -> &Path {
        Path::new(".")
    }

    /// The estimates of the decisions of the test or trial; none by default.
    fn estimates(&self) -> &[Arc<EstimateDeclaration>] {
        &[]
    }

    /// The keeper of the training's checkpoints; by default, no checkpoints are kept.
    fn checkpoints(&self) -> &dyn Checkpoints {
        &KeptNowhere
    }
}

/// A control that ignores reports and never stops a training.
#[derive(Clone, Copy, Debug)]
pub struct Uncontrolled;

impl TrainingControl for Uncontrolled {
    fn report(&self, _: TrainingProgress, _: &[CurvePoint]) {}

    fn stop_requested(&self) -> bool {
        false
    }

    fn worked(&self) -> Duration {
        Duration::ZERO
    }
}
