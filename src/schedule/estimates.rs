//! Estimates of completed jobs: from their recorded decisions, or by training again.
//!
//! Training again gives the same results. Their digest is compared with the stored one before anything is stored.

use std::mem;
use std::sync::atomic::{AtomicBool, Ordering};

use super::queued::{Queued, QueuedFor};
use crate::estimate::Estimation;
use crate::job::{Estimates, Job, JobKey, Outcome};
use crate::store::{Added, Reader, Store, StoreError, results_digest};
use crate::train::Afterwards;

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

impl Queued {
    /// Whether a worker trains the job, and does not only read its decisions.
    pub fn trains(&self) -> bool {
        self.purpose == QueuedFor::Run || trains_again(&self.job)
    }
}

/// The estimates of a job, and the digest of its results if it was trained again.
type OfJob = (Vec<Estimates>, Option<[u8; 32]>);

/// What a worker has computed of a job that lacks estimates.
pub(super) struct Computed {
    /// `None` if it was stopped, the reason if there are none.
    estimates: Result<Option<OfJob>, String>,
    /// How training again ended; `None` if the decisions were read.
    pub(super) trained: Option<Outcome>,
}

impl Computed {
    /// The estimates of a job that was trained again.
    pub(super) fn trained(job: &Job, mut outcome: Outcome) -> Computed {
        let estimates = match &mut outcome {
            Outcome::Completed(results) => results_digest(job, results)
                .map(|digest| Some((mem::take(&mut results.estimates), Some(digest))))
                .map_err(|error| error.to_string()),
            Outcome::Failed(failure) => Err(failure.message.clone()),
            Outcome::Interrupted => Ok(None),
        };
        Computed { estimates, trained: Some(outcome) }
    }

    /// The estimates of a job, from its recorded decisions.
    pub(super) fn read(reader: &Reader, queued: &Queued, stop: &AtomicBool) -> Computed {
        let estimates = read(reader, queued, stop);
        let estimates = estimates.map(|read| read.map(|estimates| (estimates, None)));
        Computed { estimates, trained: None }
    }

    /// No estimates, for a reason.
    pub(super) fn without(reason: String) -> Computed {
        Computed { estimates: Err(reason), trained: None }
    }
}

impl Estimated {
    /// Why the first job without estimates has none.
    pub fn reason(&self) -> &str {
        let differing = "training again gave other results than the store has";
        self.failures.first().map_or(differing, String::as_str)
    }

    /// The number of jobs whose estimates could not be added.
    pub fn failed(&self) -> usize {
        self.differing + self.failures.len()
    }

    /// The number of jobs, with estimates or without.
    pub fn jobs(&self) -> usize {
        self.read + self.trained + self.failed()
    }

    /// Stores what was computed of some jobs, and counts it.
    pub(super) fn store<'c>(
        &mut self,
        store: &mut Store,
        some: impl Iterator<Item = (JobKey, &'c Computed)>,
    ) -> Result<(), StoreError> {
        let mut computed = Vec::new();
        for (key, one) in some {
            match &one.estimates {
                Ok(Some(of_job)) => computed.push((key, of_job)),
                // Stopped.
                Ok(None) => {}
                Err(why) => self.failures.push(format!("job {key}: {why}")),
            }
        }
        if computed.is_empty() {
            return Ok(());
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

/// The estimates that a job lacks, from its recorded decisions.
fn read(
    reader: &Reader,
    queued: &Queued,
    stop: &AtomicBool,
) -> Result<Option<Vec<Estimates>>, String> {
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
        estimates
    }))
}
