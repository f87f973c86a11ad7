//! The optima of jobs, each environment and scenario computed once, several at a time.

use std::collections::{HashMap, HashSet};
use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;
use std::thread;

use crate::env::{Environment, Scenario};
use crate::optimum::{Effort, optimum, shows_state};
use crate::plan::Job;

/// Most optima that are computed at a time: each may take more than a gigabyte at horizons of thousands
/// of steps.
const MOST_AT_ONCE: usize = 4;

/// The environment and the scenario of a job, as words that tell them from others.
pub(super) type Place = (String, String);

/// The place of a job.
pub(super) fn place_of(job: &Job) -> Place {
    (serde_json::json!(job.environment).to_string(), job.scenario.to_string())
}

/// The best mean return that any policy can reach, by place; places whose scenario does
/// not show habituation and disengagement risk have none. `watch` is told how many of how many are
/// found.
pub(super) fn of_jobs<'j>(
    jobs: impl Iterator<Item = &'j Job>,
    mut watch: impl FnMut(usize, usize),
) -> HashMap<Place, f64> {
    let mut seen = HashSet::new();
    let distinct: Vec<(Place, &Environment, &Scenario)> = jobs
        .filter(|job| shows_state(&job.scenario).is_ok())
        .map(|job| (place_of(job), &job.environment, &job.scenario))
        .filter(|(place, _, _)| seen.insert(place.clone()))
        .collect();
    let cores = thread::available_parallelism().map_or(1, usize::from).min(MOST_AT_ONCE);
    let next = AtomicUsize::new(0);
    let (sender, found) = mpsc::channel();
    thread::scope(|scope| {
        for _ in 0..cores.min(distinct.len()) {
            let (sender, next, distinct) = (sender.clone(), &next, &distinct);
            scope.spawn(move || {
                while let Some((place, environment, scenario)) =
                    distinct.get(next.fetch_add(1, Ordering::Relaxed))
                {
                    let best = optimum(environment, scenario, Effort::usual(NonZeroUsize::MIN));
                    let best = best.map(|found| found.mean_return);
                    sender.send((place.clone(), best)).expect("the receiver outlives the threads");
                }
            });
        }
        drop(sender);
        let mut done = 0;
        let counted = found.iter().inspect(|_| {
            done += 1;
            watch(done, distinct.len());
        });
        counted.filter_map(|(place, best)| Some((place, best.ok()?))).collect()
    })
}
