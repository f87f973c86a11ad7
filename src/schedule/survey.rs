//! A survey: the jobs of a selection by their states in a store.
//!
//! In: a selection, and a store if there is one. Out: each job with its state, and why it is not
//! completed. Jobs are examined in batches and not kept, so a sweep of a million jobs takes seconds and
//! little memory.

use std::collections::hash_map::Entry;
use std::collections::{HashMap, HashSet};
use std::time::Duration;

use super::checkpoint::CheckpointFolder;
use super::programs::{ChangedPrograms, files};
use super::queued::{Queued, QueuedFor};
use super::selection::Selection;
use crate::job::{JobKey, PlannedJob, Versions};
use crate::manifest::Manifest;
use crate::plan::{self, ChangedDefault};
use crate::store::{JobState, JobStates, Reader, RetryFailed, Store, StoreError};

/// A pass through the jobs of a selection, with their states in a store.
pub struct Survey<'a> {
    selection: &'a Selection<'a>,
    /// `None` if there is no store yet.
    states: Option<JobStates<'a>>,
    /// The manifests in which each job occurs.
    met: HashMap<JobKey, Met>,
    /// Number of jobs that several manifests share.
    shared: u64,
}

/// The manifests in which a job occurs.
struct Met {
    /// Index of the last manifest with the job.
    manifest: usize,
    sharing: Sharing,
}

/// A job of a manifest, with its state in the store.
pub struct Surveyed<'s> {
    /// The job's key.
    pub key: JobKey,
    /// The job.
    pub planned: PlannedJob,
    /// Its state.
    pub state: JobState,
    /// Whether an earlier manifest has the same job.
    pub sharing: Sharing,
    states: Option<&'s JobStates<'s>>,
}

/// Whether manifests share a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sharing {
    /// No earlier manifest has the job.
    First,
    /// An earlier manifest has the job, which runs once.
    Shared,
}

/// Why a job runs again, or does not run.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Reason {
    /// Its runs were interrupted.
    Interrupted,
    /// A run failed.
    Failed,
    /// It was completed by another version of the simulation or of the algorithm, perhaps with the earlier
    /// default of a key.
    Outdated {
        /// The change of the simulation, if any.
        simulation: Option<Change>,
        /// The algorithm and its change, if any.
        algorithm: Option<(&'static str, Change)>,
        /// The key whose default has changed, if any.
        default: Option<ChangedDefault>,
    },
    /// It was completed with the earlier default of a key.
    Default(ChangedDefault),
}

/// A change of a version of the code.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Change {
    /// The version before.
    pub from: u32,
    /// The version of this release.
    pub to: u32,
}

impl Change {
    fn between(from: u32, to: u32) -> Option<Change> {
        (from != to).then_some(Change { from, to })
    }
}

