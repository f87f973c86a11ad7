//! The interface to the system that runs the tasks of a submission: four calls and their results.
//!
//! A submission is one array of tasks with a unique name. An engine identifies a task by the name
//! of its array and the number of its chunk; it uses no jobs, stores or folders. `slurm.rs`
//! implements the engine for Slurm. Another engine needs a file of this kind, a variant of
//! [`EngineKind`], and its lines in `engines.rs`.

use std::env;
use std::io::{self, Read};
use std::path::Path;
use std::process::{Command, ExitStatus, Stdio};
use std::thread;
use std::time::{Duration, Instant};

/// A system that runs arrays of tasks.
pub trait Engine {
    /// Submits the script of an array; returns the engine's id of the array.
    ///
    /// **Errors**: the engine rejected the array, or it is unknown whether the engine accepted it.
    fn submit(&self, script: &Path) -> Result<String, EngineError>;

    /// The tasks of the arrays of these names that are waiting or running.
    ///
    /// **Errors**: the engine does not answer. This says nothing about any task.
    fn alive(&self, names: &[&str]) -> Result<Vec<Alive>, EngineError>;

    /// Cancels the waiting and running tasks of an array; `array` is the engine's id.
    ///
    /// **Errors**: the engine does not answer or refuses.
    fn cancel(&self, array: &str) -> Result<(), EngineError>;

    /// The limits of the engine.
    ///
    /// **Errors**: the engine does not answer.
    fn limits(&self) -> Result<Limits, EngineError>;
}

/// The supported engines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EngineKind {
    /// Slurm.
    Slurm,
}

impl EngineKind {
    /// All engines.
    pub const ALL: [EngineKind; 1] = [EngineKind::Slurm];

    /// The engine's name in a profile.
    pub fn name(self) -> &'static str {
        match self {
            EngineKind::Slurm => "slurm",
        }
    }

    /// The engine of this name.
    pub fn named(name: &str) -> Option<EngineKind> {
        EngineKind::ALL.into_iter().find(|kind| kind.name() == name)
    }
}

/// A task that an engine holds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Alive {
    /// Name of its array.
    pub name: String,
    /// The engine's id of the array.
    pub array: String,
    /// The chunk that the task runs.
    pub chunk: u32,
    /// Whether the task runs.
    pub phase: Phase,
}

/// Whether a task held by an engine is running.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// The task is queued, for the first time or again.
    Waiting,
    /// The task has a node.
    Running,
}

/// Limits of an engine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Maximum number of tasks in an array; at least 1.
    pub most_tasks: u32,
}

/// Why a call of an engine failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EngineError {
    /// The engine's program cannot be started.
    #[error(
        "failed to run `{program}`, a command of Slurm: {source}; submit on a machine of the cluster, or plan here with --dry-run"
    )]
    Missing {
        /// The program.
        program: &'static str,
        /// The error of the system.
        source: io::Error,
    },
    /// The engine's program exited with an error.
    #[error("`{program}` failed: {words}")]
    Refused {
        /// The program.
        program: &'static str,
        /// Its message, or its exit status.
        words: String,
    },
    /// The engine's program did not end in time.
    #[error("`{program}` did not answer within {seconds} s")]
    Silent {
        /// The program.
        program: &'static str,
        /// The time limit.
        seconds: u64,
    },
}

/// Runs a program of an engine and returns its standard output, if it succeeds within `patience`. The
/// program gets the environment variables except those that are `unset`.
pub(super) fn ask(
    program: &'static str,
    arguments: &[&str],
    unset: impl Fn(&str) -> bool,
    patience: Duration,
) -> Result<String, EngineError> {
    let missing = |source| EngineError::Missing { program, source };
    let mut command = Command::new(program);
    for (variable, _) in env::vars_os().filter(|(name, _)| name.to_str().is_some_and(&unset)) {
        command.env_remove(variable);
    }
    let mut child = command
        .args(arguments)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(missing)?;
    let (out, err) = (read_all(child.stdout.take()), read_all(child.stderr.take()));
    let begun = Instant::now();
    let status = loop {
        match child.try_wait().map_err(missing)? {
            Some(status) => break status,
            None if begun.elapsed() > patience => {
                // The program may already have ended.
                let _ = child.kill();
                let _ = child.wait();
                return Err(EngineError::Silent { program, seconds: patience.as_secs() });
            }
            None => thread::sleep(Duration::from_millis(5)),
        }
    };
    let text = |reader: thread::JoinHandle<String>| reader.join().unwrap_or_default();
    let (out, err) = (text(out), text(err));
    if status.success() {
        return Ok(out);
    }
    Err(EngineError::Refused { program, words: words(&err, &out, status) })
}

/// Reads a stream to its end while the program runs.
fn read_all(stream: Option<impl Read + Send + 'static>) -> thread::JoinHandle<String> {
    thread::spawn(move || {
        let mut bytes = Vec::new();
        if let Some(mut stream) = stream {
            // After a read error, the text read so far is used.
            let _ = stream.read_to_end(&mut bytes);
        }
        String::from_utf8_lossy(&bytes).into_owned()
    })
}

fn words(err: &str, out: &str, status: ExitStatus) -> String {
    let said = [err, out].map(str::trim).into_iter().find(|text| !text.is_empty());
    said.map_or_else(|| status.to_string(), str::to_owned)
}
