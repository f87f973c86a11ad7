//! A job with its parameters, status and results.

use crate::job::metric::{DISENGAGEMENT_RATE, MEAN_LENGTH, MEAN_RETURN};
use std::sync::Arc;

use super::settings::{Settings, SharedSettings};
use crate::job::PlannedJob;
use crate::job::{
    ActionCount, Estimate, EstimateDeclaration, Estimates, Failure, JobKey, Provenance,
    RecordedPosterior, TestEpisode,
};
use crate::job::{Described, ParticipantRange, Scalar};
use crate::key::Parameter;

/// A job of an experiment with its status.
#[derive(Clone, Debug, PartialEq)]
pub struct JobRecord {
    /// Identity of the job.
    pub job_key: JobKey,
    /// Agent's name in the manifest.
    pub agent: Arc<str>,
    /// Scenario, such as `P-H-D`.
    pub scenario: String,
    /// Seed.
    pub seed: u64,
    /// Whether its algorithm learns, so that a completed run has a learning curve.
    pub learns: bool,
    /// All other parameters.
    pub settings: Arc<Settings>,
    /// The exact error rate of the most likely context; `None` if participants differ.
    pub context_error: Option<f64>,
    /// The best mean return of any policy in this environment and scenario; `None` if
    /// unknown.
    pub optimum: Option<f64>,
    /// Its status.
    pub status: JobStatus,
}

impl JobRecord {
    /// A planned job with this status, without an optimum.
    pub fn new(planned: &PlannedJob, job_key: JobKey, status: JobStatus) -> JobRecord {
        JobRecord::sharing(&mut SharedSettings::default(), planned, job_key, status)
    }

    /// Like [`JobRecord::new`], with settings that are shared with the jobs before it.
    pub fn sharing(
        shared: &mut SharedSettings,
        planned: &PlannedJob,
        job_key: JobKey,
        status: JobStatus,
    ) -> JobRecord {
        JobRecord {
            job_key,
            agent: planned.agent.clone(),
            scenario: planned.job.scenario.to_string(),
            seed: planned.job.seed,
            learns: planned.job.agent.algorithm().learns(),
            settings: shared.of(planned),
            context_error: planned.job.environment.context_error(),
            optimum: None,
            status,
        }
    }

    /// The value of the parameter of this dotted name, if the job has it.
    pub fn setting(&self, name: &str) -> Option<&Scalar> {
        self.settings.get(name)
    }

    /// The value of the parameter with this dotted name, if it is a number.
    pub fn number(&self, name: &str) -> Option<f64> {
        self.setting(name)?.number()
    }

    /// Whether both jobs were read with shared settings, and differ in their seeds alone.
    pub fn shares_arm(&self, other: &JobRecord) -> bool {
        Arc::ptr_eq(&self.settings, &other.settings)
            && self.agent == other.agent
            && self.scenario == other.scenario
    }

    /// The job with its results among some participants; without metrics if those participants were not read.
    #[must_use]
    pub fn among(&self, range: ParticipantRange) -> JobRecord {
        let mut job = JobRecord { optimum: None, ..self.clone() };
        if let JobStatus::Completed(run) = &mut job.status {
            let among = run.among.iter().find(|among| among.range == range);
            let episodes = among.map_or(&[][..], |among| &among.episodes);
            let returns = episodes.iter().map(|episode| episode.total_reward).collect();
            let metrics = among.map(AmongParticipants::metrics).unwrap_or_default();
            *run = Arc::new(CompletedRun { returns, metrics, ..CompletedRun::clone(run) });
        }
        job
    }

    /// The completed run, if there is one.
    pub fn completed(&self) -> Option<&CompletedRun> {
        match &self.status {
            JobStatus::Completed(run) => Some(run),
            JobStatus::Pending
            | JobStatus::Interrupted
            | JobStatus::Running
            | JobStatus::Failed(_) => None,
        }
    }
}

impl Described for JobRecord {
    fn value(&self, parameter: Parameter) -> Option<Scalar> {
        match parameter {
            Parameter::AGENT_NAME => Some(Scalar::Text(self.agent.to_string())),
            Parameter::SCENARIO => Some(Scalar::Text(self.scenario.clone())),
            Parameter::SEED => i64::try_from(self.seed).ok().map(Scalar::Integer),
            _ => self.setting(&parameter.to_string()).cloned(),
        }
    }
}

/// The jobs of an experiment with their results, as a report reads them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DataSet {
    /// The experiment's name.
    pub experiment: String,
    /// Its jobs, in the manifest's order.
    pub jobs: Vec<JobRecord>,
    /// How the environment described itself in a completed run; see [`crate::env::Model::description`].
    pub description: Option<String>,
}

/// The status of a job, with its results.
#[derive(Clone, Debug, PartialEq)]
pub enum JobStatus {
    /// The job has no run.
    Pending,
    /// All runs of the job were interrupted.
    Interrupted,
    /// A living process is running the job.
    Running,
    /// The job's last run failed.
    Failed(Failure),
    /// The job has a completed run.
    Completed(Arc<CompletedRun>),
}

/// The test episodes of some participants.
#[derive(Clone, Debug, PartialEq)]
pub struct AmongParticipants {
    /// The range of participants.
    pub range: ParticipantRange,
    /// The episodes of these participants, in the order of the test.
    pub episodes: Vec<TestEpisode>,
}

