//! What the estimates of a trial need beyond its decisions: observers of the trial, and what follows from them once it is
//! over.

use std::sync::Arc;

use crate::estimate::{Correction, with_standard_error};
use crate::job::{EstimateDeclaration, Estimates, Job, Pooling, StandardErrors, distinct};
use crate::train::after_study::{covariance, sums_for};
use crate::train::excursions::Excursions;
use crate::train::observers::{ObservedTrial, Observers};
use crate::train::policy_courses::PolicyCourses;
use crate::train::trace::{NoTrace, Trace};
use crate::train::truth::Truth;

/// The truths and the standard errors of the estimates of a job's trial.
#[derive(Clone, Debug, Default)]
pub struct Afterwards(Vec<OfEstimate>);

#[derive(Clone, Debug)]
struct OfEstimate {
    declaration: Arc<EstimateDeclaration>,
    /// The truth of each term; empty if it is not asked for or cannot be simulated.
    truths: Vec<f64>,
    /// The standard error of each term, or why there is none; `None` for the nominal ones.
    errors: Option<Result<Vec<f64>, String>>,
}

/// Whether an estimate of a job needs more of its trial than the decisions.
pub(super) fn needs_trial(job: &Job, declaration: &EstimateDeclaration) -> bool {
    declaration.truth || learns_from_everybody(job, declaration)
}

/// Attaches to a trial what these estimates need beyond its decisions.
pub(super) fn attach(observers: &mut Observers, job: &Job, declared: &[Arc<EstimateDeclaration>]) {
    if job.trial.is_none() || job.is_outside() {
        return;
    }
    let truths = declared.iter().filter(|declaration| declaration.truth);
    let truths: Vec<Truth<'_>> = truths.filter_map(|one| Truth::new(job, one)).collect();
    let mut courses: Vec<PolicyCourses> = Vec::new();
    for one in truths.iter().filter_map(|one| one.courses(job)).flatten() {
        if courses.iter().all(|known| !known.equals(&one)) {
            courses.push(one);
        }
    }
    let effects: Vec<&Truth<'_>> = truths.iter().filter(|one| !one.is_of_value()).collect();
    if !effects.is_empty() {
        let outcomes = distinct(effects.into_iter().map(Truth::outcome));
        observers.explore(job, Excursions::new(outcomes));
    }
    if !courses.is_empty() {
        observers.follow(job, courses);
    }
    let is_traced = |declaration: &Arc<EstimateDeclaration>| {
        learns_from_everybody(job, declaration) && sums_for(job, declaration).is_ok()
    };
    if declared.iter().any(is_traced) {
        observers.see(job);
    }
}

impl Afterwards {
    /// What the estimates of a job's trial need, from what was observed of it; or why it was not simulated.
    pub(super) fn of(
        job: &Job,
        declared: &[Arc<EstimateDeclaration>],
        observed: Result<&ObservedTrial, NoTrace>,
    ) -> Afterwards {
        let trace = observed.clone().and_then(|observed| Trace::of(job, observed));
        let truths = |declaration: &EstimateDeclaration| -> Option<Vec<f64>> {
            let truth = Truth::new(job, declaration).filter(|_| declaration.truth)?;
            truth.coefficients(job, observed.as_ref().ok()?)
        };
        let of_estimate = |declaration: &Arc<EstimateDeclaration>| OfEstimate {
            declaration: declaration.clone(),
            truths: truths(declaration).unwrap_or_default(),
            errors: learns_from_everybody(job, declaration)
                .then(|| standard_errors(job, declaration, trace.as_ref())),
        };
        Afterwards(declared.iter().map(of_estimate).collect())
    }

    /// Adds what was simulated to the estimates. An estimate without a standard error fails, and one without a truth has
    /// none.
    pub fn add_to(&self, estimates: &mut [Estimates]) {
        for Estimates { declaration, terms } in estimates {
            let Some(of) = self.0.iter().find(|of| of.declaration == *declaration) else {
                continue;
            };
            let truths = of.truths.iter().map(Some).chain(std::iter::repeat(None));
            for (index, (term, truth)) in terms.iter_mut().zip(truths).enumerate() {
                let Ok(effect) = &mut term.effect else { continue };
                effect.truth = truth.copied().filter(|truth| truth.abs() < 1e300);
                let effect = *effect;
                term.effect = match &of.errors {
                    None => Ok(effect),
                    Some(Ok(errors)) => with_standard_error(effect, errors[index]),
                    Some(Err(why)) => Err(why.clone()),
                };
            }
        }
    }
}

/// Whether the standard errors of an estimate of a job are to account for its learning. They are the nominal ones where
/// nobody learns from others.
fn learns_from_everybody(job: &Job, declaration: &EstimateDeclaration) -> bool {
    let learns = job.agent.algorithm().learns() || job.is_outside();
    let is_pooled = job.trial.as_ref().is_some_and(|trial| trial.pooling != Pooling::None);
    declaration.standard_errors == StandardErrors::AfterStudy && learns && is_pooled
}

/// The standard errors of the terms of an estimate, or why there are none.
fn standard_errors(
    job: &Job,
    declaration: &Arc<EstimateDeclaration>,
    trace: Result<&Trace, &NoTrace>,
) -> Result<Vec<f64>, String> {
    let covariance = covariance(job, declaration, Correction::ManclDeRouen, trace)
        .map_err(|why| format!("its standard errors cannot account for the learning: {why}"))?;
    let size = covariance.len().isqrt();
    let errors = covariance.iter().step_by(size + 1).map(|variance| variance.sqrt());
    Ok(errors.skip(1 + declaration.control.len()).collect())
}
