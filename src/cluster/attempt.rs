//! What an attempt at a chunk says of itself, in a file that only it writes.

use serde::{Deserialize, Serialize};

use super::clock::now;

/// One attempt at a chunk: a task from its start on a node to its end.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Attempt {
    /// The chunk.
    pub chunk: u32,
    /// A name that no other attempt has: the engine's, and eight digits.
    pub attempt: String,
    /// The node.
    pub host: String,
    /// Cores that it holds.
    pub cpus: u32,
    /// When it began, in seconds since 1970.
    pub started_at: f64,
    /// When it last wrote this.
    pub seen_at: f64,
    /// Jobs that it completed.
    pub completed: u64,
    /// Jobs that failed in it.
    pub failed: u64,
    /// How it ended; `None` while it runs, and for ever if it was killed.
    pub end: Option<AttemptEnd>,
}

/// How an attempt ended, by its own account.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AttemptEnd {
    /// All jobs of the chunk are handed in.
    Finished,
    /// A signal stopped it. What it completed is handed in, and checkpoints of the rest.
    Stopped,
    /// It cannot go on, for this reason.
    Failed(String),
}

impl Attempt {
    /// An attempt that begins now.
    pub fn begin(chunk: u32, attempt: String, host: String, cpus: u32) -> Attempt {
        let at = now();
        Attempt {
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

    /// Time of its cores as far as it is known, in hours.
    pub fn core_hours(&self) -> f64 {
        f64::from(self.cpus) * (self.seen_at - self.started_at).max(0.0) / 3600.0
    }
}
