//! A sweep: the coordinating thread, which owns the store.

use std::collections::{HashMap, HashSet, VecDeque};
use std::io;
use std::mem;
use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, mpsc};
use std::thread::{self, Scope};
use std::time::{Duration, Instant};

use crate::job::{JobKey, Outcome};
use crate::kill_point::{self, KillPoint};
use crate::schedule::checkpoint::CheckpointFolder;
use crate::schedule::estimates::{Computed, Estimated};
use crate::schedule::event::{Event, EventSink, Found};
use crate::schedule::panic;
use crate::schedule::programs;
use crate::schedule::queued::{Queued, QueuedFor};
use crate::schedule::worker::{Report, Shared, Slot, Train, WorkDone, Worker, WorkerMessage};
use crate::store::{
    Claim, Claimed, Finished, Isolation, RetryFailed, RunEnd, SessionId, Store, StoreError,
};
use crate::train::TrainingProgress;

/// The time that an outcome waits for others to share its transaction.
const GATHER: Duration = Duration::from_millis(50);
/// The maximum number of waiting outcomes; it bounds the memory of their results.
const MOST_GATHERED: usize = 256;
/// The longest time that the coordinating thread waits for a worker before it checks for a stop and shows
/// progress. A store that another process has locked can delay it further.
const TICK: Duration = Duration::from_millis(100);
/// Interval of the clock, which checks for due checkpoints and for a stop.
const LOOK: Duration = Duration::from_millis(50);
/// Interval of the session's heartbeat.
const HEARTBEAT: Duration = Duration::from_secs(5);
/// Time from the start of a job to a heartbeat which shows that the process outlived the start.
const FIRST_HEARTBEAT: Duration = Duration::from_secs(1);
/// Interval at which jobs held by other processes are tried again.
const RECHECK: Duration = Duration::from_secs(1);
/// The number of jobs that need no run and are skipped before messages are handled again.
const SKIPS_AT_ONCE: usize = 1000;

/// The options of a sweep.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// The number of training threads; each trains one job at a time.
    pub workers: NonZeroUsize,
    /// Whether jobs that failed in an earlier sweep run again.
    pub retry_failed: RetryFailed,
    /// Whether a failed job stops the sweep.
    pub on_failure: OnFailure,
    /// The time between two checkpoints of a job. It grows to at most 25 s if writing a checkpoint takes
    /// long.
    pub checkpoint_every: Duration,
}

/// The maximum number of workers; each is a thread with its own network and buffers.
pub const MOST_WORKERS: usize = 1024;

/// One worker per core.
pub fn one_per_core() -> NonZeroUsize {
    let most = NonZeroUsize::new(MOST_WORKERS).expect("it is not zero");
    thread::available_parallelism().unwrap_or(NonZeroUsize::MIN).min(most)
}

/// One worker per core and a checkpoint every 20 seconds. Failed jobs are not retried and do not stop
/// the sweep.
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

/// Whether a failed job stops the sweep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OnFailure {
    /// The other jobs continue.
    Continue,
    /// No further job starts, and running jobs are interrupted.
    Stop,
}

/// The number of jobs by their outcome in a sweep.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Completed by this sweep.
    pub completed: usize,
    /// Failed in this sweep.
    pub failed: usize,
    /// Interrupted in this sweep.
    pub interrupted: usize,
    /// Already completed by an earlier sweep or another process.
    pub already_completed: usize,
    /// Already failed, and not retried.
    pub already_failed: usize,
    /// Jobs that were completed before and lacked estimates.
    pub estimated: Estimated,
}

/// Why a sweep ended early.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SweepError {
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// No worker could be started.
    #[error("failed to start a worker: {0}; end other programs or raise the limit on threads")]
    NoWorker(#[source] io::Error),
}

