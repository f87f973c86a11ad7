//! The scheduler: from planned jobs to stored runs.
//!
//! In: a queue of jobs, an open store, a way to train. Out: a stored run for every job that was
//! missing one, and a [`Tally`].
//!
//! - One thread, the caller's, owns the store; workers never see it. It claims jobs, hands them
//!   out, writes outcomes and tells the [`Watcher`] what happened, so that all events have one order.
//! - A worker holds one job at a time and nothing of it survives but its outcome.
//! - Whether a job is free is decided by the store in the transaction that claims it, never from
//!   memory: other processes may work on the same store.
//! - A panic is an outcome of its job, not the end of its worker.
//! - Nothing is retried within a sweep; which jobs are retried never depends on their results.

mod panic;
mod worker;

use std::collections::VecDeque;
use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant};

use crate::plan::{Job, JobKey};
use crate::record::Outcome;
use crate::store::{Claim, Claimed, RetryFailed, SessionId, Store, StoreError};
use crate::train::{Monitor, Progress};

use worker::{Report, Shared, Slot, Worker};

/// How long the coordinating thread sleeps at most; bounds how late it sees a request to stop.
const TICK: Duration = Duration::from_millis(100);
/// How often the session says that it is alive.
const HEARTBEAT: Duration = Duration::from_secs(5);
/// How often jobs that another process holds are tried again.
const RECHECK: Duration = Duration::from_secs(1);

/// A way to train a job; the program's is [`crate::train::run`].
pub type Train<'a> = &'a (dyn Fn(&Job, &dyn Monitor) -> Outcome + Sync);

/// How a sweep is run.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Threads that train, each one job at a time.
    pub workers: NonZeroUsize,
    /// Whether jobs that failed in an earlier sweep run again.
    pub retry_failed: RetryFailed,
    /// What a failed job does to the jobs after it.
    pub on_failure: OnFailure,
}

/// What a failed job does to the jobs after it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OnFailure {
    /// The others go on.
    Continue,
    /// No further job is started, and those running are interrupted.
    Stop,
}

/// A job in the queue, with the name its agent goes by.
#[derive(Clone, Debug)]
pub struct Queued {
    /// Identity of the job.
    pub key: JobKey,
    /// Agent's name in the manifest.
    pub agent: String,
    /// The job.
    pub job: Job,
}

/// What a sweep did, in jobs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Completed by this sweep.
    pub completed: usize,
    /// Failed in this sweep.
    pub failed: usize,
    /// Interrupted in this sweep.
    pub interrupted: usize,
    /// Found completed, by an earlier sweep or another process.
    pub already_completed: usize,
    /// Found failed, and not retried.
    pub already_failed: usize,
}

/// What happens in a sweep, in order.
#[derive(Debug)]
pub enum Event<'a> {
    /// A worker has begun a job.
    Started {
        /// Which worker, from 0.
        worker: usize,
        /// The job.
        queued: &'a Queued,
    },
    /// A run has ended and is stored.
    Ended {
        /// Which worker, from 0.
        worker: usize,
        /// The job.
        queued: &'a Queued,
        /// How it ended.
        outcome: &'a Outcome,
        /// Time it took.
        wall: Duration,
    },
    /// A job needed no run of this sweep.
    Skipped {
        /// The job.
        queued: &'a Queued,
    },
    /// Several times a second: how far each worker has come with its job.
    Tick {
        /// By worker; `None` while idle or before the first report.
        progress: &'a [Option<Progress>],
        /// Jobs that another process holds and that nothing else is left to do but wait for.
        waiting_for: usize,
    },
}

/// Whoever shows the sweep to a person or a program.
pub trait Watcher {
    /// Hears of an event, on the thread that owns the store.
    fn hear(&mut self, event: Event<'_>);
}

/// Runs every queued job that has no completed run yet, until all are done, or `stop` is set.
///
/// **Errors**: the store fails; work under way is then lost, finished runs are stored.
pub fn run(
    store: &mut Store,
    session: SessionId,
    queue: Vec<Queued>,
    context: Context<'_>,
    watcher: &mut dyn Watcher,
) -> Result<Tally, StoreError> {
    panic::capture();
    let workers = context.options.workers.get().min(queue.len().max(1));
    let slots: Vec<Slot> = (0..workers).map(|_| Slot::default()).collect();
    // Set when the sweep must end early, for whatever reason.
    let halt = AtomicBool::new(false);
    thread::scope(|scope| {
        let (reports, inbox) = mpsc::channel();
        let shared = Shared { train: context.train, halt: &halt, reports };
        let workers = slots
            .iter()
            .enumerate()
            .map(|(index, slot)| Worker::spawn(scope, index, slot, shared.clone()))
            .collect();
        let sweep = Sweep {
            store,
            session,
            context,
            watcher,
            workers,
            waiting: queue.into(),
            held_elsewhere: VecDeque::new(),
            rechecked_at: Instant::now(),
            heartbeat_at: Instant::now(),
            tally: Tally::default(),
            halt: &halt,
        };
        let result = sweep.run(&inbox);
        // Workers still training after an error see this and end; the scope joins them.
        halt.store(true, Ordering::Relaxed);
        result
    })
}

/// What a sweep is run with.
#[derive(Clone, Copy)]
pub struct Context<'a> {
    /// How it is run.
    pub options: Options,
    /// How a job is trained.
    pub train: Train<'a>,
    /// Set from outside to stop the sweep.
    pub stop: &'a AtomicBool,
}

