//! What a run would do: the jobs of each manifest by state, why they run, and the estimated time.
//!
//! In: a survey. Out: sums of jobs, and sentences about them.

use std::collections::{BTreeMap, HashSet};
use std::fmt;
use std::num::NonZeroUsize;
use std::time::Duration;

use super::estimate::{Left, Speeds, spoken};
use super::estimates::trains_again;
use super::survey::{Change, Reason, Sharing, Survey, Surveyed};
use crate::job::counted;
use crate::key::printable;
use crate::manifest::Manifest;
use crate::plan::ChangedDefault;
use crate::store::{Counts, JobState, StoreError};

/// What a run of manifests would do.
pub struct Preview<'m> {
    manifests: &'m [Manifest],
    /// The jobs of each manifest.
    experiments: Vec<(Sum, u64)>,
    /// The distinct jobs of all manifests.
    all: Sum,
    /// Number of jobs that several manifests share.
    shared: u64,
    speeds: Speeds,
    workers: NonZeroUsize,
}

/// Totals over jobs.
#[derive(Clone, Debug, Default)]
struct Sum {
    counts: Counts,
    /// The remaining work. Running jobs count in full, as in `status`.
    left: Left,
    reasons: BTreeMap<Reason, u64>,
    /// Completed jobs that lack declared estimates, and those of them that are trained again.
    lacking: [u64; 2],
}

impl<'m> Preview<'m> {
    /// The preview of the jobs of a survey, whose selection is of `manifests`.
    ///
    /// **Errors**: the store fails.
    pub fn of(
        mut survey: Survey<'_>,
        manifests: &'m [Manifest],
        speeds: Speeds,
        workers: NonZeroUsize,
    ) -> Result<Preview<'m>, StoreError> {
        let (mut all, mut experiments) = (Sum::default(), Vec::new());
        // A job that several manifests list may lack the estimates of any of them.
        let mut lacking = HashSet::new();
        for (index, manifest) in manifests.iter().enumerate() {
            let mut experiment = Sum::default();
            survey.walk(index, |job| {
                let reason = job.reason()?;
                if job.lacks_estimates(manifest)? && lacking.insert(job.planned.form.key()) {
                    let again = u64::from(trains_again(&job.planned.job));
                    all.lacking = [all.lacking[0] + 1, all.lacking[1] + again];
                }
                experiment.add(&job, reason.as_ref());
                match job.sharing {
                    Sharing::First => all.add(&job, reason.as_ref()),
                    Sharing::Shared => {}
                }
                Ok::<_, StoreError>(())
            })?;
            experiments.push((experiment, survey.dropped(index)?));
        }
        let shared = survey.shared();
        Ok(Preview { manifests, experiments, all, shared, speeds, workers })
    }

    /// The name of each experiment, its jobs by state, and the estimated time that is left; see [`Speeds::time`].
    pub fn experiments(&self) -> impl Iterator<Item = (&str, &Counts, Option<Duration>)> {
        let named = self.manifests.iter().zip(&self.experiments);
        named.map(|(manifest, (sum, _))| (manifest.name.as_str(), &sum.counts, self.time(sum)))
    }

    /// The distinct jobs of all manifests by state, and the estimated time that is left.
    pub fn all(&self) -> (&Counts, Option<Duration>) {
        (&self.all.counts, self.time(&self.all))
    }

    fn time(&self, sum: &Sum) -> Option<Duration> {
        self.speeds.time(&sum.left, self.workers.get())
    }

    /// Sentences about the jobs: shared and dropped jobs, outside programs, reasons, and the estimated time.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        match self.shared {
            0 => {}
            1 => notes.push("1 job is shared between the manifests and runs once".to_owned()),
            n => notes.push(format!("{n} jobs are shared between the manifests and run once")),
        }
        for (manifest, (_, dropped)) in self.manifests.iter().zip(&self.experiments) {
            if *dropped > 0 {
                let (name, jobs) = (printable(&manifest.name), counted(*dropped, "job"));
                notes.push(format!(
                    "{name} has {jobs} in the store that this manifest no longer has; a run removes them \
                     from the experiment and keeps their results"
                ));
            }
        }
        notes.extend(outside_agents(self.manifests));
        notes.extend(outside_environments(self.manifests));
        notes.extend(self.all.reasons.iter().map(|(reason, jobs)| reason.of(*jobs)));
        let [lacking, again] = self.all.lacking;
        if lacking > 0 {
            let again = match again {
                0 => "without training".to_owned(),
                again => format!(
                    "{again} of them by training again: their decisions, or the costs of messages, are not recorded"
                ),
            };
            let jobs = counted(lacking, "completed job");
            notes.push(format!("estimates of {jobs} to compute, {again}"));
        }
        notes.push(self.estimate());
        notes
    }

    /// The number of jobs to run and the estimated time.
    fn estimate(&self) -> String {
        if self.all.to_run() == 0 {
            return "nothing to run".to_owned();
        }
        let jobs = counted(self.all.to_run(), "job");
        let workers = counted(self.workers.get(), "worker");
        let Some(time) = self.all().1.map(spoken) else {
            return format!(
                "{jobs} to run with {workers}; how long is not known: no job of the same algorithm with the outside program has been timed yet"
            );
        };
        let basis = match self.speeds.are_measured() {
            true => "estimated from earlier runs",
            false => "estimated from built-in speeds; no run has been timed yet",
        };
        format!("{jobs} to run: about {time} with {workers}, {basis}")
    }
}

