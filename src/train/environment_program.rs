//! A job whose environment is an outside program: the program is started first and describes itself.
//!
//! There are no checkpoints, because the state of a program cannot be saved: a stopped job starts over.

use crate::agent::recorded_decisions;
use crate::env::Environment;
use crate::env::outside::{Description, OutsideModel};
use crate::external::ProgramError;
use crate::job::{Failure, FailureKind, GROSS_REWARD, Job, Outcome, RunnableJob, STEP, Trial};
use crate::key::Size;
use crate::train::control::TrainingControl;
use crate::train::watched::Watched;

/// Runs a job with `train`, in an environment that its program simulates.
pub(super) fn run(
    job: &Job,
    model: &OutsideModel,
    control: &dyn TrainingControl,
    train: fn(RunnableJob<'_>, &dyn TrainingControl) -> Outcome,
) -> Outcome {
    let started = match model.started(control.folder(), control.stop_handle()) {
        Ok(started) => started,
        Err(ProgramError::Stopped) => return Outcome::Interrupted,
        Err(error) => return failed(error.to_string(), 0),
    };
    let program = started.program().expect("it has been started").clone();
    if let Some(fault) = misfit(job, program.description()) {
        program.stop();
        return refused(fault);
    }
    let described = Job { environment: Environment::of(started), ..job.clone() };
    let has_failed = || program.failure().is_some();
    let watched = Watched::without_checkpoints(control, &has_failed);
    let runnable = described.runnable().expect("a description adds no file");
    let outcome = train(runnable, &watched);
    match program.failure() {
        Some(ProgramError::Stopped) => program.stop(),
        Some(error) => return failed(error.to_string(), watched.episode()),
        None if outcome == Outcome::Interrupted => program.stop(),
        None => {
            program.finish();
            return outcome;
        }
    }
    Outcome::Interrupted
}

/// Why a job cannot run in its environment, which has described itself.
pub fn misfit(job: &Job, description: &Description) -> Option<String> {
    let model: &OutsideModel = job.environment.model()?;
    if let Err(fault) = description.shown(&job.scenario) {
        return Some(fault);
    }
    if let Some(name) = colliding(job, &description.state) {
        return Some(format!(
            "the program's state has the name `{name}`, which jitai gives to a number of its own; rename it in the program"
        ));
    }
    let environment = Environment::of(model.with(description.clone()));
    let job = Job { environment, ..job.clone() };
    if let Some(unsuited) = job.agent.unsuited(&job.task()) {
        return Some(format!("the agent cannot start: {unsuited}"));
    }
    let sizes = job.agent.sizes(&job.task());
    if let Some(size) = sizes.iter().find(|size| size.is_too_large()) {
        return Some(too_large(size));
    }
    let evaluation = &job.evaluation;
    let longest = u64::from(job.environment.longest_episode());
    if let Some(trial) = job.trial.as_ref().filter(|trial| trial.decisions() != longest) {
        let Trial { days, decisions_per_day, .. } = trial;
        return Some(format!(
            "`days` = {days} with `decisions_per_day` = {decisions_per_day} are {} decisions of a person; the program \
             describes a `horizon` of {longest}: change `days`, or the `horizon` and the episodes of the program",
            trial.decisions()
        ));
    }
    let (training, test, longest) = match &job.trial {
        Some(trial) => (0, trial.people, longest),
        None => (job.agent.episodes(), evaluation.test_episodes, longest),
    };
    let episodes = [
        (evaluation.record_decisions.of_training(), training),
        (evaluation.record_decisions.of_test(), test),
    ];
    let recorded = episodes.into_iter().filter(|(is_recorded, _)| *is_recorded);
    let episodes = recorded.map(|(_, episodes)| u64::from(episodes)).sum();
    let size = recorded_decisions(episodes, longest);
    size.is_too_large().then(|| too_large(&size))
}

/// The first name of a program's state that a trial, the number of the step, or an outcome has as well.
fn colliding<'s>(job: &Job, state: &'s [String]) -> Option<&'s String> {
    let trial = job.trial.as_ref()?;
    let own: Vec<String> =
        trial.recorded_names().chain([STEP, GROSS_REWARD].map(str::to_owned)).collect();
    state.iter().find(|name| own.contains(name))
}

fn too_large(Size { what, unit, size, most }: &Size) -> String {
    format!("{what} {size} {unit}; the maximum is {most}")
}

/// The outcome of a job that does not suit what the program of its environment has described.
pub(super) fn refused(message: String) -> Outcome {
    failed(message, 0)
}

fn failed(message: String, episode: u32) -> Outcome {
    Outcome::Failed(Failure { kind: FailureKind::External, message, episode })
}
