//! What tells the jobs of manifests apart beyond agent, scenario, sigma and seed.

use std::collections::{BTreeMap, HashMap};

use serde_json::Value;

use crate::cli::filter::{last_part, shown, value_of};
use crate::cli::output::{Cell, Format, printable};
use crate::key::{self, Parameter};
use crate::manifest::{Manifest, Parameters};
use crate::plan::Job;
use crate::store::FailedJob;

/// The further parameters in which the jobs of an agent differ, by the agent's name.
#[derive(Clone, Debug, Default)]
pub(super) struct Swept(BTreeMap<String, Vec<Parameter>>);

impl Swept {
    /// Those of the jobs of some manifests: swept by one, or set otherwise by another.
    pub(super) fn of(manifests: &[Manifest]) -> Self {
        let mut first = HashMap::new();
        let mut swept = Swept::default();
        for manifest in manifests {
            for agent in &manifest.agents {
                let ours = swept.0.entry(agent.name.clone()).or_default();
                for (parameter, values) in keys(manifest, &agent.parameters) {
                    let first = first.entry((&agent.name, parameter)).or_insert(&values[0]);
                    if values.iter().any(|value| value != *first) && !ours.contains(&parameter) {
                        ours.push(parameter);
                    }
                }
            }
        }
        swept
    }

    /// The dotted names, none twice.
    pub(super) fn names(&self) -> Vec<String> {
        let mut names = Vec::new();
        for name in self.0.values().flatten().map(ToString::to_string) {
            if !names.contains(&name) {
                names.push(name);
            }
        }
        names
    }

    /// A job's values with their dotted names.
    pub(super) fn values(&self, agent: &str, job: &Job) -> Vec<(String, Value)> {
        let swept = self.0.get(agent).into_iter().flatten().map(ToString::to_string);
        swept.filter_map(|name| value_of(agent, job, &name).map(|value| (name, value))).collect()
    }

    /// A job's values as text, with their dotted names.
    pub(super) fn texts(&self, agent: &str, job: &Job) -> Vec<(String, String)> {
        let values = self.values(agent, job).into_iter();
        values.map(|(name, value)| (name, shown(&value))).collect()
    }

    /// A job's values for reading, such as `learning_rate=0.001 batch=32`; empty if there are none.
    pub(super) fn words(&self, agent: &str, job: &Job) -> String {
        let word = |(name, text): &(String, String)| format!("{}={text}", last_part(name));
        self.texts(agent, job).iter().map(word).collect::<Vec<_>>().join(" ")
    }

    /// A job's values as a cell: an object in JSON, words elsewhere.
    pub(super) fn cell(&self, format: Format, agent: &str, job: &Job) -> Cell<'static> {
        match format {
            Format::Json => Cell::Nested(self.object(agent, job)),
            Format::Table | Format::Csv => Cell::text(self.words(agent, job)),
        }
    }

    /// A job's values as an object for programs.
    pub(super) fn object(&self, agent: &str, job: &Job) -> Value {
        self.values(agent, job).into_iter().collect()
    }

    /// A job as people tell it from others, such as `dqn P-H-D sigma=0.4 seed=1 batch=32`.
    pub(super) fn name(&self, agent: &str, job: &Job) -> String {
        let (scenario, sigma, seed) = (&job.scenario, job.environment.sigma, job.seed);
        let words = self.words(agent, job);
        let agent = printable(agent);
        format!("{agent} {scenario} sigma={sigma} seed={seed} {words}").trim_end().to_owned()
    }

    /// A failed job as people tell it from others; its agent alone if its content is not readable.
    pub(super) fn name_of_failed(&self, failed: &FailedJob) -> String {
        match &failed.job {
            Some(job) => self.name(&failed.agent, job),
            None => printable(&failed.agent),
        }
    }
}

/// The keys of an agent's jobs with their values, sigma not among them.
fn keys<'m>(
    manifest: &'m Manifest,
    agent: &'m Parameters,
) -> impl Iterator<Item = (Parameter, &'m [key::Value])> {
    let sections = [&manifest.environment, agent, &manifest.evaluation].into_iter();
    let keys = sections.flat_map(|parameters| {
        let section = parameters.section();
        parameters.iter().map(move |(key, values)| (section.parameter(key.name), values))
    });
    keys.filter(|(parameter, _)| *parameter != Parameter::Environment("sigma"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::manifest;
    use crate::plan;

    fn manifest(name: &str, delta_d: &str) -> Manifest {
        let text = format!(
            "format = 1\nname = \"{name}\"\nscenarios = [\"P-H-D\"]\nseeds = 2\n\
             environment.sigma = [0.4, 0.6]\nenvironment.delta_d = {delta_d}\n\
             [[agent]]\nname = \"a\"\nalgorithm = \"dueling_dqn\"\nlearning_rate = [1e-3, 5e-4]\n\
             [[agent]]\nname = \"b\"\nalgorithm = \"reinforce\"\n"
        );
        manifest::parse("test", text.as_bytes()).unwrap()
    }

    fn words(manifests: &[Manifest]) -> Vec<String> {
        let swept = Swept::of(manifests);
        let mut words: Vec<String> = manifests
            .iter()
            .flat_map(plan::jobs)
            .map(|planned| swept.words(&planned.agent, &planned.job))
            .collect();
        words.dedup();
        words
    }

    #[test]
    fn an_agent_s_jobs_are_told_apart_by_what_it_sweeps() {
        let manifest = manifest("one", "0.1");
        let expected = ["learning_rate=0.001", "learning_rate=0.0005"];
        assert_eq!(words(&[manifest]), [&expected[..], &expected[..], &[""]].concat());
    }

    #[test]
    fn what_manifests_set_otherwise_tells_their_jobs_apart() {
        let manifests = [manifest("one", "0.1"), manifest("other", "0.2")];
        assert_eq!(Swept::of(&manifests).names(), ["agent.learning_rate", "environment.delta_d"]);
        let words = words(&manifests);
        assert_eq!(words[0], "learning_rate=0.001 delta_d=0.1");
        assert_eq!(words.last().unwrap(), "delta_d=0.2");
    }
}
