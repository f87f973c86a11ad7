//! The optima of jobs, each environment and scenario computed once, several at a time.

use std::collections::{HashMap, HashSet};
use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;
use std::thread;

use crate::cli::counting::Counting;
use crate::env::{Environment, Scenario};
use crate::optimum::{Effort, optimum, shows_state};
use crate::plan::Job;

/// Most optima that are computed at a time: each may take more than a gigabyte at horizons of thousands
/// of steps.
const MOST_AT_ONCE: usize = 4;

/// An environment and a scenario, as words that tell them from others.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Cell(String, String);

impl Cell {
    /// The cell of a job.
    pub(super) fn of(job: &Job) -> Cell {
        Cell(format!("{:?}", job.environment), job.scenario.to_string())
    }
}

/// The best mean return that any policy can reach, by cell; cells whose scenario does not show
/// habituation and disengagement risk have none. Standard error shows how far it is.
pub(super) fn of_jobs<'j>(jobs: impl Iterator<Item = &'j Job>) -> HashMap<Cell, f64> {
    let mut seen = HashSet::new();
    let distinct: Vec<(Cell, &Environment, &Scenario)> = jobs
        .filter(|job| shows_state(&job.scenario).is_ok())
        .map(|job| (Cell::of(job), &job.environment, &job.scenario))
        .filter(|(cell, _, _)| seen.insert(cell.clone()))
        .collect();
    let cores = thread::available_parallelism().map_or(1, usize::from).min(MOST_AT_ONCE);
    let next = AtomicUsize::new(0);
    let (sender, found) = mpsc::channel();
    thread::scope(|scope| {
        for _ in 0..cores.min(distinct.len()) {
            let (sender, next, distinct) = (sender.clone(), &next, &distinct);
            scope.spawn(move || {
                while let Some((cell, environment, scenario)) =
                    distinct.get(next.fetch_add(1, Ordering::Relaxed))
                {
                    let best = optimum(environment, scenario, Effort::usual(NonZeroUsize::MIN));
                    let best = best.map(|found| found.mean_return);
                    sender.send((cell.clone(), best)).expect("the receiver outlives the threads");
                }
            });
        }
        drop(sender);
        let mut shown = Counting::new(distinct.len(), "optima");
        let counted = found.iter().inspect(|_| shown.one_more());
        counted.filter_map(|(cell, best)| Some((cell, best.ok()?))).collect()
    })
}
