//! A thread that trains one job at a time and reports its outcome.

use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::thread::{self, Scope};
use std::time::Duration;

use crate::job::{CurvePoint, EstimateDeclaration, Failure, FailureKind, Job, Outcome};
use crate::schedule::checkpoint::{
    Alarm, Attempt, CheckpointFolder, CheckpointNote, Entry, Form, Keeper, Stopwatch,
};
use crate::schedule::curve::{self, CurveFile};
use crate::schedule::panic;
use crate::schedule::queued::Queued;
use crate::store::Claim;
use crate::train::{Checkpoints, StopHandle, TrainingControl, TrainingProgress};

/// A function that trains a job; the program uses [`crate::train::run()`].
pub type Train<'a> = &'a (dyn Fn(&Job, &dyn TrainingControl) -> Outcome + Sync);

/// State shared by a worker and the coordinating thread: the worker's latest progress, and alarms for
/// due checkpoints, the time limit and due points of the learning curve.
#[derive(Default)]
pub(super) struct Slot {
    progress: Mutex<Option<TrainingProgress>>,
    checkpoint: Alarm,
    deadline: Alarm,
    curve: Alarm,
    worked: Stopwatch,
}

impl Slot {
    /// Reads the clock for the worker.
    pub(super) fn look(&self) {
        self.worked.look();
        self.checkpoint.look();
        self.deadline.look();
        self.curve.look();
    }

    pub(super) fn get(&self) -> Option<TrainingProgress> {
        *self.progress.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The number of training episodes finished.
    pub(super) fn episode(&self) -> u32 {
        self.get().map_or(0, |progress| progress.episode)
    }

    pub(super) fn set(&self, progress: Option<TrainingProgress>) {
        *self.progress.lock().unwrap_or_else(PoisonError::into_inner) = progress;
    }
}

/// A message from a worker.
pub(super) enum Message {
    /// The worker's job has ended.
    Ended(Box<Report>),
    /// An event of a checkpoint of the worker's job.
    Noted { worker: usize, note: CheckpointNote },
}

/// The end of a job.
pub(super) struct Report {
    pub(super) worker: usize,
    pub(super) outcome: Outcome,
    /// The time that the job took, including the earlier runs that it resumed from.
    pub(super) wall: Duration,
}

/// State that all workers of a sweep share.
#[derive(Clone)]
pub(super) struct Shared<'a> {
    pub(super) train: Train<'a>,
    pub(super) halt: &'a Arc<AtomicBool>,
    pub(super) folder: &'a CheckpointFolder,
    /// The folder for the learning curves of running jobs.
    pub(super) curves: &'a CheckpointFolder,
    /// The time between two checkpoints.
    pub(super) checkpoint_every: Duration,
    pub(super) messages: mpsc::Sender<Message>,
}

/// The coordinating thread's side of a worker.
pub(super) struct Worker<'scope> {
    /// Jobs to train, with their attempts.
    trainings: mpsc::Sender<(Queued, Attempt)>,
    slot: &'scope Arc<Slot>,
    holds: Option<(Queued, Claim)>,
}

impl<'scope> Worker<'scope> {
    /// Starts a worker with its own thread.
    ///
    /// **Errors**: the system has no more threads.
    pub(super) fn spawn(
        scope: &'scope Scope<'scope, '_>,
        index: usize,
        slot: &'scope Arc<Slot>,
        shared: Shared<'scope>,
    ) -> io::Result<Self> {
        let (trainings, inbox) = mpsc::channel::<(Queued, Attempt)>();
        let thread = thread::Builder::new().name(format!("worker {index}"));
        thread.spawn_scoped(scope, move || {
            // The loop ends when the sweep drops its end of the channel.
            for (queued, attempt) in inbox {
                let report = work(index, (&queued, attempt), slot, &shared);
                if shared.messages.send(Message::Ended(Box::new(report))).is_err() {
                    break;
                }
            }
        })?;
        Ok(Worker { trainings, slot, holds: None })
    }

    pub(super) fn is_idle(&self) -> bool {
        self.holds.is_none()
    }

    pub(super) fn start(&mut self, queued: Queued, claim: Claim) {
        self.slot.set(None);
        let attempt = Attempt { number: claim.attempt, deaths: claim.deaths };
        let training = (queued.clone(), attempt);
        self.trainings.send(training).expect("a worker lives as long as its sweep");
        self.holds = Some((queued, claim));
    }

