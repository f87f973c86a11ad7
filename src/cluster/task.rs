//! A task: one attempt at a chunk, on a node.
//!
//! The task runs the jobs of the chunk with the ordinary scheduler on a store in node-local scratch. At
//! intervals, on a stop and at the end, it closes that store, seals it, hands it in as a part and starts
//! a new store for the remaining jobs. Running jobs are checkpointed and resume with bit-identical
//! results, so a part is never a copy of a store in use. Checkpoints are handed in with the parts.
//! SQLite never writes to the shared disk.

use std::collections::{HashMap, HashSet};
use std::fs;
use std::io::Write;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use super::attempt::{AttemptEnd, TaskAttempt};
use super::clock::{now, random};
use super::error::ClusterError;
use super::folder::{HandedIn, Submission, copy_whole};
use crate::job::Outcome;
use crate::job::{JobKey, counted};
use crate::manifest::{self, Manifest};
use crate::schedule::{
    self, CheckpointFolder, CheckpointNote, Context, Event, Options, Queued, Selection,
};
use crate::store::{self, RetryFailed, Store};
use crate::train;

/// Interval of an attempt's heartbeat.
const SAY: Duration = Duration::from_secs(30);
/// Time between two tries of a hand-in.
const RETRY: Duration = Duration::from_secs(5);
/// Maximum time for which a hand-in is retried.
const MOST_RETRIES: Duration = Duration::from_secs(600);
/// Number of dead attempts after which a chunk is left to another submission, in smaller chunks.
const MOST_DEATHS: usize = 3;

/// The assignment of a task.
#[derive(Clone, Copy, Debug)]
pub struct TaskOrder<'a> {
    /// The submission.
    pub submission: &'a Submission,
    /// The chunk.
    pub chunk: u32,
    /// The engine's name for this attempt; two attempts may share it.
    pub attempt: &'a str,
    /// A node-local folder.
    pub scratch: &'a Path,
    /// Set from outside to stop the task.
    pub stop: &'a AtomicBool,
}

/// How a task ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TaskEnd {
    /// All jobs of the chunk are handed in.
    Finished,
    /// The task was stopped; another attempt resumes it.
    Stopped,
    /// The task ran no job: its submission was stopped, or too many attempts had died.
    NotWanted,
}

/// Runs a chunk. `out` is the task's log.
///
/// **Errors**: the submission cannot be read, the scratch folder cannot be written, or nothing can
/// be handed in.
pub fn run_chunk(task: TaskOrder<'_>, out: &mut dyn Write) -> Result<TaskEnd, ClusterError> {
    let TaskOrder { submission, chunk, attempt, .. } = task;
    if submission.stopped().is_some() {
        say(out, "the submission was cancelled or submitted again; nothing is run");
        return Ok(TaskEnd::NotWanted);
    }
    let attempts = submission.attempts()?.remove(&chunk).unwrap_or_default();
    let deaths = attempts.iter().filter(|earlier| earlier.end.is_none()).count();
    if deaths >= MOST_DEATHS {
        say(
            out,
            "three attempts at this chunk were killed; `jitai submit` splits it into smaller \
             chunks",
        );
        return Ok(TaskEnd::NotWanted);
    }
    let host = store::host_name();
    let cpus = submission.intent.cpus_per_task;
    // A controller that was killed may start a task a second time under the same name.
    let attempt = format!("{attempt}-{:08x}", random() as u32);
    let attempt = TaskAttempt::begin(chunk, attempt, host, cpus);
    say(out, &format!("attempt {} at chunk {chunk} on {}", attempt.attempt, attempt.host));
    let mut run = Run { task, attempt, said_at: Instant::now(), out };
    run.record();
    let end = run.run();
    run.attempt.end = Some(match &end {
        Ok(TaskEnd::Finished) => AttemptEnd::Finished,
        Ok(TaskEnd::Stopped | TaskEnd::NotWanted) => AttemptEnd::Stopped,
        Err(error) => AttemptEnd::Failed(error.to_string()),
    });
    run.record();
    end
}

fn say(out: &mut dyn Write, line: &str) {
    // A failed write to the log does not stop the task.
    let _ = writeln!(out, "{line}").and_then(|()| out.flush());
}

