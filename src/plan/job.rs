//! A job, its canonical form and its key.

use std::fmt;

use data_encoding::HEXLOWER;
use serde_json::{Map, Value as Json};
use sha2::{Digest, Sha256};

use crate::agent::{Agent, Algorithm, Task, Work};
use crate::env::{self, Environment, Scenario};
use crate::key::{CanonicalError, Key, Keyed, Parameter, Value, canonical_object, read_object};
use crate::manifest::Evaluation;

/// What should run: the whole content of a training with its test.
///
/// Two jobs are the same job when their canonical forms and versions are equal, whatever the
/// manifest or agent name they came from.
#[derive(Clone, Debug, PartialEq)]
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

/// Why a text is not the canonical form of a job.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum JobError {
    /// The text is not JSON.
    #[error("it is not JSON: {0}")]
    Syntax(#[from] serde_json::Error),
    /// A part is missing, of another type, or not one of a job's.
    #[error("`{0}` is missing, unknown or of another type")]
    Part(String),
    /// The algorithm is not registered.
    #[error("there is no algorithm `{0}`")]
    Algorithm(String),
    /// The keys of a part are not those of its table.
    #[error("in `{part}`: {error}")]
    Keys {
        /// The part.
        part: &'static str,
        /// What is wrong.
        error: CanonicalError,
    },
    /// The text means a job, but is not the one spelling that its key is taken from.
    #[error("its canonical form is {0}")]
    Spelling(String),
}

/// Multiply-adds that take as long as a step of the simulation.
const PER_SIMULATED_STEP: u64 = 500;

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
        Versions { environment: env::VERSION, algorithm: self.agent.version() }
    }

    /// The task that the agent learns.
    pub fn task(&self) -> Task<'_> {
        Task { environment: &self.environment, scenario: &self.scenario, seed: self.seed }
    }

    /// How much arithmetic it takes where no episode ends early, in multiply-adds.
    pub fn work(&self) -> u64 {
        let task = self.task();
        let Work { training, choice } = self.agent.work(&task);
        let (trained, tested) = (self.agent.episodes(), self.evaluation.test_episodes);
        let simulated = (task.steps(trained) + task.steps(tested)) * PER_SIMULATED_STEP;
        let chosen = task.steps(tested).saturating_mul(choice);
        training.saturating_add(simulated).saturating_add(chosen)
    }

    /// The canonical form, from which the key follows.
    pub fn form(&self) -> CanonicalForm {
        let (environment, evaluation) = (text(&self.environment), text(&self.evaluation));
        CanonicalForm::of(self, &agent_text(&self.agent), &environment, &evaluation)
    }

    /// The job as one line of JSON; see [`CanonicalForm::text`].
    pub fn canonical(&self) -> String {
        self.form().text
    }

    /// See [`CanonicalForm::key`].
    pub fn key(&self) -> JobKey {
        self.form().key()
    }

    /// The job of a canonical form, which this or an earlier version of the program wrote.
    ///
    /// **Errors**: the text is no canonical form, or names an algorithm that is not registered.
    pub fn from_canonical(text: &str) -> Result<Job, JobError> {
        let mut parts: Map<String, Json> = serde_json::from_str(text)?;
        let mut take = |part: &str| parts.remove(part);
        let part = |name: &str| JobError::Part(name.to_owned());
        let (Some(Json::Object(environment)), Some(Json::Object(evaluation))) =
            (take("environment"), take("evaluation"))
        else {
            return Err(part("environment` or `evaluation"));
        };
        let Some(Json::Object(mut agent)) = take("agent") else { return Err(part("agent")) };
        let scenario = take("scenario").and_then(|scenario| scenario.as_str()?.parse().ok());
        let seed = take("seed").and_then(|seed| seed.as_u64());
        if let Some(unknown) = parts.keys().next() {
            return Err(part(unknown));
        }
        let Some(Json::String(algorithm)) = agent.remove("algorithm") else {
            return Err(part("agent.algorithm"));
        };
        let Some(algorithm) = Algorithm::named(&algorithm) else {
            return Err(JobError::Algorithm(algorithm));
        };
        let job = Job {
            environment: read("environment", &environment)?,
            scenario: scenario.ok_or_else(|| part("scenario"))?,
            agent: Agent::with_values(algorithm, values("agent", algorithm.keys(), &agent)?)
                .ok_or_else(|| part("agent"))?,
            evaluation: read("evaluation", &evaluation)?,
            seed: seed.ok_or_else(|| part("seed"))?,
        };
        match job.canonical() {
            canonical if canonical == text => Ok(job),
            canonical => Err(JobError::Spelling(canonical)),
        }
    }

    /// The sections of the job: name, keys and their values.
    fn sections(&self) -> [(&'static str, &'static [Key], Vec<Value>); 3] {
        [
            ("agent", self.agent.algorithm().keys(), self.agent.values().to_vec()),
            ("environment", Environment::KEYS, self.environment.to_values()),
            ("evaluation", Evaluation::KEYS, self.evaluation.to_values()),
        ]
    }

    /// The value of a key; `None` for one that the job's algorithm does not have, and for scenario
    /// and seed, which are no keys.
    pub fn value(&self, parameter: Parameter) -> Option<Value> {
        let place = |keys: &[Key], name: &str| keys.iter().position(|key| key.name == name);
        let (section, name) = match parameter {
            Parameter::Agent(name) => (0, name),
            Parameter::Environment(name) => (1, name),
            Parameter::Evaluation(name) => (2, name),
            Parameter::Scenario | Parameter::Seed => return None,
        };
        let (_, keys, values) = &self.sections()[section];
        place(keys, name).map(|place| values[place].clone())
    }

    /// Every parameter as a dotted name and its value, as the view `parameter` shows them, in the
    /// order of the names.
    pub fn parameters(&self) -> Vec<(String, Scalar)> {
        let mut parameters = vec![
            ("agent.algorithm".to_owned(), Scalar::Text(self.algorithm().to_owned())),
            ("scenario".to_owned(), Scalar::Text(self.scenario.to_string())),
            ("seed".to_owned(), Scalar::Integer(self.seed as i64)),
        ];
        for (section, keys, values) in self.sections() {
            let named = keys.iter().zip(&values);
            parameters.extend(
                named.map(|(key, value)| (format!("{section}.{}", key.name), Scalar::of(value))),
            );
        }
        parameters.sort_by(|(one, _), (other, _)| one.cmp(other));
        parameters
    }
}

