//! The two sides of a difference, at every setting of the other parameters.

use std::collections::HashMap;

use super::arm::{Arm, ArmId, Token, arms, cells, varying};
use crate::analyse::grouped;
use crate::job::Condition;
use crate::key::Parameter;
use crate::manifest::Sides;
use crate::record::JobRecord;

/// The arms that one difference compares.
#[derive(Clone, Debug)]
pub struct Pair<'j> {
    /// What distinguishes the difference from the others of its analysis.
    pub name: ArmId,
    /// The jobs of the first side.
    pub first: Vec<&'j JobRecord>,
    /// The jobs of the second side.
    pub second: Vec<&'j JobRecord>,
}

/// The differences between the sides, in order of first appearance. Parameters in `aside` distinguish no
/// difference.
///
/// Both sides of a difference have the same environment, population and settings of the agent. If the
/// sides are two agents, a setting that only one of them sweeps has a difference per value: the other
/// agent lacks the key, or has a single value of its own.
pub fn pairs<'j>(sides: &Sides, jobs: &[&'j JobRecord], aside: &[&str]) -> Vec<Pair<'j>> {
    let select = |side: &Condition| -> Vec<&'j JobRecord> {
        jobs.iter().filter(|job| side.is_met_by(job)).copied().collect()
    };
    let (first, second) = (select(&sides.first), select(&sides.second));
    let swept = [varying(&first), varying(&second)];
    let both: Vec<&JobRecord> = first.iter().chain(&second).copied().collect();
    let mut names = varying(&both);
    // Exclusions can leave each agent an environment of its own; these are not compared either.
    for name in cells(&both).flat_map(|job| both[0].settings.differing(&job.settings)) {
        if !name.starts_with("agent.") && !names.iter().any(|known| known == name) {
            names.push(name.to_owned());
        }
    }
    names.retain(|name| !aside.contains(&name.as_str()));
    let are_agents = sides.first.parameter == Parameter::AGENT_NAME;
    let is_of_one = |name: &String| {
        are_agents && name.starts_with("agent.") && !swept.iter().all(|swept| swept.contains(name))
    };
    // What both sides of a difference have in common.
    let shared: Vec<&String> = names.iter().filter(|name| !is_of_one(name)).collect();
    // A setting that one side sweeps has that side's value in the name.
    let named = |one: &ArmId, other: &ArmId| {
        let from = |name: &String| {
            let arm = if is_of_one(name) && swept[1].contains(name) { other } else { one };
            arm.settings.iter().find(|(key, _)| key == name).cloned()
        };
        ArmId { settings: names.iter().filter_map(from).collect(), ..one.clone() }
    };
    let compared = sides.first.parameter;
    let [firsts, seconds] =
        [first, second].map(|jobs| distinguished(arms(&jobs, aside), &names, compared));
    let mut partners: HashMap<_, Vec<&Arm<'j>>> = HashMap::new();
    for arm in &seconds {
        partners.entry(common(&arm.name, &shared)).or_default().push(arm);
    }
    let all = firsts.iter().flat_map(|one| {
        let partners = partners.get(&common(&one.name, &shared));
        partners.into_iter().flatten().map(move |other| (one, other))
    });
    all.map(|(one, other)| Pair {
        name: named(&one.name, &other.name),
        first: one.jobs.clone(),
        second: other.jobs.clone(),
    })
    .collect()
}

/// The arms of a side by what distinguishes its differences: these parameters, varied on the side or not, and agent and
/// scenario unless they are compared. Arms that nothing distinguishes are one.
fn distinguished<'j>(arms: Vec<Arm<'j>>, names: &[String], compared: Parameter) -> Vec<Arm<'j>> {
    let named = arms.into_iter().map(|mut arm| {
        let job = arm.jobs[0];
        let settings = names.iter().filter_map(|name| Some((name, job.setting(name)?)));
        arm.name.settings = settings.map(|(name, value)| (name.clone(), value.clone())).collect();
        match compared {
            Parameter::SCENARIO => arm.name.scenario.clear(),
            Parameter::AGENT_NAME => arm.name.agent.clear(),
            _ => {}
        }
        let tokens: Vec<Option<Token<'_>>> =
            names.iter().map(|name| job.setting(name).map(Token::of)).collect();
        ((arm.name.agent.clone(), arm.name.scenario.clone(), tokens), arm)
    });
    let merged = |mut one: Arm<'j>, other: Arm<'j>| {
        one.jobs.extend(other.jobs);
        one
    };
    let same = grouped(named).into_iter();
    same.filter_map(|(_, arms)| arms.into_iter().reduce(merged)).collect()
}