/// A running attempt.
struct Run<'a> {
    task: TaskOrder<'a>,
    attempt: TaskAttempt,
    said_at: Instant,
    out: &'a mut dyn Write,
}

impl Run<'_> {
    /// Writes the record of the attempt with its progress.
    fn record(&mut self) {
        self.said_at = Instant::now();
        self.attempt.seen_at = now();
        if let Err(error) = self.task.submission.record_attempt(&self.attempt) {
            say(self.out, &format!("failed to write to the submission's folder: {error}"));
        }
    }

    fn run(&mut self) -> Result<TaskEnd, ClusterError> {
        let TaskOrder { submission, chunk, .. } = self.task;
        let mut left: Vec<JobKey> = submission.chunk(chunk)?;
        let all = left.len();
        let handed: HashSet<JobKey> = submission
            .parts()?
            .iter()
            .filter(|part| part.chunk == Some(chunk))
            .filter_map(|part| part.jobs())
            .flatten()
            .map(|(key, _)| key)
            .collect();
        left.retain(|key| !handed.contains(key));
        say(self.out, &format!("jobs: {all}, left: {}", left.len()));
        if left.is_empty() {
            return Ok(TaskEnd::Finished);
        }
        let plan = Plan::read(submission, &left)?;
        let scratch = Scratch::make(self.task, self.out)?;
        // Earlier attempts at these jobs have ended.
        submission.curves().forget_curves(|key| left.contains(key));
        self.adopt_checkpoints(&scratch, &left);
        let mut number = 0;
        while !left.is_empty() {
            if self.stopped() {
                return Ok(TaskEnd::Stopped);
            }
            number += 1;
            let ended = self.sweep(&scratch, &plan, &left)?;
            self.hand_in(&scratch, &ended, number)?;
            let ended: HashSet<JobKey> = ended.into_iter().map(|(key, _)| key).collect();
            left.retain(|key| !ended.contains(key));
            self.hand_in_checkpoints(&scratch, &ended);
            self.record();
        }
        say(self.out, "finished");
        Ok(TaskEnd::Finished)
    }

    fn stopped(&self) -> bool {
        self.task.stop.load(Ordering::Relaxed)
    }

    /// Runs jobs until all have ended, a hand-in is due or the task is stopped; returns those that
    /// ended.
    fn sweep(
        &mut self,
        scratch: &Scratch,
        plan: &Plan,
        left: &[JobKey],
    ) -> Result<Vec<(JobKey, HandedIn)>, ClusterError> {
        let due = Duration::from_secs_f64(self.task.submission.intent.hand_in_seconds);
        let begun = Instant::now();
        let mut store = Store::open(&scratch.store())?;
        plan.register(&mut store, left)?;
        let workers = NonZeroUsize::new(self.attempt.cpus as usize).unwrap_or(NonZeroUsize::MIN);
        let options = Options { workers, retry_failed: RetryFailed::No, ..Options::default() };
        let halt = AtomicBool::new(false);
        let curves = self.task.submission.curves();
        let context = Context { options, train: &train::run, stop: &halt, curves: Some(&curves) };
        let session = store.begin_session(&schedule::of_this_process())?;
        let mut ended = Vec::new();
        let swept =
            schedule::run(&mut store, session, plan.queue(left), context, &mut |event: Event<
                '_,
            >| {
                self.hear(&event, &mut ended);
                if self.stopped() || begun.elapsed() >= due {
                    halt.store(true, Ordering::Relaxed);
                }
            });
        let session_ended = store.end_session(session);
        swept?;
        session_ended?;
        Ok(ended)
    }

    fn hear(&mut self, event: &Event<'_>, ended: &mut Vec<(JobKey, HandedIn)>) {
        match event {
            Event::Ended { queued, outcome: Outcome::Completed(_), .. } => {
                self.attempt.completed += 1;
                ended.push((queued.key, HandedIn::Completed));
            }
            Event::Ended { queued, outcome: Outcome::Failed(failure), .. } => {
                self.attempt.failed += 1;
                ended.push((queued.key, HandedIn::Failed));
                let (key, kind) = (queued.key, failure.kind);
                say(self.out, &format!("{key} failed: {kind} ({})", failure.message));
            }
            Event::Checkpoint { queued, note, .. } => {
                let key = queued.key;
                let line = match note {
                    CheckpointNote::Resumed(resumed) => {
                        format!("{key} resumed from episode {}", resumed.episode)
                    }
                    CheckpointNote::Refused { path, reason } => {
                        format!("{key}: checkpoint {} rejected: {reason}", path.display())
                    }
                    CheckpointNote::NotKept { path, reason } => {
                        format!("failed to write {}: {reason}", path.display())
                    }
                };
                say(self.out, &line);
            }
            Event::FewerWorkers { started, reason } => {
                say(self.out, &format!("only {} started: {reason}", counted(*started, "worker")));
            }
            Event::Ended { outcome: Outcome::Interrupted, .. }
            | Event::Started { .. }
            | Event::Lost { .. }
            | Event::Skipped { .. }
            | Event::Tick { .. } => {}
        }
        if self.said_at.elapsed() >= SAY {
            self.record();
        }
    }

    /// Seals the store and hands it in; retries if that fails, for example while the shared disk is
    /// full.
    fn hand_in(
        &mut self,
        scratch: &Scratch,
        ended: &[(JobKey, HandedIn)],
        number: u32,
    ) -> Result<(), ClusterError> {
        let store = scratch.store();
        if ended.is_empty() {
            return fs::remove_file(&store).map_err(ClusterError::io("remove", &store));
        }
        store::seal(&store)?;
        let TaskAttempt { chunk, attempt, .. } = &self.attempt;
        let stem = format!("{chunk}.{attempt}-{number}");
        let begun = Instant::now();
        loop {
            match self.task.submission.hand_in(&stem, &store, ended) {
                Ok(part) => {
                    say(self.out, &format!("handed in: {}, jobs: {}", part.display(), ended.len()));
                    break;
                }
                Err(source) => {
                    say(self.out, &format!("failed to hand in {stem}: {source}"));
                    // A stopped task has little time left, so it retries only briefly.
                    if begun.elapsed() >= MOST_RETRIES
                        || (self.stopped() && begun.elapsed() >= RETRY)
                    {
                        let path = self.task.submission.path().to_owned();
                        return Err(ClusterError::NotHandedIn { path, source });
                    }
                    self.wait(RETRY);
                }
            }
        }
        fs::remove_file(&store).map_err(ClusterError::io("remove", &store))
    }

    /// Waits for this time; returns early if the task is stopped meanwhile.
    fn wait(&self, time: Duration) {
        let begun = Instant::now();
        let was_stopped = self.stopped();
        while begun.elapsed() < time && self.stopped() == was_stopped {
            thread::sleep(Duration::from_millis(50));
        }
    }

    /// Copies checkpoints of the jobs, from this or other submissions, to the store in scratch.
    fn adopt_checkpoints(&mut self, scratch: &Scratch, left: &[JobKey]) {
        let folder = CheckpointFolder::beside(&scratch.store());
        let found = checkpoints_beside(self.task.submission.path());
        for key in left {
            let Some((checkpoint, _)) = found.get(key) else { continue };
            if let Err(error) = folder.adopt(key, checkpoint) {
                say(self.out, &format!("failed to read {}: {error}", checkpoint.display()));
            }
        }
    }

    /// Hands in the checkpoints of jobs that have not ended, and removes the checkpoints of jobs
    /// that have.
    fn hand_in_checkpoints(&mut self, scratch: &Scratch, ended: &HashSet<JobKey>) {
        let submission = self.task.submission;
        for (key, checkpoint) in CheckpointFolder::beside(&scratch.store()).latest() {
            if ended.contains(&key) {
                continue;
            }
            match copy_whole(&checkpoint, &submission.checkpoint(&key)) {
                Ok(()) => say(self.out, &format!("{key}: checkpoint handed in")),
                Err(error) => say(self.out, &format!("{key}: checkpoint not handed in: {error}")),
            }
        }
        for key in ended {
            // Most jobs have no checkpoint.
            let _ = fs::remove_file(submission.checkpoint(key));
        }
    }
}

