//! A job in the queue.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use crate::job::{EstimateDeclaration, Job, JobKey};

/// What a job is in the queue for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum QueuedFor {
    /// A run.
    Run,
    /// The estimates that its completed run lacks.
    Estimates,
}

/// A job in the queue, with the name of its agent.
#[derive(Clone, Debug)]
pub struct Queued {
    /// Identity of the job.
    pub key: JobKey,
    /// Agent's name in the manifest.
    pub agent: String,
    /// The job.
    pub job: Job,
    /// The time limit of the job, summed over runs that resume one another; `None` if unlimited.
    pub time_limit: Option<Duration>,
    /// The declared estimates of the decisions of its test or trial.
    pub estimates: Vec<Arc<EstimateDeclaration>>,
    /// What it is in the queue for.
    pub purpose: QueuedFor,
    /// The folder of the job's manifest, in which an outside program starts.
    pub folder: PathBuf,
}
