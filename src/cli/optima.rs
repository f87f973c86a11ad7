//! The optima of jobs, each environment and scenario computed once, on every core.

use std::collections::{HashMap, HashSet};
use std::thread;

use crate::manifest::{Environment, Scenario};
use crate::optimum::optimum;
use crate::plan::Job;

/// An environment and a scenario, as words that tell them from others.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Cell(String, String);

impl Cell {
    /// The cell of a job.
    pub(super) fn of(job: &Job) -> Cell {
        Cell(serde_json::json!(job.environment).to_string(), job.scenario.to_string())
    }
}

/// The best mean return that any policy can reach, by cell; cells whose scenario does not show
/// habituation and disengagement risk have none.
pub(super) fn of_jobs<'j>(jobs: impl Iterator<Item = &'j Job>) -> HashMap<Cell, f64> {
    let mut seen = HashSet::new();
    let distinct: Vec<(Cell, &Environment, &Scenario)> = jobs
        .map(|job| (Cell::of(job), &job.environment, &job.scenario))
        .filter(|(cell, _, _)| seen.insert(cell.clone()))
        .collect();
    let cores = thread::available_parallelism().map_or(1, usize::from);
    let found = |part: &[(Cell, &Environment, &Scenario)]| -> Vec<(Cell, f64)> {
        let known = part.iter().filter_map(|(cell, environment, scenario)| {
            Some((cell.clone(), optimum(environment, scenario).ok()?.mean_return))
        });
        known.collect()
    };
    thread::scope(|scope| {
        let parts = distinct.chunks(distinct.len().div_ceil(cores).max(1));
        let workers: Vec<_> = parts.map(|part| scope.spawn(move || found(part))).collect();
        let joined = workers.into_iter().map(|worker| worker.join());
        joined.flat_map(|part| part.expect("no computation of an optimum panics")).collect()
    })
}
