//! Optima of many environments and scenarios, computed in parallel.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;
use std::thread;

use super::limits::NoOptimum;
use super::two_grids::{Optimum, optimum};
use crate::env::{Scenario, StepCount};

/// The most optima that are computed at a time: each may take several hundred megabytes.
const MOST_AT_ONCE: usize = 4;

/// The optimum of each environment and scenario, in their order, computed on several threads. `on_progress`
/// receives the number of optima found so far.
pub fn several(
    pairs: &[(&StepCount, &Scenario)],
    mut on_progress: impl FnMut(usize),
) -> Vec<Result<Optimum, NoOptimum>> {
    let cores = thread::available_parallelism().map_or(1, usize::from).min(MOST_AT_ONCE);
    let next = AtomicUsize::new(0);
    let (sender, receiver) = mpsc::channel();
    thread::scope(|scope| {
        let next = &next;
        let work = move || {
            loop {
                let index = next.fetch_add(1, Ordering::Relaxed);
                let Some((environment, scenario)) = pairs.get(index) else { break };
                let found = (index, optimum(environment, scenario));
                sender.send(found).expect("the receiver outlives the threads");
            }
        };
        let start = |_: &usize| thread::Builder::new().spawn_scoped(scope, work.clone()).is_ok();
        // Where the system refuses every thread, this one does the work.
        if (0..cores.min(pairs.len())).take_while(start).count() == 0 {
            work.clone()();
        }
        drop(work);
        let mut found = Vec::with_capacity(pairs.len());
        for optimum in receiver {
            found.push(optimum);
            on_progress(found.len());
        }
        found.sort_by_key(|(index, _)| *index);
        found.into_iter().map(|(_, best)| best).collect()
    })
}
