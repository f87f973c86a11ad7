//! A job with its parameters, status and results.

use super::{ActionCount, Failure, JobKey, Provenance};
use crate::key::Parameter;
use crate::manifest::{Described, Setting};
use crate::plan::{PlannedJob, Scalar};

/// A job of an experiment with its status.
#[derive(Clone, Debug, PartialEq)]
pub struct JobRecord {
    /// Identity of the job.
    pub job_key: JobKey,
    /// Agent's name in the manifest.
    pub agent: String,
    /// Scenario, like `P-H-D`.
    pub scenario: String,
    /// Seed.
    pub seed: u64,
    /// Whether its algorithm learns, so that a completed run has a learning curve.
    pub learns: bool,
    /// Every other parameter: dotted name and value, by name.
    pub settings: Vec<(String, Setting)>,
    /// The best mean return that any policy can reach in its environment and scenario, in steps
    /// walked, where that is known.
    pub optimum: Option<f64>,
    /// Its status.
    pub status: JobStatus,
}

impl JobRecord {
    /// A planned job that came so far; its optimum is not known.
    pub fn new(planned: &PlannedJob, job_key: JobKey, status: JobStatus) -> JobRecord {
        JobRecord {
            job_key,
            agent: planned.agent.to_string(),
            scenario: planned.job.scenario.to_string(),
            seed: planned.job.seed,
            learns: planned.job.agent.algorithm().learns(),
            settings: settings(planned),
            optimum: None,
            status,
        }
    }

    /// The value of the parameter of this dotted name, if the job has it.
    pub fn setting(&self, name: &str) -> Option<&Setting> {
        let place = self.settings.binary_search_by(|(known, _)| known.as_str().cmp(name)).ok()?;
        Some(&self.settings[place].1)
    }

    /// The number that the parameter of this dotted name has, if it has one.
    pub fn number(&self, name: &str) -> Option<f64> {
        match self.setting(name)? {
            Setting::Number(number) => Some(*number),
            Setting::Text(_) => None,
        }
    }

    /// Its completed run, if it has one.
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
    fn agent_name(&self) -> &str {
        &self.agent
    }

    fn scenario_name(&self) -> String {
        self.scenario.clone()
    }

    fn seed(&self) -> u64 {
        self.seed
    }

    fn key(&self, parameter: Parameter) -> Option<Setting> {
        self.setting(&parameter.to_string()).cloned()
    }
}

/// Every parameter of a job but scenario and seed, by name.
fn settings(planned: &PlannedJob) -> Vec<(String, Setting)> {
    let named = planned.job.parameters().into_iter();
    let others = named.filter(|(name, _)| name != "scenario" && name != "seed");
    let mut settings: Vec<(String, Setting)> = others
        .map(|(name, value)| match value {
            Scalar::Real(real) => (name, Setting::Number(real)),
            Scalar::Integer(whole) => (name, Setting::Number(whole as f64)),
            Scalar::Text(text) => (name, Setting::Text(text)),
        })
        .collect();
    settings.sort_by(|one, other| one.0.cmp(&other.0));
    settings
}

/// The jobs of an experiment with everything that is known of them: what reports are made of.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DataSet {
    /// The experiment's name.
    pub experiment: String,
    /// Its jobs, in the manifest's order.
    pub jobs: Vec<JobRecord>,
}

/// The status of a job, with what it left behind.
#[derive(Clone, Debug, PartialEq)]
pub enum JobStatus {
    /// It has no run.
    Pending,
    /// Its runs were interrupted.
    Interrupted,
    /// A living process runs it.
    Running,
    /// Its last run failed.
    Failed(Failure),
    /// It has its one completed run.
    Completed(Box<CompletedRun>),
}

/// The results of a completed run, as far as the reader asked for them.
#[derive(Clone, Debug, PartialEq)]
pub struct CompletedRun {
    /// Names and values of its metrics, by name.
    pub metrics: Vec<(String, f64)>,
    /// Training episodes finished and mean return since the point before; empty if not asked for.
    pub curve: Vec<(u32, f64)>,
    /// Choices of action in the test; empty if not asked for.
    pub actions: Vec<ActionCount>,
    /// Returns of the test episodes, by position; empty if not asked for.
    pub returns: Vec<f64>,
    /// What made it.
    pub provenance: Provenance,
    /// When it ended, in UTC, ISO 8601 with milliseconds.
    pub ended_at: String,
    /// Time it took, in seconds.
    pub wall_seconds: f64,
}

impl CompletedRun {
    /// The metric of this name, if it was recorded.
    pub fn metric(&self, name: &str) -> Option<f64> {
        self.metrics.iter().find(|(known, _)| known == name).map(|(_, value)| *value)
    }
}
