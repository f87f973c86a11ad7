//! Checks that an analysis has jobs: all together, on each of its sides, and along its axes.

use std::collections::HashSet;

use crate::env::Scenario;
use crate::job::Condition;
use crate::key::{Parameter, Value};
use crate::manifest::analysis::declared::AnalysisDraft;
use crate::manifest::declared::{DeclaredAgent, Manifest};
use crate::manifest::draft::Draft;
use crate::manifest::parameter::scenario_of;
use crate::manifest::presence::absent;
use crate::text::{Fault, FaultList, Located};

/// Reports a recovery without an optimum, or with a group of conditions that no job meets.
pub(in crate::manifest) fn of_groups(
    draft: &Draft,
    manifest: &Manifest,
    (analysis, groups): (&AnalysisDraft, [(&str, &[Condition]); 2]),
    faults: &mut FaultList,
) {
    let is_absent = |one: &Located<Condition>| absent(draft, manifest, &one.value).is_some();
    if draft.is_invalid(Parameter::SCENARIO)
        || draft.invalid_agents()
        || analysis.conditions.iter().any(is_absent)
    {
        return;
    }
    let of_all = &analysis.analysis.conditions;
    if !scenarios_meeting(manifest, of_all.iter()).any(|one| one.shows_state()) {
        let message =
            "no job to analyse has a scenario that shows H and D, whose optimum a recovery needs";
        let help = match manifest.scenarios().any(|one| one.shows_state()) {
            true => "let the conditions of `where` include it",
            false => "add one to the manifest's `scenarios`, as in [\"P-T\", \"P-H-D\"]",
        };
        faults.add(Fault::at(analysis.span, message.to_owned()).help(help));
    }
    for (side, conditions) in groups {
        let all: Vec<&Condition> = of_all.iter().chain(conditions).collect();
        if agent_meeting(draft, manifest, &all).is_some() {
            continue;
        }
        let message = match of_all.is_empty() {
            true => format!("no job meets all conditions of `{side}`"),
            false => format!("no job meets all conditions of `where` and `{side}`"),
        };
        let on_side = analysis.conditions.iter().find(|one| conditions.contains(&one.value));
        let span = on_side.map_or(analysis.span, |one| one.span);
        let help =
            "name an agent and values that it has: { agent.name = \"ppo\", scenario = \"P-T\" }";
        faults.add(Fault::at(span, message).help(help));
    }
}

/// The scenarios of a manifest that meet the conditions on scenarios.
fn scenarios_meeting<'m>(
    manifest: &'m Manifest,
    conditions: impl Iterator<Item = &'m Condition>,
) -> impl Iterator<Item = Scenario> {
    let wanted = conditions.filter(|condition| condition.parameter == Parameter::SCENARIO);
    let wanted: Vec<HashSet<&Value>> = wanted.map(|one| one.values.iter().collect()).collect();
    let meets = move |one: &&Value| wanted.iter().all(|list| list.contains(one));
    manifest.scenarios.iter().filter(meets).map(scenario_of)
}

/// Reports an analysis without jobs, or with a side or an axis that none of its jobs has.
pub(in crate::manifest) fn of(
    draft: &Draft,
    manifest: &Manifest,
    analysis: &AnalysisDraft,
    faults: &mut FaultList,
) {
    if draft.is_invalid(Parameter::SCENARIO) || draft.invalid_agents() {
        return;
    }
    let conditions: Vec<&Condition> = analysis.analysis.conditions.iter().collect();
    let span_of = |condition: &Condition| {
        let located = analysis.conditions.iter().find(|one| one.value == *condition);
        located.map_or(analysis.span, |one| one.span)
    };
    if agent_meeting(draft, manifest, &conditions).is_none() {
        let span = conditions.first().map_or(analysis.span, |one| span_of(one));
        let fault = Fault::at(span, "no job meets all conditions of `where`");
        faults.add(fault.help("leave one of them out"));
        return;
    }
    for side in analysis.analysis.kind.sides().iter().flat_map(|sides| sides.both()) {
        let all = [&conditions[..], &[side]].concat();
        if agent_meeting(draft, manifest, &all).is_none() {
            let value = &side.scalars()[0];
            let message = format!("no job of the side `{value}` meets the conditions of `where`");
            let fault = Fault::at(span_of(side), message);
            faults.add(fault.help("let `where` select jobs of both sides"));
        }
    }
    for axis in &analysis.axes {
        let has_axis = |agent: &&DeclaredAgent| manifest.values(agent, axis.value).is_some();
        let mut agents = agents_meeting(draft, manifest, &conditions);
        if !draft.is_invalid(axis.value) && !agents.any(|agent| has_axis(&agent)) {
            let message = format!("no job that `where` selects has the key `{}`", axis.value);
            let fault = Fault::at(axis.span, message);
            faults.add(fault.help("let `where` select an agent with this key"));
        }
    }
}

