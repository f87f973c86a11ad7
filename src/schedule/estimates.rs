//! Estimates of completed jobs: from their recorded decisions, or by training again.
//!
//! Training again gives the same results. Their digest is compared with the stored one before anything is stored.

use std::mem;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::RecvTimeoutError;
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::thread;
use std::time::{Duration, Instant};

use super::event::{Event, EventSink, Found};
use super::panic;
use super::queued::Queued;
use super::sweep::SweepError;
use super::worker::{Slot, caught};
use crate::estimate::Estimation;
use crate::job::{CurvePoint, EstimateDeclaration, Estimates, Failure, FailureKind, Job, Outcome};
use crate::store::{Added, Reader, Store, StoreError, results_digest};
use crate::train::{self, Afterwards, StopHandle, TrainingControl, TrainingProgress};

/// The most jobs whose estimates are stored in one transaction.
const TOGETHER: usize = 256;

/// Interval at which a stop is looked for.
const LOOK: Duration = Duration::from_millis(50);

/// How the estimates of completed jobs came about.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Estimated {
    /// The number of jobs whose estimates were computed from their recorded decisions.
    pub read: usize,
    /// The number of jobs that were trained again for their estimates.
    pub trained: usize,
    /// The number of jobs of which nothing was stored, because training again gave other results.
    pub differing: usize,
    /// Why other jobs have no estimates, in the order in which they failed.
    pub failures: Vec<String>,
}

/// Whether a completed job must be trained again for estimates: its decisions, or the costs of its messages, are not
/// recorded.
pub fn trains_again(job: &Job) -> bool {
    let environment = &job.environment;
    let differ = environment.differing() > 0 || environment.costs_vary();
    !job.evaluation.record_decisions.of_test() || (differ && environment.message_cost().is_some())
}

/// The estimates of a job, and the digest of its results if it was trained again; `None` if it was stopped, the reason if
/// there are none.
type Computed = Result<Option<(Vec<Estimates>, Option<[u8; 32]>)>, String>;

/// A message from a thread that computes estimates.
enum Message<'q> {
    /// It trains a job again.
    Started { worker: usize, queued: &'q Queued },
    /// It is done with a job.
    Ended(Box<Ended<'q>>),
}

/// What became of a job.
struct Ended<'q> {
    worker: usize,
    queued: &'q Queued,
    computed: Computed,
    /// How training again ended and how long it took; `None` if the decisions were read.
    trained: Option<(Outcome, Duration)>,
}

/// Adds to completed jobs the estimates that they lack, until all are added or `stop` is set. `sink` receives events of the
/// jobs that are trained again as if they ran for the first time; the others are skipped.
///
/// **Errors**: no thread can be started, or the store fails. What was stored before remains.
pub fn add_estimates(
    store: &mut Store,
    jobs: &[Queued],
    workers: usize,
    stop: &AtomicBool,
    sink: &mut dyn EventSink,
) -> Result<Estimated, SweepError> {
    panic::capture();
    // Outlives this call, as waits on outside programs may.
    let halt = &Arc::new(AtomicBool::new(false));
    let readers = (0..workers.min(jobs.len())).map(|_| store.reader());
    let readers = readers.collect::<Result<Vec<_>, _>>()?;
    let slots: Vec<Slot> = readers.iter().map(|_| Slot::default()).collect();
    let waiting = Mutex::new(jobs.iter());
    let (messages, inbox) = mpsc::sync_channel(TOGETHER);
    thread::scope(|scope| {
        for (worker, (reader, slot)) in readers.into_iter().zip(&slots).enumerate() {
            let (messages, waiting) = (messages.clone(), &waiting);
            let work = move || {
                let next = || {
                    let next = waiting.lock().unwrap_or_else(PoisonError::into_inner).next();
                    next.filter(|_| !halt.load(Ordering::Relaxed))
                };
                while let Some(queued) = next() {
                    let started = Message::Started { worker, queued };
                    if trains_again(&queued.job) && messages.send(started).is_err() {
                        return;
                    }
                    let ended = compute(worker, &reader, queued, slot, halt);
                    if messages.send(Message::Ended(Box::new(ended))).is_err() {
                        return;
                    }
                }
            };
            match thread::Builder::new().spawn_scoped(scope, work) {
                Ok(_) => {}
                Err(reason) if worker == 0 => return Err(SweepError::NoWorker(reason)),
                Err(reason) => {
                    sink.on_event(Event::FewerWorkers { started: worker, reason: &reason });
                    break;
                }
            }
        }
        drop(messages);
        let mut estimated = Estimated::default();
        loop {
            halt.store(stop.load(Ordering::Relaxed), Ordering::Relaxed);
            let first = match inbox.recv_timeout(LOOK) {
                Ok(first) => first,
                Err(RecvTimeoutError::Timeout) => {
                    let progress: Vec<_> = slots.iter().map(Slot::get).collect();
                    sink.on_event(Event::Tick { progress: &progress, waiting_for: 0 });
                    continue;
                }
                Err(RecvTimeoutError::Disconnected) => return Ok(estimated),
            };
            let some = [first].into_iter().chain(inbox.try_iter()).take(TOGETHER);
            // After an error, the threads see the closed channel or this, and end.
            let received = estimated.receive(store, some, sink);
            received.inspect_err(|_| halt.store(true, Ordering::Relaxed))?;
        }
    })
}

impl Estimated {
    /// Why the first job without estimates has none.
    pub fn reason(&self) -> &str {
        let differing = "training again gave other results than the store has";
        self.failures.first().map_or(differing, String::as_str)
    }

