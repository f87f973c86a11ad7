//! Rules between keys: zips, exclusions, the size of the grid, and the constraints of environments,
//! populations and algorithms.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use crate::agent::Algorithm;
use crate::job::{Condition, EvaluatedOn, REWARD, TestActions, Trial};
use crate::key::{Assignment, Constraint, Keyed, Parameter, SectionName, Size, Value, Violation};
use crate::manifest::declared::{DeclaredAgent, Exclusion, Manifest};
use crate::manifest::draft::Draft;
use crate::manifest::estimate::declared::DeclaredEstimate;
use crate::manifest::grid::{Axis, Grid, axes, size, zipped};
use crate::manifest::limits::{MOST_COMPARISONS, MOST_JOBS};
use crate::manifest::presence::absent;
use crate::manifest::{analysis, data, estimate};
use crate::text::{Fault, FaultList, Span};

/// Reports faults between the keys of `manifest`, which was completed from `draft`.
///
/// The faults of analyses that refer to something that the manifest does not declare are returned, by the
/// index of the analysis.
pub(super) fn check(
    draft: &Draft,
    mut manifest: Manifest,
    faults: &mut FaultList,
) -> (Manifest, Vec<(usize, FaultList)>) {
    let broken = zips(draft, &manifest, faults);
    manifest.zips.retain(|zip| !zip.parameters.iter().any(|name| broken.contains(name)));
    let lost = analysis::read::lost(draft, &manifest, faults);
    if !size_fits(draft, &manifest, faults) {
        if listed(&manifest) <= FEW_LISTED {
            exclusions(draft, &manifest, faults);
        }
        return (manifest, lost);
    }
    if !comparisons_fit(draft, &manifest, faults) {
        return (manifest, lost);
    }
    let exclusions_hold = exclusions(draft, &manifest, faults);
    let grids: Vec<Grid> =
        (0..manifest.agents.len()).map(|agent| Grid::of(&manifest, agent)).collect();
    for constraint in manifest.family().constraints.iter().copied().flatten() {
        let certain = grids.iter().enumerate();
        let mut certain = certain.filter(|(index, grid)| {
            is_certain(draft, *index, grid, constraint.parameters, &broken)
        });
        // No key of an agent is involved: one agent's violation stands for all.
        if let Some((index, grid)) = certain.find(|(_, grid)| grid.violation(constraint).is_some())
        {
            hold(draft, Concerned::Environment(index), grid, constraint, faults);
        }
    }
    let agents = manifest.agents.iter().zip(&grids).enumerate();
    for (index, (declared, grid)) in agents {
        for constraint in declared.algorithm.constraints() {
            if is_certain(draft, index, grid, constraint.parameters, &broken) {
                hold(draft, Concerned::Agent(index), grid, constraint, faults);
            }
        }
        for (keys, violation) in grid.too_large().into_iter().chain(grid.unsuited()) {
            let parameters: Vec<Parameter> = keys.parameters().collect();
            if is_certain(draft, index, grid, &parameters, &broken) {
                report(draft, Concerned::Agent(index), &keys, violation, faults);
            }
        }
    }
    trials(draft, &manifest, &grids, faults);
    data::check(draft, &manifest, faults);
    if faults.is_empty() {
        estimate::read::check(draft, &manifest, &grids, faults);
    }
    if exclusions_hold && broken.is_empty() && !draft.invalid_cells {
        matches(draft, &grids, faults);
    }
    let costs = |grid: &Grid| grid.environments().any(|one| one.message_cost().is_some());
    let estimates = !manifest.estimates.is_empty() && faults.is_empty();
    if estimates && grids.iter().any(costs) {
        for DeclaredEstimate { declaration, .. } in &mut manifest.estimates {
            Arc::make_mut(declaration).less_costs = declaration.outcome == REWARD;
        }
    }
    (manifest, lost)
}

