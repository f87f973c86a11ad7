//! `--workers`: how many jobs are trained at a time.

use std::num::NonZeroUsize;

use crate::schedule::MOST_WORKERS;

/// A number of workers, as `--workers` takes it.
pub(super) fn workers(text: &str) -> Result<NonZeroUsize, String> {
    text.parse()
        .ok()
        .filter(|workers: &NonZeroUsize| workers.get() <= MOST_WORKERS)
        .ok_or_else(|| format!("expected a whole number from 1 to {MOST_WORKERS}"))
}