impl AmongParticipants {
    /// The metrics that are defined for single episodes, by name; empty if there are no episodes.
    pub fn metrics(&self) -> Vec<(Arc<str>, f64)> {
        let n = self.episodes.len() as f64;
        if self.episodes.is_empty() {
            return Vec::new();
        }
        let mean =
            |value: fn(&TestEpisode) -> f64| self.episodes.iter().map(value).sum::<f64>() / n;
        let terminated = mean(|one| f64::from(u8::from(one.terminated)));
        vec![
            (DISENGAGEMENT_RATE.text().into(), terminated),
            (MEAN_LENGTH.text().into(), mean(|one| f64::from(one.length))),
            (MEAN_RETURN.text().into(), mean(|one| one.total_reward)),
        ]
    }
}

/// A decision of a person of the test or trial.
#[derive(Clone, Debug, PartialEq)]
pub struct PersonDecision {
    /// The number of the person, from 1.
    pub person: u32,
    /// The number of the decision, from 0.
    pub step: u32,
    /// The action; NaN where no message could be sent.
    pub action: f64,
    /// The reward.
    pub reward: f64,
    /// Names and numbers of the recorded state.
    pub state: Vec<(String, f64)>,
}

/// The probabilities of an agent at the decisions of a recorded trial, beside the recorded ones of the actions that were
/// taken.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReplayedDecisions {
    /// The number of decisions at which an action was possible.
    pub decisions: u64,
    /// The number of decisions whose probabilities differ by more than the threshold.
    pub differing: u64,
    /// The first decision in the order of time that differs so.
    pub first: Option<ReplayedDecision>,
    /// The decision that differs most.
    pub largest: Option<ReplayedDecision>,
    /// By day of the trial: the sum of the absolute differences, and the largest.
    pub days: Vec<(u32, f64, f64)>,
}

/// A decision of a replay.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ReplayedDecision {
    /// The number of the person, from 1.
    pub person: u32,
    /// The number of the decision, from 0.
    pub step: u32,
    /// The day of the trial.
    pub day: u32,
    /// The recorded probability of the action that was taken.
    pub recorded: f64,
    /// The probability that the agent would have had.
    pub replayed: f64,
}

impl ReplayedDecisions {
    /// Adds the next decision in the order of time.
    pub fn add(&mut self, one: ReplayedDecision, threshold: f64) {
        let difference = one.difference();
        self.decisions += 1;
        if difference > threshold {
            self.differing += 1;
            self.first.get_or_insert(one);
        }
        if self.largest.is_none_or(|largest| difference > largest.difference()) {
            self.largest = Some(one);
        }
        match self.days.last_mut().filter(|(day, ..)| *day == one.day) {
            Some((_, sum, most)) => (*sum, *most) = (*sum + difference, most.max(difference)),
            None => self.days.push((one.day, difference, difference)),
        }
    }
}

impl ReplayedDecision {
    /// By how much the probabilities differ.
    pub fn difference(&self) -> f64 {
        (self.replayed - self.recorded).abs()
    }
}

/// The requested results of a completed run.
#[derive(Clone, Debug, PartialEq)]
pub struct CompletedRun {
    /// Names and values of its metrics, by name.
    pub metrics: Vec<(Arc<str>, f64)>,
    /// Training episodes finished and the mean return since the previous point; empty if not requested.
    pub curve: Vec<(u32, f64)>,
    /// Choices of action in the test; empty if not requested.
    pub actions: Vec<ActionCount>,
    /// Returns of the test episodes, by position; empty if not requested.
    pub returns: Vec<f64>,
    /// Test episodes of some participants, for each requested range.
    pub among: Vec<AmongParticipants>,
    /// The estimates of its decisions; empty if not requested.
    pub estimates: Vec<Estimates>,
    /// What was learned at the updates of a trial, by update and action; empty if not requested.
    pub posteriors: Vec<RecordedPosterior>,
    /// Decisions of some people, by person and step; empty if not requested.
    pub days: Vec<PersonDecision>,
    /// How the environment described itself; `None` if it did not, or if it was not requested.
    pub description: Option<String>,
    /// How the replay of a recorded trial differs from the record; `None` if it was not requested.
    pub replayed: Option<ReplayedDecisions>,
    /// The mean outcome of the decisions of a recorded trial; `None` if it was not requested.
    pub mean_outcome: Option<f64>,
    /// The code and the machine that produced the run.
    pub provenance: Arc<Provenance>,
    /// When the run ended, in UTC, ISO 8601 with milliseconds.
    pub ended_at: String,
    /// The duration of the run, in seconds.
    pub wall_seconds: f64,
}

impl CompletedRun {
    /// The metric of this name, if it was recorded.
    pub fn metric(&self, name: &str) -> Option<f64> {
        self.metrics.iter().find(|(known, _)| **known == *name).map(|(_, value)| *value)
    }

    /// The terms of a declared estimate, if they were requested and the run has them.
    pub fn estimate(&self, declaration: &EstimateDeclaration) -> Option<&[Estimate]> {
        let found = self.estimates.iter().find(|one| *one.declaration == *declaration);
        found.map(|estimates| &*estimates.terms)
    }
}