    /// Stores what was computed of some jobs, and reports it once it is stored. The events of each worker keep their order.
    fn receive<'q>(
        &mut self,
        store: &mut Store,
        some: impl Iterator<Item = Message<'q>>,
        sink: &mut dyn EventSink,
    ) -> Result<(), StoreError> {
        let some: Vec<_> = some.collect();
        let mut computed = Vec::new();
        for message in &some {
            let Message::Ended(ended) = message else { continue };
            match &ended.computed {
                Ok(Some(of_job)) => computed.push((ended.queued.key, of_job)),
                // Stopped.
                Ok(None) => {}
                Err(why) => self.failures.push(format!("job {}: {why}", ended.queued.key)),
            }
        }
        let rows = computed.iter().map(|(key, (estimates, digest))| (key, &**estimates, *digest));
        let added = store.add_estimates(rows)?;
        for ((_, (_, digest)), added) in computed.iter().zip(added) {
            match (added, digest) {
                (Added::Stored, None) => self.read += 1,
                (Added::Stored, Some(_)) => self.trained += 1,
                (Added::Differing, _) => self.differing += 1,
                // Another process removed the job.
                (Added::NotCompleted, _) => {}
            }
        }
        some.iter().for_each(|message| sink.on_event(message.event()));
        Ok(())
    }
}

impl Message<'_> {
    fn event(&self) -> Event<'_> {
        match self {
            Message::Started { worker, queued } => Event::Started { worker: *worker, queued },
            Message::Ended(ended) => match &ended.trained {
                Some((outcome, wall)) => Event::Ended {
                    worker: ended.worker,
                    queued: ended.queued,
                    outcome,
                    wall: *wall,
                },
                None => Event::Skipped { queued: ended.queued, found: Found::Completed },
            },
        }
    }
}

/// Computes the estimates that a job lacks.
fn compute<'q>(
    worker: usize,
    reader: &Reader,
    queued: &'q Queued,
    slot: &Slot,
    stop: &Arc<AtomicBool>,
) -> Ended<'q> {
    if !trains_again(&queued.job) {
        let computed = read(reader, queued, stop);
        return Ended { worker, queued, computed, trained: None };
    }
    let started = Instant::now();
    slot.set(None);
    let mut outcome = train_again(queued, slot, stop, started);
    slot.set(None);
    let computed = match &mut outcome {
        Outcome::Completed(results) => results_digest(&queued.job, results)
            .map(|digest| Some((mem::take(&mut results.estimates), Some(digest))))
            .map_err(|error| error.to_string()),
        Outcome::Failed(failure) => Err(failure.message.clone()),
        Outcome::Interrupted => Ok(None),
    };
    Ended { worker, queued, computed, trained: Some((outcome, started.elapsed())) }
}

/// The estimates that a job lacks, from its recorded decisions.
fn read(reader: &Reader, queued: &Queued, stop: &AtomicBool) -> Computed {
    let job = reader.described(queued.job.clone()).map_err(|error| error.to_string())?;
    let (actions, names) = (job.task().interface().actions, job.state_names());
    let mut estimations: Vec<Estimation> = queued
        .estimates
        .iter()
        .map(|declared| Estimation::new(declared.clone(), actions, &names))
        .collect();
    let add = |decision: &_| estimations.iter_mut().for_each(|one| one.add(decision));
    reader.decisions(&job, add).map_err(|error| error.to_string())?;
    let mut estimates: Vec<Estimates> = estimations.iter().map(Estimation::finish).collect();
    let stop = || stop.load(Ordering::Relaxed);
    Ok(Afterwards::simulate(&job, &queued.estimates, &stop).map(|afterwards| {
        afterwards.add_to(&mut estimates);
        (estimates, None)
    }))
}

/// Trains a job again, within its time limit.
fn train_again(queued: &Queued, slot: &Slot, stop: &Arc<AtomicBool>, started: Instant) -> Outcome {
    let deadline = queued.time_limit.and_then(|limit| started.checked_add(limit));
    let control = Again { queued, slot, stop, deadline, started };
    match caught(slot, || train::run(&queued.job, &control)) {
        Outcome::Interrupted if !stop.load(Ordering::Relaxed) => Outcome::Failed(Failure {
            kind: FailureKind::OverTime,
            message: "training it again exceeded its time limit".to_owned(),
            episode: slot.episode(),
        }),
        outcome => outcome,
    }
}

/// The control of a job that is trained again.
struct Again<'q> {
    queued: &'q Queued,
    slot: &'q Slot,
    stop: &'q Arc<AtomicBool>,
    deadline: Option<Instant>,
    started: Instant,
}

impl TrainingControl for Again<'_> {
    fn report(&self, progress: TrainingProgress, _: &[CurvePoint]) {
        self.slot.set(Some(progress));
    }

    fn stop_requested(&self) -> bool {
        let is_over = self.deadline.is_some_and(|deadline| Instant::now() >= deadline);
        is_over || self.stop.load(Ordering::Relaxed)
    }

    fn stop_handle(&self) -> StopHandle {
        let (stop, deadline) = (self.stop.clone(), self.deadline);
        let is_over = move || deadline.is_some_and(|deadline| Instant::now() >= deadline);
        Arc::new(move || stop.load(Ordering::Relaxed) || is_over())
    }

    fn worked(&self) -> Duration {
        self.started.elapsed()
    }

    fn folder(&self) -> &Path {
        &self.queued.folder
    }

    fn estimates(&self) -> &[Arc<EstimateDeclaration>] {
        &self.queued.estimates
    }
}