/// The first agent that has jobs that meet all conditions.
fn agent_meeting<'m>(
    draft: &'m Draft,
    manifest: &'m Manifest,
    conditions: &'m [&Condition],
) -> Option<&'m DeclaredAgent> {
    agents_meeting(draft, manifest, conditions).next()
}

/// The agents that have jobs that meet all conditions, as far as scenarios, names and keys decide.
fn agents_meeting<'m>(
    draft: &'m Draft,
    manifest: &'m Manifest,
    conditions: &'m [&Condition],
) -> impl Iterator<Item = &'m DeclaredAgent> {
    let has_scenario = scenarios_meeting(manifest, conditions.iter().copied()).next().is_some();
    let agents = manifest.agents.iter().filter(move |_| has_scenario);
    agents.filter(|agent| {
        conditions
            .iter()
            .all(|condition| agent_can_meet(draft, manifest, agent, (condition, conditions)))
    })
}

/// Whether an agent has jobs that meet a condition, as far as its name and keys decide. Several conditions
/// on one key need a value in common.
fn agent_can_meet(
    draft: &Draft,
    manifest: &Manifest,
    agent: &DeclaredAgent,
    (condition, all): (&Condition, &[&Condition]),
) -> bool {
    let parameter = condition.parameter;
    if matches!(parameter, Parameter::Job(_)) {
        return true;
    }
    let sets = all.iter().filter(|other| other.parameter == parameter);
    let sets: Vec<HashSet<&Value>> = sets.map(|other| other.values.iter().collect()).collect();
    let has = manifest.values(agent, parameter).unwrap_or_default();
    let is_wanted = |value| sets.iter().all(|wanted| wanted.contains(value));
    draft.is_invalid(parameter) || has.iter().any(is_wanted)
}

#[cfg(test)]
mod tests {
    use crate::manifest::parse;

    /// The faults of an analysis of a rule and a learner, with their lines.
    fn faults(analysis: &str) -> Vec<String> {
        let text = format!(
            "format = 1\nname = \"t\"\nscenarios = [\"P-H-D\", \"L-H-D\"]\nseeds = 2\n\
             environment.sigma = [0.4, 0.6]\n[[agent]]\nname = \"rule\"\nalgorithm = \"rule\"\n\
             rule = \"tailored\"\n[[agent]]\nname = \"rf\"\nalgorithm = \"reinforce\"\n\
             episodes = 40\nlearning_rate = [0.001, 0.01]\n[[analysis]]\nname = \"a\"\n{analysis}"
        );
        match parse("t", text.as_bytes()) {
            Ok(_) => Vec::new(),
            Err(faults) => faults.list().iter().map(|fault| fault.message().to_owned()).collect(),
        }
    }

    #[test]
    fn a_side_without_jobs_is_a_fault() {
        let contrast = |by: &str, between: &str, conditions: &str| {
            faults(&format!(
                "kind = \"contrast\"\nby = \"{by}\"\nbetween = [{between}]\nwhere = {{ {conditions} }}\n"
            ))
        };
        assert_eq!(
            contrast("agent.learning_rate", "0.001, 0.01", "agent.name = \"rule\""),
            [
                "no job of the side `0.001` meets the conditions of `where`",
                "no job of the side `0.01` meets the conditions of `where`",
            ]
        );
        let other =
            |side: &str| [format!("no job of the side `{side}` meets the conditions of `where`")];
        assert_eq!(contrast("agent", "\"rule\", \"rf\"", "agent.name = \"rule\""), other("rf"));
        assert_eq!(
            contrast("scenario", "\"P-H-D\", \"L-H-D\"", "scenario = \"P-H-D\""),
            other("L-H-D")
        );
        assert_eq!(
            contrast("environment.sigma", "0.4, 0.6", "environment.sigma = 0.4"),
            other("0.6")
        );
        let lacks = contrast("agent", "\"rule\", \"rf\"", "agent.learning_rate = 0.001");
        assert_eq!(lacks.len(), 1, "{lacks:?}");
        assert!(contrast("agent", "\"rule\", \"rf\"", "environment.sigma = 0.4").is_empty());
        assert!(contrast("agent.learning_rate", "0.001, 0.01", "scenario = \"P-H-D\"").is_empty());
    }

    #[test]
    fn an_axis_without_jobs_and_conditions_that_no_job_meets_are_faults() {
        let curve = |conditions: &str| {
            faults(&format!(
                "kind = \"curve\"\nx = \"agent.learning_rate\"\nwhere = {{ {conditions} }}\n"
            ))
        };
        assert_eq!(
            curve("agent.name = \"rule\""),
            ["no job that `where` selects has the key `agent.learning_rate`"]
        );
        assert_eq!(
            curve("agent.name = \"rule\", agent.learning_rate = 0.001"),
            ["no job meets all conditions of `where`"]
        );
        assert!(curve("environment.sigma = 0.4").is_empty());
    }
}
