//! Short names of jobs: agent, scenario, headline key of the environment, seed, and the parameters that vary.

use serde_json::Value;

use crate::job::{Job, distinct, short_beside, shown, value_of};
use crate::key::{Parameter, printable, shortened};
use crate::manifest::{Manifest, Varying};

/// The additional parameters in which the jobs of an agent differ.
#[derive(Clone, Debug, Default)]
pub struct Swept(Varying);

impl Swept {
    /// The parameters that vary among the jobs of these manifests, because a manifest sweeps them or
    /// manifests set them differently.
    pub fn of(manifests: &[Manifest]) -> Swept {
        let headlines = headlines(manifests);
        Swept(headlines.iter().fold(Varying::of(manifests), |varying, name| varying.without(name)))
    }

    /// The distinct dotted names.
    pub fn names(&self) -> Vec<String> {
        self.0.names()
    }

    /// Whether the jobs of an agent differ in a parameter.
    pub fn is_of(&self, agent: &str, name: &str) -> bool {
        self.0.of_agent(agent).iter().any(|known| known == name)
    }

    /// A job's values with their dotted names.
    fn values(&self, agent: &str, job: &Job) -> impl Iterator<Item = (String, Value)> {
        let names = self.0.of_agent(agent).iter();
        names.filter_map(move |name| Some((name.clone(), value_of(agent, job, name)?)))
    }

    /// A job's values as readable text, such as `learning_rate=0.001 batch=32`; empty if there are no values.
    pub fn words(&self, agent: &str, job: &Job) -> String {
        let headline = job.environment.family().headline.map(Parameter::Environment);
        let fixed = [Some(Parameter::SEED), Some(Parameter::SCENARIO), headline];
        let fixed = fixed.into_iter().flatten().map(|parameter| parameter.to_string());
        let beside: Vec<String> = fixed.chain(self.0.of_agent(agent).iter().cloned()).collect();
        let words = self
            .values(agent, job)
            .map(|(name, value)| format!("{}={}", short_beside(&name, &beside), shown(&value)));
        words.collect::<Vec<_>>().join(" ")
    }

    /// A job's values as a JSON object.
    pub fn object(&self, agent: &str, job: &Job) -> Value {
        self.values(agent, job).collect()
    }

    /// The short name of a job: agent, scenario, headline key, seed, and what is swept besides.
    pub fn name(&self, agent: &str, job: &Job) -> String {
        self.named(agent, job, &format!(" seed={}", job.seed))
    }

    /// The short name of the jobs that differ from a job in their seeds alone.
    pub fn arm(&self, agent: &str, job: &Job) -> String {
        self.named(agent, job, "")
    }

    fn named(&self, agent: &str, job: &Job, seed: &str) -> String {
        let scenario = &job.scenario;
        let headline =
            job.environment.family().headline.and_then(|key| {
                Some(format!(" {key}={}", job.number(Parameter::Environment(key))?))
            });
        let headline = headline.unwrap_or_default();
        let words = shortened(&self.words(agent, job));
        let agent = printable(agent);
        format!("{agent} {scenario}{headline}{seed} {words}").trim_end().to_owned()
    }
}

/// The distinct dotted names of the headline keys of these manifests' families.
pub fn headlines(manifests: &[Manifest]) -> Vec<String> {
    let keys = manifests.iter().filter_map(|manifest| manifest.family().headline);
    distinct(keys.map(|key| Parameter::Environment(key).to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{manifest, plan};

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
    fn an_agent_s_jobs_are_distinguished_by_what_it_sweeps() {
        let manifest = manifest("one", "0.1");
        let expected = ["learning_rate=0.001", "learning_rate=0.0005"];
        assert_eq!(words(&[manifest]), [&expected[..], &expected[..], &[""]].concat());
    }

    #[test]
    fn what_manifests_set_otherwise_distinguishes_their_jobs() {
        let manifests = [manifest("one", "0.1"), manifest("other", "0.2")];
        assert_eq!(Swept::of(&manifests).names(), ["agent.learning_rate", "environment.delta_d"]);
        let words = words(&manifests);
        assert_eq!(words[0], "learning_rate=0.001 delta_d=0.1");
        assert_eq!(words.last().unwrap(), "delta_d=0.2");
    }
}
