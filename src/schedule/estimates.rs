//! Estimates of completed jobs: from their recorded decisions, or by training again.
//!
//! Training again gives the same results. Their digest is compared with the stored one before anything is stored.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::RecvTimeoutError;
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::thread;
use std::time::{Duration, Instant};

use super::panic;
use super::queued::Queued;
use crate::estimate::Estimation;
use crate::job::{CurvePoint, EstimateDeclaration, Estimates, Job, Outcome};
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

/// Whether a completed job must be trained again for estimates: its decisions are not recorded.
pub fn trains_again(job: &Job) -> bool {
    !job.evaluation.record_decisions.of_test()
}

/// The estimates of a job, and the digest of its results if it was trained again.
type Computed = (Vec<Estimates>, Option<[u8; 32]>);

/// Adds to completed jobs the estimates that they lack, until all are added or `stop` is set.
///
/// **Errors**: the store fails. What was stored before remains.
pub fn add_estimates(
    store: &mut Store,
    jobs: &[Queued],
    workers: usize,
    stop: &AtomicBool,
) -> Result<Estimated, StoreError> {
    panic::capture();
    // Outlives this call, as waits on outside programs may.
    let halt = &Arc::new(AtomicBool::new(false));
    let readers = (0..workers.min(jobs.len())).map(|_| store.reader());
    let readers = readers.collect::<Result<Vec<_>, _>>()?;
    let waiting = Mutex::new(jobs.iter());
    let (results, inbox) = mpsc::sync_channel(TOGETHER);
    thread::scope(|scope| {
        for reader in readers {
            let (results, waiting) = (results.clone(), &waiting);
            scope.spawn(move || {
                loop {
                    let next = waiting.lock().unwrap_or_else(PoisonError::into_inner).next();
                    let Some(queued) = next.filter(|_| !halt.load(Ordering::Relaxed)) else {
                        return;
                    };
                    let computed = compute(&reader, queued, halt);
                    if results.send((queued, computed)).is_err() {
                        return;
                    }
                }
            });
        }
        drop(results);
        let mut estimated = Estimated::default();
        loop {
            halt.store(stop.load(Ordering::Relaxed), Ordering::Relaxed);
            let first = match inbox.recv_timeout(LOOK) {
                Ok(first) => first,
                Err(RecvTimeoutError::Timeout) => continue,
                Err(RecvTimeoutError::Disconnected) => return Ok(estimated),
            };
            let some: Vec<_> = [first].into_iter().chain(inbox.try_iter()).take(TOGETHER).collect();
            // After an error, the threads see the closed channel or this, and end.
            let stored = estimated.store(store, some);
            stored.inspect_err(|_| halt.store(true, Ordering::Relaxed))?;
        }
    })
}

impl Estimated {
    /// Why the first job without estimates has none.
    pub fn reason(&self) -> &str {
        let differing = "training again gave other results than the store has";
        self.failures.first().map_or(differing, String::as_str)
    }

    /// Stores what was computed of some jobs.
    fn store(
        &mut self,
        store: &mut Store,
        some: Vec<(&Queued, Result<Option<Computed>, String>)>,
    ) -> Result<(), StoreError> {
        let mut computed = Vec::new();
        for (queued, result) in some {
            match result {
                Ok(Some(of_job)) => computed.push((queued.key, of_job)),
                // Stopped.
                Ok(None) => {}
                Err(why) => self.failures.push(format!("job {}: {why}", queued.key)),
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
        Ok(())
    }
}

/// The estimates that a job lacks; `None` if it was stopped.
fn compute(
    reader: &Reader,
    queued: &Queued,
    stop: &Arc<AtomicBool>,
) -> Result<Option<Computed>, String> {
    if !trains_again(&queued.job) {
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
        let Some(afterwards) = Afterwards::simulate(&job, &queued.estimates, &stop) else {
            return Ok(None);
        };
        afterwards.add_to(&mut estimates);
        return Ok(Some((estimates, None)));
    }
    let deadline = queued.time_limit.and_then(|limit| Instant::now().checked_add(limit));
    let control = Again { queued, stop, deadline, started: Instant::now() };
    match panic::catch(|| train::run(&queued.job, &control))? {
        Outcome::Completed(results) => {
            let digest =
                results_digest(&queued.job, &results).map_err(|error| error.to_string())?;
            Ok(Some((results.estimates, Some(digest))))
        }
        Outcome::Failed(failure) => Err(failure.message),
        Outcome::Interrupted if stop.load(Ordering::Relaxed) => Ok(None),
        Outcome::Interrupted => Err("training it again exceeded its time limit".to_owned()),
    }
}

/// The control of a job that is trained again.
struct Again<'q> {
    queued: &'q Queued,
    stop: &'q Arc<AtomicBool>,
    deadline: Option<Instant>,
    started: Instant,
}

impl TrainingControl for Again<'_> {
    fn report(&self, _: TrainingProgress, _: &[CurvePoint]) {}

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
