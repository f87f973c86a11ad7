//! Jobs of an experiment by state, as `plan` and `status` print them.

use std::time::Duration;

use crate::cli::output::OutputField;
use crate::store::Counts;

/// The columns of [`fields`].
pub(super) const COLUMNS: [&str; 8] = [
    "experiment",
    "jobs",
    "completed",
    "running",
    "failed",
    "interrupted",
    "pending",
    "seconds_left",
];

/// A row: an experiment, its jobs by state, and the estimated time left, if it is known.
pub(super) fn fields<'a>(
    experiment: &'a str,
    counts: &Counts,
    left: Option<Duration>,
) -> Vec<OutputField<'a>> {
    let integer = |count: u64| OutputField::Integer(count as i64);
    vec![
        OutputField::text(experiment),
        integer(counts.total()),
        integer(counts.completed),
        integer(counts.running),
        integer(counts.failed),
        integer(counts.interrupted),
        integer(counts.pending),
        // Estimates are rounded to a tenth of a second.
        left.map_or(OutputField::Empty, |left| {
            OutputField::Rounded((left.as_secs_f64() * 10.0).round() / 10.0, 0)
        }),
    ]
}
