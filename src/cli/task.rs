//! `jitai task`: one attempt at a chunk of a submission, called by the script of the job array.

use std::io;
use std::path::PathBuf;

use crate::cli::{Error, Exit, signals};
use crate::cluster::{Submission, TaskEnd, TaskOrder, run_chunk};

/// Run one chunk of a submission, on a node of the cluster
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// Folder of the submission
    folder: PathBuf,
    /// Number of the chunk
    #[arg(long)]
    chunk: u32,
    /// Name of this attempt, from the cluster
    #[arg(long)]
    attempt: String,
    /// A folder on a local disk of this node
    #[arg(long)]
    scratch: PathBuf,
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    let stop = signals::lasting_stop_flag()
        .map_err(|source| Error::Io { what: "listen for signals".to_owned(), source })?;
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "._-".contains(c);
    if arguments.attempt.is_empty() || !arguments.attempt.chars().all(is_plain) {
        return Err(Error::Usage(
            "--attempt: expected letters, digits, `.`, `_` or `-`".to_owned(),
        ));
    }
    let submission = Submission::open(&arguments.folder)?;
    let assignment = TaskOrder {
        submission: &submission,
        chunk: arguments.chunk,
        attempt: &arguments.attempt,
        scratch: &arguments.scratch,
        stop: &stop,
    };
    match run_chunk(assignment, &mut io::stdout())? {
        TaskEnd::Finished | TaskEnd::NotWanted => Ok(Exit::Done),
        TaskEnd::Stopped => Ok(Exit::RunAgain),
    }
}
