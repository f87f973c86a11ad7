//! The estimated time of a job.

use crate::plan::Job;
use crate::schedule::{Episodes, Speeds};

/// Speed of a core that has not been timed, in multiply-adds per second.
const MULTIPLY_ADDS_PER_SECOND: f64 = 2e9;
/// Time that any job takes, in seconds.
const LEAST_SECONDS: f64 = 0.005;

/// The estimated time of a job on one core, in seconds.
pub fn seconds(speeds: &Speeds, job: &Job) -> f64 {
    let mut episodes = Episodes::default();
    episodes.add(job.algorithm(), u64::from(job.agent.episodes()));
    let timed = speeds.seconds(&episodes).filter(|seconds| *seconds > 0.0);
    timed.unwrap_or_else(|| job.work() as f64 / MULTIPLY_ADDS_PER_SECOND) + LEAST_SECONDS
}