/// The typed struct of a part that [`text`] wrote.
fn read<T: Keyed>(part: &'static str, object: &Map<String, Json>) -> Result<T, JobError> {
    let values = values(part, T::KEYS, object)?;
    T::from_values(&values).ok_or_else(|| JobError::Part(part.to_owned()))
}

fn values(
    part: &'static str,
    keys: &[Key],
    object: &Map<String, Json>,
) -> Result<Vec<Value>, JobError> {
    read_object(keys, object).map_err(|error| JobError::Keys { part, error })
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
pub(super) fn text<T: Keyed>(part: &T) -> String {
    Json::Object(canonical_object(T::KEYS, &part.to_values())).to_string()
}

/// The canonical text of an agent.
pub(super) fn agent_text(agent: &Agent) -> String {
    let mut object = canonical_object(agent.algorithm().keys(), agent.values());
    object.insert("algorithm".to_owned(), agent.algorithm().name().into());
    Json::Object(object).to_string()
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

impl Scalar {
    /// The value of a key.
    pub fn of(value: &Value) -> Scalar {
        match value {
            Value::Real(real) => Scalar::Real(*real),
            Value::Integer(whole) => i64::try_from(*whole)
                .map_or_else(|_| Scalar::Text(whole.to_string()), Scalar::Integer),
            Value::Flag(flag) => Scalar::Integer(i64::from(*flag)),
            Value::Choice(word) => Scalar::Text((*word).to_owned()),
            Value::RealPair(_) | Value::Widths(_) => {
                let json = serde_json::to_string(value).expect("values are finite");
                Scalar::Text(json)
            }
        }
    }
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
    fmt::Display::fmt(&HEXLOWER.encode_display(bytes), f)
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
    use crate::agent::{DecisionRule, DuelingDqn, Reinforce, RuleParameters};

    fn jobs() -> Vec<Job> {
        let agents = [
            Agent::of(&DuelingDqn::default()),
            Agent::of(&Reinforce::default()),
            Agent::of(&RuleParameters::new(DecisionRule::Random)),
        ];
        let job = |agent| Job {
            environment: Environment::paper(0.6),
            scenario: "P-H-D".parse().unwrap(),
            agent,
            evaluation: Evaluation::default(),
            seed: i64::MAX as u64,
        };
        agents.map(job).into()
    }

    #[test]
    fn the_work_of_jobs_is_that_worked_by_hand() {
        // Three inputs, two layers of 128, and heads of 1 and 4; or one layer, and 4 logits.
        let (dueling, policy) = (4 * 128 + 129 * 128 + 129 * 5, 4 * 128 + 129 * 4);
        // A batch of 64 three times through the network and one row to choose; then Adam.
        let of_dqn = 50_000 * ((64 * 3 + 1 + 14) * dueling + 3500);
        // Every step once to choose and three times to learn; Adam after every episode.
        let of_reinforce = 750_000 * (4 * policy + 3500) + 15_000 * 14 * policy;
        let expected = [
            of_dqn + 500 * 100_000 + 50_000 * dueling,
            of_reinforce + 500 * 800_000 + 50_000 * policy,
            500 * 50_000 + 50_000,
        ];
        assert_eq!(jobs().iter().map(Job::work).collect::<Vec<_>>(), expected);
    }

    #[test]
    fn the_canonical_form_is_the_whole_job_with_its_keys_in_order() {
        for job in jobs() {
            let canonical = job.canonical();
            let json: Json = serde_json::from_str(&canonical).unwrap();
            assert_eq!(json.to_string(), canonical);
            assert_eq!(Job::from_canonical(&canonical).unwrap(), job);
            let members = |part: &str| json[part].as_object().unwrap().len();
            let written = Environment::KEYS.iter().filter(|key| key.before().is_none());
            assert_eq!(members("environment"), written.count());
            assert_eq!(members("agent"), job.agent.algorithm().keys().len() + 1);
        }
    }

    #[test]
    fn what_is_no_canonical_form_is_refused_with_its_reason() {
        let canonical = jobs()[1].canonical();
        let refused = |from: &str, to: &str| {
            assert!(canonical.contains(from), "{from}");
            Job::from_canonical(&canonical.replacen(from, to, 1)).unwrap_err().to_string()
        };
        assert_eq!(refused("reinforce", "sarsa"), "there is no algorithm `sarsa`");
        assert_eq!(
            refused("\"sigma\":0.6", "\"sigma\":[]"),
            "in `environment`: key `sigma` has a value of another type"
        );
        assert_eq!(refused(",\"sigma\":0.6", ""), "in `environment`: key `sigma` is missing");
        assert_eq!(refused("\"sigma\"", "\"stigma\""), "in `environment`: key `stigma` is unknown");
        assert_eq!(refused("P-H-D", "P-P"), "`scenario` is missing, unknown or of another type");
        assert_eq!(
            refused("{\"agent\"", "{\"a\":1,\"agent\""),
            "`a` is missing, unknown or of another type"
        );
        assert!(refused("}", "").starts_with("it is not JSON"));
        // Numbers that mean the same.
        let sigma = |text: &str| refused("\"sigma\":0.6", &format!("\"sigma\":{text}"));
        for spelling in ["6e-1", "0.60"] {
            assert!(sigma(spelling).starts_with("its canonical form is {\"agent\""), "{spelling}");
        }
        assert!(sigma("1").contains("\"sigma\":1.0"));
        assert!(sigma("-0.0").contains("\"sigma\":0.0"));
        // A layer that is wider than any number of the struct.
        let wide = refused("[128]", "[4294967296]");
        assert_eq!(wide, "in `agent`: key `layers` has a value of another type");
    }

    #[test]
    fn zero_has_one_sign_and_no_key_is_infinite() {
        let with = |sigma| Job { environment: Environment::paper(sigma), ..jobs().remove(0) };
        assert_eq!(with(-0.0).key(), with(0.0).key());
        let infinite = std::panic::catch_unwind(|| with(f64::INFINITY).key());
        assert!(infinite.is_err());
    }

    #[test]
    fn parameters_are_listed_once_in_the_order_of_their_names() {
        for job in jobs() {
            let parameters = job.parameters();
            assert!(parameters.is_sorted_by(|(one, _), (other, _)| one < other));
            let value =
                |name: &str| parameters.iter().find(|(known, _)| known == name).unwrap().1.clone();
            assert_eq!(value("environment.mu"), Scalar::Text("[0.1,0.1]".to_owned()));
            assert_eq!(value("environment.rho_1"), Scalar::Real(50.0));
            assert_eq!(value("environment.time_one_hot"), Scalar::Integer(0));
            assert_eq!(value("seed"), Scalar::Integer(i64::MAX));
            assert_eq!(job.value(Parameter::Environment("rho_1")), Some(Value::Real(50.0)));
            assert_eq!(job.value(Parameter::Agent("sigma")), None);
        }
    }
}
