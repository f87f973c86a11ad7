//! The parameters of a script for an array of tasks.

use std::path::Path;

use super::profile::Profile;

/// An array of tasks, as an engine's script describes it.
#[derive(Clone, Copy, Debug)]
pub struct Order<'a> {
    /// Name of the array.
    pub name: &'a str,
    /// Number of tasks; their chunks are numbered from 0.
    pub chunks: u32,
    /// Folder of the submission, an absolute path.
    pub folder: &'a Path,
    /// Absolute path of this program.
    pub program: &'a Path,
    /// Where and how tasks run.
    pub profile: &'a Profile,
}

/// Exit code of a task that was stopped by a signal and resumes from its checkpoints when run again
/// (`EX_TEMPFAIL` of sysexits.h).
pub const RUN_AGAIN: u8 = 75;

/// A text quoted as one word for a POSIX shell.
pub(super) fn quoted(text: &str) -> String {
    format!("'{}'", text.replace('\'', "'\\''"))
}
