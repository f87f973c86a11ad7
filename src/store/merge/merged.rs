//! The result of a merge.

use std::path::PathBuf;

use crate::store::copy::Origin;

/// The result of a merge: the numbers of copied rows, and what was not copied.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Merged {
    /// The number of stores read.
    pub sources: usize,
    /// The number of experiments copied.
    pub experiments: usize,
    /// The number of jobs copied.
    pub jobs: usize,
    /// The number of completed runs copied, each with all its results.
    pub completed: usize,
    /// The number of failed runs copied.
    pub failed: usize,
    /// The number of runs that the target already had, including failed runs of jobs that are completed in
    /// the target.
    pub already_there: usize,
    /// The number of rows of estimates added to runs that the target already had.
    pub estimates: usize,
    /// The number of runs whose jobs a process is running in the target. Merge again when these
    /// runs have ended.
    pub in_progress: usize,
    /// Jobs with different results in two stores. The target keeps its own.
    pub conflicts: Vec<Conflict>,
    /// Damaged data, which was not copied.
    pub damaged: Vec<Damage>,
    /// Experiments with a different manifest in the target, which keeps its own.
    pub differing: Vec<OtherManifest>,
}

/// A job with different results in two stores.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Conflict {
    /// The store that was read.
    pub source: PathBuf,
    /// The job.
    pub job_key: String,
    /// The run that was not copied.
    pub theirs: Origin,
    /// The run that the target keeps.
    pub ours: Origin,
}

/// Damage found in a store.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Damage {
    /// The store.
    pub source: PathBuf,
    /// The job whose run is damaged; `None` if it is unknown, or if more than one run is damaged.
    pub job_key: Option<String>,
    /// What is wrong, as a fragment.
    pub what: String,
}

/// An experiment with a different manifest in the target.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OtherManifest {
    /// The store that was read.
    pub source: PathBuf,
    /// The experiment's name.
    pub experiment: String,
}

/// The progress of a merge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MergeProgress {
    /// The number of runs handled so far.
    pub done: usize,
    /// The total number of runs.
    pub of: usize,
}
