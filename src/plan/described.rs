//! Jobs by the names of their parameters.

use serde::Serialize;
use serde_json::{Value, json};

use super::{Job, PlannedJob};
use crate::manifest::{Described, Parameter, Section, Setting};

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
        let value = value_of(&self.agent, &self.job, &parameter.to_string())?;
        Some(match value {
            Value::Number(number) => Setting::Number(number.as_f64()?),
            Value::Bool(flag) => Setting::Number(f64::from(u8::from(flag))),
            Value::String(text) => Setting::Text(text),
            Value::Null | Value::Array(_) | Value::Object(_) => Setting::Text(value.to_string()),
        })
    }
}

/// The value that a job of this agent has of the parameter of this name; `None` if it has none.
pub fn value_of(agent: &str, job: &Job, name: &str) -> Option<Value> {
    let (section, key) = match name.split_once('.') {
        Some((section, key)) => (Some(section), key),
        None => (None, name),
    };
    let is_in = |known: Section| {
        section.is_none_or(|section| section == known.name()) && known.find(key).is_some()
    };
    match (section, key) {
        (None, "agent") => Some(json!(agent)),
        (None, "scenario") => Some(json!(job.scenario.to_string())),
        (None, "seed") => Some(json!(job.seed)),
        (None | Some("agent"), "algorithm") => Some(json!(job.algorithm())),
        _ if is_in(job.agent.algorithm().section()) => field(&job.agent, key),
        _ if is_in(Section::Environment) => field(&job.environment, key),
        _ if is_in(Section::Evaluation) => field(&job.evaluation, key),
        _ => None,
    }
}

fn field(part: &impl Serialize, key: &str) -> Option<Value> {
    let mut part = serde_json::to_value(part).expect("jobs hold finite numbers and string keys");
    part.get_mut(key).map(Value::take)
}

/// The value as a filter writes it.
pub fn shown(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}
