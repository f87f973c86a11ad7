//! What a script for an array of tasks must do.

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
    /// This program, an absolute path.
    pub program: &'a Path,
    /// Where and how tasks run.
    pub profile: &'a Profile,
}

/// Exit code of a task that was stopped by a signal and goes on from its checkpoints if it is run
/// again (`EX_TEMPFAIL` of sysexits.h).
pub const RUN_AGAIN: u8 = 75;

/// A text as one word of a POSIX shell.
pub(super) fn quoted(text: &str) -> String {
    format!("'{}'", text.replace('\'', "'\\''"))
}
