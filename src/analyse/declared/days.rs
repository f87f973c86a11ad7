//! The days of single people: recorded variables over their decisions.

use super::arm::{ArmId, arms};
use crate::manifest::kind::Days;
use crate::record::JobRecord;

/// The days of a person.
#[derive(Clone, Debug, PartialEq)]
pub struct DaysFigure {
    /// The arm.
    pub name: ArmId,
    /// The seed.
    pub seed: u64,
    /// The number of the person, from 1.
    pub person: u32,
    /// The decisions, each with its number and action; NaN for the action where none could be chosen.
    pub actions: Vec<(u32, f64)>,
    /// The variables, each with its number at every decision; NaN where it is unknown.
    pub variables: Vec<(String, Vec<f64>)>,
}

/// The most variables that are drawn unless they are named.
const MOST_UNNAMED: usize = 8;

/// What a trial records beside the state, and is drawn if it is named.
const CLOCKS: [&str; 2] = ["calendar_day", "policy"];

/// The name of the reward among variables.
const REWARD: &str = "reward";

/// One figure per arm and person, of the first seed whose decisions were read.
pub fn figures(kind: &Days, jobs: &[&JobRecord]) -> Vec<DaysFigure> {
    let mut figures = Vec::new();
    for arm in arms(jobs, &[]) {
        let read = arm.jobs.iter().find_map(|job| {
            let days = &job.completed()?.days;
            (!days.is_empty()).then_some((job.seed, days))
        });
        let Some((seed, days)) = read else { continue };
        for person in &kind.people {
            let own: Vec<_> = days.iter().filter(|one| one.person == *person).collect();
            let Some(first) = own.first() else { continue };
            let mut names = kind.variables.0.clone();
            if names.is_empty() {
                let recorded = first.state.iter().map(|(name, _)| name.clone());
                let recorded = recorded.filter(|name| !CLOCKS.contains(&name.as_str()));
                names = [REWARD.to_owned()].into_iter().chain(recorded).collect();
                names.truncate(MOST_UNNAMED);
            }
            let variables = names.into_iter().map(|name| {
                let number = |one: &&crate::record::RecordedDay| {
                    let known = one.state.iter().find(|(known, _)| *known == name);
                    match known {
                        Some((_, number)) => *number,
                        None if name == REWARD => one.reward,
                        None => f64::NAN,
                    }
                };
                let numbers: Vec<f64> = own.iter().map(number).collect();
                (name, numbers)
            });
            figures.push(DaysFigure {
                name: arm.name.clone(),
                seed,
                person: *person,
                actions: own.iter().map(|one| (one.step, one.action)).collect(),
                variables: variables.filter(|(_, all)| all.iter().any(|x| x.is_finite())).collect(),
            });
        }
    }
    figures
}
