//! The probabilities that agents would have had at the decisions of a recorded trial, beside the recorded ones.

use super::arm::{ArmId, arms};
use crate::record::{JobRecord, ReplayedDecisions};

/// Up to this difference, probabilities count as equal: the rounding of sums in another order.
pub const SAME: f64 = 1e-12;

/// Replays of a recorded trial.
#[derive(Clone, Debug, PartialEq)]
pub struct ReplayFigure {
    /// One row per arm and seed.
    pub rows: Vec<ReplayRow>,
}

/// A replay by a job.
#[derive(Clone, Debug, PartialEq)]
pub struct ReplayRow {
    /// The arm.
    pub name: ArmId,
    /// The seed.
    pub seed: u64,
    /// How its decisions differ from the record.
    pub replayed: ReplayedDecisions,
}

/// The replays by the jobs.
pub fn figure(jobs: &[&JobRecord]) -> ReplayFigure {
    let row = |name: &ArmId, job: &JobRecord| {
        let replayed = job.completed()?.replayed.clone()?;
        Some(ReplayRow { name: name.clone(), seed: job.seed, replayed })
    };
    let arms = arms(jobs, &[]);
    let rows = arms.iter().flat_map(|arm| arm.jobs.iter().filter_map(|job| row(&arm.name, job)));
    ReplayFigure { rows: rows.collect() }
}