/// Names the agents that are outside programs, for which jitai cannot guarantee determinism.
fn outside_agents(manifests: &[Manifest]) -> Option<String> {
    let agents = manifests.iter().flat_map(|manifest| &manifest.agents);
    let outside = agents.filter(|agent| agent.algorithm.is_external());
    let names: Vec<String> = outside.map(|agent| printable(&agent.name)).collect();
    (!names.is_empty()).then(|| {
        format!(
            "outside programs: {}; their job keys cover command, version, parameters and budget, but \
             jitai cannot guarantee that equal jobs give equal results",
            names.join(", ")
        )
    })
}

/// Names the experiments whose environments are outside programs.
fn outside_environments(manifests: &[Manifest]) -> Option<String> {
    let outside = manifests.iter().filter(|manifest| manifest.family().is_external());
    let names: Vec<String> = outside.map(|manifest| printable(&manifest.name)).collect();
    (!names.is_empty()).then(|| {
        format!(
            "environments that are outside programs: {}; their jobs start over instead of resuming in the middle; \
             job keys cover command, version and parameters, and `jitai check --try` checks that equal seeds \
             give equal episodes",
            names.join(", ")
        )
    })
}

impl fmt::Display for Reason {
    /// Formats the reason for one job.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (simulation, algorithm, default) = match self {
            Reason::Interrupted => return write!(f, "was interrupted"),
            Reason::Failed => return write!(f, "failed; runs with --retry-failed"),
            Reason::Default(changed @ ChangedDefault { key, before, .. }) => {
                return write!(
                    f,
                    "{}; with {key} = {before} it is completed",
                    new_default(changed)
                );
            }
            Reason::Outdated { simulation, algorithm, default } => (simulation, algorithm, default),
        };
        let simulation = simulation.map(|change| ("the simulation", change));
        let changes = simulation.into_iter().chain(*algorithm);
        let changes =
            changes.map(|(what, Change { from, to })| format!("{what} changed: {from} → {to}"));
        let changes = changes.chain(default.as_ref().map(new_default));
        f.write_str(&changes.collect::<Vec<_>>().join(", "))
    }
}

fn new_default(ChangedDefault { algorithm, key, now, .. }: &ChangedDefault) -> String {
    format!("{key} = {now} is the new default of {algorithm}")
}

impl Reason {
    /// The message for this number of jobs.
    fn of(&self, jobs: u64) -> String {
        let (all, one) = (counted(jobs, "job"), jobs == 1);
        match self {
            Reason::Interrupted if one => {
                format!("{all} was interrupted; `jitai run` continues it")
            }
            Reason::Interrupted => format!("{all} were interrupted; `jitai run` continues them"),
            Reason::Failed if one => format!("{all} failed; `--retry-failed` runs it again"),
            Reason::Failed => format!("{all} failed; `--retry-failed` runs them again"),
            Reason::Outdated { .. } => format!("{all} to run again: {self}"),
            Reason::Default(ChangedDefault { algorithm, key, now, before }) => format!(
                "{all} to run, of {algorithm} with {key} = {now}, which is the default now; with the earlier \
                 default they are completed: to keep those results, write {key} = {before} in the agent"
            ),
        }
    }
}

impl Sum {
    fn add(&mut self, job: &Surveyed<'_>, reason: Option<&Reason>) {
        self.counts.add(job.state, 1);
        if let Some(reason) = reason {
            *self.reasons.entry(reason.clone()).or_default() += 1;
        }
        match job.state {
            JobState::Pending | JobState::Interrupted | JobState::Running => {
                self.left.add(&job.planned.job, 1);
            }
            JobState::Completed | JobState::Failed => {}
        }
    }

    fn to_run(&self) -> u64 {
        self.counts.pending + self.counts.interrupted
    }
}
