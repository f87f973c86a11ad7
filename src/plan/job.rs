//! A job, its canonical form and its key.

use std::fmt;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::manifest::{Agent, DecisionRule, Environment, Evaluation, Rule, Scenario};

/// What should run: the whole content of a training with its test.
///
/// Two jobs are the same job when their canonical forms and versions are equal, whatever the
/// manifest or agent name they came from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Job {
    /// Parameters of the simulation.
    pub environment: Environment,
    /// What the agent observes.
    pub scenario: Scenario,
    /// The algorithm with its hyper-parameters, the budget among them.
    pub agent: Agent,
    /// How the trained agent is tested and its training recorded.
    pub evaluation: Evaluation,
    /// Seed of the job's random streams.
    pub seed: u64,
}

/// Versions of the code that a job's results depend on. One is raised whenever a change makes the
/// same job end in other bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Versions {
    /// Of the simulation and the random streams.
    pub environment: u32,
    /// Of the agent's algorithm.
    pub algorithm: u32,
}

impl Versions {
    /// Those up to these and other than these.
    pub fn earlier(self) -> impl Iterator<Item = Versions> {
        (1..=self.environment)
            .flat_map(move |environment| {
                (1..=self.algorithm).map(move |algorithm| Versions { environment, algorithm })
            })
            .filter(move |versions| *versions != self)
    }

    /// The key of a job whose canonical text is this, if it is run with these.
    pub fn key_of(self, canonical: &str) -> JobKey {
        let Versions { environment, algorithm } = self;
        JobKey(hash(&[&format!("jitai job e{environment} a{algorithm}\n"), canonical]))
    }
}

impl Job {
    /// The algorithm's name, as the manifest writes it.
    pub fn algorithm(&self) -> &'static str {
        self.agent.algorithm().name()
    }

    /// The versions of the code that this job would run with.
    pub fn versions(&self) -> Versions {
        Versions {
            environment: 1,
            algorithm: match &self.agent {
                Agent::DuelingDqn(_) => 2,
                Agent::Reinforce(_) => 2,
                Agent::Rule(DecisionRule { rule: Rule::Optimal, .. }) => 4,
                Agent::Rule(_) => 1,
            },
        }
    }

    /// The canonical form, from which both keys follow.
    pub fn form(&self) -> CanonicalForm {
        let (environment, evaluation) = (text(&self.environment), text(&self.evaluation));
        CanonicalForm::of(self, &text(&self.agent), &environment, &evaluation)
    }

    /// The job as one line of JSON; see [`CanonicalForm::text`].
    pub fn canonical(&self) -> String {
        self.form().text
    }

    /// See [`CanonicalForm::key`].
    pub fn key(&self) -> JobKey {
        self.form().key()
    }

    /// Every parameter as a dotted name and its value, as the view `parameter` shows them.
    pub fn parameters(&self) -> Vec<(String, Scalar)> {
        let value = serde_json::to_value(self).expect("a job holds finite numbers and string keys");
        let mut parameters = Vec::new();
        flatten("", &value, &mut parameters);
        parameters
    }
}

/// A job written out in the one way that its identity is taken from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CanonicalForm {
    text: String,
    versions: Versions,
}

impl CanonicalForm {
    /// The form of a job whose agent, environment and evaluation have these [`text`]s.
    pub(super) fn of(job: &Job, agent: &str, environment: &str, evaluation: &str) -> CanonicalForm {
        // A scenario is letters and hyphens: nothing in it needs escaping.
        let (scenario, seed) = (&job.scenario, job.seed);
        CanonicalForm {
            text: format!(
                "{{\"agent\":{agent},\"environment\":{environment},\"evaluation\":{evaluation},\
                 \"scenario\":\"{scenario}\",\"seed\":{seed}}}"
            ),
            versions: job.versions(),
        }
    }

    /// The job as one line of JSON: every parameter spelled out, keys in alphabetical order,
    /// numbers in their shortest form that reads back equal.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// The versions of the code that the job would run with.
    pub fn versions(&self) -> Versions {
        self.versions
    }

    /// Hash of the text and the versions: the identity of the job.
    pub fn key(&self) -> JobKey {
        self.key_under(self.versions)
    }

    /// The key that the same content has under other versions of the code.
    pub fn key_under(&self, versions: Versions) -> JobKey {
        versions.key_of(&self.text)
    }
}

/// The canonical text of a part of a job.
pub(super) fn text(part: &impl Serialize) -> String {
    // serde_json's map is ordered by key, which is what makes the text canonical.
    let value = serde_json::to_value(part).expect("jobs hold finite numbers and string keys");
    value.to_string()
}

/// A parameter's value as SQL can hold it.
#[derive(Clone, Debug, PartialEq)]
pub enum Scalar {
    /// A number with a fraction.
    Real(f64),
    /// A whole number; flags are 0 and 1.
    Integer(i64),
    /// A word, or a list as JSON text (`[128,128]`).
    Text(String),
}

fn flatten(prefix: &str, value: &serde_json::Value, out: &mut Vec<(String, Scalar)>) {
    use serde_json::Value as Json;
    let scalar = match value {
        Json::Object(map) => {
            for (name, inner) in map {
                let dotted =
                    if prefix.is_empty() { name.clone() } else { format!("{prefix}.{name}") };
                flatten(&dotted, inner, out);
            }
            return;
        }
        Json::Number(n) => match (n.as_i64(), n.as_f64()) {
            (Some(whole), _) => Scalar::Integer(whole),
            (None, Some(real)) => Scalar::Real(real),
            (None, None) => Scalar::Text(n.to_string()),
        },
        Json::Bool(flag) => Scalar::Integer(i64::from(*flag)),
        Json::String(text) => Scalar::Text(text.clone()),
        Json::Null | Json::Array(_) => Scalar::Text(value.to_string()),
    };
    out.push((prefix.to_owned(), scalar));
}

/// The first half of the hash of these texts, one after the other.
fn hash(texts: &[&str]) -> [u8; 16] {
    let mut hasher = Sha256::new();
    texts.iter().for_each(|text| hasher.update(text));
    let digest = hasher.finalize();
    let mut key = [0; 16];
    key.copy_from_slice(&digest[..16]);
    key
}

/// Identity of a job: the first 128 bits of a SHA-256, written as 32 hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct JobKey(pub [u8; 16]);

fn write_hex(bytes: &[u8], f: &mut fmt::Formatter<'_>) -> fmt::Result {
    bytes.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
}

impl fmt::Display for JobKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write_hex(&self.0, f)
    }
}

impl fmt::Debug for JobKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write_hex(&self.0, f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::manifest::{DuelingDqn, Reinforce};

    #[test]
    fn the_canonical_form_is_the_whole_job_with_its_keys_in_order() {
        for agent in
            [Agent::DuelingDqn(DuelingDqn::default()), Agent::Reinforce(Reinforce::default())]
        {
            let job = Job {
                environment: Environment::paper(0.6),
                scenario: "P-H-D".parse().unwrap(),
                agent,
                evaluation: Evaluation::default(),
                seed: i64::MAX as u64,
            };
            assert_eq!(job.canonical(), serde_json::to_value(&job).unwrap().to_string());
            assert_eq!(serde_json::from_str::<Job>(&job.canonical()).unwrap(), job);
        }
    }
}
