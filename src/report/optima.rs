//! The optima of jobs, one per environment and scenario.

use std::collections::{HashMap, HashSet};

use crate::env::{Environment, Scenario};
use crate::optimum::{self, NoOptimum};
use crate::plan::Job;

/// An environment and a scenario, as text that identifies them.
pub(super) type Place = (String, String);

/// The place of a job.
pub(super) fn place_of(job: &Job) -> Place {
    (format!("{:?} {:?}", job.environment, job.population), job.scenario.to_string())
}

/// Whether the optimum of a job can be computed. If there are several reasons against it, a scenario
/// that hides the state takes precedence.
fn check(job: &Job) -> Result<(), NoOptimum> {
    let alike = optimum::check_people(&job.population);
    match optimum::check(&job.environment, &job.scenario) {
        hidden @ Err(NoOptimum::StateHidden { .. }) => hidden,
        other => alike.and(other),
    }
}

/// The distinct reasons for unknown optima of jobs whose scenarios show the state.
pub(super) fn unknown<'j>(jobs: impl Iterator<Item = &'j Job>) -> Vec<String> {
    let mut reasons: Vec<String> = Vec::new();
    for job in jobs {
        let reason = match check(job).err() {
            Some(
                error @ (NoOptimum::NotKnown { .. }
                | NoOptimum::PeopleDiffer { .. }
                | NoOptimum::TooLong { .. }),
            ) => error,
            Some(NoOptimum::StateHidden { .. }) | None => continue,
        };
        let reason = reason.to_string();
        if !reasons.contains(&reason) {
            reasons.push(reason);
        }
    }
    reasons
}

/// The highest mean return of any policy, by place. Places whose optimum cannot be computed are
/// left out. `on_progress` receives the number of optima found so far and the total.
pub(super) fn of_jobs<'j>(
    jobs: impl Iterator<Item = &'j Job>,
    mut on_progress: impl FnMut(usize, usize),
) -> HashMap<Place, f64> {
    let mut seen = HashSet::new();
    let (places, pairs): (Vec<Place>, Vec<(&Environment, &Scenario)>) = jobs
        .filter(|job| check(job).is_ok())
        .map(|job| (place_of(job), (&job.environment, &job.scenario)))
        .filter(|(place, _)| seen.insert(place.clone()))
        .unzip();
    let found = optimum::several(&pairs, |done| on_progress(done, pairs.len()));
    let found = places.into_iter().zip(found);
    found.filter_map(|(place, best)| Some((place, best.ok()?.mean_return))).collect()
}
