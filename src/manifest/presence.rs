//! Checks whether the values in conditions occur in a manifest.

use std::collections::HashSet;

use super::condition::Condition;
use super::declared::Manifest;
use super::draft::Draft;
use super::fault::{Fault, nearest_value};
use super::source::Span;
use crate::key::Parameter;

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
    let agents = &manifest.agents;
    match condition {
        Condition::Scenario(list) if !draft.is_invalid(Parameter::Scenario) => {
            first_absent("scenario".to_owned(), list, manifest.scenarios.iter())
        }
        Condition::Seed(list) if !draft.is_invalid(Parameter::Seed) => {
            first_absent("seed".to_owned(), list, manifest.seeds.iter())
        }
        // An agent that could not be read has its name all the same, unless the name is unknown.
        Condition::AgentName(list) if !draft.unread_agents.contains(&None) => {
            let unread = draft.unread_agents.iter().flatten();
            let names = agents.iter().map(|agent| &agent.name).chain(unread);
            first_absent("agent.name".to_owned(), list, names)
        }
        Condition::Key { parameter, values } if !draft.is_invalid(*parameter) => {
            let of_agent = |agent| manifest.values(agent, *parameter).unwrap_or_default();
            first_absent(parameter.to_string(), values, agents.iter().flat_map(of_agent))
        }
        Condition::Scenario(_)
        | Condition::Seed(_)
        | Condition::AgentName(_)
        | Condition::Key { .. } => None,
    }
}

fn first_absent<'m, T: Eq + std::hash::Hash + std::fmt::Display + 'm>(
    name: String,
    wanted: &[T],
    present: impl Iterator<Item = &'m T>,
) -> Option<Absent> {
    let mut unseen: HashSet<&T> = wanted.iter().collect();
    let mut shown: Vec<&T> = Vec::new();
    for value in present {
        if unseen.is_empty() {
            return None;
        }
        unseen.remove(value);
        if shown.len() < COMPARED && !shown.contains(&value) {
            shown.push(value);
        }
    }
    let absent = wanted.iter().find(|value| unseen.contains(value))?;
    let present = shown.iter().map(ToString::to_string).collect();
    Some(Absent { name, value: absent.to_string(), present })
}
