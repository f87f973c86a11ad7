//! Estimates of single jobs with their intervals, beside published ones.

use std::sync::Arc;

use super::arm::{ArmId, arms};
use crate::job::{Effect, EstimateDeclaration};
use crate::manifest::kind::Effects;
use crate::manifest::{Published, PublishedEstimate};
use crate::record::JobRecord;

/// The estimates of jobs.
#[derive(Clone, Debug, PartialEq)]
pub struct EffectsFigure {
    /// One row per arm, seed and term.
    pub rows: Vec<EffectRow>,
    /// Completed jobs whose estimates are not computed yet.
    pub lacking: usize,
}

/// A term of an estimate of a job.
#[derive(Clone, Debug, PartialEq)]
pub struct EffectRow {
    /// The arm.
    pub name: ArmId,
    /// The seed.
    pub seed: u64,
    /// The estimate.
    pub declaration: Arc<EstimateDeclaration>,
    /// The term of its effect.
    pub term: String,
    /// The estimate; an error says why there is none.
    pub effect: Result<Effect, String>,
    /// For the value of a policy on a recorded trial, the mean outcome of the trial's own decisions.
    pub of_trial: Option<f64>,
    /// The published number.
    pub published: Option<PublishedEstimate>,
}

/// The estimates that the jobs have.
pub fn figure(kind: &Effects, jobs: &[&JobRecord], published: Option<&Published>) -> EffectsFigure {
    let chosen = &kind.estimates.0;
    let (mut rows, mut lacking) = (Vec::new(), 0);
    for arm in arms(jobs, &[]) {
        for job in &arm.jobs {
            let Some(run) = job.completed() else { continue };
            lacking += usize::from(run.estimates.is_empty());
            let is_chosen =
                |name: &String| chosen.is_empty() || chosen.iter().any(|one| one == name);
            for of in run.estimates.iter().filter(|of| is_chosen(&of.declaration.name)) {
                let name = &of.declaration.name;
                let is_value = of.declaration.is_value() && of.declaration.is_of_reward();
                rows.extend(of.terms.iter().map(|one| EffectRow {
                    name: arm.name.clone(),
                    seed: job.seed,
                    declaration: of.declaration.clone(),
                    term: one.term.clone(),
                    effect: one.effect.clone(),
                    of_trial: run.mean_outcome.filter(|_| is_value),
                    published: number(published, name, &one.term),
                }));
            }
        }
    }
    EffectsFigure { rows, lacking }
}

fn number(published: Option<&Published>, name: &str, term: &str) -> Option<PublishedEstimate> {
    let mut all = published?.estimates.iter();
    all.find(|one| one.estimate == name && one.term == term).cloned()
}
