//! One job, from its declaration to its outcome.
//!
//! In: a [`Job`] and a [`TrainingControl`]. Out: an [`Outcome`] that depends on the job and the code
//! alone, however often the training was stopped and resumed. It knows no database, no worker and no
//! other job, and of [`Checkpoints`] neither where they are kept nor when they are due.

mod checkpoint;
mod curve;
mod roll;
mod test;
mod training;

use std::time::Duration;

use crate::agent::OutOfMemory;
use crate::plan::Job;
use crate::record::Outcome;

use training::{Stage, Training, out_of_memory};

pub use checkpoint::{
    CheckpointError, CheckpointFile, Checkpoints, KeptNowhere, ReadCheckpoint, Resumed,
    WriteCheckpoint,
};
pub use roll::{Recording, RollStreams, StepObserver, begin, play, roll};

/// How far a training has come.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrainingProgress {
    /// Training episodes finished.
    pub episode: u32,
    /// Training episodes in all.
    pub episodes: u32,
    /// Mean return of the last hundred episodes or fewer, in steps walked.
    pub recent_return: f64,
}

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

/// Trains the job's agent, tests it, and returns what came out. Goes on from a checkpoint if there
/// is one, and leaves one if it is stopped.
pub fn run(job: &Job, control: &dyn TrainingControl) -> Outcome {
    let checkpoints = control.checkpoints();
    let mut training = match start_or_resume(job, checkpoints) {
        Ok(training) => training,
        Err(error) => return Outcome::Failed(out_of_memory(&error, 0)),
    };
    let pause = || control.stop_requested() || checkpoints.are_due();
    loop {
        if let Err(failure) = training.advance(&pause) {
            return Outcome::Failed(failure);
        }
        control.report(training.progress());
        if training.stage() == Stage::Over {
            break;
        }
        let stopped = control.stop_requested();
        if stopped || checkpoints.are_due() {
            checkpoints.keep(&mut |out| checkpoint::write(&training, control.worked(), out));
        }
        if stopped {
            return Outcome::Interrupted;
        }
    }
    Outcome::Completed(training.results())
}

/// A job at its beginning, or where a checkpoint was made.
///
/// **Errors**: there is no memory for what learns.
fn start_or_resume<'j>(
    job: &'j Job,
    checkpoints: &dyn Checkpoints,
) -> Result<Training<'j>, OutOfMemory> {
    let mut found = None;
    checkpoints.resume(&mut |file| {
        let training = checkpoint::read(job, file)?;
        let resumed = Resumed { episode: training.episodes(), worked: training.before() };
        found = Some(training);
        Ok(resumed)
    });
    found.map_or_else(|| Training::new(job), Ok)
}
