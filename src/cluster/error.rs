//! Errors of submissions.

use std::io;
use std::path::{Path, PathBuf};

use super::engine::EngineError;
use crate::manifest::Faults;
use crate::schedule::SweepError;
use crate::store::StoreError;

/// Why a submission cannot be made, read or collected.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ClusterError {
    /// A call of the engine failed.
    #[error(transparent)]
    Engine(#[from] EngineError),
    /// The engine did not answer, so it is unknown whether it accepted an array.
    #[error(
        "it is unknown whether the cluster accepted {name}: {reason}; check with `jitai status`; \
         `jitai submit` never submits a job twice"
    )]
    Uncertain {
        /// Name of the array.
        name: String,
        /// The error of the engine.
        reason: EngineError,
    },
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The sweep of a task failed.
    #[error(transparent)]
    Sweep(#[from] SweepError),
    /// A frozen manifest has faults.
    #[error(transparent)]
    Manifest(#[from] Faults),
    /// A file that a manifest names cannot be read.
    #[error("a file of the manifest cannot be read: {0}")]
    Companion(String),
    /// A file or folder cannot be used.
    #[error("failed to {action} `{}`: {source}", .path.display())]
    Io {
        /// The operation.
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The error of the system.
        source: io::Error,
    },
    /// A file of a submission has invalid content.
    #[error("`{}` cannot be used: {reason}", .path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// No submission has the name.
    #[error("there is no submission {name} in `{}`; `jitai status` lists them", .folder.display())]
    NoSuchSubmission {
        /// The name.
        name: String,
        /// The folder of the submissions.
        folder: PathBuf,
    },
    /// The task's program expands the frozen manifests into other jobs than the program that submitted
    /// them.
    #[error(
        "{missing} of the chunk's jobs are not among the jobs that this version of jitai derives \
         from the stored manifests; version {code_version} made the plan; submit again with the \
         version that the tasks run"
    )]
    OtherCode {
        /// Number of missing jobs.
        missing: usize,
        /// The version that made the plan.
        code_version: String,
    },
    /// A part could not be handed in.
    #[error(
        "failed to hand in `{}`: {source}; the task retried until its time limit", .path.display()
    )]
    NotHandedIn {
        /// The folder of the submission.
        path: PathBuf,
        /// The last error of the system.
        source: io::Error,
    },
}

impl ClusterError {
    /// An I/O error during `action` on `path`.
    pub(super) fn io(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> ClusterError {
        let path = path.to_owned();
        move |source| ClusterError::Io { action, path, source }
    }
}
