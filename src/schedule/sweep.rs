//! A sweep: the coordinating thread, which owns the store.

use std::collections::VecDeque;
use std::io;
use std::mem;
use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread::{self, Scope};
use std::time::{Duration, Instant};

use crate::kill_point::{self, KillPoint};
use crate::record::Outcome;
use crate::schedule::checkpoint::CheckpointFolder;
use crate::schedule::event::{Event, EventSink, Found};
use crate::schedule::panic;
use crate::schedule::queued::Queued;
use crate::schedule::worker::{Message, Report, Shared, Slot, Train, Worker};
use crate::store::{
    Claim, Claimed, Finished, Isolation, RetryFailed, RunEnd, SessionId, Store, StoreError,
};
use crate::train::TrainingProgress;

/// How long an outcome waits for others to be stored with it.
const GATHER: Duration = Duration::from_millis(50);
/// How many outcomes wait at most; bounds the memory of their results.
const MOST_GATHERED: usize = 256;
/// How long the coordinating thread waits for a worker, at most, before it looks at the request to
/// stop and shows progress. A store that another process holds can keep it for longer.
const TICK: Duration = Duration::from_millis(100);
/// How often the clock is looked at for checkpoints that are due, and the request to stop.
const LOOK: Duration = Duration::from_millis(50);
/// How often the session says that it is alive.
const HEARTBEAT: Duration = Duration::from_secs(5);
/// How often jobs that another process holds are tried again.
const RECHECK: Duration = Duration::from_secs(1);
/// How many jobs that need no run are passed over before workers and requests are heard again.
const SKIPS_AT_ONCE: usize = 1000;

/// How a sweep is run.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Threads that train, each one job at a time.
    pub workers: NonZeroUsize,
    /// Whether jobs that failed in an earlier sweep run again.
    pub retry_failed: RetryFailed,
    /// What a failed job does to the jobs after it.
    pub on_failure: OnFailure,
    /// Time between two checkpoints of a job. Where writing one takes long it is more, up to 25 s.
    pub checkpoint_every: Duration,
}

/// Most workers that can be asked for; each is a thread with its own network and buffers.
pub const MOST_WORKERS: usize = 1024;

/// One worker per core.
pub fn one_per_core() -> NonZeroUsize {
    let most = NonZeroUsize::new(MOST_WORKERS).expect("it is not zero");
    thread::available_parallelism().unwrap_or(NonZeroUsize::MIN).min(most)
}

/// One worker per core; a checkpoint every 20 seconds; failed jobs are not tried again and stop no
/// other.
impl Default for Options {
    fn default() -> Self {
        Options {
            workers: one_per_core(),
            retry_failed: RetryFailed::No,
            on_failure: OnFailure::Continue,
            checkpoint_every: Duration::from_secs(20),
        }
    }
}

/// What a failed job does to the jobs after it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OnFailure {
    /// The others go on.
    Continue,
    /// No further job is started, and those running are interrupted.
    Stop,
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

/// Why a sweep broke off.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SweepError {
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// Not one worker could be started.
    #[error("failed to start a worker: {0}; end other programs or raise the limits on them")]
    NoWorker(#[source] io::Error),
}

/// Runs every queued job that has no completed run yet, until all are done, or `stop` is set.
///
/// **Errors**: no worker can be started; the store fails: work under way is then lost, runs that
/// were told of are stored.
pub fn run(
    store: &mut Store,
    session: SessionId,
    queue: Vec<Queued>,
    context: Context<'_>,
    sink: &mut dyn EventSink,
) -> Result<Tally, SweepError> {
    panic::capture();
    let wanted = context.options.workers.get().min(queue.len().max(1));
    let slots: Vec<Slot> = (0..wanted).map(|_| Slot::default()).collect();
    // Set when the sweep must end early, for whatever reason.
    let halt = AtomicBool::new(false);
    let folder = CheckpointFolder::beside(store.path());
    thread::scope(|scope| {
        let _clock = start_clock(scope, &slots, context.stop, &halt)?;
        let (messages, inbox) = mpsc::channel();
        let shared = Shared {
            train: context.train,
            halt: &halt,
            folder: &folder,
            checkpoint_every: context.options.checkpoint_every,
            messages,
        };
        let workers = start_workers(scope, &slots, &shared, sink)?;
        drop(shared);
        let sweep = Sweep {
            store,
            session,
            context,
            sink,
            workers,
            waiting: queue.into(),
            held_elsewhere: VecDeque::new(),
            suspects: VecDeque::new(),
            isolation: Isolation::Shared,
            gathered: Vec::new(),
            rechecked_at: Instant::now(),
            heartbeat_at: Instant::now(),
            tally: Tally::default(),
            halt: &halt,
            folder: &folder,
        };
        let result = sweep.run(&inbox);
        // Workers still training after an error see this and end; the scope joins them.
        halt.store(true, Ordering::Relaxed);
        Ok(result?)
    })
}

