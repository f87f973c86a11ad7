//! One job, from its declaration to its outcome.
//!
//! In: a [`Job`] and a [`Monitor`] to report to. Out: an [`Outcome`] that depends on the job and
//! the code alone, however often the training was stopped and gone on with. It knows no database,
//! no worker and no other job, and of [`Checkpoints`] neither where they lie nor when they are due.

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
pub use roll::{Chooser, TestStreams, Watch, roll};

/// How far a training has come.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Training episodes finished.
    pub episode: u32,
    /// Training episodes in all.
    pub episodes: u32,
    /// Mean return of the last hundred episodes or fewer, in steps walked.
    pub recent_return: f64,
}

/// Whom a training reports to, who may stop it, and who keeps its checkpoints.
pub trait Monitor {
    /// Hears how far it has come, after every span of the learner: an episode, or an update.
    fn report(&self, progress: Progress);

    /// Whether the training should end at the next occasion, without a result.
    fn stop_requested(&self) -> bool;

    /// Time at work on it in this process, which its checkpoints tell.
    fn worked(&self) -> Duration;

    /// Who keeps its checkpoints; nobody, unless there is someone.
    fn checkpoints(&self) -> &dyn Checkpoints {
        &KeptNowhere
    }
}

/// A monitor that nobody watches.
#[derive(Clone, Copy, Debug)]
pub struct Unwatched;

impl Monitor for Unwatched {
    fn report(&self, _: Progress) {}

    fn stop_requested(&self) -> bool {
        false
    }

    fn worked(&self) -> Duration {
        Duration::ZERO
    }
}

/// Trains the job's agent, tests it, and returns what came out. Goes on from a checkpoint if there
/// is one, and leaves one if it is stopped.
pub fn run(job: &Job, monitor: &dyn Monitor) -> Outcome {
    let checkpoints = monitor.checkpoints();
    let mut training = match begin(job, checkpoints) {
        Ok(training) => training,
        Err(error) => return Outcome::Failed(out_of_memory(&error, 0)),
    };
    let pause = || monitor.stop_requested() || checkpoints.are_due();
    loop {
        if let Err(failure) = training.advance(&pause) {
            return Outcome::Failed(failure);
        }
        monitor.report(training.progress());
        if training.stage() == Stage::Over {
            break;
        }
        let stopped = monitor.stop_requested();
        if stopped || checkpoints.are_due() {
            checkpoints.keep(&mut |out| checkpoint::write(&training, monitor.worked(), out));
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
fn begin<'j>(job: &'j Job, checkpoints: &dyn Checkpoints) -> Result<Training<'j>, OutOfMemory> {
    let mut found = None;
    checkpoints.resume(&mut |file| {
        let training = checkpoint::read(job, file)?;
        let resumed = Resumed { episode: training.episodes(), worked: training.before() };
        found = Some(training);
        Ok(resumed)
    });
    found.map_or_else(|| Training::new(job), Ok)
}
