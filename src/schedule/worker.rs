//! A thread that trains one job at a time.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError, mpsc};
use std::thread::{self, Scope};
use std::time::{Duration, Instant};

use crate::plan::Job;
use crate::record::{Failure, FailureKind, Outcome};
use crate::schedule::{Queued, Train, panic};
use crate::store::Claim;
use crate::train::{Monitor, Progress};

/// Where a worker leaves its latest progress for the coordinating thread.
#[derive(Default)]
pub(super) struct Slot(Mutex<Option<Progress>>);

impl Slot {
    fn get(&self) -> Option<Progress> {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn set(&self, progress: Option<Progress>) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = progress;
    }
}

/// What a worker sends when its job has ended.
pub(super) struct Report {
    pub(super) worker: usize,
    pub(super) outcome: Outcome,
    pub(super) wall: Duration,
}

/// What all workers of a sweep share.
#[derive(Clone)]
pub(super) struct Shared<'a> {
    pub(super) train: Train<'a>,
    pub(super) halt: &'a AtomicBool,
    pub(super) reports: mpsc::Sender<Report>,
}

/// The coordinating thread's end of a worker.
pub(super) struct Worker<'scope> {
    jobs: mpsc::Sender<Job>,
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
        let (jobs, inbox) = mpsc::channel::<Job>();
        let thread = thread::Builder::new().name(format!("worker {index}"));
        thread.spawn_scoped(scope, move || {
            let Shared { train, halt, reports } = shared;
            let monitor = SlotMonitor { slot, halt };
            // Ends when the sweep drops its end of the channel.
            for job in inbox {
                let started = Instant::now();
                let outcome = train_caught(train, &job, &monitor);
                let report = Report { worker: index, outcome, wall: started.elapsed() };
                if reports.send(report).is_err() {
                    break;
                }
            }
        })?;
        Ok(Worker { jobs, slot, holds: None })
    }

    pub(super) fn is_idle(&self) -> bool {
        self.holds.is_none()
    }

    pub(super) fn start(&mut self, queued: Queued, claim: Claim) {
        self.slot.set(None);
        self.jobs.send(queued.job.clone()).expect("a worker lives as long as its sweep");
        self.holds = Some((queued, claim));
    }

    /// Takes back the job that has ended.
    pub(super) fn finish(&mut self) -> (Queued, Claim) {
        self.slot.set(None);
        self.holds.take().expect("a report comes from a worker that holds a job")
    }

    pub(super) fn progress(&self) -> Option<Progress> {
        self.slot.get()
    }
}

struct SlotMonitor<'a> {
    slot: &'a Slot,
    halt: &'a AtomicBool,
}

impl Monitor for SlotMonitor<'_> {
    fn report(&self, progress: Progress) {
        self.slot.set(Some(progress));
    }

    fn stop_requested(&self) -> bool {
        self.halt.load(Ordering::Relaxed)
    }
}

/// Trains a job; a panic becomes a failure.
fn train_caught(train: Train<'_>, job: &Job, monitor: &SlotMonitor<'_>) -> Outcome {
    match panic::catch(|| train(job, monitor)) {
        Ok(outcome) => outcome,
        Err(message) => Outcome::Failed(Failure {
            kind: FailureKind::Panicked,
            message,
            episode: monitor.slot.get().map_or(0, |progress| progress.episode),
        }),
    }
}
