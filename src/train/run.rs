//! A job from its beginning, or from a checkpoint, to its outcome.

use crate::agent::OutOfMemory;
use crate::plan::Job;
use crate::record::Outcome;
use crate::train::checkpoint::{self, Checkpoints, Resumed};
use crate::train::control::TrainingControl;
use crate::train::training::{Stage, Training, out_of_memory};

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
