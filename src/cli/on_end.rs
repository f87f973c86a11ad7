//! `--on-end`: a command that is called once, when a command ends.

use std::io::{self, Write};
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::cli::{Error, Exit, reader};
use crate::job::{Failure, JobKey, Outcome};
use crate::schedule::{Event, Found};
use crate::watch::failures::without_numbers;

/// Maximum number of different failures in a summary.
const FAILURES: usize = 10;
/// Time between two checks whether the command has ended.
const LOOK: Duration = Duration::from_millis(50);

/// Longest time that the end of the program waits until the command has read its summary.
const PATIENCE: Duration = Duration::from_millis(200);

/// The command of `--on-end`, and what its summary will say.
pub(super) struct OnEnd {
    /// `None` without `--on-end`.
    command: Option<String>,
    verb: &'static str,
    store: String,
    begun: Instant,
    called: AtomicBool,
    facts: Mutex<Facts>,
}

/// The facts of a summary, as far as they are known.
#[derive(Default)]
struct Facts {
    experiments: Vec<String>,
    jobs: Option<Jobs>,
    /// The different failures, each with its first job and the number of its jobs.
    failures: Vec<(JobKey, Failure, usize)>,
}

/// The jobs of a command by state.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Jobs {
    pub(super) completed: usize,
    pub(super) failed: usize,
    pub(super) left: usize,
}

impl OnEnd {
    /// The command of a verb that begins now.
    pub(super) fn new(
        command: Option<&String>,
        verb: &'static str,
        store: &std::path::Path,
    ) -> Self {
        OnEnd {
            command: command.cloned(),
            verb,
            store: store.display().to_string(),
            begun: Instant::now(),
            called: AtomicBool::new(false),
            facts: Mutex::default(),
        }
    }

    fn change(&self, change: impl FnOnce(&mut Facts)) {
        change(&mut self.facts.lock().unwrap_or_else(PoisonError::into_inner));
    }

    /// Sets the experiments of the summary.
    pub(super) fn experiments(&self, names: impl Iterator<Item = String>) {
        self.change(|facts| facts.experiments = names.collect());
    }

    /// Sets the jobs of the summary.
    pub(super) fn jobs(&self, jobs: Jobs) {
        self.change(|facts| facts.jobs = Some(jobs));
    }

    /// Adds a job that failed.
    pub(super) fn failed(&self, key: JobKey, failure: &Failure) {
        let plain = |failure: &Failure| (failure.kind.word(), without_numbers(&failure.message));
        self.change(|Facts { failures, .. }| {
            match failures.iter().position(|(_, other, _)| plain(other) == plain(failure)) {
                Some(index) => failures[index].2 += 1,
                None if failures.len() < FAILURES => failures.push((key, failure.clone(), 1)),
                None => {}
            }
        });
    }

    /// Counts the jobs that end in a sweep.
    pub(super) fn hear(&self, event: &Event<'_>) {
        if !event.is_of_run() {
            return;
        }
        let has_failed = match event {
            Event::Ended { outcome: Outcome::Completed(_), .. }
            | Event::Skipped { found: Found::Completed, .. } => false,
            Event::Ended { outcome: Outcome::Failed(failure), queued, .. } => {
                self.failed(queued.key, failure);
                true
            }
            Event::Skipped { found: Found::Failed, .. } => true,
            _ => return,
        };
        self.change(|facts| {
            if let Some(jobs) = &mut facts.jobs {
                jobs.left = jobs.left.saturating_sub(1);
                *(if has_failed { &mut jobs.failed } else { &mut jobs.completed }) += 1;
            }
        });
    }

    /// Calls the command after a verb has ended, and waits for it unless the verb was stopped by a signal.
    /// `event` names an end without an error.
    pub(super) fn after(&self, ended: &Result<Exit, Error>, event: &str, stop: &AtomicBool) {
        let (event, exit, message) = match ended {
            Ok(Exit::Interrupted) => ("stopped", Exit::Interrupted, None),
            Ok(exit) => (event, *exit, None),
            Err(error) => ("error", error.exit(), Some(error.to_string())),
        };
        let Some(mut child) = self.call(event, exit, message.as_deref()) else { return };
        while !stop.load(Ordering::Relaxed) {
            match child.try_wait() {
                Ok(None) => thread::sleep(LOOK),
                Ok(Some(status)) if status.success() => return,
                Ok(Some(status)) => return warn(&format!("ended with {status}")),
                Err(error) => return warn(&error.to_string()),
            }
        }
    }

    /// Calls the command, which then runs on its own, unless it has been called before.
    pub(super) fn call(&self, event: &str, exit: Exit, message: Option<&str>) -> Option<Child> {
        let command = self.command.as_ref()?;
        if self.called.swap(true, Ordering::Relaxed) {
            return None;
        }
        let summary = self.summary(event, exit, message);
        let mut started = Command::new("sh");
        // Standard output of this program is for data.
        started.args(["-c", command]).stdin(Stdio::piped()).stdout(io::stderr());
        // After a signal, another Ctrl-C ends only this program. Otherwise the command may use the terminal, whose
        // questions a group of its own could not answer: the system would stop it.
        if exit == Exit::Interrupted {
            started.process_group(0);
        }
        let mut child = match started.spawn() {
            Ok(child) => child,
            Err(error) => {
                warn(&format!("failed to start: {error}"));
                return None;
            }
        };
        // A command may end without reading the summary, or never read it.
        let input = child.stdin.take();
        reader::within(PATIENCE, move || drop(input.map(|mut input| writeln!(input, "{summary}"))));
        Some(child)
    }

    fn summary(&self, event: &str, exit: Exit, message: Option<&str>) -> Value {
        let facts = self.facts.lock().unwrap_or_else(PoisonError::into_inner);
        let failures = facts.failures.iter().map(|(key, failure, jobs)| {
            json!({
                "job_key": key.to_string(), "kind": failure.kind.word(),
                "message": failure.message, "jobs": jobs,
            })
        });
        json!({
            "command": self.verb, "event": event, "exit_code": exit.code(), "message": message,
            "store": self.store, "experiments": facts.experiments,
            "seconds": self.begun.elapsed().as_secs_f64(),
            "completed": facts.jobs.map(|jobs| jobs.completed),
            "failed": facts.jobs.map(|jobs| jobs.failed),
            "left": facts.jobs.map(|jobs| jobs.left),
            "failures": failures.collect::<Vec<_>>(),
        })
    }
}

fn warn(what: &str) {
    reader::say(&format!("the command of --on-end {what}"));
}
