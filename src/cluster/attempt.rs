//! The record of an attempt at a chunk, in a file that only the attempt writes.

use serde::{Deserialize, Serialize};

use super::clock::now;

/// One attempt at a chunk: a task from its start on a node to its end.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TaskAttempt {
    /// The chunk.
    pub chunk: u32,
    /// Unique name: the engine's name of the attempt, and eight hexadecimal digits.
    pub attempt: String,
    /// The node.
    pub host: String,
    /// Number of cores of the task.
    pub cpus: u32,
    /// Start, in seconds since 1970.
    pub started_at: f64,
    /// Last write of the record, in seconds since 1970.
    pub seen_at: f64,
    /// Number of jobs that the attempt completed.
    pub completed: u64,
    /// Number of jobs that failed in the attempt.
    pub failed: u64,
    /// How the attempt ended; `None` while it runs, or if it was killed.
    pub end: Option<AttemptEnd>,
}

/// How an attempt ended, as the attempt itself recorded it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AttemptEnd {
    /// All jobs of the chunk are handed in.
    Finished,
    /// A signal stopped the attempt. Completed runs, and checkpoints of the other jobs, are handed in.
    Stopped,
    /// The attempt failed for this reason.
    Failed(String),
}

impl TaskAttempt {
    /// An attempt that starts now.
    pub fn begin(chunk: u32, attempt: String, host: String, cpus: u32) -> TaskAttempt {
        let at = now();
        TaskAttempt {
            chunk,
            attempt,
            host,
            cpus,
            started_at: at,
            seen_at: at,
            completed: 0,
            failed: 0,
            end: None,
        }
    }

    /// Core-hours from the start to the last write of the record.
    pub fn core_hours(&self) -> f64 {
        f64::from(self.cpus) * (self.seen_at - self.started_at).max(0.0) / 3600.0
    }
}
