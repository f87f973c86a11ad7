//! The interface to the system that runs the tasks of a submission: what it declares, and four calls.
//!
//! A submission is one array of tasks with a unique name. An engine identifies a task by the name
//! of its array and the number of its chunk; it uses no jobs, stores or folders. `slurm.rs` is the
//! engine Slurm. Another engine needs a file of this kind and a variant in `engines.rs`.

use std::env;
use std::io;
use std::path::Path;
use std::process::{Command, Output};
use std::time::Duration;

use serde_json::Value as Json;
use toml::de::{DeInteger, DeValue};

use super::order::Order;
use crate::external::output_within;
use crate::key::{Key, Value};

/// What an engine declares: its keys in a profile, its script and its calls.
#[derive(Clone, Copy)]
pub(super) struct Declaration {
    /// The keys of a profile that only this engine has.
    pub keys: &'static [Key],
    /// The forms of keys that are stricter than the kinds of the keys.
    pub forms: &'static [KeyForm],
    /// The program to which the other keys of a profile are passed as options.
    pub program: &'static str,
    /// Options that jitai sets, with the key to use instead, or another remedy; it may be empty.
    pub reserved: &'static [(&'static str, &'static str)],
    /// What an option's value must be, if the value is wrong.
    pub expected: fn(option: &str, value: Option<&str>) -> Option<&'static str>,
    /// The limits of the engine where its configuration is unknown.
    pub usual: Limits,
    /// The script of an array.
    pub script: fn(&Order<'_>) -> String,
    /// The engine; makes no call.
    pub connect: fn() -> Box<dyn Engine>,
}

/// The form of the values of a key.
pub(super) struct KeyForm {
    /// Name of the key.
    pub key: &'static str,
    /// The values, to follow "expected".
    pub expected: &'static str,
    /// The value, if it has this form.
    pub read: fn(&DeValue<'_>) -> Option<Value>,
    /// The schema of the values.
    pub schema: fn() -> Json,
}

/// The text of a value.
pub(super) fn text(value: &DeValue<'_>) -> Option<String> {
    value.as_str().map(str::to_owned)
}

/// A text, or a whole number as text.
pub(super) fn text_or_number(value: &DeValue<'_>) -> Option<String> {
    let number = |whole: &DeInteger<'_>| i64::from_str_radix(whole.as_str(), whole.radix()).ok();
    text(value).or_else(|| value.as_integer().and_then(number).map(|number| number.to_string()))
}

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
    pub phase: TaskPhase,
}

/// Whether a task held by an engine is running.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TaskPhase {
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
        "failed to run `{program}`, a command of {engine}: {source}; submit on a machine of the cluster, or plan here with --dry-run"
    )]
    Missing {
        /// The engine's name in messages.
        engine: &'static str,
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

/// How the programs of an engine are run.
pub(super) struct Programs {
    /// The engine's name in messages.
    pub engine: &'static str,
    /// Whether an environment variable is hidden from the programs.
    pub is_unset: fn(&str) -> bool,
}

impl Programs {
    /// Runs a program and returns its standard output, if it succeeds within `patience`.
    ///
    /// **Errors**: the program cannot be started, fails, or does not end in time.
    pub(super) fn ask(
        &self,
        program: &'static str,
        arguments: &[&str],
        patience: Duration,
    ) -> Result<String, EngineError> {
        let mut command = Command::new(program);
        command.args(arguments);
        for (variable, _) in env::vars_os() {
            if variable.to_str().is_some_and(self.is_unset) {
                command.env_remove(variable);
            }
        }
        match output_within(command, patience) {
            Ok(Some(output)) if output.status.success() => Ok(lossy(&output.stdout)),
            Ok(Some(output)) => Err(EngineError::Refused { program, words: words(&output) }),
            Ok(None) => Err(EngineError::Silent { program, seconds: patience.as_secs() }),
            Err(source) => Err(EngineError::Missing { engine: self.engine, program, source }),
        }
    }
}

fn lossy(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn words(output: &Output) -> String {
    let said = [&output.stderr, &output.stdout].map(|bytes| lossy(bytes).trim().to_owned());
    said.into_iter().find(|text| !text.is_empty()).unwrap_or_else(|| output.status.to_string())
}