/// Reports what does not suit a trial: what is evaluated, agents that cannot act in one, its files and its days.
fn trials(draft: &Draft, manifest: &Manifest, grids: &[Grid], faults: &mut FaultList) {
    let has = |key, value: &Value| {
        manifest.sections[SectionName::Evaluation].get(key).is_some_and(|all| all.contains(value))
    };
    let on = |on: EvaluatedOn| has("on", &Value::Choice(on.word()));
    let span = |key| {
        draft.sections[SectionName::Evaluation]
            .span_of(key)
            .or(draft.sections[SectionName::Trial].span)
    };
    let span = |key| span(key).unwrap_or(Span { start: 0, end: 0 });
    let mut fault = |span, says: &str, help: &str| faults.add(Fault::at(span, says).help(help));
    let has_trial = manifest.has_trial();
    if !has_trial && on(EvaluatedOn::Trial) {
        let says = "`on` = \"trial\" needs people in a trial, and the manifest has no [trial]";
        fault(span("on"), says, "write a [trial], or on = \"test\"");
    } else if has_trial && on(EvaluatedOn::Test) {
        let says = "a trial is evaluated on its people, and `on` of [evaluation] is \"test\"";
        fault(span("on"), says, "write on = \"trial\" in [evaluation]");
    }
    let none = Value::Integer(0);
    if on(EvaluatedOn::Test) && !has_trial && has("test_episodes", &none) {
        let says =
            "`test_episodes` = 0 is for trials: without a trial there is nothing to evaluate";
        fault(span("test_episodes"), says, "write at least 1");
    } else if has_trial
        && on(EvaluatedOn::Trial)
        && manifest.sections[SectionName::Evaluation]
            .get("test_episodes")
            .is_some_and(|all| all.iter().any(|n| *n != none))
    {
        let says = "no test follows a trial that is the evaluation, and `test_episodes` is above 0";
        fault(span("test_episodes"), says, "remove test_episodes");
    }
    if !has_trial {
        return;
    }
    if has("test_actions", &Value::Choice(TestActions::Greedy.word())) {
        let says =
            "`test_actions` is not read in a trial: an agent acts there by its probabilities";
        fault(span("test_actions"), says, "remove it");
    }
    acting_in_trials(draft, manifest, faults);
    let is_known = Trial::KEYS.iter().all(|key| !draft.is_invalid(Parameter::Trial(key.name)));
    if let Some((key, says)) = grids.iter().filter(|_| is_known).find_map(Grid::trial_fault) {
        let span = draft.sections[SectionName::Trial]
            .span_of(key.key())
            .or(draft.sections[SectionName::Trial].span);
        faults.add(Fault::at(span.unwrap_or(Span { start: 0, end: 0 }), says));
    }
}

/// Reports agents that cannot act in a trial, and their keys that are not read there.
fn acting_in_trials(draft: &Draft, manifest: &Manifest, faults: &mut FaultList) {
    for (declared, agent) in manifest.agents.iter().zip(&draft.agents) {
        let unread = declared.algorithm.unread_in_trials();
        for key in unread.unwrap_or_default() {
            // Manifests that are written out in full have every key.
            if let Some(span) = agent.settings.differs(key) {
                let says = format!("agent `{}`: `{key}` is not read in a trial", declared.name);
                faults
                    .add(Fault::at(span, says).help("remove it; [trial] has the times of updates"));
            }
        }
        if unread.is_none() {
            let able = Algorithm::all().into_iter();
            let able = able.filter(|algorithm| algorithm.unread_in_trials().is_some());
            let able: Vec<&str> = able.map(Algorithm::name).collect();
            let says = format!(
                "agent `{}`: {} cannot act in a trial",
                declared.name,
                declared.algorithm.name()
            );
            faults.add(
                Fault::at(agent.name.span, says)
                    .help(format!("algorithms that can: {}", able.join(", "))),
            );
        }
    }
}

/// Reports zips of parameters that are not swept or differ in length; returns the parameters of faulty
/// zips.
fn zips(draft: &Draft, manifest: &Manifest, faults: &mut FaultList) -> HashSet<Parameter> {
    let mut broken = HashSet::new();
    for zip in draft.zips.iter().flatten() {
        if zip.value.is_empty() || zip.value.iter().any(|parameter| draft.is_invalid(*parameter)) {
            broken.extend(&zip.value);
        } else if let Some(message) = zip_fault(manifest, &zip.value) {
            broken.extend(&zip.value);
            faults.add(
                Fault::at(zip.span, message).help(
                    "a zip advances parameters together; their lists must have the same length",
                ),
            );
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
            return Some(format!("`zip`: `{single}` is not swept: it has one value"));
        }
        if lengths.iter().any(|length| *length != lengths[0]) {
            let each = parameters.iter().zip(&lengths);
            let each: Vec<String> =
                each.map(|(parameter, length)| format!("`{parameter}` has {length}")).collect();
            return Some(format!("`zip`: the lists differ in length: {}", each.join(", ")));
        }
        if let Some([first, second]) = same_positions(manifest, agent, parameters) {
            return Some(format!("`zip`: positions {first} and {second} have the same values"));
        }
    }
    None
}

