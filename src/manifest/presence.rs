//! Checks whether the values in conditions occur in a manifest.

use std::collections::HashSet;

use crate::job::Condition;
use crate::key::{Parameter, Value};
use crate::manifest::declared::Manifest;
use crate::manifest::draft::Draft;
use crate::text::{Fault, Span, nearest_value};

/// A value of a condition that does not occur in a manifest.
pub(super) struct Absent {
    /// The name of the condition's parameter.
    name: String,
    value: String,
    /// The first values that occur.
    present: Vec<String>,
}

/// Maximum number of values that are compared with an absent one.
const COMPARED: usize = 100;

impl Absent {
    /// The fault of a condition on `what`, with the nearest value that occurs.
    pub fn fault(&self, what: &str, span: Span) -> Fault {
        const SHOWN: usize = 10;
        let Absent { name, value, present } = self;
        let fault = Fault::at(span, format!("{what} has `{name}` = {value}"));
        if present.is_empty() {
            return fault.help(format!("no agent of this manifest has the key `{name}`"));
        }
        let more = if present.len() > SHOWN { ", …" } else { "" };
        let shown: Vec<&str> = present.iter().take(SHOWN).map(String::as_str).collect();
        let values = format!("its values here: {}{more}", shown.join(", "));
        fault.help(match nearest_value(value, present) {
            Some(meant) => format!("did you mean `{meant}`? {values}"),
            None => values,
        })
    }
}

/// The first value of a condition that does not occur; `None` if all of them occur, or if the parameter's
/// values are faulty.
pub(super) fn absent(draft: &Draft, manifest: &Manifest, condition: &Condition) -> Option<Absent> {
    let parameter = &condition.parameter;
    if draft.is_invalid(*parameter) {
        return None;
    }
    // Without an agent, scenarios and seeds are known all the same.
    let of_job = match *parameter {
        Parameter::SCENARIO => &manifest.scenarios[..],
        Parameter::SEED => &manifest.seeds[..],
        _ => &[],
    };
    let of_agent = |agent| manifest.values(agent, *parameter).unwrap_or_default();
    let unread = draft.unread_agents.iter().flatten().cloned().map(Value::Text);
    let unread: Vec<Value> = unread.filter(|_| *parameter == Parameter::AGENT_NAME).collect();
    first_absent(condition, manifest.agents.iter().flat_map(of_agent).chain(of_job).chain(&unread))
}

fn first_absent<'m>(
    condition: &Condition,
    present: impl Iterator<Item = &'m Value>,
) -> Option<Absent> {
    let mut unseen: HashSet<&Value> = condition.values.iter().collect();
    let mut shown: Vec<&Value> = Vec::new();
    for value in present {
        if unseen.is_empty() {
            return None;
        }
        unseen.remove(value);
        if shown.len() < COMPARED && !shown.contains(&value) {
            shown.push(value);
        }
    }
    let absent = condition.values.iter().find(|value| unseen.contains(value))?;
    let present = shown.iter().map(|value| written(condition.parameter, value)).collect();
    Some(Absent { name: condition.name(), value: written(condition.parameter, absent), present })
}

/// A value as messages write it: names and scenarios without quotes.
fn written(parameter: Parameter, value: &Value) -> String {
    match (parameter, value) {
        (Parameter::SCENARIO | Parameter::AGENT_NAME, Value::Text(text)) => text.clone(),
        _ => value.to_string(),
    }
}
