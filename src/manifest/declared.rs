//! A validated manifest: complete and consistent.

use std::path::Path;
use std::sync::Arc;

use crate::agent::Algorithm;
use crate::env::{Family, Scenario};
use crate::job::{Condition, EstimateDeclaration, distinct};
use crate::key::{Parameter, SectionName, Value};
use crate::manifest::analysis::declared::Analysis;
use crate::manifest::estimate::declared::DeclaredEstimate;
use crate::manifest::parameter::{Parameters, scenario_of, seed_of};
use crate::manifest::search::declared::Search;
use crate::manifest::search::draw::Draw;
use crate::manifest::section::SharedSections;

/// A validated manifest: every default filled in, every cell of its grids a possible job.
///
/// Only [`super::load`] and [`super::parse`] make it; changing its fields voids the validation.
#[derive(Clone, Debug, PartialEq)]
pub struct Manifest {
    /// The file it was read from, as the user named it.
    pub path: String,
    /// The text it was read from.
    pub source: String,
    /// The experiment's name.
    pub name: String,
    /// The question of the experiment, in prose.
    pub question: Option<String>,
    /// The expected result, in prose.
    pub hypothesis: Option<String>,
    /// The file of published numbers to compare with, relative to the manifest.
    pub published: Option<String>,
    /// Time limit of a job in seconds, after which it fails; not part of any job.
    pub time_limit_seconds: Option<u64>,
    /// The distinct scenarios, as texts; at least one.
    pub(super) scenarios: Vec<Value>,
    /// The distinct seeds; at least one.
    pub(super) seeds: Vec<Value>,
    /// The parameters of the sections that agents share; none of a trial that the manifest does not declare.
    pub sections: SharedSections<Parameters>,
    /// The agents, with distinct names; at least one.
    pub agents: Vec<DeclaredAgent>,
    /// The search for the best of drawn settings; `None` if no key is drawn.
    pub search: Option<Search>,
    /// Swept parameters that advance together.
    pub zips: Vec<Zip>,
    /// Excluded cells of the grids.
    pub exclusions: Vec<Exclusion>,
    /// Estimates of causal effects from the decisions of jobs; not part of any job.
    pub estimates: Vec<DeclaredEstimate>,
    /// Analyses for the report; not part of any job.
    pub analyses: Vec<Analysis>,
    /// The values that name jobs of a store, each with the text of the job's policy.
    pub named_runs: Vec<(String, String)>,
}

/// An agent of a manifest: a name and the values of its hyper-parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct DeclaredAgent {
    /// Its name, in the store and in tables as CSV.
    pub name: String,
    /// The name as the value of a condition.
    pub(super) names: [Value; 1],
    /// The name in figures and tables for readers; the agent's name if `None`.
    pub label: Option<String>,
    /// The algorithm.
    pub algorithm: &'static Algorithm,
    /// The algorithm's hyper-parameters.
    pub parameters: Parameters,
    /// The keys that a search draws. Their lists of values have equal lengths and are the arms of its race.
    pub draws: Vec<(Parameter, Draw)>,
}

/// Parameters whose lists have equal lengths and advance together, as one axis of the grid.
///
/// A zip that names keys of agents applies to the agents that sweep all of these keys. Other agents
/// sweep the zip's parameters on separate axes.
#[derive(Clone, Debug, PartialEq)]
pub struct Zip {
    /// At least two parameters, none of which is in another zip.
    pub parameters: Vec<Parameter>,
}

/// Excluded cells: those that meet every condition.
#[derive(Clone, Debug, PartialEq)]
pub struct Exclusion {
    /// At least one condition.
    pub conditions: Vec<Condition>,
}

impl Manifest {
    /// The folder of its file.
    pub fn folder(&self) -> &Path {
        Path::new(&self.path).parent().unwrap_or(Path::new(""))
    }

