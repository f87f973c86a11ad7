//! A thread that trains one job at a time and reports its outcome.

use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::thread::{self, Scope};
use std::time::Duration;

use crate::job::{CurvePoint, EstimateDeclaration, Failure, FailureKind, Job, Outcome};
use crate::schedule::checkpoint::{
    Alarm, CheckpointFolder, CheckpointNote, FileForm, FolderEntry, Keeper, RunAttempt, Stopwatch,
};
use crate::schedule::curve::{self, CurveFile};
use crate::schedule::estimates::Computed;
use crate::schedule::panic;
use crate::schedule::queued::Queued;
use crate::store::{Claim, Reader};
use crate::train::{Checkpoints, KeptNowhere, StopHandle, TrainingControl, TrainingProgress};

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
pub(super) enum WorkerMessage {
    /// The worker's job has ended.
    Ended(Box<Report>),
    /// An event of a checkpoint of the worker's job.
    Noted { worker: usize, note: CheckpointNote },
}

/// The end of a job.
pub(super) struct Report {
    pub(super) worker: usize,
    pub(super) work: WorkDone,
    /// The time that the job took, including the earlier runs that it resumed from.
    pub(super) wall: Duration,
}

/// What a worker has done.
pub(super) enum WorkDone {
    /// It ran a job.
    Ran(Outcome),
    /// It computed the estimates that a job lacked.
    Estimated(Computed),
}

/// State that all workers of a sweep share.
#[derive(Clone)]
pub(super) struct Shared<'a> {
    pub(super) train: Train<'a>,
    pub(super) halt: &'a Arc<AtomicBool>,
    pub(super) folder: &'a CheckpointFolder,
    /// The folder for the learning curves of running jobs.
    pub(super) curves: &'a CheckpointFolder,
    /// The file of the store, from which recorded decisions are read.
    pub(super) store: &'a Path,
    /// The time between two checkpoints.
    pub(super) checkpoint_every: Duration,
    pub(super) messages: mpsc::Sender<WorkerMessage>,
}

/// The coordinating thread's side of a worker.
pub(super) struct Worker<'scope> {
    /// Jobs, with the attempts of their runs.
    jobs: mpsc::Sender<(Queued, Option<RunAttempt>)>,
    slot: &'scope Arc<Slot>,
    holds: Option<(Queued, Option<Claim>)>,
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
        let (jobs, inbox) = mpsc::channel::<(Queued, Option<RunAttempt>)>();
        let thread = thread::Builder::new().name(format!("worker {index}"));
        thread.spawn_scoped(scope, move || {
            // The loop ends when the sweep drops its end of the channel.
            let mut reader = None;
            for (queued, attempt) in inbox {
                let report = match attempt {
                    Some(attempt) => work(index, (&queued, attempt), slot, &shared),
                    None => estimate(index, (&queued, &mut reader), slot, &shared),
                };
                if shared.messages.send(WorkerMessage::Ended(Box::new(report))).is_err() {
                    break;
                }
            }
        })?;
        Ok(Worker { jobs, slot, holds: None })
    }

    pub(super) fn is_idle(&self) -> bool {
        self.holds.is_none()
    }

    pub(super) fn start(&mut self, queued: Queued, claim: Option<Claim>) {
        self.slot.set(None);
        let attempt = |claim: &Claim| RunAttempt { number: claim.attempt, deaths: claim.deaths };
        let job = (queued.clone(), claim.as_ref().map(attempt));
        self.jobs.send(job).expect("a worker lives as long as its sweep");
        self.holds = Some((queued, claim));
    }

    /// Whether the current job has a claimed run.
    pub(super) fn has_claim(&self) -> bool {
        matches!(self.holds, Some((_, Some(_))))
    }

    /// The current job.
    pub(super) fn job(&self) -> &Queued {
        let (queued, _) = self.holds.as_ref().expect("a message comes from a worker with a job");
        queued
    }

    /// Returns the job that has ended.
    pub(super) fn finish(&mut self) -> (Queued, Option<Claim>) {
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
    (queued, attempt): (&Queued, RunAttempt),
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
        let _ = shared.messages.send(WorkerMessage::Noted { worker, note });
    };
    let clock = (&slot.checkpoint, shared.checkpoint_every);
    let keeper = Keeper::new(shared.folder, (*key, attempt), clock, &report);
    slot.curve.set(curve::EVERY);
    let entry = FolderEntry { key: *key, attempt: attempt.number, form: FileForm::Curve };
    let curve = CurveFile::new(shared.curves, entry);
    let keeps = Some(Keeps { keeper, curve });
    let control = SlotControl { slot, halt: shared.halt, keeps, estimates, folder };
    let outcome = match caught(slot, job, || (shared.train)(job, &control)) {
        Outcome::Interrupted if slot.deadline.rings() => {
            Outcome::Failed(over_time(slot, limit, job))
        }
        outcome => outcome,
    };
    Report { worker, work: WorkDone::Ran(outcome), wall: control.before() + slot.worked.look() }
}