struct Sweep<'scope, 'a> {
    store: &'a mut Store,
    session: SessionId,
    context: Context<'a>,
    watcher: &'a mut dyn Watcher,
    workers: Vec<Worker<'scope>>,
    waiting: VecDeque<Queued>,
    held_elsewhere: VecDeque<Queued>,
    rechecked_at: Instant,
    heartbeat_at: Instant,
    tally: Tally,
    halt: &'a AtomicBool,
}

impl Sweep<'_, '_> {
    fn run(mut self, inbox: &mpsc::Receiver<Report>) -> Result<Tally, StoreError> {
        self.store.release_dead_sessions(self.session)?;
        loop {
            if self.context.stop.load(Ordering::Relaxed) {
                self.halt.store(true, Ordering::Relaxed);
            }
            if !self.halted() {
                self.assign()?;
            }
            let busy = self.workers.iter().any(|worker| !worker.is_idle());
            if !busy && (self.halted() || self.held_elsewhere.is_empty()) {
                return Ok(self.tally);
            }
            match inbox.recv_timeout(TICK) {
                Ok(report) => self.end(report)?,
                Err(_) => self.tick(busy)?,
            }
        }
    }

    fn halted(&self) -> bool {
        self.halt.load(Ordering::Relaxed)
    }

    /// Gives every idle worker a job, as far as there are any.
    fn assign(&mut self) -> Result<(), StoreError> {
        if self.rechecked_at.elapsed() >= RECHECK && !self.held_elsewhere.is_empty() {
            self.rechecked_at = Instant::now();
            self.store.release_dead_sessions(self.session)?;
            self.waiting.append(&mut self.held_elsewhere);
        }
        for index in 0..self.workers.len() {
            if !self.workers[index].is_idle() {
                continue;
            }
            let Some((queued, claim)) = self.claim_next()? else { break };
            self.watcher.hear(Event::Started { worker: index, queued: &queued });
            self.workers[index].start(queued, claim);
        }
        Ok(())
    }

    fn claim_next(&mut self) -> Result<Option<(Queued, Claim)>, StoreError> {
        while let Some(queued) = self.waiting.pop_front() {
            let retry = self.context.options.retry_failed;
            match self.store.claim(self.session, &queued.key, retry)? {
                Claimed::Claimed(claim) => return Ok(Some((queued, claim))),
                Claimed::HeldElsewhere => self.held_elsewhere.push_back(queued),
                Claimed::Completed => {
                    self.tally.already_completed += 1;
                    self.watcher.hear(Event::Skipped { queued: &queued });
                }
                Claimed::Failed => {
                    self.tally.already_failed += 1;
                    self.watcher.hear(Event::Skipped { queued: &queued });
                }
            }
        }
        Ok(None)
    }

    /// Stores an outcome and counts it.
    fn end(&mut self, report: Report) -> Result<(), StoreError> {
        let Report { worker, outcome, wall } = report;
        let (queued, claim) = self.workers[worker].finish();
        match self.store.finish(&claim, &outcome, wall.as_secs_f64()) {
            Ok(()) => {}
            // Another process took the job over and will complete it: this outcome is not needed.
            Err(StoreError::ClaimLost { .. }) => {
                self.held_elsewhere.push_back(queued);
                return Ok(());
            }
            Err(error) => return Err(error),
        }
        match outcome {
            Outcome::Completed(_) => self.tally.completed += 1,
            Outcome::Interrupted => self.tally.interrupted += 1,
            Outcome::Failed(_) => {
                self.tally.failed += 1;
                if self.context.options.on_failure == OnFailure::Stop {
                    self.halt.store(true, Ordering::Relaxed);
                }
            }
        }
        self.watcher.hear(Event::Ended { worker, queued: &queued, outcome: &outcome, wall });
        self.beat()
    }

    fn tick(&mut self, busy: bool) -> Result<(), StoreError> {
        let progress: Vec<Option<Progress>> =
            self.workers.iter().map(|worker| worker.progress()).collect();
        let waiting_for = if busy { 0 } else { self.held_elsewhere.len() };
        self.watcher.hear(Event::Tick { progress: &progress, waiting_for });
        self.beat()
    }

    fn beat(&mut self) -> Result<(), StoreError> {
        if self.heartbeat_at.elapsed() >= HEARTBEAT {
            self.heartbeat_at = Instant::now();
            self.store.heartbeat(self.session)?;
        }
        Ok(())
    }
}
