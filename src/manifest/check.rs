//! The rules that no key can be held to alone: zips, exclusions, the size of the grid, and keys of
//! an agent that depend on each other.

use std::collections::HashSet;

use super::declared::{Condition, Exclusion, MOST_JOBS, Manifest};
use super::draft::Draft;
use super::fault::{Fault, FaultList};
use super::grid::{Axis, Grid, axes, size, zipped};
use super::keys::{Algorithm, Value};
use super::parameter::Parameter;
use super::source::Span;

/// Two keys of an algorithm that depend on each other.
struct Rule {
    algorithm: Algorithm,
    keys: [&'static str; 2],
    holds: fn(&Value, &Value) -> bool,
    says: &'static str,
}

const RULES: &[Rule] = &[
    Rule {
        algorithm: Algorithm::Reinforce,
        keys: ["episodes", "trajectories_per_update"],
        holds: |episodes, trajectories| match (episodes, trajectories) {
            (Value::Integer(episodes), Value::Integer(each)) => episodes.is_multiple_of(*each),
            _ => true,
        },
        says: "must be a multiple of",
    },
    Rule {
        algorithm: Algorithm::DuelingDqn,
        keys: ["batch", "buffer"],
        holds: |batch, buffer| match (batch, buffer) {
            (Value::Integer(batch), Value::Integer(buffer)) => batch <= buffer,
            _ => true,
        },
        says: "must not exceed",
    },
    Rule {
        algorithm: Algorithm::DuelingDqn,
        keys: ["epsilon_floor", "epsilon_start"],
        holds: |floor, start| match (floor, start) {
            (Value::Real(floor), Value::Real(start)) => floor <= start,
            _ => true,
        },
        says: "must not exceed",
    },
];

/// Notes what is wrong between the keys of `manifest`, which was completed from `draft`.
pub(super) fn check(draft: &Draft, mut manifest: Manifest, faults: &mut FaultList) -> Manifest {
    let broken = zips(draft, &manifest, faults);
    manifest.zips.retain(|zip| !zip.parameters.iter().any(|name| broken.contains(name)));
    if !size_fits(draft, &manifest, faults) {
        return manifest;
    }
    let exclusions_hold = exclusions(draft, &manifest, faults);
    for agent in 0..manifest.agents.len() {
        rules(draft, &manifest, agent, &broken, faults);
    }
    if exclusions_hold && broken.is_empty() && !draft.lost_cells {
        matches(draft, &manifest, faults);
    }
    manifest
}

/// Notes zips of what is not swept or of unequal lengths; the parameters of those.
fn zips(draft: &Draft, manifest: &Manifest, faults: &mut FaultList) -> HashSet<Parameter> {
    let mut broken = HashSet::new();
    for zip in draft.zips.iter().flatten() {
        if zip.value.is_empty() || zip.value.iter().any(|parameter| draft.is_lost(*parameter)) {
            broken.extend(&zip.value);
        } else if let Some(message) = zip_fault(manifest, &zip.value) {
            broken.extend(&zip.value);
            faults.add(Fault::at(zip.span, message).help(
                "a zip takes parameters with lists of one length, and advances them together",
            ));
        }
    }
    broken
}

fn zip_fault(manifest: &Manifest, parameters: &[Parameter]) -> Option<String> {
    let concerned = manifest.agents.iter().filter(|agent| zipped(manifest, agent, parameters));
    let concerned: Vec<_> = concerned.collect();
    if concerned.is_empty() && !manifest.agents.is_empty() {
        let of_agents = parameters.iter().filter(|name| matches!(name, Parameter::Agent(_)));
        let names: Vec<String> = of_agents.map(|name| format!("`{name}`")).collect();
        return Some(format!("`zip`: no agent sweeps {}", names.join(" and ")));
    }
    for agent in concerned {
        let lengths: Vec<usize> =
            parameters.iter().map(|parameter| manifest.length(agent, *parameter)).collect();
        if let Some((single, _)) = parameters.iter().zip(&lengths).find(|(_, length)| **length == 1)
        {
            return Some(format!("`zip`: `{single}` has one value, it is not swept"));
        }
        if lengths.iter().any(|length| *length != lengths[0]) {
            let each = parameters.iter().zip(&lengths);
            let each: Vec<String> =
                each.map(|(parameter, length)| format!("`{parameter}` has {length}")).collect();
            return Some(format!("`zip`: the lists differ in length: {}", each.join(", ")));
        }
    }
    None
}

/// Notes conditions on values that nothing in the manifest has; whether there are none.
fn exclusions(draft: &Draft, manifest: &Manifest, faults: &mut FaultList) -> bool {
    let mut hold = true;
    for condition in draft.exclusions.iter().flat_map(|exclusion| &exclusion.value) {
        let Some((name, absent, present)) = absent(draft, manifest, &condition.value) else {
            continue;
        };
        hold = false;
        let message = format!("no cell to exclude has `{name}` = {absent}");
        let fault = Fault::at(condition.span, message);
        faults.add(match present.is_empty() {
            true => fault.help(format!("no agent of this manifest has the key `{name}`")),
            false => fault.help(format!("its values here: {present}")),
        });
    }
    hold
}

/// A value of the condition that does not occur, with the parameter's name and what does occur.
fn absent(
    draft: &Draft,
    manifest: &Manifest,
    condition: &Condition,
) -> Option<(String, String, String)> {
    let agents = &manifest.agents;
    match condition {
        Condition::Scenario(list) if !draft.is_lost(Parameter::Scenario) => {
            first_absent("scenario".to_owned(), list, manifest.scenarios.iter())
        }
        Condition::Seed(list) if !draft.is_lost(Parameter::Seed) => {
            first_absent("seed".to_owned(), list, manifest.seeds.iter())
        }
        Condition::AgentName(list) if !draft.lost_agents => {
            first_absent("agent.name".to_owned(), list, agents.iter().map(|agent| &agent.name))
        }
        Condition::Key { parameter, values } if !draft.is_lost(*parameter) => {
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

/// Notes a grid of too many cells; whether it is small enough to be walked through.
fn size_fits(draft: &Draft, manifest: &Manifest, faults: &mut FaultList) -> bool {
    let grids: Vec<Vec<Axis>> = manifest.agents.iter().map(|agent| axes(manifest, agent)).collect();
    let sizes = grids.iter().map(|axes| size(axes));
    let total = sizes.clone().fold(0, u128::saturating_add);
    if total <= u128::from(MOST_JOBS) {
        return true;
    }
    let largest = sizes.enumerate().max_by_key(|(_, size)| *size).map_or(0, |(agent, _)| agent);
    let axes = &grids[largest];
    let longest = axes.iter().max_by_key(|axis| axis.length).map(|axis| axis.parameters[0]);
    let span = longest.and_then(|parameter| draft.span_of(largest, parameter));
    let factors = axes.iter().map(|axis| format!("{} ({})", axis.parameters[0], axis.length));
    let factors: Vec<String> = factors.collect();
    let name = &manifest.agents[largest].name;
    let message = format!("the grid has {total} jobs, at most {MOST_JOBS} are possible");
    let fault = Fault::at(span.unwrap_or(Span { start: 0, end: 0 }), message);
    // With an unreadable zip the count may be too high, and the zip's own fault comes first.
    if !draft.lost_cells && draft.zips.iter().flatten().count() == manifest.zips.len() {
        faults.add(fault.help(format!("agent `{name}`: {}", factors.join(" × "))));
    }
    false
}

/// Notes combinations of an agent's keys that break a rule, unless they are excluded.
fn rules(
    draft: &Draft,
    manifest: &Manifest,
    agent: usize,
    broken: &HashSet<Parameter>,
    faults: &mut FaultList,
) {
    let declared = &manifest.agents[agent];
    for rule in RULES.iter().filter(|rule| rule.algorithm == declared.algorithm) {
        let keys = rule.keys.map(Parameter::Agent);
        let settings = &draft.agents[agent].settings;
        let swept = keys.iter().any(|key| manifest.length(declared, *key) > 1);
        let uncertain = draft.lost_cells || keys.iter().any(|key| broken.contains(key));
        if rule.keys.iter().any(|key| settings.is_lost(key)) || (swept && uncertain) {
            continue;
        }
        let grid = Grid::of(manifest, agent);
        if let Some((first, second)) = grid.counterexample(keys, rule.holds) {
            let [one, other] = rule.keys;
            // The later of the two is the author's own where the other is a preset's.
            let spans = keys.iter().filter_map(|key| draft.span_of(agent, *key));
            let span = spans.max();
            let span = span.unwrap_or(draft.agents[agent].name.span);
            let name = &declared.name;
            let message = format!(
                "agent `{name}`: `{one}` {} `{other}`, found {first} and {second}",
                rule.says
            );
            faults.add(Fault::at(span, message));
        }
    }
}

/// Notes exclusions that leave out nothing, or everything.
fn matches(draft: &Draft, manifest: &Manifest, faults: &mut FaultList) {
    let grids: Vec<Grid> =
        (0..manifest.agents.len()).map(|agent| Grid::of(manifest, agent)).collect();
    for exclusion in &draft.exclusions {
        let known = |condition: &Condition| match condition {
            Condition::Scenario(_) => !draft.is_lost(Parameter::Scenario),
            Condition::Seed(_) => !draft.is_lost(Parameter::Seed),
            Condition::AgentName(_) => !draft.lost_agents,
            Condition::Key { parameter, .. } => !draft.is_lost(*parameter),
        };
        let conditions: Vec<Condition> =
            exclusion.value.iter().map(|condition| condition.value.clone()).collect();
        let all_known = !draft.lost_agents && conditions.iter().all(known);
        let exclusion_met = Exclusion { conditions };
        if all_known && !grids.iter().any(|grid| grid.meets(&exclusion_met)) {
            let fault = Fault::at(exclusion.span, "the exclusion matches no cell");
            faults.add(fault.help("no cell meets all of its conditions at once"));
        }
    }
    let left: u64 = grids.iter().map(Grid::count).sum();
    if let Some(first) = draft.exclusions.first().filter(|_| left == 0 && !grids.is_empty()) {
        faults.add(Fault::at(first.span, "the exclusions leave no job"));
    }
}

#[cfg(test)]
mod tests {
    use super::super::parse;

    #[test]
    fn a_fault_between_an_authors_key_and_a_presets_points_to_the_authors() {
        let text = "format = 1\nname = \"t\"\nextends = \"paper\"\nscenarios = [\"C\"]\n\
                    environment.sigma = 0\n[[agent]]\nname = \"dqn\"\nbuffer = 32\n";
        let faults = parse("t", text.as_bytes()).unwrap_err();
        assert_eq!(faults.position(&faults.list()[0]).map(|position| position.line), Some(8));
    }

    #[test]
    fn faults_of_every_kind_are_found_in_one_go() {
        let text = "format = 1\nname = \"t\"\nscenarios = [\"C\", \"P\"]\nseeds = 2\n\
                    zip = [[\"environment.delta_d\", \"environment.delta_h\"]]\nseeds = 3\n\
                    [environment]\nsigma = [0, nan]\ndelta_d = [0.1, 0.2]\ndelta_h = [0.1, 0.2, 0.3]\n\
                    [[agent]]\nname = \"dqn\"\nalgorithm = \"dueling_dqn\"\nbuffer = 32\n\
                    [[exclude]]\nscenario = \"T\"\n";
        let faults = parse("t", text.as_bytes()).unwrap_err();
        let lines: Vec<_> =
            faults.list().iter().filter_map(|fault| faults.position(fault)).collect();
        let lines: Vec<_> = lines.iter().map(|position| position.line).collect();
        assert_eq!(lines, [5, 6, 8, 14, 16]);
    }
}