    /// The unit of the return in its environment.
    pub fn return_unit(&self) -> &'static str {
        self.family().return_unit
    }

    /// The family of its environment.
    pub fn family(&self) -> &'static Family {
        let environment = &self.sections[SectionName::Environment];
        environment.section().family().unwrap_or(Family::first())
    }

    /// The digests of files whose contents are values, with the names of the files, unless others have the same name.
    pub fn file_labels(&self) -> Vec<(String, String)> {
        let shared = self.sections.iter().flat_map(|(_, parameters)| parameters.iter());
        let own = self.agents.iter().flat_map(|agent| agent.parameters.iter());
        let values = shared.chain(own).flat_map(|(_, values)| values);
        let label = |value: &Value| match value {
            Value::Content(content) => content.digest_and_file(),
            _ => None,
        };
        let all = distinct(values.filter_map(label));
        let is_own = |(_, label): &&(String, String)| {
            all.iter().filter(|(_, other)| other == label).count() == 1
        };
        all.iter().filter(is_own).cloned().collect()
    }

    /// Whether the manifest declares a trial.
    pub fn has_trial(&self) -> bool {
        self.sections[SectionName::Trial].section().is_declared()
    }

    /// The parameters of a section of an agent's jobs.
    pub fn parameters<'m>(
        &'m self,
        agent: &'m DeclaredAgent,
        section: SectionName,
    ) -> &'m Parameters {
        match section {
            SectionName::Agent => &agent.parameters,
            shared => &self.sections[shared],
        }
    }

    /// The scenarios, in the order of the manifest.
    pub fn scenarios(&self) -> impl Iterator<Item = Scenario> {
        self.scenarios.iter().map(scenario_of)
    }

    /// The seeds, in the order of the manifest.
    pub fn seeds(&self) -> impl Iterator<Item = u64> {
        self.seeds.iter().map(seed_of)
    }

    /// The estimates of the jobs of an agent.
    pub fn estimates_of(&self, agent: &str) -> Vec<Arc<EstimateDeclaration>> {
        let is_of = |one: &&DeclaredEstimate| {
            one.agents.as_ref().is_none_or(|agents| agents.iter().any(|name| name == agent))
        };
        self.estimates.iter().filter(is_of).map(|one| one.declaration.clone()).collect()
    }

    /// The number of values that `parameter` takes for `agent`; 0 if the agent has no such key.
    pub(super) fn length(&self, agent: &DeclaredAgent, parameter: Parameter) -> usize {
        self.values(agent, parameter).map_or(0, <[Value]>::len)
    }

    /// The values of a parameter for `agent`; `None` if the agent has no such key.
    pub(super) fn values<'m>(
        &'m self,
        agent: &'m DeclaredAgent,
        parameter: Parameter,
    ) -> Option<&'m [Value]> {
        match parameter {
            Parameter::SCENARIO => Some(&self.scenarios),
            Parameter::SEED => Some(&self.seeds),
            Parameter::AGENT_NAME => Some(&agent.names),
            of_section => self.parameters(agent, of_section.section()?).get(of_section.key()),
        }
    }

    /// The keys of `agent`'s jobs that are swept, in the order of the tables.
    pub(super) fn swept_keys(&self, agent: &DeclaredAgent) -> Vec<Parameter> {
        let swept = |parameters: &Parameters| -> Vec<Parameter> {
            let keys = parameters.iter().filter(|(_, values)| values.len() > 1);
            keys.map(|(key, _)| parameters.section().parameter(key.name)).collect()
        };
        SectionName::ALL.into_iter().flat_map(|one| swept(self.parameters(agent, one))).collect()
    }
}

/// Two manifests of the same name, as a message: they would be one experiment, and one would replace the other.
pub fn same_name<'a>(manifests: impl IntoIterator<Item = &'a Manifest>) -> Option<String> {
    let mut seen: Vec<&Manifest> = Vec::new();
    for manifest in manifests {
        if let Some(other) = seen.iter().find(|other| other.name == manifest.name) {
            return Some(format!(
                "{} and {} have the same name, {:?}; give each experiment a name of its own",
                other.path, manifest.path, manifest.name
            ));
        }
        seen.push(manifest);
    }
    None
}