/// Runs every queued job without a completed run, and adds the estimates that completed ones lack, until all jobs are
/// done or `stop` is set. Jobs whose recorded decisions are read for estimates have no events.
///
/// **Errors**: no worker can be started, or the store fails. If the store fails, unfinished work is lost, but
/// every reported run is stored.
pub fn run(
    store: &mut Store,
    session: SessionId,
    queue: Vec<Queued>,
    context: Context<'_>,
    sink: &mut dyn EventSink,
) -> Result<Tally, SweepError> {
    panic::capture();
    let wanted = context.options.workers.get().min(queue.len().max(1));
    let slots: Vec<Arc<Slot>> = (0..wanted).map(|_| Arc::default()).collect();
    // Set when the sweep must end early, for any reason.
    let halt = Arc::new(AtomicBool::new(false));
    let path = store.path().to_owned();
    let folder = CheckpointFolder::beside(&path);
    thread::scope(|scope| {
        let _clock = start_clock(scope, &slots, context.stop, &halt)?;
        let (messages, inbox) = mpsc::channel();
        let shared = Shared {
            train: context.train,
            halt: &halt,
            folder: &folder,
            curves: context.curves.unwrap_or(&folder),
            store: &path,
            checkpoint_every: context.options.checkpoint_every,
            messages,
        };
        let workers = start_workers(scope, &slots, &shared, sink)?;
        drop(shared);
        let trains_again =
            |queued: &Queued| queued.purpose == QueuedFor::Estimates && queued.trains();
        let (retrained, waiting) = queue.into_iter().partition(trains_again);
        let sweep = Sweep {
            store,
            session,
            context,
            sink,
            workers,
            waiting,
            retrained,
            held_elsewhere: VecDeque::new(),
            suspects: VecDeque::new(),
            isolation: Isolation::Shared,
            died: HashMap::new(),
            some_died: false,
            gathered: Vec::new(),
            rechecked_at: Instant::now(),
            heartbeat_at: Instant::now(),
            started_at: Instant::now(),
            tally: Tally::default(),
            halt: &halt,
            folder: &folder,
        };
        let result = sweep.run(&inbox);
        // After an error, workers that are still training see this and end; the scope joins them.
        halt.store(true, Ordering::Relaxed);
        Ok(result?)
    })
}

/// Starts one worker per slot, or as many as the system's limit on threads allows.
fn start_workers<'scope>(
    scope: &'scope Scope<'scope, '_>,
    slots: &'scope [Arc<Slot>],
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

/// Starts the clock, which notifies workers of due checkpoints and of a stop, until the returned sender is
/// dropped. The coordinating thread cannot do this while it waits for a locked store.
fn start_clock<'scope>(
    scope: &'scope Scope<'scope, '_>,
    slots: &'scope [Arc<Slot>],
    stop: &'scope AtomicBool,
    halt: &'scope AtomicBool,
) -> Result<mpsc::Sender<()>, SweepError> {
    let (running, ended) = mpsc::channel();
    let tick = move || {
        while ended.recv_timeout(LOOK) == Err(mpsc::RecvTimeoutError::Timeout) {
            slots.iter().for_each(|slot| slot.look());
            if stop.load(Ordering::Relaxed) {
                halt.store(true, Ordering::Relaxed);
            }
        }
    };
    let thread = thread::Builder::new().name("clock".to_owned());
    thread.spawn_scoped(scope, tick).map_err(SweepError::NoWorker)?;
    Ok(running)
}

/// The settings and callbacks of a sweep.
#[derive(Clone, Copy)]
pub struct Context<'a> {
    /// Options of the sweep.
    pub options: Options,
    /// The function that trains a job.
    pub train: Train<'a>,
    /// Set from outside to stop the sweep.
    pub stop: &'a AtomicBool,
    /// The folder for the learning curves of running jobs; `None` for the folder of checkpoints.
    pub curves: Option<&'a CheckpointFolder>,
}

/// The result of assigning jobs to idle workers.
enum Assigned {
    /// No idle worker can get a job now.
    AllThatCan,
    /// Some workers are still idle, and there may be jobs for them.
    SomeForNow,
}

/// The end of a job that is not stored yet.
struct Gathered {
    worker: usize,
    queued: Queued,
    end: Ended,
    wall: Duration,
    at: Instant,
}

/// How a job ended, with the claim on its run.
enum Ended {
    Ran(Claim, Outcome),
    Estimated(Computed),
}

impl Gathered {
    /// The end of a run.
    fn run(&self) -> Option<RunEnd<'_>> {
        let wall_seconds = self.wall.as_secs_f64();
        match &self.end {
            Ended::Ran(claim, outcome) => Some(RunEnd { claim, outcome, wall_seconds }),
            Ended::Estimated(_) => None,
        }
    }

    /// The estimates of a job.
    fn estimated(&self) -> Option<(JobKey, &Computed)> {
        match &self.end {
            Ended::Ran(..) => None,
            Ended::Estimated(computed) => Some((self.queued.key, computed)),
        }
    }
}

