//! Access to the parameters of jobs by name.

use serde_json::{Value, json};

use super::{Job, PlannedJob};
use crate::key::{Key, Parameter};
use crate::manifest::{Described, Section, Setting};

impl Described for PlannedJob {
    fn agent_name(&self) -> &str {
        &self.agent
    }

    fn scenario_name(&self) -> String {
        self.job.scenario.to_string()
    }

    fn seed(&self) -> u64 {
        self.job.seed
    }

    fn key(&self, parameter: Parameter) -> Option<Setting> {
        match parameter {
            Parameter::Agent("algorithm") => Some(Setting::Text(self.job.algorithm().to_owned())),
            _ => self.job.value(parameter).as_ref().map(Setting::from),
        }
    }
}

/// The value of a named parameter in a job of this agent; `None` if the job lacks it.
pub fn value_of(agent: &str, job: &Job, name: &str) -> Option<Value> {
    let (section, key) = match name.split_once('.') {
        // The parameter of an outside program, without its section.
        Some(("parameters", _)) => (None, name),
        Some((section, key)) => (Some(section), key),
        None => (None, name),
    };
    let is_in = |known: Section| {
        let (_, Key { name, .. }) = known.find(key)?;
        section.is_none_or(|section| section == known.name()).then(|| known.parameter(name))
    };
    match (section, key) {
        (None, "agent") => Some(json!(agent)),
        (None, "scenario") => Some(json!(job.scenario.to_string())),
        (None, "seed") => Some(json!(job.seed)),
        (None | Some("agent"), "algorithm") => Some(json!(job.algorithm())),
        _ => {
            let agent = Section::Agent(job.agent.algorithm());
            let known = [agent, Section::Environment, Section::Population, Section::Evaluation];
            let free = || {
                let (_, Key { name, .. }) = agent.find(&format!("parameters.{key}"))?;
                section.is_none().then_some(Parameter::Agent(name))
            };
            let parameter = known.into_iter().find_map(is_in).or_else(free)?;
            job.value(parameter).map(|value| json!(value))
        }
    }
}

/// The value, as a filter writes it.
pub fn shown(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
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