/// A worker a slot, or as many as the system has threads for.
fn start_workers<'scope>(
    scope: &'scope Scope<'scope, '_>,
    slots: &'scope [Slot],
    shared: &Shared<'scope>,
    sink: &mut dyn EventSink,
) -> Result<Vec<Worker<'scope>>, SweepError> {
    let mut workers = Vec::with_capacity(slots.len());
    for (index, slot) in slots.iter().enumerate() {
        match Worker::spawn(scope, index, slot, shared.clone()) {
            Ok(worker) => workers.push(worker),
            Err(reason) if index == 0 => return Err(SweepError::NoWorker(reason)),
            Err(reason) => {
                sink.on_event(Event::FewerWorkers { started: index, reason: &reason });
                break;
            }
        }
    }
    Ok(workers)
}

/// Notifies workers that checkpoints are due and that the sweep is to stop, until what it returns is
/// dropped. The coordinating thread could not: it may be waiting for a store that another process
/// holds.
fn start_clock<'scope>(
    scope: &'scope Scope<'scope, '_>,
    slots: &'scope [Slot],
    stop: &'scope AtomicBool,
    halt: &'scope AtomicBool,
) -> Result<mpsc::Sender<()>, SweepError> {
    let (running, ended) = mpsc::channel();
    let tick = move || {
        while ended.recv_timeout(LOOK) == Err(mpsc::RecvTimeoutError::Timeout) {
            slots.iter().for_each(Slot::look);
            if stop.load(Ordering::Relaxed) {
                halt.store(true, Ordering::Relaxed);
            }
        }
    };
    let thread = thread::Builder::new().name("clock".to_owned());
    thread.spawn_scoped(scope, tick).map_err(SweepError::NoWorker)?;
    Ok(running)
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

/// What became of the idle workers.
enum Assigned {
    /// All of them have a job for which there is one.
    AllThatCan,
    /// Some are still idle, and there may be jobs for them.
    SomeForNow,
}

/// An outcome that is not stored yet.
struct Gathered {
    worker: usize,
    queued: Queued,
    claim: Claim,
    outcome: Outcome,
    wall: Duration,
    at: Instant,
}

impl Gathered {
    fn end(&self) -> RunEnd<'_> {
        let wall_seconds = self.wall.as_secs_f64();
        RunEnd { claim: &self.claim, outcome: &self.outcome, wall_seconds }
    }
}

struct Sweep<'scope, 'a> {
    store: &'a mut Store,
    session: SessionId,
    context: Context<'a>,
    sink: &'a mut dyn EventSink,
    workers: Vec<Worker<'scope>>,
    waiting: VecDeque<Queued>,
    held_elsewhere: VecDeque<Queued>,
    suspects: VecDeque<Queued>,
    /// Of the jobs under way.
    isolation: Isolation,
    gathered: Vec<Gathered>,
    rechecked_at: Instant,
    heartbeat_at: Instant,
    tally: Tally,
    halt: &'a AtomicBool,
    folder: &'a CheckpointFolder,
}

impl Sweep<'_, '_> {
    fn run(mut self, inbox: &mpsc::Receiver<Message>) -> Result<Tally, StoreError> {
        self.store.release_dead_sessions(self.session)?;
        loop {
            if self.context.stop.load(Ordering::Relaxed) {
                self.halt.store(true, Ordering::Relaxed);
            }
            let assigned = if self.halted() { Assigned::AllThatCan } else { self.assign()? };
            let patience = match (assigned, self.gathered.first()) {
                (Assigned::SomeForNow, _) => Duration::ZERO,
                (Assigned::AllThatCan, Some(first)) => GATHER.saturating_sub(first.at.elapsed()),
                (Assigned::AllThatCan, None) => TICK,
            };
            let busy = self.workers.iter().any(|worker| !worker.is_idle());
            if self.is_due(busy) {
                self.store_gathered()?;
                continue;
            }
            let none_left = self.waiting.is_empty()
                && self.held_elsewhere.is_empty()
                && self.suspects.is_empty();
            if !busy && (self.halted() || none_left) {
                return Ok(self.tally);
            }
            match inbox.recv_timeout(patience) {
                Ok(Message::Ended(report)) => self.gather(report),
                Ok(Message::Noted { worker, note }) => {
                    let queued = self.workers[worker].job();
                    self.sink.on_event(Event::Checkpoint { worker, queued, note: &note });
                }
                Err(_) if self.gathered.is_empty() => self.tick(busy)?,
                Err(_) => {}
            }
        }
    }

    /// Whether the gathered outcomes are to be stored now.
    fn is_due(&self, busy: bool) -> bool {
        self.gathered.first().is_some_and(|first| {
            !busy || first.at.elapsed() >= GATHER || self.gathered.len() >= MOST_GATHERED
        })
    }

    fn halted(&self) -> bool {
        self.halt.load(Ordering::Relaxed)
    }

