//! A trial that is simulated once more, for what its job does not store.
//!
//! In: a job with a trial. Out: what its agent saw and learned, or what its estimates need.

use std::sync::Arc;

use crate::estimate::Correction;
use crate::job::{EstimateDeclaration, Failure, Job};
use crate::train::after_study::{BanditTrace, NoAfterStudy, covariance, sums_for, sums_of};
use crate::train::afterwards::{Afterwards, attach, needs_trial};
use crate::train::observers::{ObservedTrial, Observers};
use crate::train::trace::{NoTrace, Trace};
use crate::train::training::{Stage, Training};

/// The trial of a job, simulated once more until `stop` returns true.
///
/// **Errors**: see [`NoTrace`].
pub fn trace(job: &Job, stop: &dyn Fn() -> bool) -> Result<Trace, NoTrace> {
    Trace::of(job, &play(job, |observers| observers.see(job), stop)?)
}

/// What observers see of the trial of a job, which is simulated once more until `stop` returns true; `attach` attaches
/// them.
///
/// **Errors**: see [`NoTrace`].
pub(super) fn play(
    job: &Job,
    attach: impl FnOnce(&mut Observers),
    stop: &dyn Fn() -> bool,
) -> Result<ObservedTrial, NoTrace> {
    if job.trial.is_none() {
        return Err(NoTrace::NoTrial);
    }
    if job.is_outside() {
        return Err(NoTrace::Outside);
    }
    // Of an environment that can fail, the copy of this trial alone.
    let fresh = job.environment.fresh();
    let own = fresh.map(|environment| Job { environment, ..job.clone() });
    let job = own.as_ref().unwrap_or(job);
    let runnable = job.runnable()?;
    let failed = |failure: Failure| NoTrace::Failed(failure.message);
    let mut training =
        Training::new(runnable).map_err(|error| NoTrace::Failed(error.to_string()))?;
    attach(training.observers());
    while training.stage() != Stage::Over {
        training.advance(stop).map_err(failed)?;
        if let Some(failure) = job.environment.failure() {
            return Err(NoTrace::Failed(failure));
        }
        if stop() {
            return Err(NoTrace::Stopped);
        }
    }
    Ok(training.into_observed())
}

/// The trial of a job whose agent is a bandit, simulated once more, with what its updates know.
///
/// **Errors**: see [`NoAfterStudy`].
pub fn bandit_trace(job: &Job) -> Result<BanditTrace, NoAfterStudy> {
    sums_of(job)?;
    BanditTrace::of(job, trace(job, &|| false)?)
}

/// The covariance of the coefficients of an estimate, those of the control features included, \[columns, columns\]. The
/// trial is simulated once more until `stop` returns true.
///
/// **Errors**: see [`NoAfterStudy`].
pub fn after_study_covariance(
    job: &Job,
    declaration: &Arc<EstimateDeclaration>,
    correction: Correction,
    stop: &dyn Fn() -> bool,
) -> Result<Vec<f64>, NoAfterStudy> {
    sums_for(job, declaration)?;
    covariance(job, declaration, correction, trace(job, stop).as_ref())
}

impl Afterwards {
    /// Simulates the trial of a job once more for these estimates, if they need it; `None` if `stop` has returned true.
    pub fn simulate(
        job: &Job,
        declared: &[Arc<EstimateDeclaration>],
        stop: &dyn Fn() -> bool,
    ) -> Option<Afterwards> {
        if !declared.iter().any(|declaration| needs_trial(job, declaration)) {
            return Some(Afterwards::default());
        }
        let observed = play(job, |observers| attach(observers, job, declared), stop);
        // What was interrupted is no result.
        (!stop()).then(|| Afterwards::of(job, declared, observed.as_ref().map_err(Clone::clone)))
    }
}