/// The latest checkpoint of each job that was handed in to this or another submission of the store.
fn checkpoints_beside(submission: &Path) -> HashMap<JobKey, (PathBuf, std::time::SystemTime)> {
    let mut found: HashMap<JobKey, (PathBuf, std::time::SystemTime)> = HashMap::new();
    let siblings = submission.parent().and_then(|folder| fs::read_dir(folder).ok());
    for sibling in siblings.into_iter().flatten().flatten() {
        let files = fs::read_dir(sibling.path().join("checkpoints"));
        for file in files.into_iter().flatten().flatten() {
            let name = file.file_name();
            let Some(stem) = name.to_str().and_then(|name| name.strip_suffix(".checkpoint")) else {
                continue;
            };
            let Ok(key) = u128::from_str_radix(stem, 16) else { continue };
            let Ok(written) = file.metadata().and_then(|metadata| metadata.modified()) else {
                continue;
            };
            let key = JobKey(key.to_be_bytes());
            if found.get(&key).is_none_or(|(_, other)| *other < written) {
                found.insert(key, (file.path(), written));
            }
        }
    }
    found
}

/// The folder of an attempt on its node; removed at its end.
struct Scratch {
    path: PathBuf,
}

impl Scratch {
    fn make(task: TaskOrder<'_>, out: &mut dyn Write) -> Result<Scratch, ClusterError> {
        let name = task.submission.name();
        let (chunk, random) = (task.chunk, random() as u32);
        let path = task.scratch.join(format!("jitai-{name}-{chunk}-{random:08x}"));
        fs::create_dir_all(&path).map_err(ClusterError::io("create", &path))?;
        say(out, &format!("scratch: {}", path.display()));
        Ok(Scratch { path })
    }

