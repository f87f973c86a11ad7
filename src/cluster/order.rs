//! An array of tasks, as the script of an engine describes it.

use std::path::Path;

use crate::key::{Kind, Value};
use crate::keys;

/// Maximum number of cores per task; equal to the maximum number of workers of a sweep.
const MOST_CPUS: u64 = 1024;

/// Minimum of the keys that are times in minutes.
const LEAST_MINUTES: f64 = 0.00001;

keys! {
    /// The keys of a profile that every engine has.
    pub struct Tasks {
        /// cores per task, and jobs that a task trains at the same time
        cpus_per_task: u32 = 1, in Kind::Integer { min: 1, max: MOST_CPUS };
        /// maximum number of tasks that run at the same time
        max_running: u32 = 0, in Kind::Integer { min: 1, max: 1_000_000 };
        /// estimated time of the jobs of a task, in minutes
        chunk_minutes: f64 = 15.0, in Kind::Real { min: LEAST_MINUTES, max: 100_000.0 };
        /// maximum time between two hand-ins of finished jobs and checkpoints, in minutes
        hand_in_minutes: f64 = 9.0, in Kind::Real { min: LEAST_MINUTES, max: 10.0 };
        /// node-local folder for a task's store; variables are expanded on the node
        scratch: String = "${TMPDIR:-/tmp}".to_owned(), in Kind::Text { most: Kind::LONGEST_TEXT };
        /// folder for submissions, on a disk that login node and compute nodes share; beside
        /// the store if absent
        folder: String = String::new(), in Kind::Text { most: Kind::LONGEST_TEXT };
        /// lines of shell that each task runs first, such as `module load`
        setup: Vec<String> = Vec::new(), in Kind::Words { most: 1000, longest: Kind::LONGEST_TEXT };
    }
}

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
    /// How tasks run.
    pub tasks: &'a Tasks,
    /// Values of the keys that only the engine has.
    pub settings: &'a [Value],
    /// Options of the engine, in the order of the profile; `None` as the value of a switch.
    pub options: &'a [(String, Option<String>)],
}

/// Exit code of a task that was stopped by a signal and resumes from its checkpoints when run again
/// (`EX_TEMPFAIL` of sysexits.h).
pub const RUN_AGAIN: u8 = 75;

/// A text quoted as one word for a POSIX shell.
pub(super) fn quoted(text: &str) -> String {
    format!("'{}'", text.replace('\'', "'\\''"))
}