    /// Gives every idle worker a job, as far as there are any.
    fn assign(&mut self) -> Result<Assigned, StoreError> {
        if self.rechecked_at.elapsed() >= RECHECK && !self.held_elsewhere.is_empty() {
            self.rechecked_at = Instant::now();
            self.store.release_dead_sessions(self.session)?;
            self.waiting.append(&mut self.held_elsewhere);
        }
        let busy = self.workers.iter().any(|worker| !worker.is_idle());
        if busy && self.isolation == Isolation::Alone {
            return Ok(Assigned::AllThatCan);
        }
        self.choose_isolation(busy);
        let mut skips = 0;
        for index in 0..self.workers.len() {
            if !self.workers[index].is_idle() {
                continue;
            }
            let Some((queued, claim)) = self.claim_next(&mut skips)? else { break };
            self.sink.on_event(Event::Started { worker: index, queued: &queued });
            self.workers[index].start(queued, claim);
        }
        Ok(if skips < SKIPS_AT_ONCE { Assigned::AllThatCan } else { Assigned::SomeForNow })
    }

    /// Lets a suspect be the next job if there is nothing else to run, and nothing runs.
    fn choose_isolation(&mut self, busy: bool) {
        self.isolation = Isolation::Shared;
        if !busy
            && self.waiting.is_empty()
            && let Some(suspect) = self.suspects.pop_front()
        {
            self.isolation = Isolation::Alone;
            self.waiting.push_back(suspect);
        }
    }

    /// The next job that is free; `None` if there is none, or none among so many that others should
    /// have their turn. `skips` counts those passed over.
    fn claim_next(&mut self, skips: &mut usize) -> Result<Option<(Queued, Claim)>, StoreError> {
        while *skips < SKIPS_AT_ONCE {
            let Some(queued) = self.waiting.pop_front() else { break };
            let retry = self.context.options.retry_failed;
            match self.store.claim(self.session, &queued.key, retry, self.isolation)? {
                Claimed::Claimed(claim) => return Ok(Some((queued, claim))),
                Claimed::Suspect => self.suspects.push_back(queued),
                Claimed::HeldElsewhere => self.held_elsewhere.push_back(queued),
                Claimed::Completed => {
                    self.tally.already_completed += 1;
                    self.sink.on_event(Event::Skipped { queued: &queued, found: Found::Completed });
                }
                Claimed::Failed => {
                    self.tally.already_failed += 1;
                    self.sink.on_event(Event::Skipped { queued: &queued, found: Found::Failed });
                }
            }
            *skips += 1;
        }
        Ok(None)
    }

    /// Takes an outcome back, to be stored with others.
    fn gather(&mut self, report: Report) {
        let Report { worker, outcome, wall } = report;
        let (queued, claim) = self.workers[worker].finish();
        if let (Outcome::Failed(_), OnFailure::Stop) = (&outcome, self.context.options.on_failure) {
            self.halt.store(true, Ordering::Relaxed);
        }
        self.gathered.push(Gathered { worker, queued, claim, outcome, wall, at: Instant::now() });
    }

    /// Stores the gathered outcomes, counts them and tells of them.
    fn store_gathered(&mut self) -> Result<(), StoreError> {
        let gathered = mem::take(&mut self.gathered);
        let ends: Vec<RunEnd<'_>> = gathered.iter().map(Gathered::end).collect();
        let finished = self.store.finish_all(&ends)?;
        kill_point::pass(KillPoint::EndsStored);
        for (Gathered { worker, queued, claim, outcome, wall, .. }, finished) in
            gathered.into_iter().zip(finished)
        {
            match (finished, &outcome) {
                (Finished::ClaimLost, _) => self.folder.forget_run(&queued.key, claim.attempt),
                (Finished::Stored, Outcome::Completed(_) | Outcome::Failed(_)) => {
                    self.folder.forget(&queued.key, claim.attempt);
                }
                (Finished::Stored, Outcome::Interrupted) => {}
            }
            match (finished, &outcome) {
                // Another process will complete it: this outcome is not needed.
                (Finished::ClaimLost, _) => {
                    self.sink.on_event(Event::Lost { worker, queued: &queued });
                    self.held_elsewhere.push_back(queued);
                    continue;
                }
                (Finished::Stored, Outcome::Completed(_)) => self.tally.completed += 1,
                (Finished::Stored, Outcome::Failed(_)) => self.tally.failed += 1,
                (Finished::Stored, Outcome::Interrupted) => self.tally.interrupted += 1,
            }
            self.sink.on_event(Event::Ended { worker, queued: &queued, outcome: &outcome, wall });
        }
        self.beat()
    }

    fn tick(&mut self, busy: bool) -> Result<(), StoreError> {
        let progress: Vec<Option<TrainingProgress>> =
            self.workers.iter().map(|worker| worker.progress()).collect();
        let waiting_for = if busy { 0 } else { self.held_elsewhere.len() };
        self.sink.on_event(Event::Tick { progress: &progress, waiting_for });
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
