//! A job in the queue.

use std::time::Duration;

use crate::plan::{Job, JobKey};

/// A job in the queue, with the name its agent goes by.
#[derive(Clone, Debug)]
pub struct Queued {
    /// Identity of the job.
    pub key: JobKey,
    /// Agent's name in the manifest.
    pub agent: String,
    /// The job.
    pub job: Job,
    /// Time that it may take before it has failed, over all runs that go on from each other.
    pub time_limit: Option<Duration>,
}
