//! Checks whether the values in conditions occur in a manifest.

use std::collections::HashSet;

use super::condition::Condition;
use super::declared::Manifest;
use super::draft::Draft;
use crate::key::Parameter;

/// The name of the condition's parameter, the first value that does not occur, and the values that occur;
/// `None` if all values of the condition occur, or if the parameter's values are faulty.
pub(super) fn absent(
    draft: &Draft,
    manifest: &Manifest,
    condition: &Condition,
) -> Option<(String, String, String)> {
    let agents = &manifest.agents;
    match condition {
        Condition::Scenario(list) if !draft.is_invalid(Parameter::Scenario) => {
            first_absent("scenario".to_owned(), list, manifest.scenarios.iter())
        }
        Condition::Seed(list) if !draft.is_invalid(Parameter::Seed) => {
            first_absent("seed".to_owned(), list, manifest.seeds.iter())
        }
        Condition::AgentName(list) if !draft.invalid_agents => {
            first_absent("agent.name".to_owned(), list, agents.iter().map(|agent| &agent.name))
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
) -> Option<(String, String, String)> {
    const SHOWN: usize = 10;
    let mut unseen: HashSet<&T> = wanted.iter().collect();
    let mut shown: Vec<&T> = Vec::new();
    for value in present {
        if unseen.is_empty() {
            return None;
        }
        unseen.remove(value);
        if shown.len() <= SHOWN && !shown.contains(&value) {
            shown.push(value);
        }
    }
    let absent = wanted.iter().find(|value| unseen.contains(value))?;
    let more = if shown.len() > SHOWN { ", …" } else { "" };
    let shown: Vec<String> = shown.iter().take(SHOWN).map(ToString::to_string).collect();
    Some((name, absent.to_string(), shown.join(", ") + more))
}
