//! A job, its canonical form and its key.

use std::fmt;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::manifest::{Agent, Environment, Evaluation, Scenario};

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
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Versions {
    /// Of the simulation and the random streams.
    pub environment: u32,
    /// Of the agent's algorithm.
    pub algorithm: u32,
}

impl Job {
    /// The algorithm's name, as the manifest writes it.
    pub fn algorithm(&self) -> &'static str {
        match self.agent {
            Agent::DuelingDqn(_) => "dueling_dqn",
            Agent::Reinforce(_) => "reinforce",
        }
    }

    /// The versions of the code that this job would run with.
    pub fn versions(&self) -> Versions {
        Versions {
            environment: 1,
            algorithm: match self.agent {
                Agent::DuelingDqn(_) => 1,
                Agent::Reinforce(_) => 1,
            },
        }
    }

    /// The job as one line of JSON: every parameter spelled out, keys in alphabetical order,
    /// numbers in their shortest form that reads back equal.
    pub fn canonical(&self) -> String {
        // serde_json's map is ordered by key, which is what makes the form canonical.
        let value = serde_json::to_value(self).expect("a job holds finite numbers and string keys");
        serde_json::to_string(&value).expect("a JSON value can be written")
    }

    /// Hash of the canonical form and the versions: the identity of the job.
    pub fn key(&self) -> JobKey {
        self.identity().key
    }

    /// The key that the same content has under other versions of the code.
    pub fn key_under(&self, versions: Versions) -> JobKey {
        JobKey::of(&self.canonical(), versions)
    }

    /// Canonical form and key, for the price of one.
    pub fn identity(&self) -> Identity {
        let canonical = self.canonical();
        Identity { key: JobKey::of(&canonical, self.versions()), canonical }
    }

    /// Every parameter as a dotted name and its value, as the view `parameter` shows them.
    pub fn parameters(&self) -> Vec<(String, Scalar)> {
        let value = serde_json::to_value(self).expect("a job holds finite numbers and string keys");
        let mut parameters = Vec::new();
        flatten("", &value, &mut parameters);
        parameters
    }
}

/// What tells a job from every other.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity {
    /// As [`Job::key`].
    pub key: JobKey,
    /// As [`Job::canonical`].
    pub canonical: String,
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

/// Identity of a job: the first 128 bits of a SHA-256, written as 32 hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct JobKey(pub [u8; 16]);

impl JobKey {
    fn of(canonical: &str, versions: Versions) -> Self {
        let Versions { environment, algorithm } = versions;
        let text = format!("jitai job e{environment} a{algorithm}\n{canonical}");
        let mut key = [0; 16];
        key.copy_from_slice(&Sha256::digest(text.as_bytes())[..16]);
        JobKey(key)
    }
}

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
