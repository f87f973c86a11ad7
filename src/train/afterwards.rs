//! What the estimates of a trial need beyond its decisions, simulated once the trial is over.

use std::sync::Arc;

use crate::estimate::{Correction, with_standard_error};
use crate::job::{EstimateDeclaration, Estimates, Job, Pooling, StandardErrors};
use crate::train::after_study::after_study_covariance;
use crate::train::truth::own_truth;

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

impl Afterwards {
    /// Simulates the trial of a job for these estimates; `None` if `stop` has returned true.
    pub fn simulate(
        job: &Job,
        declared: &[Arc<EstimateDeclaration>],
        stop: &dyn Fn() -> bool,
    ) -> Option<Afterwards> {
        let mut all: Vec<OfEstimate> = Vec::new();
        for declaration in declared {
            // Estimates of one effect have one truth.
            let alike = all.iter().find(|of| is_of_one_effect(&of.declaration, declaration));
            let truths = match (declaration.truth, alike) {
                (false, _) => Vec::new(),
                (true, Some(alike)) => alike.truths.clone(),
                (true, None) => own_truth(job, declaration, stop).unwrap_or_default(),
            };
            let errors = learns_from_everybody(job, declaration)
                .then(|| standard_errors(job, declaration, stop));
            all.push(OfEstimate { declaration: declaration.clone(), truths, errors });
        }
        let is_simulated = |of: &OfEstimate| of.declaration.truth || of.errors.is_some();
        // What was interrupted is no result.
        (!all.iter().any(is_simulated) || !stop()).then_some(Afterwards(all))
    }

    /// Adds what was simulated to the estimates. An estimate without a standard error fails, and one without a truth has
    /// none.
    pub fn add_to(&self, estimates: &mut [Estimates]) {
        for Estimates { declaration, terms } in estimates {
            let Some(of) = self.0.iter().find(|of| of.declaration == *declaration) else {
                continue;
            };
            let truths = of.truths.iter().map(Some).chain(std::iter::repeat(None));
            for (place, (term, truth)) in terms.iter_mut().zip(truths).enumerate() {
                let Ok(effect) = &mut term.effect else { continue };
                effect.truth = truth.copied().filter(|truth| truth.abs() < 1e300);
                let effect = *effect;
                term.effect = match &of.errors {
                    None => Ok(effect),
                    Some(Ok(errors)) => with_standard_error(effect, errors[place]),
                    Some(Err(why)) => Err(why.clone()),
                };
            }
        }
    }
}

/// Whether two estimates whose truth is asked for are of the same effect.
fn is_of_one_effect(one: &EstimateDeclaration, other: &EstimateDeclaration) -> bool {
    let effect =
        |of: &EstimateDeclaration| (of.outcome.clone(), of.moderators.clone(), of.treatment);
    one.truth && other.truth && effect(one) == effect(other)
}

/// Whether the standard errors of an estimate of a job are to account for its learning. They are the nominal ones where
/// nobody learns from others.
fn learns_from_everybody(job: &Job, declaration: &EstimateDeclaration) -> bool {
    let learns = job.agent.algorithm().learns() || job.is_outside();
    let is_pooled = job.trial.as_ref().is_some_and(|trial| trial.pooling == Pooling::Full);
    declaration.standard_errors == StandardErrors::AfterStudy && learns && is_pooled
}

/// The standard errors of the terms of an estimate, or why there are none.
fn standard_errors(
    job: &Job,
    declaration: &Arc<EstimateDeclaration>,
    stop: &dyn Fn() -> bool,
) -> Result<Vec<f64>, String> {
    let covariance = after_study_covariance(job, declaration, Correction::ManclDeRouen, stop)
        .map_err(|why| format!("its standard errors cannot account for the learning: {why}"))?;
    let size = covariance.len().isqrt();
    let errors = covariance.iter().step_by(size + 1).map(|variance| variance.sqrt());
    Ok(errors.skip(1 + declaration.control.len()).collect())
}