/// Computes the estimates that a job lacks: reads its recorded decisions, or trains it again.
fn estimate(
    worker: usize,
    (queued, reader): (&Queued, &mut Option<Reader>),
    slot: &Arc<Slot>,
    shared: &Shared<'_>,
) -> Report {
    slot.worked.restart();
    slot.deadline.set(queued.time_limit.unwrap_or(Duration::MAX));
    let compute = || compute(queued, reader, slot, shared);
    let computed = panic::catch(compute).unwrap_or_else(Computed::without);
    Report { worker, work: WorkDone::Estimated(computed), wall: slot.worked.look() }
}

/// The estimates of a job that lacks them.
fn compute(
    queued: &Queued,
    reader: &mut Option<Reader>,
    slot: &Arc<Slot>,
    shared: &Shared<'_>,
) -> Computed {
    let Queued { job, estimates, folder, .. } = queued;
    if queued.trains() {
        let control = SlotControl { slot, halt: shared.halt, keeps: None, estimates, folder };
        let outcome = match caught(slot, job, || (shared.train)(job, &control)) {
            Outcome::Interrupted if slot.deadline.rings() => Outcome::Failed(Failure {
                kind: FailureKind::OverTime,
                message: "training it again exceeded its time limit".to_owned(),
                episode: slot.episode(),
            }),
            outcome => outcome,
        };
        Computed::trained(job, outcome)
    } else {
        let opened = match reader.take() {
            Some(open) => Ok(open),
            None => Reader::open(shared.store),
        };
        match opened {
            Ok(open) => Computed::read(reader.insert(open), queued, shared.halt),
            Err(error) => Computed::without(error.to_string()),
        }
    }
}

struct SlotControl<'a> {
    slot: &'a Arc<Slot>,
    halt: &'a Arc<AtomicBool>,
    /// `None` for a job that is trained again.
    keeps: Option<Keeps<'a>>,
    estimates: &'a [Arc<EstimateDeclaration>],
    folder: &'a Path,
}

/// What is kept of a running job.
struct Keeps<'a> {
    keeper: Keeper<'a>,
    curve: CurveFile<'a>,
}

impl SlotControl<'_> {
    /// The time that earlier runs took from which this one was resumed.
    fn before(&self) -> Duration {
        self.keeps.as_ref().map_or(Duration::ZERO, |keeps| keeps.keeper.before())
    }
}

impl TrainingControl for SlotControl<'_> {
    fn report(&self, progress: TrainingProgress, curve: &[CurvePoint]) {
        self.slot.set(Some(progress));
        if let Some(keeps) = self.keeps.as_ref().filter(|_| self.report_is_due()) {
            self.slot.curve.set(curve::EVERY);
            keeps.curve.add(progress, self.before() + self.worked(), curve);
        }
    }

    fn report_is_due(&self) -> bool {
        self.keeps.is_some() && self.slot.curve.rings()
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
        match &self.keeps {
            Some(keeps) => &keeps.keeper,
            None => &KeptNowhere,
        }
    }
}

/// The outcome of a training. A panic and results that cannot be stored are failures.
pub(super) fn caught(slot: &Slot, job: &Job, train: impl FnOnce() -> Outcome) -> Outcome {
    let outcome = panic::catch(train).unwrap_or_else(|message| {
        let (kind, episode) = (FailureKind::Panicked, slot.episode());
        Outcome::Failed(Failure { kind, message, episode })
    });
    outcome.judged(slot.episode(), job.can_miss_numbers())
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
