//! `--workers`: the number of jobs trained at the same time.

use std::num::NonZeroUsize;

use crate::schedule::MOST_WORKERS;

/// Parses the argument of `--workers`.
pub(super) fn workers(text: &str) -> Result<NonZeroUsize, String> {
    text.parse()
        .ok()
        .filter(|workers: &NonZeroUsize| workers.get() <= MOST_WORKERS)
        .ok_or_else(|| format!("expected a whole number from 1 to {MOST_WORKERS}"))
}