impl<'a> Survey<'a> {
    /// A survey of a selection; `reader` is `None` if there is no store yet.
    pub fn of(selection: &'a Selection<'a>, reader: Option<&'a Reader>) -> Survey<'a> {
        let states = reader.map(JobStates::of);
        Survey { selection, states, met: HashMap::new(), shared: 0 }
    }

    /// Number of jobs that several of the walked manifests share.
    pub fn shared(&self) -> u64 {
        self.shared
    }

    /// Calls `see` once for every distinct job of the manifest with this index.
    pub fn walk<E: From<StoreError>>(
        &mut self,
        manifest: usize,
        mut see: impl FnMut(Surveyed<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut jobs = self.selection.jobs(manifest).peekable();
        while jobs.peek().is_some() {
            let mut distinct = Vec::new();
            for planned in jobs.by_ref().take(JobStates::TOGETHER) {
                let key = planned.form.key();
                if let Some(sharing) = self.meet(key, manifest) {
                    distinct.push((key, sharing, planned));
                }
            }
            let keys: Vec<JobKey> = distinct.iter().map(|(key, ..)| *key).collect();
            let states = match &mut self.states {
                Some(states) => states.ask(&keys)?,
                None => vec![JobState::Pending; keys.len()],
            };
            for ((key, sharing, planned), state) in distinct.into_iter().zip(states) {
                see(Surveyed { key, planned, state, sharing, states: self.states.as_ref() })?;
            }
        }
        Ok(())
    }

    /// Calls `see` once for every distinct job of the selection.
    pub fn walk_all<E: From<StoreError>>(
        &mut self,
        mut see: impl FnMut(Surveyed<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        (0..self.selection.manifests().len()).try_for_each(|manifest| {
            self.walk(manifest, |job| match job.sharing {
                Sharing::First => see(job),
                Sharing::Shared => Ok(()),
            })
        })
    }

    /// Whether an earlier manifest shares the job; `None` if this manifest has already listed the job.
    fn meet(&mut self, key: JobKey, manifest: usize) -> Option<Sharing> {
        let first = Met { manifest, sharing: Sharing::First };
        let met = match self.met.entry(key) {
            Entry::Vacant(unmet) => return Some(unmet.insert(first).sharing),
            Entry::Occupied(met) => met.into_mut(),
        };
        if met.manifest == manifest {
            return None;
        }
        self.shared += u64::from(met.sharing == Sharing::First);
        *met = Met { manifest, sharing: Sharing::Shared };
        Some(Sharing::Shared)
    }

    /// The number of jobs that the experiment has in the store but no longer in its manifest. The
    /// manifest with this index must be the last one walked. A filter does not change the number.
    ///
    /// **Errors**: the store fails.
    pub fn dropped(&self, manifest: usize) -> Result<u64, StoreError> {
        let Some(states) = &self.states else { return Ok(0) };
        let declared = &self.selection.staged()[manifest];
        let mut others = HashSet::new();
        states.reader().jobs_of(&declared.name, |key| {
            if self.met.get(&key).is_none_or(|met| met.manifest != manifest) {
                others.insert(key);
            }
        })?;
        if !others.is_empty() && self.selection.is_filtered() {
            for planned in declared.jobs() {
                others.remove(&planned.form.key());
            }
        }
        Ok(others.len() as u64)
    }

    /// The distinct jobs that are wanted, in order. A job in several manifests gets their longest time limit, the
    /// estimates of all, and the folder of the first. Other jobs are not kept.
    ///
    /// **Errors**: the store fails.
    pub fn queue(
        mut self,
        mut is_wanted: impl FnMut(&JobKey, JobState) -> bool,
    ) -> Result<Vec<Queued>, StoreError> {
        let mut queue: Vec<Queued> = Vec::new();
        // Indices in the queue.
        let mut queued = HashMap::new();
        for (index, manifest) in self.selection.manifests().iter().enumerate() {
            let time_limit = manifest.time_limit_seconds.map(Duration::from_secs);
            self.walk(index, |Surveyed { key, planned, state, sharing, .. }| {
                match sharing {
                    Sharing::First if is_wanted(&key, state) => {
                        queued.insert(key, queue.len());
                        let (agent, folder) = (planned.agent.to_string(), manifest.folder());
                        let (job, folder) = (planned.job, folder.to_owned());
                        let estimates = manifest.estimates_of(&agent);
                        let purpose = QueuedFor::Run;
                        let queued =
                            Queued { key, agent, job, time_limit, estimates, purpose, folder };
                        queue.push(queued);
                    }
                    Sharing::First => {}
                    Sharing::Shared => {
                        if let Some(earlier) = queued.get(&key).map(|&index| &mut queue[index]) {
                            earlier.time_limit = longer(earlier.time_limit, time_limit);
                            for declared in manifest.estimates_of(&planned.agent) {
                                if !earlier.estimates.contains(&declared) {
                                    earlier.estimates.push(declared);
                                }
                            }
                        }
                    }
                }
                Ok::<_, StoreError>(())
            })?;
        }
        Ok(queue)
    }
}

/// The longer of two limits; `None` is unlimited.
fn longer(one: Option<Duration>, other: Option<Duration>) -> Option<Duration> {
    one.zip(other).map(|(one, other)| one.max(other))
}

impl Surveyed<'_> {
    /// Whether the job is completed and lacks an estimate that the manifest declares.
    ///
    /// **Errors**: the store fails.
    pub fn lacks_estimates(&self, manifest: &Manifest) -> Result<bool, StoreError> {
        let Some(states) = self.states.filter(|_| self.state == JobState::Completed) else {
            return Ok(false);
        };
        let declared = manifest.estimates_of(&self.planned.agent);
        Ok(!states.reader().lacking_estimates(&self.key, &declared)?.is_empty())
    }

    /// Why the job runs again, or does not run; `None` if it is completed, running or new.
    ///
    /// **Errors**: the store fails.
    pub fn reason(&self) -> Result<Option<Reason>, StoreError> {
        match self.state {
            JobState::Interrupted => return Ok(Some(Reason::Interrupted)),
            JobState::Failed => return Ok(Some(Reason::Failed)),
            JobState::Running | JobState::Completed => return Ok(None),
            JobState::Pending => {}
        }
        let Some(states) = self.states else { return Ok(None) };
        if let Some(earlier) = states.superseded(&self.planned.form)? {
            return Ok(Some(self.outdated(earlier, None)));
        }
        let Some((changed, form)) = plan::under_earlier_default(&self.planned.job) else {
            return Ok(None);
        };
        if states.state(&form.key())? == JobState::Completed {
            return Ok(Some(Reason::Default(changed)));
        }
        let earlier = states.superseded(&form)?;
        Ok(earlier.map(|earlier| self.outdated(earlier, Some(changed))))
    }

    /// The reason for a job whose content was completed by earlier versions of the code.
    fn outdated(&self, earlier: Versions, default: Option<ChangedDefault>) -> Reason {
        let now = self.planned.job.versions();
        let algorithm = Change::between(earlier.algorithm, now.algorithm);
        Reason::Outdated {
            simulation: Change::between(earlier.environment, now.environment),
            algorithm: algorithm.map(|change| (self.planned.job.algorithm(), change)),
            default,
        }
    }
}

/// The jobs that a command still has to run.
pub struct Remaining {
    /// The jobs that need a run, in order.
    pub queue: Vec<Queued>,
    /// The number of jobs that have a completed run.
    pub completed: usize,
    /// The completed jobs that lack declared estimates, each with those alone.
    pub lacking: Vec<Queued>,
    /// The number of failed jobs that are not retried.
    pub failed: usize,
    /// The files of outside programs that have changed since jobs were completed.
    pub changed: ChangedPrograms,
}

impl Remaining {
    /// Sorts jobs by their states in the store. Also removes checkpoints and crash marks that no job needs
    /// any more.
    ///
    /// **Errors**: the store or the folder of its checkpoints fails.
    pub fn of(
        store: &Store,
        selection: &Selection<'_>,
        retry_failed: RetryFailed,
    ) -> Result<Remaining, StoreError> {
        let reader = store.reader()?;
        CheckpointFolder::beside(store.path()).clear(&reader)?;
        store.clear_crash_marks()?;
        let declares = selection.manifests().iter().any(|manifest| !manifest.estimates.is_empty());
        let is_outside = |manifest: &Manifest| {
            let mut agents = manifest.agents.iter();
            manifest.family().is_external() || agents.any(|agent| agent.algorithm.is_external())
        };
        let keeps_completed = declares || selection.manifests().iter().any(is_outside);
        let (mut completed, mut failed) = (HashSet::new(), 0);
        let queue = Survey::of(selection, Some(&reader)).queue(|key, state| {
            match (state, retry_failed) {
                (JobState::Completed, _) => {
                    completed.insert(*key);
                    keeps_completed
                }
                (JobState::Failed, RetryFailed::No) => {
                    failed += 1;
                    false
                }
                (JobState::Failed, RetryFailed::Yes)
                | (JobState::Pending | JobState::Interrupted | JobState::Running, _) => true,
            }
        })?;
        let (done, queue): (Vec<_>, Vec<_>) =
            queue.into_iter().partition(|queued| completed.contains(&queued.key));
        let (mut lacking, mut changed) = (Vec::new(), ChangedPrograms::default());
        let mut now = HashMap::new();
        for queued in done {
            if queued.job.is_outside() {
                let command = (queued.job.programs(), queued.folder.clone());
                let files =
                    now.entry(command).or_insert_with(|| files(&queued.job, &queued.folder));
                changed.add(&reader.programs(&queued.key)?, files);
            }
            let estimates = reader.lacking_estimates(&queued.key, &queued.estimates)?;
            if !estimates.is_empty() {
                lacking.push(Queued { estimates, purpose: QueuedFor::Estimates, ..queued });
            }
        }
        Ok(Remaining { queue, completed: completed.len(), lacking, failed, changed })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_job_of_two_manifests_has_the_time_that_the_more_patient_gives_it() {
        let text = |limit: &str| {
            format!(
                "format = 1\nname = \"sweep\"\n{limit}\nscenarios = [\"C\"]\nseeds = 1\n\
                 environment.sigma = 1\n[[agent]]\nname = \"never\"\nalgorithm = \"rule\"\n\
                 rule = \"never\"\n"
            )
        };
        let five = ["time_limit_seconds = 5", "time_limit_seconds = 2"];
        for (limits, expected) in [(five, Some(Duration::from_secs(5))), ([five[0], ""], None)] {
            let parsed =
                limits.map(|limit| crate::manifest::parse("m", text(limit).as_bytes()).unwrap());
            let selection = Selection::new(&parsed, None).unwrap();
            let queue = Survey::of(&selection, None).queue(|_, _| true).unwrap();
            let found: Vec<_> = queue.iter().map(|queued| queued.time_limit).collect();
            assert_eq!(found, [expected]);
        }
    }
}
