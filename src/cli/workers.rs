//! `--workers`: how many jobs are trained at a time.

use std::num::NonZeroUsize;
use std::thread;

/// Most workers that can be asked for; each is a thread with its own network and buffers.
const MOST_WORKERS: usize = 1024;

/// A number of workers, as `--workers` takes it.
pub(super) fn workers(text: &str) -> Result<NonZeroUsize, String> {
    text.parse()
        .ok()
        .filter(|workers: &NonZeroUsize| workers.get() <= MOST_WORKERS)
        .ok_or_else(|| format!("expected a whole number from 1 to {MOST_WORKERS}"))
}

/// One worker a core.
pub(super) fn one_a_core() -> NonZeroUsize {
    let most = NonZeroUsize::new(MOST_WORKERS).expect("it is not zero");
    thread::available_parallelism().unwrap_or(NonZeroUsize::MIN).min(most)
}
