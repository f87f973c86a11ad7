//! A job from its start, or from a checkpoint, to its outcome.

use crate::agent::{External, StartError};
use crate::env::outside::OutsideModel;
use crate::job::{Failure, FailureKind, Job, Outcome, RunnableJob};
use crate::train::checkpoint::{self, Resumed};
use crate::train::control::TrainingControl;
use crate::train::environment_program;
use crate::train::outside;
use crate::train::training::{Stage, Training, out_of_memory};
use crate::train::watched::Watched;

/// Trains the job's agent, tests it, and returns the outcome. Continues from a checkpoint if there is one,
/// and writes one if it is stopped.
///
/// # Panics
/// If the job cannot run ([`Job::runnable`]), as a job of a store that names files.
pub fn run(job: &Job, control: &dyn TrainingControl) -> Outcome {
    let job = job.runnable().unwrap_or_else(|error| panic!("{error}"));
    if let Some(model) = job.environment.model::<OutsideModel>() {
        return environment_program::run(&job, model, control, train);
    }
    match job.environment.fresh() {
        Some(environment) => in_model(Job { environment, ..job.job().clone() }, control),
        None => train(job, control),
    }
}

/// Runs a job in an environment whose simulations can fail.
fn in_model(job: Job, control: &dyn TrainingControl) -> Outcome {
    let failure = || job.environment.failure();
    let has_failed = || failure().is_some();
    let watched = Watched::new(control, &has_failed);
    let outcome = train(job.runnable().expect("the job has been runnable"), &watched);
    match failure() {
        Some(message) => {
            let (kind, episode) = (FailureKind::Diverged, watched.episode());
            Outcome::Failed(Failure { kind, message, episode })
        }
        None => outcome,
    }
}

/// Trains the job's agent in an environment that is known.
fn train(job: RunnableJob<'_>, control: &dyn TrainingControl) -> Outcome {
    if let Some(external) = job.agent.parameters::<External>() {
        return outside::run(job, &external, control);
    }
    let checkpoints = control.checkpoints();
    let mut training = match start_or_resume(job, control) {
        Ok(training) => training,
        Err(StartError::OutOfMemory(error)) => return Outcome::Failed(out_of_memory(&error, 0)),
        // What agents must suit in the environment of a program is known once it runs.
        Err(error) if job.environment.family().is_external() => {
            return environment_program::refused(format!("the agent cannot start: {error}"));
        }
        // Other manifests with such an agent are rejected, so the algorithm is at fault.
        Err(error) => panic!("the agent cannot start: {error}"),
    };
    let pause = || control.stop_requested() || checkpoints.are_due() || control.report_is_due();
    loop {
        if let Err(failure) = training.advance(&pause) {
            return Outcome::Failed(failure);
        }
        control.report(training.progress(), training.curve());
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
    training.results().map_or_else(Outcome::Failed, Outcome::Completed)
}

/// A job at its start, or at a checkpoint.
///
/// **Errors**: there is not enough memory for the learner, or the agent does not suit the environment.
fn start_or_resume<'j>(
    job: RunnableJob<'j>,
    control: &dyn TrainingControl,
) -> Result<Training<'j>, StartError> {
    let mut found = None;
    control.checkpoints().resume(&mut |file| {
        let training = checkpoint::read(job, control.estimates(), file)?;
        let resumed = Resumed { episode: training.episodes(), worked: training.before() };
        found = Some(training);
        Ok(resumed)
    });
    if let Some(training) = found {
        return Ok(training);
    }
    let mut training = Training::new(job)?;
    training.estimate(control.estimates());
    Ok(training)
}
