//! The optima of jobs, one for each environment and scenario.

use std::collections::{HashMap, HashSet};

use crate::env::{Environment, Scenario};
use crate::optimum::{self, NoOptimum};
use crate::plan::Job;

/// An environment and a scenario, as text that identifies them.
pub(super) type Place = (String, String);

/// The place of a job.
pub(super) fn place_of(job: &Job) -> Place {
    (format!("{:?}", job.environment), job.scenario.to_string())
}

/// Why the optimum of jobs is not known although their scenarios show the state, each reason once.
pub(super) fn unknown<'j>(jobs: impl Iterator<Item = &'j Job>) -> Vec<String> {
    let mut reasons: Vec<String> = Vec::new();
    for job in jobs {
        let error = optimum::check(&job.environment, &job.scenario).err();
        let reason = match error {
            Some(error @ (NoOptimum::NotKnown { .. } | NoOptimum::TooLong { .. })) => error,
            Some(NoOptimum::StateHidden { .. }) | None => continue,
        };
        let reason = reason.to_string();
        if !reasons.contains(&reason) {
            reasons.push(reason);
        }
    }
    reasons
}

/// The highest mean return of any policy, by place; without the places whose optimum is not computed.
/// `on_progress` gets the number of optima found so far and the number of all.
pub(super) fn of_jobs<'j>(
    jobs: impl Iterator<Item = &'j Job>,
    mut on_progress: impl FnMut(usize, usize),
) -> HashMap<Place, f64> {
    let mut seen = HashSet::new();
    let (places, pairs): (Vec<Place>, Vec<(&Environment, &Scenario)>) = jobs
        .filter(|job| optimum::check(&job.environment, &job.scenario).is_ok())
        .map(|job| (place_of(job), (&job.environment, &job.scenario)))
        .filter(|(place, _)| seen.insert(place.clone()))
        .unzip();
    let found = optimum::several(&pairs, |done| on_progress(done, pairs.len()));
    let found = places.into_iter().zip(found);
    found.filter_map(|(place, best)| Some((place, best.ok()?.mean_return))).collect()
}
