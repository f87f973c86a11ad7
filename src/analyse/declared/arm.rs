//! Arms: jobs that differ in their seed alone, and the parameters that distinguish them.

use std::collections::{HashMap, HashSet};

use crate::analyse::{Sample, lower_quartile};
use crate::manifest::{Condition, Setting, Varying};
use crate::record::{JobRecord, JobStatus};

/// What distinguishes an arm from the others of its analysis.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmId {
    /// Agent's name in the manifest.
    pub agent: String,
    /// Scenario, like `P-H-D`.
    pub scenario: String,
    /// Parameters that differ between the arms of the analysis: dotted name and value.
    pub settings: Vec<(String, Setting)>,
}

/// The jobs of an arm.
#[derive(Clone, Debug)]
pub struct Arm<'j> {
    /// What distinguishes it from the others.
    pub name: ArmId,
    /// Its jobs, in the manifest's order.
    pub jobs: Vec<&'j JobRecord>,
}

impl Arm<'_> {
    /// The metric of its seeds. A seed that comes twice is taken once: its jobs are one job that
    /// two agents of equal content share.
    pub fn sample(&self, metric: &str) -> Sample {
        let mut seen = HashSet::new();
        let (mut values, mut failed, mut open) = (Vec::new(), 0, 0);
        for job in &self.jobs {
            if !seen.insert(job.seed) {
                continue;
            }
            match &job.status {
                // One that completed without this metric is lost as one that is not finite.
                JobStatus::Completed(_) => {
                    values.push((job.seed, value(job, metric).unwrap_or(f64::NAN)));
                }
                JobStatus::Failed(_) => failed += 1,
                JobStatus::Pending | JobStatus::Interrupted | JobStatus::Running => open += 1,
            }
        }
        Sample::new(values, failed, open).expect("every seed is taken once")
    }

    /// The best mean return that any policy can reach where the arm is, if it is known.
    pub fn optimum(&self) -> Option<f64> {
        self.jobs.iter().find_map(|job| job.optimum)
    }
}

/// Messages sent in a test episode, on average: the product of two recorded metrics.
pub const MESSAGES: &str = "messages_per_episode";

/// A completed job's value of a metric.
pub fn value(job: &JobRecord, metric: &str) -> Option<f64> {
    let run = job.completed()?;
    match metric {
        "lower_quartile_return" => lower_quartile(&run.returns).ok(),
        MESSAGES => Some(run.metric("message_rate")? * run.metric("mean_length")?),
        recorded => run.metric(recorded),
    }
}

/// An arm's name without what its side decides.
pub fn shared(side: &Condition, name: ArmId) -> ArmId {
    match side {
        Condition::Scenario(_) => ArmId { scenario: String::new(), ..name },
        Condition::AgentName(_) => ArmId { agent: String::new(), ..name },
        Condition::Seed(_) | Condition::Key { .. } => name,
    }
}

/// Whether a job matches a row's name; an empty word matches any.
pub fn is_at(job: &JobRecord, name: &ArmId) -> bool {
    let is = |wanted: &str, found: &str| wanted.is_empty() || wanted == found;
    let set = |(key, value): &(String, Setting)| job.setting(key) == Some(value);
    is(&name.agent, &job.agent)
        && is(&name.scenario, &job.scenario)
        && name.settings.iter().all(set)
}

/// The parameters that differ between jobs of one agent, by name.
pub fn varying(jobs: &[&JobRecord]) -> Vec<String> {
    let values = jobs.iter().flat_map(|job| {
        job.settings.iter().map(|(name, value)| (job.agent.as_str(), name.as_str(), value))
    });
    let mut names = Varying::among(values).names();
    names.sort();
    names
}

/// The arms of some jobs, in the order in which they first appear. `aside` are parameters that do
/// not tell arms apart.
pub fn arms<'j>(jobs: &[&'j JobRecord], aside: &[&str]) -> Vec<Arm<'j>> {
    let mut names = varying(jobs);
    names.retain(|name| !aside.contains(&name.as_str()));
    let mut arms: Vec<Arm<'j>> = Vec::new();
    let mut places = HashMap::new();
    for job in jobs {
        let settings = names.iter().filter_map(|name| Some((name.clone(), job.setting(name)?)));
        let name = ArmId {
            agent: job.agent.clone(),
            scenario: job.scenario.clone(),
            settings: settings.map(|(name, value)| (name, value.clone())).collect(),
        };
        let place = *places.entry(format!("{name:?}")).or_insert(arms.len());
        match arms.get_mut(place) {
            Some(arm) => arm.jobs.push(job),
            None => arms.push(Arm { name, jobs: vec![job] }),
        }
    }
    arms
}

/// Numbers in ascending order, none twice.
pub fn distinct(mut numbers: Vec<f64>) -> Vec<f64> {
    numbers.sort_by(f64::total_cmp);
    numbers.dedup();
    numbers
}
