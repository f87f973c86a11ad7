//! The control of a job whose environment can fail.

use std::cell::Cell;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use crate::job::{CurvePoint, EstimateDeclaration};
use crate::train::checkpoint::{Checkpoints, ReadCheckpoint, WriteCheckpoint};
use crate::train::control::{StopHandle, TrainingControl};
use crate::train::progress::TrainingProgress;

/// A control that also ends the job once its environment has failed.
pub(super) struct Watched<'c> {
    control: &'c dyn TrainingControl,
    has_failed: &'c dyn Fn() -> bool,
    /// Whether the environment can be saved.
    is_saved: bool,
    /// The number of training episodes finished.
    episode: Cell<u32>,
}

impl<'c> Watched<'c> {
    pub fn new(control: &'c dyn TrainingControl, has_failed: &'c dyn Fn() -> bool) -> Watched<'c> {
        Watched { control, has_failed, is_saved: true, episode: Cell::new(0) }
    }

    /// The control of a job whose environment cannot be saved.
    pub fn without_checkpoints(
        control: &'c dyn TrainingControl,
        has_failed: &'c dyn Fn() -> bool,
    ) -> Watched<'c> {
        Watched { is_saved: false, ..Watched::new(control, has_failed) }
    }

    /// The number of training episodes finished.
    pub fn episode(&self) -> u32 {
        self.episode.get()
    }
}

impl TrainingControl for Watched<'_> {
    fn report(&self, progress: TrainingProgress, curve: &[CurvePoint]) {
        self.episode.set(progress.episode);
        self.control.report(progress, curve);
    }

    fn report_is_due(&self) -> bool {
        self.control.report_is_due()
    }

    fn stop_requested(&self) -> bool {
        self.control.stop_requested() || (self.has_failed)()
    }

    fn stop_handle(&self) -> StopHandle {
        self.control.stop_handle()
    }

    fn worked(&self) -> Duration {
        self.control.worked()
    }

    fn folder(&self) -> &Path {
        self.control.folder()
    }

    fn estimates(&self) -> &[Arc<EstimateDeclaration>] {
        self.control.estimates()
    }

    fn checkpoints(&self) -> &dyn Checkpoints {
        self
    }
}

impl Checkpoints for Watched<'_> {
    fn are_due(&self) -> bool {
        self.is_saved && self.control.checkpoints().are_due()
    }

    fn resume(&self, read: &mut ReadCheckpoint<'_>) {
        if self.is_saved {
            self.control.checkpoints().resume(read);
        }
    }

    fn keep(&self, write: &mut WriteCheckpoint<'_>) {
        // After a failure, another attempt would begin with what failed.
        if self.is_saved && !(self.has_failed)() {
            self.control.checkpoints().keep(write);
        }
    }
}