    fn store(&self) -> PathBuf {
        self.path.join("jitai.sqlite")
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // If this fails, the node's own clean-up removes the folder.
        let _ = fs::remove_dir_all(&self.path);
    }
}

/// The jobs of a chunk, expanded from the frozen manifests.
struct Plan {
    manifests: Vec<Manifest>,
    jobs: HashMap<JobKey, Queued>,
}

impl Plan {
    /// The jobs with these keys.
    ///
    /// **Errors**: a manifest cannot be read, or this program does not derive all of these jobs from
    /// the manifests.
    fn read(submission: &Submission, keys: &[JobKey]) -> Result<Plan, ClusterError> {
        let paths = submission.manifests();
        let mut manifests: Vec<Manifest> =
            paths.iter().map(|path| manifest::load(path)).collect::<Result<_, _>>()?;
        // Outside programs start in the folder of the author's manifest, not in the folder of the
        // frozen copy.
        for (manifest, folder) in manifests.iter_mut().zip(&submission.intent.folders) {
            manifest.path = format!("{folder}/manifest.toml");
        }
        let selection = Selection::new(&manifests, None).expect("no filter refuses");
        let selection = selection.part(keys.iter().copied().collect());
        let queue = schedule::Survey::of(&selection, None).queue(|_, _| true)?;
        let jobs: HashMap<JobKey, Queued> =
            queue.into_iter().map(|queued| (queued.key, queued)).collect();
        match keys.len() - jobs.len() {
            0 => Ok(Plan { manifests, jobs }),
            missing => {
                let code_version = submission.intent.code_version.clone();
                Err(ClusterError::OtherCode { missing, code_version })
            }
        }
    }

    /// Registers the remaining jobs under their experiments.
    fn register(&self, store: &mut Store, left: &[JobKey]) -> Result<(), ClusterError> {
        let left: HashSet<JobKey> = left.iter().copied().collect();
        let selection = Selection::new(&self.manifests, None).expect("no filter refuses");
        let never = AtomicBool::new(false);
        schedule::register(store, &selection.part(left), &never, |_| {}).map(drop)?;
        Ok(())
    }

    /// The jobs with these keys, in the order of the keys.
    fn queue(&self, keys: &[JobKey]) -> Vec<Queued> {
        keys.iter().filter_map(|key| self.jobs.get(key).cloned()).collect()
    }
}
