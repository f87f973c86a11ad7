//! Why a submission cannot be made, read or collected.

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
    /// The engine.
    #[error(transparent)]
    Engine(#[from] EngineError),
    /// The engine did not answer, and nobody knows whether it accepted an array.
    #[error(
        "it is unknown whether {name} was accepted: {reason}; `jitai status` asks again, and \
         `jitai submit` submits nothing twice"
    )]
    Uncertain {
        /// Name of the array.
        name: String,
        /// What the engine said.
        reason: EngineError,
    },
    /// The store.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The sweep of a task.
    #[error(transparent)]
    Sweep(#[from] SweepError),
    /// A frozen manifest.
    #[error(transparent)]
    Manifest(#[from] Faults),
    /// A file or folder.
    #[error("failed to {action} `{}`: {source}", .path.display())]
    Io {
        /// What was to be done.
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A file of a submission does not say what it should.
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
        /// Where it was looked for.
        folder: PathBuf,
    },
    /// The program of a task makes other jobs of the frozen manifests than the program that
    /// submitted them.
    #[error(
        "{missing} of the chunk's jobs are not in the frozen manifests as this version of jitai \
         reads them; the plan was made by {code_version}. Submit again with the jitai that tasks run"
    )]
    OtherCode {
        /// Number of jobs.
        missing: usize,
        /// What made the plan.
        code_version: String,
    },
    /// A part could not be handed in.
    #[error(
        "failed to hand in `{}`: {source}; it was tried until the task had to end", .path.display()
    )]
    NotHandedIn {
        /// The folder of the submission.
        path: PathBuf,
        /// What the system said last.
        source: io::Error,
    },
}

impl ClusterError {
    /// An error of the system at `path`, while it was to be `action`ed.
    pub(super) fn io(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> ClusterError {
        let path = path.to_owned();
        move |source| ClusterError::Io { action, path, source }
    }
}