/// Two positions of a zip, counted from 1, at which all of its lists have the same value. `None` for zips with
/// scenarios or seeds, which are distinct.
fn same_positions(
    manifest: &Manifest,
    agent: &DeclaredAgent,
    parameters: &[Parameter],
) -> Option<[usize; 2]> {
    let lists: Option<Vec<_>> =
        parameters.iter().map(|parameter| manifest.values(agent, *parameter)).collect();
    let lists = lists?;
    let mut seen = HashMap::new();
    (0..lists[0].len()).find_map(|position| {
        let values: Vec<&Value> = lists.iter().map(|list| &list[position]).collect();
        seen.insert(values, position).map(|earlier| [earlier + 1, position + 1])
    })
}

/// Reports conditions on values that the manifest does not have; true if there are none.
fn exclusions(draft: &Draft, manifest: &Manifest, faults: &mut FaultList) -> bool {
    let mut hold = true;
    for condition in draft.exclusions.iter().flat_map(|exclusion| &exclusion.value) {
        let Some(absent) = absent(draft, manifest, &condition.value) else {
            continue;
        };
        hold = false;
        faults.add(absent.fault("no cell to exclude", condition.span));
    }
    hold
}

/// Reports a grid with too many cells; true if the grid is small enough to be enumerated.
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
    let message = format!("the grid has {total} jobs; the maximum is {MOST_JOBS}");
    let fault = Fault::at(span.unwrap_or(Span { start: 0, end: 0 }), message);
    // An unreadable zip can inflate the count. Its own fault has already been reported.
    if !draft.invalid_cells && draft.zips.iter().flatten().count() == manifest.zips.len() {
        faults.add(fault.help(format!("agent `{name}`: {}", factors.join(" × "))));
    }
    false
}

/// The number of values in the conditions of exclusions up to which they are compared with a grid of any size.
const FEW_LISTED: usize = 1000;

/// The number of values in the conditions of exclusions.
fn listed(manifest: &Manifest) -> usize {
    let listed = manifest.exclusions.iter().flat_map(|exclusion| &exclusion.conditions);
    listed.map(|one| one.values.len()).sum()
}

/// Whether comparing cells with exclusions takes acceptable time; reports a fault if not.
fn comparisons_fit(draft: &Draft, manifest: &Manifest, faults: &mut FaultList) -> bool {
    let sizes = manifest.agents.iter().map(|agent| size(&axes(manifest, agent)));
    let cells = sizes.fold(0, u128::saturating_add);
    let listed = listed(manifest);
    let of_cells = cells.saturating_mul(manifest.exclusions.len() as u128);
    let comparisons = of_cells.saturating_add((listed * manifest.agents.len()) as u128);
    if comparisons <= u128::from(MOST_COMPARISONS) {
        return true;
    }
    let message = format!(
        "the exclusions need {comparisons} comparisons with cells; the maximum is \
         {MOST_COMPARISONS}"
    );
    let span = draft.exclusions.first().map_or(Span { start: 0, end: 0 }, |first| first.span);
    faults.add(Fault::at(span, message).help(format!(
        "cells: {cells}, exclusions: {}, values that they list: {listed}; one exclusion can list \
         several values",
        manifest.exclusions.len()
    )));
    false
}

/// Whether the values of parameters are known in every cell of an agent.
fn is_certain(
    draft: &Draft,
    agent: usize,
    grid: &Grid,
    parameters: &[Parameter],
    broken: &HashSet<Parameter>,
) -> bool {
    if parameters.iter().any(|name| draft.is_invalid_for(agent, *name)) {
        return false;
    }
    let swept = parameters.iter().any(|name| grid.is_swept(*name));
    !swept || !(draft.invalid_cells || parameters.iter().any(|name| broken.contains(name)))
}

/// The subject of a constraint, with the index of the agent whose grid is checked.
#[derive(Clone, Copy)]
enum Concerned {
    /// The environment alone.
    Environment(usize),
    /// Keys of the agent, perhaps with others.
    Agent(usize),
}

/// Reports a combination of keys that violates a constraint, unless the combination is excluded.
fn hold(
    draft: &Draft,
    concerned: Concerned,
    grid: &Grid,
    constraint: &Constraint,
    faults: &mut FaultList,
) {
    if let Some((chosen, violation)) = grid.violation(constraint) {
        report(draft, concerned, &chosen, violation, faults);
    }
}