/// The agent, the scenario and the values of these parameters, as a key of a table.
fn common<'n>(arm: &'n ArmId, names: &[&String]) -> (&'n str, &'n str, Vec<Option<Token<'n>>>) {
    let token = |name: &&String| {
        let setting = arm.settings.iter().find(|(key, _)| key == *name);
        setting.map(|(_, value)| Token::of(value))
    };
    (&arm.agent, &arm.scenario, names.iter().map(token).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::manifest::{Manifest, parse};
    use crate::plan;
    use crate::record::JobStatus;

    fn manifest(keys: &str, by: &str, between: [&str; 2]) -> Manifest {
        let text = format!(
            "format = 1\nname = \"t\"\nscenarios = [\"P-H-D\", \"L-H-D\"]\nseeds = 2\n\
             environment.sigma = [0.4, 0.6]\n{keys}\n[[agent]]\nname = \"rule\"\nalgorithm = \"rule\"\n\
             rule = \"tailored\"\n[[analysis]]\nname = \"a\"\nkind = \"contrast\"\nby = \"{by}\"\n\
             between = [\"{}\", \"{}\"]\n",
            between[0], between[1]
        );
        parse("t", text.as_bytes()).unwrap()
    }

    /// The label of each difference, and the numbers of jobs of its sides.
    fn found(manifest: &Manifest) -> Vec<(String, usize, usize)> {
        let jobs: Vec<JobRecord> = plan::jobs(manifest)
            .map(|planned| JobRecord::new(&planned, planned.form.key(), JobStatus::Pending))
            .collect();
        let jobs: Vec<&JobRecord> = jobs.iter().collect();
        let sides = manifest.analyses[0].kind.sides().unwrap();
        let label = |name: &ArmId| {
            let settings = name.settings.iter().map(|(key, value)| format!(" {key}={value}"));
            format!("{} {}{}", name.agent, name.scenario, settings.collect::<String>())
        };
        pairs(sides, &jobs, &[])
            .iter()
            .map(|pair| (label(&pair.name), pair.first.len(), pair.second.len()))
            .collect()
    }

    #[test]
    fn a_setting_that_one_agent_sweeps_has_a_difference_per_value() {
        let learner = "[[agent]]\nname = \"learner\"\nalgorithm = \"reinforce\"\nepisodes = 10\n\
                       learning_rate = [0.001, 0.003]";
        for between in [["learner", "rule"], ["rule", "learner"]] {
            let found = found(&manifest(learner, "agent.name", between));
            assert_eq!(found.len(), 8, "{found:?}");
            for rate in ["0.001", "0.003"] {
                let label = format!(" P-H-D agent.learning_rate={rate} environment.sigma=0.6");
                assert!(found.contains(&(label, 2, 2)), "{found:?}");
            }
        }
    }

    #[test]
    fn settings_that_both_agents_sweep_are_compared_value_by_value() {
        let learners = "[[agent]]\nname = \"one\"\nalgorithm = \"reinforce\"\nepisodes = 10\n\
                        learning_rate = [0.001, 0.003]\n\
                        [[agent]]\nname = \"two\"\nalgorithm = \"reinforce\"\nepisodes = 20\n\
                        learning_rate = [0.003, 0.01]";
        let found = found(&manifest(learners, "agent.name", ["one", "two"]));
        let labels: Vec<&str> = found.iter().map(|(label, ..)| label.as_str()).collect();
        assert_eq!(found.len(), 4, "{found:?}");
        assert!(labels.iter().all(|label| label.contains("learning_rate=0.003")), "{labels:?}");
    }

    #[test]
    fn agents_in_different_environments_are_not_compared() {
        let apart = "[[agent]]\nname = \"learner\"\nalgorithm = \"reinforce\"\nepisodes = 10\n\
                     [[exclude]]\nagent.name = \"learner\"\nenvironment.sigma = 0.4\n\
                     [[exclude]]\nagent.name = \"rule\"\nenvironment.sigma = 0.6";
        let found = found(&manifest(apart, "agent.name", ["learner", "rule"]));
        assert!(found.is_empty(), "{found:?}");
    }

    #[test]
    fn sides_that_are_scenarios_have_the_same_agent_and_settings() {
        let learner = "[[agent]]\nname = \"learner\"\nalgorithm = \"reinforce\"\nepisodes = 10\n\
                       learning_rate = [0.001, 0.003]\n[[exclude]]\nscenario = \"L-H-D\"\n\
                       agent.learning_rate = 0.003";
        let found = found(&manifest(learner, "scenario", ["P-H-D", "L-H-D"]));
        // Two sigmas, for the rule and for the only rate that both scenarios have.
        assert_eq!(found.len(), 4, "{found:?}");
        assert!(found.iter().all(|(label, first, second)| {
            !label.contains("0.003") && (*first, *second) == (2, 2)
        }));
    }
}
