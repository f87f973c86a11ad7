//! Conditions on jobs, as exclusions, analyses and filters state them, and the trait for what they test.

use std::fmt;

use super::written::{list, quoted};
use crate::env::Scenario;
use crate::key::{Parameter, Value};

/// A condition on a job: the parameter has one of the values.
#[derive(Clone, Debug, PartialEq)]
pub enum Condition {
    /// On the scenario.
    Scenario(Vec<Scenario>),
    /// On the seed.
    Seed(Vec<u64>),
    /// On the agent's name.
    AgentName(Vec<String>),
    /// On a key; agents without the key do not meet it.
    Key {
        /// The key's dotted name.
        parameter: Parameter,
        /// The values that meet the condition.
        values: Vec<Value>,
    },
}

/// A parameter's value, as a job has it.
#[derive(Clone, Debug, PartialEq)]
pub enum Setting {
    /// A number; flags are 0 and 1.
    Number(f64),
    /// A word, or a list as JSON text (`[128,128]`).
    Text(String),
}

/// The subject of conditions: a job and the name of its agent.
pub trait Described {
    /// The agent's name in the manifest.
    fn agent_name(&self) -> &str;
    /// The scenario, like `P-H-D`.
    fn scenario_name(&self) -> String;
    /// The seed.
    fn seed(&self) -> u64;
    /// The value of a key; `None` if the job has no such key.
    fn key(&self, parameter: Parameter) -> Option<Setting>;
}

impl<T: Described> Described for &T {
    fn agent_name(&self) -> &str {
        (**self).agent_name()
    }

    fn scenario_name(&self) -> String {
        (**self).scenario_name()
    }

    fn seed(&self) -> u64 {
        (**self).seed()
    }

    fn key(&self, parameter: Parameter) -> Option<Setting> {
        (**self).key(parameter)
    }
}

impl Condition {
    /// Whether a job meets the condition.
    pub fn is_met_by(&self, job: &impl Described) -> bool {
        match self {
            Condition::Scenario(list) => {
                let found = job.scenario_name();
                list.iter().any(|scenario| scenario.to_string() == found)
            }
            Condition::Seed(list) => list.contains(&job.seed()),
            Condition::AgentName(list) => list.iter().any(|name| name == job.agent_name()),
            Condition::Key { parameter, values } => job
                .key(*parameter)
                .is_some_and(|found| values.iter().any(|value| Setting::from(value) == found)),
        }
    }

    /// The dotted name of the parameter.
    pub fn name(&self) -> String {
        match self {
            Condition::Scenario(_) => "scenario".to_owned(),
            Condition::Seed(_) => "seed".to_owned(),
            Condition::AgentName(_) => "agent.name".to_owned(),
            Condition::Key { parameter, .. } => parameter.to_string(),
        }
    }

    /// The values that meet the condition, as jobs have them.
    pub fn settings(&self) -> Vec<Setting> {
        match self {
            Condition::Scenario(list) => {
                list.iter().map(|one| Setting::Text(one.to_string())).collect()
            }
            Condition::Seed(list) => {
                list.iter().map(|seed| Setting::Number(*seed as f64)).collect()
            }
            Condition::AgentName(list) => list.iter().cloned().map(Setting::Text).collect(),
            Condition::Key { values, .. } => values.iter().map(Setting::from).collect(),
        }
    }

    /// The condition as a manifest writes it: `scenario = ["P-T"]`.
    pub(super) fn written(&self) -> String {
        let values = match self {
            Condition::Scenario(scenarios) => {
                list(&scenarios.iter().map(quoted).collect::<Vec<_>>())
            }
            Condition::Seed(seeds) => list(seeds),
            Condition::AgentName(names) => list(&names.iter().map(quoted).collect::<Vec<_>>()),
            Condition::Key { values, .. } => list(values),
        };
        format!("{} = {values}", self.name())
    }

    /// The number of values that meet the condition.
    pub(super) fn len(&self) -> usize {
        match self {
            Condition::Scenario(list) => list.len(),
            Condition::Seed(list) => list.len(),
            Condition::AgentName(list) => list.len(),
            Condition::Key { values, .. } => values.len(),
        }
    }

    /// The condition that is met if this one or the other is met; `None` if they concern different
    /// parameters.
    pub fn or(&self, other: &Condition) -> Option<Condition> {
        let mut either = self.clone();
        match (&mut either, other) {
            (Condition::Scenario(list), Condition::Scenario(others)) => {
                list.extend(others.iter().cloned());
            }
            (Condition::Seed(list), Condition::Seed(others)) => list.extend(others),
            (Condition::AgentName(list), Condition::AgentName(others)) => {
                list.extend(others.iter().cloned());
            }
            (
                Condition::Key { parameter, values },
                Condition::Key { parameter: same, values: others },
            ) if parameter == same => values.extend(others.iter().cloned()),
            (
                Condition::Scenario(_)
                | Condition::Seed(_)
                | Condition::AgentName(_)
                | Condition::Key { .. },
                _,
            ) => return None,
        }
        Some(either)
    }
}

impl From<&Value> for Setting {
    fn from(value: &Value) -> Setting {
        match value {
            Value::Real(real) => Setting::Number(*real),
            Value::Integer(whole) => Setting::Number(*whole as f64),
            Value::Flag(flag) => Setting::Number(f64::from(u8::from(*flag))),
            Value::Choice(word) => Setting::Text((*word).to_owned()),
            Value::RealPair(pair) => Setting::Text(format!("[{:?},{:?}]", pair[0], pair[1])),
            Value::Reals(reals) => {
                let reals: Vec<String> = reals.iter().map(|real| format!("{real:?}")).collect();
                Setting::Text(format!("[{}]", reals.join(",")))
            }
            Value::Wholes(widths) => {
                let widths: Vec<String> = widths.iter().map(ToString::to_string).collect();
                Setting::Text(format!("[{}]", widths.join(",")))
            }
            Value::Negative(whole) => Setting::Number(*whole as f64),
            Value::Text(text) => Setting::Text(text.clone()),
            Value::Words(words) => Setting::Text(serde_json::json!(words).to_string()),
            Value::Distribution(distribution) => Setting::Text(distribution.text()),
            Value::Rows(rows) => Setting::Text(rows.text()),
        }
    }
}

impl fmt::Display for Setting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            // Scientific notation for very small and very large numbers.
            Setting::Number(number) if *number != 0.0 && !(1e-6..1e15).contains(&number.abs()) => {
                write!(f, "{number:e}")
            }
            Setting::Number(number) => write!(f, "{number}"),
            Setting::Text(text) => f.write_str(text),
        }
    }
}

/// The last part of a dotted name: `sigma` of `environment.sigma`. Keys of a population keep their full
/// names, because the environment has keys of the same name.
pub fn short_name(dotted: &str) -> &str {
    if dotted.starts_with("population.") {
        return dotted;
    }
    dotted.rsplit('.').next().unwrap_or(dotted)
}
