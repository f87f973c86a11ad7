//! A thread that trains one job at a time, and tells what becomes of it.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError, mpsc};
use std::thread::{self, Scope};
use std::time::Duration;

use crate::plan::{Job, JobKey};
use crate::record::{Failure, FailureKind, Outcome};
use crate::schedule::checkpoint::{Alarm, CheckpointFolder, CheckpointNote, Keeper, Stopwatch};
use crate::schedule::panic;
use crate::schedule::queued::Queued;
use crate::store::Claim;
use crate::train::{Checkpoints, TrainingControl, TrainingProgress};

/// A way to train a job; the program's is [`crate::train::run()`].
pub type Train<'a> = &'a (dyn Fn(&Job, &dyn TrainingControl) -> Outcome + Sync);

/// Where a worker leaves its latest progress for the coordinating thread, and hears that a
/// checkpoint is due or its job over its time.
#[derive(Default)]
pub(super) struct Slot {
    progress: Mutex<Option<TrainingProgress>>,
    checkpoint: Alarm,
    deadline: Alarm,
    worked: Stopwatch,
}

impl Slot {
    /// Looks at the clock for the worker.
    pub(super) fn look(&self) {
        self.worked.look();
        self.checkpoint.look();
        self.deadline.look();
    }

    fn get(&self) -> Option<TrainingProgress> {
        *self.progress.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Training episodes finished.
    fn episode(&self) -> u32 {
        self.get().map_or(0, |progress| progress.episode)
    }

    fn set(&self, progress: Option<TrainingProgress>) {
        *self.progress.lock().unwrap_or_else(PoisonError::into_inner) = progress;
    }
}

/// What a worker sends.
pub(super) enum Message {
    /// Its job has ended.
    Ended(Report),
    /// Something happened to a checkpoint of its job.
    Noted { worker: usize, note: CheckpointNote },
}

/// How a job has ended.
pub(super) struct Report {
    pub(super) worker: usize,
    pub(super) outcome: Outcome,
    /// Time that it took, that of the runs included that it went on from.
    pub(super) wall: Duration,
}

/// What all workers of a sweep share.
#[derive(Clone)]
pub(super) struct Shared<'a> {
    pub(super) train: Train<'a>,
    pub(super) halt: &'a AtomicBool,
    pub(super) folder: &'a CheckpointFolder,
    /// Time between two checkpoints.
    pub(super) checkpoint_every: Duration,
    pub(super) messages: mpsc::Sender<Message>,
}

/// A job to train.
struct Task {
    job: Job,
    key: JobKey,
    attempt: u32,
    time_limit: Option<Duration>,
}

/// The coordinating thread's end of a worker.
pub(super) struct Worker<'scope> {
    tasks: mpsc::Sender<Task>,
    slot: &'scope Slot,
    holds: Option<(Queued, Claim)>,
}

impl<'scope> Worker<'scope> {
    /// A worker with a thread of its own.
    ///
    /// **Errors**: the system has no more threads.
    pub(super) fn spawn(
        scope: &'scope Scope<'scope, '_>,
        index: usize,
        slot: &'scope Slot,
        shared: Shared<'scope>,
    ) -> io::Result<Self> {
        let (tasks, inbox) = mpsc::channel::<Task>();
        let thread = thread::Builder::new().name(format!("worker {index}"));
        thread.spawn_scoped(scope, move || {
            // Ends when the sweep drops its end of the channel.
            for task in inbox {
                let report = work(index, &task, slot, &shared);
                if shared.messages.send(Message::Ended(report)).is_err() {
                    break;
                }
            }
        })?;
        Ok(Worker { tasks, slot, holds: None })
    }

    pub(super) fn is_idle(&self) -> bool {
        self.holds.is_none()
    }

    pub(super) fn start(&mut self, queued: Queued, claim: Claim) {
        self.slot.set(None);
        let (job, time_limit) = (queued.job.clone(), queued.time_limit);
        let task = Task { job, key: queued.key, attempt: claim.attempt, time_limit };
        self.tasks.send(task).expect("a worker lives as long as its sweep");
        self.holds = Some((queued, claim));
    }

    /// The job that it is at.
    pub(super) fn job(&self) -> &Queued {
        let (queued, _) = self.holds.as_ref().expect("a message comes from a worker with a job");
        queued
    }

    /// Takes back the job that has ended.
    pub(super) fn finish(&mut self) -> (Queued, Claim) {
        self.slot.set(None);
        self.holds.take().expect("a report comes from a worker that holds a job")
    }

    pub(super) fn progress(&self) -> Option<TrainingProgress> {
        self.slot.get()
    }
}

/// Trains a job.
fn work(worker: usize, task: &Task, slot: &Slot, shared: &Shared<'_>) -> Report {
    slot.worked.restart();
    let Task { job, key, attempt, time_limit } = task;
    let limit = time_limit.unwrap_or(Duration::MAX);
    slot.deadline.set(limit);
    let tell = |note| {
        if let CheckpointNote::Resumed(resumed) = &note {
            slot.deadline.set(limit.saturating_sub(resumed.worked));
        }
        // A sweep that has ended early hears nothing any more.
        let _ = shared.messages.send(Message::Noted { worker, note });
    };
    let clock = (&slot.checkpoint, shared.checkpoint_every);
    let keeper = Keeper::new(shared.folder, (*key, *attempt), clock, &tell);
    let control = SlotControl { slot, halt: shared.halt, keeper };
    let outcome = match train_caught(shared.train, job, &control) {
        Outcome::Interrupted if slot.deadline.rings() => Outcome::Failed(over_time(slot, limit)),
        outcome => outcome,
    };
    Report { worker, outcome, wall: control.keeper.before() + slot.worked.look() }
}

struct SlotControl<'a> {
    slot: &'a Slot,
    halt: &'a AtomicBool,
    keeper: Keeper<'a>,
}

impl TrainingControl for SlotControl<'_> {
    fn report(&self, progress: TrainingProgress) {
        self.slot.set(Some(progress));
    }

    fn stop_requested(&self) -> bool {
        self.halt.load(Ordering::Relaxed) || self.slot.deadline.rings()
    }

    fn worked(&self) -> Duration {
        self.slot.worked.look()
    }

    fn checkpoints(&self) -> &dyn Checkpoints {
        &self.keeper
    }
}

/// Trains a job; a panic becomes a failure.
fn train_caught(train: Train<'_>, job: &Job, control: &SlotControl<'_>) -> Outcome {
    match panic::catch(|| train(job, control)) {
        Ok(outcome) => outcome,
        Err(message) => Outcome::Failed(Failure {
            kind: FailureKind::Panicked,
            message,
            episode: control.slot.episode(),
        }),
    }
}

/// The failure of a job that was stopped at its time limit.
fn over_time(slot: &Slot, limit: Duration) -> Failure {
    Failure {
        kind: FailureKind::OverTime,
        message: format!(
            "it took longer than its time limit of {} s; raise `time_limit_seconds` and run it \
             again with `--retry-failed`",
            limit.as_secs_f64()
        ),
        episode: slot.episode(),
    }
}
