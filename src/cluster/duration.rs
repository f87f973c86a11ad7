//! The estimated time of a job.

use crate::plan::Job;
use crate::schedule::{Episodes, Speeds};

/// Time of an episode of an algorithm that has not been timed, in seconds.
const SECONDS_PER_EPISODE: f64 = 0.005;
/// Time that any job takes, in seconds.
const LEAST_SECONDS: f64 = 0.005;

/// The estimated time of a job on one core, in seconds.
pub fn seconds(speeds: &Speeds, job: &Job) -> f64 {
    let mut episodes = Episodes::default();
    episodes.add(job.algorithm(), u64::from(job.agent.episodes()));
    let timed = speeds.seconds(&episodes);
    timed.unwrap_or_else(|| SECONDS_PER_EPISODE * f64::from(job.agent.episodes())) + LEAST_SECONDS
}
