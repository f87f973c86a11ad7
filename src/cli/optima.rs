//! Optima of many environments and scenarios, several at a time.

use std::collections::{HashMap, HashSet};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;
use std::thread;

use crate::cli::counting::Counting;
use crate::env::{Environment, Scenario};
use crate::optimum::{self, NoOptimum, Optimum, optimum};
use crate::plan::Job;

/// Most optima that are computed at a time: each may take some hundred megabytes.
const MOST_AT_ONCE: usize = 4;

/// An environment and a scenario, as text that identifies them.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Cell(String, String);

impl Cell {
    /// The cell of an environment and a scenario.
    pub(super) fn new(environment: &Environment, scenario: &Scenario) -> Cell {
        Cell(format!("{environment:?}"), scenario.to_string())
    }

    /// The cell of a job.
    pub(super) fn of(job: &Job) -> Cell {
        Cell::new(&job.environment, &job.scenario)
    }
}

/// The highest mean return of any policy, by cell; without the cells whose optimum is not computed.
/// Standard error shows the progress.
pub(super) fn of_jobs<'j>(jobs: impl Iterator<Item = &'j Job>) -> HashMap<Cell, f64> {
    let mut seen = HashSet::new();
    let (cells, pairs): (Vec<Cell>, Vec<_>) = jobs
        .filter(|job| optimum::check(&job.environment, &job.scenario).is_ok())
        .map(|job| (Cell::of(job), (&job.environment, &job.scenario)))
        .filter(|(cell, _)| seen.insert(cell.clone()))
        .unzip();
    let found = cells.into_iter().zip(compute(&pairs));
    found.filter_map(|(cell, best)| Some((cell, best.ok()?.mean_return))).collect()
}

/// The optimum of each environment and scenario, in their order. Standard error shows the progress.
pub(super) fn compute(pairs: &[(&Environment, &Scenario)]) -> Vec<Result<Optimum, NoOptimum>> {
    let cores = thread::available_parallelism().map_or(1, usize::from).min(MOST_AT_ONCE);
    let next = AtomicUsize::new(0);
    let (sender, receiver) = mpsc::channel();
    thread::scope(|scope| {
        for _ in 0..cores.min(pairs.len()) {
            let (sender, next) = (sender.clone(), &next);
            scope.spawn(move || {
                loop {
                    let place = next.fetch_add(1, Ordering::Relaxed);
                    let Some((environment, scenario)) = pairs.get(place) else { break };
                    let found = (place, optimum(environment, scenario));
                    sender.send(found).expect("the receiver outlives the threads");
                }
            });
        }
        drop(sender);
        let mut shown = Counting::new(pairs.len(), "optima");
        let mut found: Vec<_> = receiver.iter().inspect(|_| shown.one_more()).collect();
        found.sort_by_key(|(place, _)| *place);
        found.into_iter().map(|(_, best)| best).collect()
    })
}
