//! Jobs with the name of their agent, and access to their parameters by name.

use std::sync::Arc;

use serde_json::{Value as Json, json};

use super::{CanonicalForm, Described, Job, Scalar};
use crate::key::{Key, Parameter, Value};

/// A job with the name of its agent in the manifest; the name is not part of the job.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannedJob {
    /// The agent's name.
    pub agent: Arc<str>,
    /// The job.
    pub job: Job,
    /// The job's canonical form.
    pub form: CanonicalForm,
}

impl Described for PlannedJob {
    fn value(&self, parameter: Parameter) -> Option<Scalar> {
        (&*self.agent, &self.job).value(parameter)
    }
}

/// A job with the name of its agent.
impl Described for (&str, &Job) {
    fn value(&self, parameter: Parameter) -> Option<Scalar> {
        let (agent, job) = self;
        match parameter {
            Parameter::AGENT_NAME => Some(Scalar::Text((*agent).to_owned())),
            _ => job.value(parameter).as_ref().map(Scalar::from),
        }
    }
}

/// The value of a named parameter in a job of this agent; `None` if the job lacks it. The section of a key
/// and the prefix of a parameter of an outside program may be omitted.
pub fn value_of(agent: &str, job: &Job, name: &str) -> Option<Json> {
    let parameter = match name {
        "agent" => return Some(json!(agent)),
        "scenario" => Parameter::SCENARIO,
        "seed" => Parameter::SEED,
        "algorithm" | "agent.algorithm" => Parameter::ALGORITHM,
        _ => return key_of(job, name).map(|value| json!(value)),
    };
    job.value(parameter).map(|value| json!(value))
}

fn key_of(job: &Job, name: &str) -> Option<Value> {
    let sections = job.sections();
    let find = |is_meant: &dyn Fn(&str, &str) -> bool| {
        sections.iter().find_map(|(section, keys, values)| {
            let mut named = keys.iter().zip(values);
            let is_meant = |key: &Key| is_meant(section.word(), key.name);
            named.find(|(key, _)| is_meant(key)).map(|(_, value)| value.clone())
        })
    };
    let is_key = |section: &str, key: &str| {
        let dotted = name.strip_prefix(section).and_then(|rest| rest.strip_prefix('.'));
        name == key || dotted == Some(key)
    };
    let is_free = |_: &str, key: &str| key.strip_prefix("parameters.") == Some(name);
    find(&is_key).or_else(|| find(&is_free))
}

/// The value, as a filter writes it.
pub fn shown(value: &Json) -> String {
    match value {
        Json::String(text) => text.clone(),
        Json::Number(number) if number.is_f64() => number
            .as_f64()
            .map_or_else(|| number.to_string(), |real| Scalar::Real(real).to_string()),
        other => other.to_string(),
    }
}

/// A number with its noun: `1 job`, `2 jobs`.
pub fn counted(count: impl TryInto<u64>, noun: &str) -> String {
    match count.try_into().unwrap_or(u64::MAX) {
        1 => format!("1 {noun}"),
        count => format!("{count} {noun}s"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn things_are_counted_as_people_say_it() {
        assert_eq!([0, 1, 2].map(|n| counted(n, "job")), ["0 jobs", "1 job", "2 jobs"]);
    }
}