    /// The current job.
    pub(super) fn job(&self) -> &Queued {
        let (queued, _) = self.holds.as_ref().expect("a message comes from a worker with a job");
        queued
    }

    /// Returns the job that has ended.
    pub(super) fn finish(&mut self) -> (Queued, Claim) {
        self.slot.set(None);
        self.holds.take().expect("a report comes from a worker that holds a job")
    }

    pub(super) fn progress(&self) -> Option<TrainingProgress> {
        self.slot.get()
    }
}

/// Trains a job.
fn work(
    worker: usize,
    (queued, attempt): (&Queued, Attempt),
    slot: &Arc<Slot>,
    shared: &Shared<'_>,
) -> Report {
    slot.worked.restart();
    let Queued { job, key, time_limit, estimates, folder, .. } = queued;
    let limit = time_limit.unwrap_or(Duration::MAX);
    slot.deadline.set(limit);
    let report = |note| {
        if let CheckpointNote::Resumed(resumed) = &note {
            slot.deadline.set(limit.saturating_sub(resumed.worked));
        }
        // A sweep that has ended early no longer receives messages.
        let _ = shared.messages.send(Message::Noted { worker, note });
    };
    let clock = (&slot.checkpoint, shared.checkpoint_every);
    let keeper = Keeper::new(shared.folder, (*key, attempt), clock, &report);
    slot.curve.set(curve::EVERY);
    let entry = Entry { key: *key, attempt: attempt.number, form: Form::Curve };
    let curve = CurveFile::new(shared.curves, entry);
    let control = SlotControl { slot, halt: shared.halt, keeper, estimates, curve, folder };
    let outcome = match caught(slot, || (shared.train)(job, &control)) {
        Outcome::Interrupted if slot.deadline.rings() => {
            Outcome::Failed(over_time(slot, limit, job))
        }
        outcome => outcome,
    };
    Report { worker, outcome, wall: control.keeper.before() + slot.worked.look() }
}

struct SlotControl<'a> {
    slot: &'a Arc<Slot>,
    halt: &'a Arc<AtomicBool>,
    keeper: Keeper<'a>,
    estimates: &'a [Arc<EstimateDeclaration>],
    curve: CurveFile<'a>,
    folder: &'a Path,
}

impl TrainingControl for SlotControl<'_> {
    fn report(&self, progress: TrainingProgress, curve: &[CurvePoint]) {
        self.slot.set(Some(progress));
        if self.report_is_due() {
            self.slot.curve.set(curve::EVERY);
            self.curve.add(progress, self.keeper.before() + self.worked(), curve);
        }
    }

    fn report_is_due(&self) -> bool {
        self.slot.curve.rings()
    }

    fn stop_requested(&self) -> bool {
        self.halt.load(Ordering::Relaxed) || self.slot.deadline.rings()
    }

    fn stop_handle(&self) -> StopHandle {
        let (slot, halt) = (self.slot.clone(), self.halt.clone());
        Arc::new(move || halt.load(Ordering::Relaxed) || slot.deadline.rings())
    }

    fn worked(&self) -> Duration {
        self.slot.worked.look()
    }

    fn folder(&self) -> &Path {
        self.folder
    }

    fn estimates(&self) -> &[Arc<EstimateDeclaration>] {
        self.estimates
    }

    fn checkpoints(&self) -> &dyn Checkpoints {
        &self.keeper
    }
}

/// The outcome of a training. A panic and results that cannot be stored are failures.
pub(super) fn caught(slot: &Slot, train: impl FnOnce() -> Outcome) -> Outcome {
    let outcome = panic::catch(train).unwrap_or_else(|message| {
        let (kind, episode) = (FailureKind::Panicked, slot.episode());
        Outcome::Failed(Failure { kind, message, episode })
    });
    outcome.judged(slot.episode())
}

/// The failure of a job that was stopped at its time limit.
fn over_time(slot: &Slot, limit: Duration, job: &Job) -> Failure {
    // The usual cause if a program sends nothing.
    let is_external = job.agent.algorithm().is_external() || job.environment.family().is_external();
    let hint = match is_external {
        true => ", or make the program flush its standard output after every message,",
        false => "",
    };
    Failure {
        kind: FailureKind::OverTime,
        message: format!(
            "the job exceeded its time limit of {} s; raise `time_limit_seconds`{hint} and run it again \
             with `--retry-failed`",
            limit.as_secs_f64()
        ),
        episode: slot.episode(),
    }
}