struct Sweep<'scope, 'a> {
    store: &'a mut Store,
    session: SessionId,
    context: Context<'a>,
    sink: &'a mut dyn EventSink,
    workers: Vec<Worker<'scope>>,
    waiting: VecDeque<Queued>,
    /// Completed jobs that are trained again for their estimates, after all runs: if one of them ends the process, it
    /// takes no claimed run with it.
    retrained: VecDeque<Queued>,
    held_elsewhere: VecDeque<Queued>,
    suspects: VecDeque<Queued>,
    /// The isolation of the running jobs.
    isolation: Isolation,
    /// The jobs whose processes died, with the number of deaths.
    died: HashMap<JobKey, u32>,
    /// Whether the process of a waiting job died: the next job may end this process, too.
    some_died: bool,
    gathered: Vec<Gathered>,
    rechecked_at: Instant,
    heartbeat_at: Instant,
    /// The start of the latest job.
    started_at: Instant,
    tally: Tally,
    halt: &'a AtomicBool,
    folder: &'a CheckpointFolder,
}

impl Sweep<'_, '_> {
    fn run(mut self, inbox: &mpsc::Receiver<WorkerMessage>) -> Result<Tally, StoreError> {
        self.store.release_dead_sessions(self.session)?;
        self.postpone_jobs_that_died()?;
        loop {
            if self.context.stop.load(Ordering::Relaxed) {
                self.halt.store(true, Ordering::Relaxed);
            }
            // What is complete must not be lost with the next job.
            if self.some_died && !self.gathered.is_empty() {
                self.store_gathered()?;
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
            let queues = [&self.waiting, &self.retrained, &self.held_elsewhere, &self.suspects];
            let none_left = queues.iter().all(|queue| queue.is_empty());
            if !busy && (self.halted() || none_left) {
                return Ok(self.tally);
            }
            match inbox.recv_timeout(patience) {
                Ok(WorkerMessage::Ended(report)) => self.gather(*report),
                Ok(WorkerMessage::Noted { worker, note }) => {
                    let queued = self.workers[worker].job();
                    self.sink.on_event(Event::Checkpoint { worker, queued, note: &note });
                }
                Err(_) if self.gathered.is_empty() => self.tick(busy)?,
                Err(_) => {}
            }
        }
    }

    /// Moves jobs whose processes died behind all others, after the other jobs of their agents, which may
    /// die in the same way. The job with the fewest deaths comes first: it may be innocent.
    fn postpone_jobs_that_died(&mut self) -> Result<(), StoreError> {
        self.died = self.store.died()?;
        let deaths = |queued: &Queued| self.died.get(&queued.key).copied();
        let agents: HashSet<String> = self
            .waiting
            .iter()
            .filter(|queued| deaths(queued).is_some())
            .map(|queued| queued.agent.clone())
            .collect();
        self.some_died = !agents.is_empty();
        if self.some_died {
            self.waiting
                .make_contiguous()
                .sort_by_key(|queued| (deaths(queued), agents.contains(&queued.agent)));
        }
        Ok(())
    }

    /// Whether the gathered outcomes must be stored now.
    fn is_due(&self, busy: bool) -> bool {
        self.gathered.first().is_some_and(|first| {
            !busy || first.at.elapsed() >= GATHER || self.gathered.len() >= MOST_GATHERED
        })
    }

    fn halted(&self) -> bool {
        self.halt.load(Ordering::Relaxed)
    }

    /// Assigns free jobs to idle workers.
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
            if let Some(claim) = &claim {
                let files = programs::files(&queued.job, &queued.folder);
                if !files.is_empty() {
                    self.store.record_programs(claim, &files)?;
                }
            }
            if queued.trains() {
                self.sink.on_event(Event::Started { worker: index, queued: &queued });
            }
            self.workers[index].start(queued, claim);
            self.started_at = Instant::now();
        }
        Ok(if skips < SKIPS_AT_ONCE { Assigned::AllThatCan } else { Assigned::SomeForNow })
    }

    /// Selects a suspect as the next job if no other job is waiting or running, and the jobs that are trained again if
    /// no suspect is left either.
    fn choose_isolation(&mut self, busy: bool) {
        self.isolation = Isolation::Shared;
        if busy || !self.waiting.is_empty() {
            return;
        }
        if let Some(suspect) = self.suspects.pop_front() {
            self.isolation = Isolation::Alone;
            self.waiting.push_back(suspect);
        } else {
            self.waiting.append(&mut self.retrained);
        }
    }

    /// Whether a worker trains a job again.
    fn is_training_again(&self) -> bool {
        let mut workers = self.workers.iter().filter(|worker| !worker.is_idle());
        workers.any(|worker| !worker.has_claim() && worker.job().trains())
    }

    /// The next free job, with the claim on its run if it needs one; `None` if no job is free, or if so many jobs were
    /// skipped that messages should be handled first. `skips` counts the skipped jobs.
    fn claim_next(
        &mut self,
        skips: &mut usize,
    ) -> Result<Option<(Queued, Option<Claim>)>, StoreError> {
        while *skips < SKIPS_AT_ONCE {
            let Some(queued) = self.waiting.pop_front() else { break };
            if queued.purpose == QueuedFor::Estimates {
                let is_suspect = queued.trains() && self.died.contains_key(&queued.key);
                if !is_suspect || self.isolation == Isolation::Alone {
                    return Ok(Some((queued, None)));
                }
                self.suspects.push_back(queued);
                *skips += 1;
                continue;
            }
            // A job that another process gave up.
            if self.is_training_again() {
                self.held_elsewhere.push_back(queued);
                *skips += 1;
                continue;
            }
            let retry = self.context.options.retry_failed;
            match self.store.claim(self.session, &queued.key, retry, self.isolation)? {
                Claimed::Claimed(claim) => return Ok(Some((queued, Some(claim)))),
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

    /// Receives the end of a job, to be stored together with others.
    fn gather(&mut self, report: Report) {
        let Report { worker, work, wall } = report;
        let (queued, claim) = self.workers[worker].finish();
        let end = match (work, claim) {
            (WorkDone::Ran(outcome), Some(claim)) => Ended::Ran(claim, outcome),
            (WorkDone::Estimated(computed), None) => Ended::Estimated(computed),
            _ => unreachable!("a worker with a claim runs, and one without estimates"),
        };
        if let (Ended::Ran(_, Outcome::Failed(_)), OnFailure::Stop) =
            (&end, self.context.options.on_failure)
        {
            self.halt.store(true, Ordering::Relaxed);
        }
        self.gathered.push(Gathered { worker, queued, end, wall, at: Instant::now() });
    }

    /// Stores, counts and reports what has been gathered.
    fn store_gathered(&mut self) -> Result<(), StoreError> {
        let gathered = mem::take(&mut self.gathered);
        let runs: Vec<RunEnd<'_>> = gathered.iter().filter_map(Gathered::run).collect();
        let mut finished = self.store.finish_all(&runs)?.into_iter();
        kill_point::pass(KillPoint::EndsStored);
        self.tally.estimated.store(self.store, gathered.iter().filter_map(Gathered::estimated))?;
        for Gathered { worker, queued, end, wall, .. } in gathered {
            match end {
                Ended::Ran(claim, outcome) => {
                    let finished = finished.next().expect("every run has an end");
                    self.finish(worker, (queued, claim), (outcome, wall), finished);
                }
                Ended::Estimated(computed) => {
                    if let Some(outcome) = &computed.trained {
                        let (queued, outcome) = (&queued, outcome);
                        self.sink.on_event(Event::Ended { worker, queued, outcome, wall });
                    }
                }
            }
        }
        self.beat()
    }

    /// Counts and reports a run whose end has been stored, unless its claim was lost.
    fn finish(
        &mut self,
        worker: usize,
        (queued, claim): (Queued, Claim),
        (outcome, wall): (Outcome, Duration),
        finished: Finished,
    ) {
        match (finished, &outcome) {
            // Another process will complete the job, so this outcome is not needed.
            (Finished::ClaimLost, _) => {
                self.folder.forget_run(&queued.key, claim.attempt);
                self.sink.on_event(Event::Lost { worker, queued: &queued });
                self.held_elsewhere.push_back(queued);
                return;
            }
            (Finished::Stored, Outcome::Completed(_)) => self.tally.completed += 1,
            (Finished::Stored, Outcome::Failed(_)) => self.tally.failed += 1,
            (Finished::Stored, Outcome::Interrupted) => self.tally.interrupted += 1,
        }
        if !matches!(outcome, Outcome::Interrupted) {
            self.folder.forget(&queued.key, claim.attempt);
        }
        self.sink.on_event(Event::Ended { worker, queued: &queued, outcome: &outcome, wall });
    }

    fn tick(&mut self, busy: bool) -> Result<(), StoreError> {
        let progress: Vec<Option<TrainingProgress>> =
            self.workers.iter().map(|worker| worker.progress()).collect();
        let waiting_for = if busy { 0 } else { self.held_elsewhere.len() };
        self.sink.on_event(Event::Tick { progress: &progress, waiting_for });
        self.beat()
    }

    fn beat(&mut self) -> Result<(), StoreError> {
        let is_first = self.heartbeat_at < self.started_at + FIRST_HEARTBEAT
            && self.started_at.elapsed() >= FIRST_HEARTBEAT;
        if is_first || self.heartbeat_at.elapsed() >= HEARTBEAT {
            self.heartbeat_at = Instant::now();
            self.store.heartbeat(self.session)?;
        }
        Ok(())
    }
}