/// Reports a violation by these values.
fn report(
    draft: &Draft,
    concerned: Concerned,
    chosen: &Assignment,
    violation: Violation,
    faults: &mut FaultList,
) {
    let (Concerned::Environment(agent) | Concerned::Agent(agent)) = concerned;
    // Keys of a preset have the position of `extends`; the last position is a key of the author.
    // The position of the scenarios would say less than that of a key.
    let keys = chosen.parameters().filter(|key| *key != Parameter::SCENARIO);
    let span = keys.filter_map(|key| draft.span_of(agent, key)).max();
    let name = &draft.agents[agent].name;
    let name_span = name.span;
    let fault = |message| Fault::at(span.unwrap_or(name_span), message);
    let of = match concerned {
        Concerned::Environment(_) => String::new(),
        Concerned::Agent(_) if name.value.is_empty() => String::new(),
        Concerned::Agent(_) => format!("agent `{}`: ", name.value),
    };
    let fault = match violation {
        Violation::Contradiction(says) => fault(format!("{of}{says}")),
        Violation::Impossible { says, help } => fault(format!("{of}{says}")).help(help),
        Violation::ImpossibleAt { parameter, says, help } => {
            let span = draft.span_of(agent, parameter).unwrap_or(name.span);
            Fault::at(span, format!("{of}{says}")).help(help)
        }
        Violation::InFile { parameter, content, faults: found } => {
            let name = parameter.key();
            let says = faults.add_of_file(content.file(), content.text(), found);
            let span = draft.span_of(agent, parameter).or(span);
            Fault::at(span.unwrap_or(name_span), format!("{of}`{name}`: {says}"))
        }
        Violation::TooLarge(Size { what, unit, size, most }) => {
            let says = format!("{what} {size} {unit}; the maximum is {most}");
            fault(format!("{of}{says}")).help(format!("with {}", chosen.listed()))
        }
    };
    faults.add(fault);
}

/// Reports exclusions that exclude nothing or everything.
fn matches(draft: &Draft, grids: &[Grid], faults: &mut FaultList) {
    for exclusion in &draft.exclusions {
        let known = |condition: &Condition| !draft.is_invalid(condition.parameter);
        let conditions: Vec<Condition> =
            exclusion.value.iter().map(|condition| condition.value.clone()).collect();
        let all_known = !draft.invalid_agents() && conditions.iter().all(known);
        let exclusion_met = Exclusion { conditions };
        if all_known && !grids.iter().any(|grid| grid.meets(&exclusion_met)) {
            let fault = Fault::at(exclusion.span, "the exclusion matches no cell");
            faults.add(fault.help("no cell meets all its conditions together"));
        }
    }
    let left: u64 = grids.iter().map(Grid::count).sum();
    if let Some(first) = draft.exclusions.first().filter(|_| left == 0 && !grids.is_empty()) {
        faults.add(Fault::at(first.span, "the exclusions leave no job"));
    }
}

#[cfg(test)]
mod tests {
    use crate::manifest::parse;

    #[test]
    fn a_fault_between_an_authors_key_and_a_presets_points_to_the_authors() {
        let text = "format = 1\nname = \"t\"\nextends = \"paper\"\nscenarios = [\"C\"]\n\
                    environment.sigma = 0\n[[agent]]\nname = \"dqn\"\nbuffer = 32\n";
        let faults = parse("t", text.as_bytes()).unwrap_err();
        assert_eq!(faults.position(&faults.list()[0]).map(|position| position.line), Some(8));
    }

    #[test]
    fn a_key_that_does_not_suit_the_actions_is_refused_once_per_agent() {
        let text = |keys: &str, exclusion: &str| {
            format!(
                "format = 1\nname = \"t\"\nextends = \"paper\"\nscenarios = [\"C\", \"P\"]\n\
                 environment.sigma = 0\n{exclusion}[[agent]]\nname = \"bandit\"\n\
                 algorithm = \"linear_thompson\"\nepisodes = [1, 2]\n{keys}\n"
            )
        };
        let said = |keys, exclusion| {
            let faults = parse("t", text(keys, exclusion).as_bytes()).err();
            let faults = faults.iter().flat_map(|faults| faults.list());
            faults.map(|fault| fault.message().to_string()).collect::<Vec<_>>()
        };
        for (keys, expected) in [
            (
                "pi_min = [0.1, 0.3]",
                "agent `bandit`: `pi_min` does not suit an environment with 4 actions",
            ),
            ("action_bias = [0, 1]", "agent `bandit`: `action_bias` does not suit"),
        ] {
            let messages = said(keys, "");
            assert!(messages.len() == 1 && messages[0].contains(expected), "{messages:?}");
        }
        assert_eq!(said("action_bias = [0, 0]", ""), Vec::<String>::new());
        assert_eq!(said("pi_min = 0.25\naction_bias = [0, 1, 2, 3]", ""), Vec::<String>::new());
        let excluded = "[[exclude]]\nagent.pi_min = 0.3\n";
        assert_eq!(said("pi_min = [0.1, 0.3]", excluded), Vec::<String>::new());
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
