//! The boundary to what runs the tasks of a submission: four calls, and what they answer.
//!
//! A submission is one array of tasks under a name of its own. An engine knows tasks by that name and
//! by the chunk that each runs; it does not know jobs, stores or folders. Slurm is in `slurm.rs`.
//! Another engine is a file like it, a variant of [`EngineKind`], and its line in `engines.rs`.

use std::io::{self, Read};
use std::path::Path;
use std::process::{Command, ExitStatus, Stdio};
use std::thread;
use std::time::{Duration, Instant};

/// Something that runs arrays of tasks.
pub trait Engine {
    /// Submits the script of an array; returns the engine's own name for it.
    ///
    /// **Errors**: it was refused, or nobody knows whether it was accepted.
    fn submit(&self, script: &Path) -> Result<String, EngineError>;

    /// The tasks of the arrays of these names that are waiting or running.
    ///
    /// **Errors**: the engine does not answer. This says nothing about any task.
    fn alive(&self, names: &[&str]) -> Result<Vec<Alive>, EngineError>;

    /// Ends what is waiting or running of an array, by the engine's own name for it.
    ///
    /// **Errors**: the engine does not answer or refuses.
    fn cancel(&self, array: &str) -> Result<(), EngineError>;

    /// What the engine accepts.
    ///
    /// **Errors**: the engine does not answer.
    fn limits(&self) -> Result<Limits, EngineError>;
}

/// The engines that there are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EngineKind {
    /// Slurm.
    Slurm,
}

impl EngineKind {
    /// Every engine.
    pub const ALL: [EngineKind; 1] = [EngineKind::Slurm];

    /// Its name in a profile.
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
    /// The engine's own name for the array.
    pub array: String,
    /// The chunk that it runs.
    pub chunk: u32,
    /// Whether it runs.
    pub phase: Phase,
}

/// Whether a task that an engine holds runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// It waits to be started, for the first time or again.
    Waiting,
    /// It has a node.
    Running,
}

/// What an engine accepts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Most tasks of an array; at least 1.
    pub most_tasks: u32,
}

/// Why an engine did not do what it was called for.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EngineError {
    /// Its program cannot be started.
    #[error(
        "failed to run `{program}`: {source}; is Slurm installed on this machine, and on the PATH?"
    )]
    Missing {
        /// The program.
        program: &'static str,
        /// What the system said.
        source: io::Error,
    },
    /// Its program failed.
    #[error("`{program}` says: {words}")]
    Refused {
        /// The program.
        program: &'static str,
        /// What it wrote, or how it ended.
        words: String,
    },
    /// Its program did not end in time.
    #[error("`{program}` has not answered for {seconds} s")]
    Silent {
        /// The program.
        program: &'static str,
        /// How long it was waited for.
        seconds: u64,
    },
}

/// What a program of an engine wrote to standard output, if it succeeded within `patience`.
pub(super) fn ask(
    program: &'static str,
    arguments: &[&str],
    patience: Duration,
) -> Result<String, EngineError> {
    let missing = |source| EngineError::Missing { program, source };
    let mut child = Command::new(program)
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
                // It may have ended by itself.
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
            // What cannot be read is no message.
            let _ = stream.read_to_end(&mut bytes);
        }
        String::from_utf8_lossy(&bytes).into_owned()
    })
}

fn words(err: &str, out: &str, status: ExitStatus) -> String {
    let said = [err, out].map(str::trim).into_iter().find(|text| !text.is_empty());
    said.map_or_else(|| status.to_string(), str::to_owned)
}
