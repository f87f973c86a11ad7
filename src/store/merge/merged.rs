//! What a merge did, and what it left out.

use std::path::PathBuf;

use crate::store::copy::Origin;

/// What a merge copied, and what it did not.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Merged {
    /// Stores that were read.
    pub sources: usize,
    /// Experiments that were copied.
    pub experiments: usize,
    /// Jobs that were copied.
    pub jobs: usize,
    /// Completed runs that were copied, each with all its results.
    pub completed: usize,
    /// Failed runs that were copied.
    pub failed: usize,
    /// Runs that the target had already, and failed runs of jobs that it has completed.
    pub already_there: usize,
    /// Runs whose jobs a process is running in the target. Merging again, when these have ended,
    /// settles them.
    pub in_progress: usize,
    /// Jobs that two stores completed with other results. The target keeps its own.
    pub conflicts: Vec<Conflict>,
    /// What was left out because it is not as it was stored.
    pub damaged: Vec<Damage>,
    /// Experiments that have another manifest in the target, which keeps its own.
    pub differing: Vec<OtherManifest>,
}

/// A job that two stores completed with other results.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Conflict {
    /// The store that was read.
    pub source: PathBuf,
    /// The job.
    pub job_key: String,
    /// The run that was left out.
    pub theirs: Origin,
    /// The run that the target keeps.
    pub ours: Origin,
}

/// What cannot be trusted of a store.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Damage {
    /// The store.
    pub source: PathBuf,
    /// The job whose run is damaged; `None` if it cannot be told, or if more than a run is damaged.
    pub job_key: Option<String>,
    /// What is wrong, as a fragment.
    pub what: String,
}

/// An experiment that has another manifest in the target.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OtherManifest {
    /// The store that was read.
    pub source: PathBuf,
    /// The experiment's name.
    pub experiment: String,
}

/// How far a merge is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MergeProgress {
    /// Runs that have been copied or left out.
    pub done: usize,
    /// Runs in all.
    pub of: usize,
}
