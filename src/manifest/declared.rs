//! A manifest after validation: what its author declared, complete and consistent.

use super::analysis::Analysis;
use super::condition::Condition;
use super::parameter::Parameters;
use crate::agent::Algorithm;
use crate::env::Scenario;
use crate::key::{Parameter, Value};

/// A validated manifest: every default filled in, every cell of its grids a possible job.
///
/// Made by [`super::load`] and [`super::parse`] alone; changing its fields voids the validation.
#[derive(Clone, Debug, PartialEq)]
pub struct Manifest {
    /// The file it was read from, as the user named it.
    pub path: String,
    /// The text it was read from.
    pub source: String,
    /// The experiment's name.
    pub name: String,
    /// What the experiment asks, in prose.
    pub question: Option<String>,
    /// What its author expects, in prose.
    pub hypothesis: Option<String>,
    /// The file of published numbers to compare with, relative to the manifest.
    pub published: Option<String>,
    /// Seconds that a job may take before it has failed; no part of any job.
    pub time_limit_seconds: Option<u64>,
    /// The scenarios, none twice, at least one.
    pub scenarios: Vec<Scenario>,
    /// The seeds, none twice, at least one.
    pub seeds: Vec<u64>,
    /// The environment's parameters.
    pub environment: Parameters,
    /// The agents, their names distinct, at least one.
    pub agents: Vec<DeclaredAgent>,
    /// The parameters of testing and recording.
    pub evaluation: Parameters,
    /// Swept parameters that advance together.
    pub zips: Vec<Zip>,
    /// Cells of the grids that are left out.
    pub exclusions: Vec<Exclusion>,
    /// What the report computes from the results; no part of any job.
    pub analyses: Vec<Analysis>,
}

/// An agent of a manifest: a name and the values of its hyper-parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct DeclaredAgent {
    /// The name that tables and figures show.
    pub name: String,
    /// The algorithm.
    pub algorithm: &'static Algorithm,
    /// The algorithm's hyper-parameters.
    pub parameters: Parameters,
}

/// Parameters whose lists have one length and advance together, as one axis of the grid.
///
/// A zip that names keys of agents concerns the agents that sweep all of those keys; the others
/// sweep what they sweep on axes of their own.
#[derive(Clone, Debug, PartialEq)]
pub struct Zip {
    /// At least two parameters, in no other zip.
    pub parameters: Vec<Parameter>,
}

/// Cells to leave out: those that meet every condition.
#[derive(Clone, Debug, PartialEq)]
pub struct Exclusion {
    /// At least one condition.
    pub conditions: Vec<Condition>,
}

impl Manifest {
    /// The values that `parameter` takes for `agent`: how many, 0 if the agent has no such key.
    pub(super) fn length(&self, agent: &DeclaredAgent, parameter: Parameter) -> usize {
        match parameter {
            Parameter::Scenario => self.scenarios.len(),
            Parameter::Seed => self.seeds.len(),
            Parameter::Environment(_) | Parameter::Agent(_) | Parameter::Evaluation(_) => {
                self.values(agent, parameter).map_or(0, <[Value]>::len)
            }
        }
    }

    /// The values of a key for `agent`; `None` for what is no key, or not one of the agent.
    pub(super) fn values<'m>(
        &'m self,
        agent: &'m DeclaredAgent,
        parameter: Parameter,
    ) -> Option<&'m [Value]> {
        match parameter {
            Parameter::Scenario | Parameter::Seed => None,
            Parameter::Environment(key) => self.environment.get(key),
            Parameter::Agent(key) => agent.parameters.get(key),
            Parameter::Evaluation(key) => self.evaluation.get(key),
        }
    }

    /// The keys of `agent`'s jobs that are swept, in the order of the tables.
    pub(super) fn swept_keys(&self, agent: &DeclaredAgent) -> Vec<Parameter> {
        let sections = [&self.environment, &agent.parameters, &self.evaluation];
        let swept = |parameters: &Parameters| -> Vec<Parameter> {
            let keys = parameters.iter().filter(|(_, values)| values.len() > 1);
            keys.map(|(key, _)| parameters.section().parameter(key.name)).collect()
        };
        sections.into_iter().flat_map(swept).collect()
    }
}
