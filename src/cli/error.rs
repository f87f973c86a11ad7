//! Exit codes and errors of the commands.

use std::io::{self, Write};
use std::process::ExitCode;

use crate::cluster::{ClusterError, RUN_AGAIN};
use crate::manifest::Faults;
use crate::plan::FilterError;
use crate::schedule::SweepError;
use crate::store::{QueryError, StoreError};
use crate::watch::WatchError;

/// How a command ended; each variant has an exit code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Exit {
    /// Everything was done.
    Done,
    /// Some jobs failed.
    JobsFailed,
    /// A simulation differs from its recording, or a run from its digest or from another store.
    Differs,
    /// The arguments or a manifest are wrong.
    Usage,
    /// The store or the system failed.
    System,
    /// Stopped by a signal; the same command resumes.
    Interrupted,
    /// A cluster task was stopped by a signal; the next attempt resumes.
    RunAgain,
}

impl Exit {
    /// The exit code.
    pub(crate) fn code(self) -> u8 {
        match self {
            Exit::Done => 0,
            Exit::JobsFailed | Exit::Differs => 1,
            Exit::Usage => 2,
            Exit::System => 3,
            Exit::RunAgain => RUN_AGAIN,
            Exit::Interrupted => 130,
        }
    }
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> ExitCode {
        ExitCode::from(exit.code())
    }
}

/// Why a command failed.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Error {
    /// Wrong arguments that clap does not detect.
    #[error("{0}")]
    Usage(String),
    /// A filter that matches no job.
    #[error(transparent)]
    Filter(#[from] FilterError),
    /// Manifests with faults; all faults are listed.
    #[error("{}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"))]
    Manifests(Vec<Faults>),
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A sweep failed.
    #[error(transparent)]
    Sweep(#[from] SweepError),
    /// A submission failed.
    #[error(transparent)]
    Cluster(#[from] ClusterError),
    /// A query failed.
    #[error("{0}")]
    Query(QueryError),
    /// A file or stream failed.
    #[error("failed to {what}: {source}")]
    Io {
        /// The operation, with the path.
        what: String,
        /// The error of the system.
        source: io::Error,
    },
}

/// A failed write of the output. [`Error::report`] treats a closed pipe as success.
impl From<io::Error> for Error {
    fn from(source: io::Error) -> Self {
        Error::Io { what: "write the output".to_owned(), source }
    }
}

impl From<WatchError> for Error {
    fn from(error: WatchError) -> Self {
        match error {
            WatchError::Store(error) => error.into(),
            WatchError::Cluster(error) => error.into(),
            WatchError::Unknown { .. } | WatchError::Nothing { .. } => {
                Error::Usage(error.to_string())
            }
        }
    }
}

impl Error {
    /// Writes the error to standard error and returns how the command ended.
    pub(crate) fn report(&self) -> Exit {
        if let Error::Io { source, .. } = self
            && source.kind() == io::ErrorKind::BrokenPipe
        {
            return Exit::Done;
        }
        let mut stderr = io::stderr();
        // A failure to write the error itself is ignored.
        let _ = match self {
            Error::Manifests(_) => writeln!(stderr, "{self}"),
            _ => writeln!(stderr, "error: {self}"),
        };
        self.exit()
    }

    /// How a command with this error ends.
    pub(crate) fn exit(&self) -> Exit {
        match self {
            Error::Query(QueryError::Damaged { .. }) => Exit::System,
            Error::Usage(_) | Error::Filter(_) | Error::Manifests(_) | Error::Query(_) => {
                Exit::Usage
            }
            Error::Cluster(ClusterError::NoSuchSubmission { .. }) => Exit::Usage,
            Error::Store(_) | Error::Sweep(_) | Error::Cluster(_) | Error::Io { .. } => {
                Exit::System
            }
        }
    }
}
