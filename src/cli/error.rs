//! How commands end.

use std::io::{self, Write};
use std::process::ExitCode;

use crate::cluster::{ClusterError, RUN_AGAIN};
use crate::manifest::Faults;
use crate::plan::FilterError;
use crate::schedule::SweepError;
use crate::store::{QueryError, StoreError};

/// How a command ended, as its exit code says it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Exit {
    /// Everything asked for is done.
    Done,
    /// Some jobs failed.
    JobsFailed,
    /// A simulation differs from its recording, or a run from that of another store or its digest.
    Differs,
    /// The arguments or a manifest are wrong.
    Usage,
    /// The store or the system failed.
    System,
    /// Stopped by a signal; the same command goes on.
    Interrupted,
    /// A task of a cluster was stopped by a signal; the next attempt goes on.
    RunAgain,
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> ExitCode {
        ExitCode::from(match exit {
            Exit::Done => 0,
            Exit::JobsFailed | Exit::Differs => 1,
            Exit::Usage => 2,
            Exit::System => 3,
            Exit::RunAgain => RUN_AGAIN,
            Exit::Interrupted => 130,
        })
    }
}

/// What kept a command from its end.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Error {
    /// Arguments that clap cannot judge.
    #[error("{0}")]
    Usage(String),
    /// A filter that no job meets.
    #[error(transparent)]
    Filter(#[from] FilterError),
    /// Manifests with faults; each report is complete.
    #[error("{}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"))]
    Manifests(Vec<Faults>),
    /// The store.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A sweep.
    #[error(transparent)]
    Sweep(#[from] SweepError),
    /// A submission.
    #[error(transparent)]
    Cluster(#[from] ClusterError),
    /// A query.
    #[error("{0}")]
    Query(QueryError),
    /// A file or stream.
    #[error("failed to {what}: {source}")]
    Io {
        /// What was to be done, with the path.
        what: String,
        /// What the system said.
        source: io::Error,
    },
}

/// Output that cannot be written; a reader that closed the pipe has read enough.
impl From<io::Error> for Error {
    fn from(source: io::Error) -> Self {
        Error::Io { what: "write the output".to_owned(), source }
    }
}

impl Error {
    /// Tells the user and returns how the command ended.
    pub(crate) fn report(&self) -> Exit {
        if let Error::Io { source, .. } = self
            && source.kind() == io::ErrorKind::BrokenPipe
        {
            return Exit::Done;
        }
        let mut stderr = io::stderr();
        // Nothing is left to do if even this cannot be written.
        let _ = match self {
            Error::Manifests(_) => writeln!(stderr, "{self}"),
            _ => writeln!(stderr, "error: {self}"),
        };
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
