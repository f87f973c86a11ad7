//! The days of single people: recorded variables over their decisions.

use super::arm::{ArmId, arms};
use crate::job::distinct;
use crate::manifest::kind::Days;
use crate::record::{JobRecord, PersonDecision};

/// The days of some people of every arm, of its first seed with decisions.
#[derive(Clone, Debug, PartialEq)]
pub struct DaysFigure {
    /// One per arm and person.
    pub people: Vec<PersonDays>,
    /// The people without decisions, by their numbers.
    pub absent: Vec<u32>,
    /// The names that no recorded variable has.
    pub unknown: Vec<String>,
    /// The number of recorded variables that are not drawn, because none is named.
    pub left_out: usize,
    /// The number of people beyond the first 60 of all arms, who are not drawn.
    pub beyond: usize,
}

/// The days of a person.
#[derive(Clone, Debug, PartialEq)]
pub struct PersonDays {
    /// The arm.
    pub name: ArmId,
    /// The seed.
    pub seed: u64,
    /// The number of the person, from 1.
    pub person: u32,
    /// The decisions, each with its number and action; NaN for the action where none could be sent.
    pub actions: Vec<(u32, f64)>,
    /// The variables, each with its number at every decision; NaN where it is unknown.
    pub variables: Vec<(String, Vec<f64>)>,
}

/// The most variables that are drawn unless they are named.
const MOST_UNNAMED: usize = 8;

/// The most people of all arms that are drawn.
const MOST_DRAWN: usize = 60;

/// What a trial records beside the state, and is drawn if it is named.
const CLOCKS: [&str; 2] = ["calendar_day", "policy"];

/// The name of the reward among variables, unless a variable has it.
const REWARD: &str = "reward";

/// The figure of these jobs.
pub fn figure(kind: &Days, jobs: &[&JobRecord]) -> DaysFigure {
    let mut figure = DaysFigure {
        people: Vec::new(),
        absent: Vec::new(),
        unknown: Vec::new(),
        left_out: 0,
        beyond: 0,
    };
    for arm in arms(jobs, &[]) {
        let read = arm.jobs.iter().find_map(|job| {
            let days = &job.completed()?.days;
            (!days.is_empty()).then_some((job.seed, days))
        });
        let Some((seed, days)) = read else { continue };
        for person in &kind.people {
            let own: Vec<&PersonDecision> =
                days.iter().filter(|one| one.person == *person).collect();
            if own.is_empty() {
                figure.absent.push(*person);
                continue;
            }
            if figure.people.len() == MOST_DRAWN {
                figure.beyond += 1;
                continue;
            }
            let names = figure.names(kind, own[0]);
            let variables = names.into_iter().filter_map(|name| {
                let numbers: Vec<f64> = own.iter().map(|one| number(one, &name)).collect();
                numbers.iter().any(|number| number.is_finite()).then_some((name, numbers))
            });
            figure.people.push(PersonDays {
                name: arm.name.clone(),
                seed,
                person: *person,
                actions: own.iter().map(|one| (one.step, one.action)).collect(),
                variables: variables.collect(),
            });
        }
    }
    figure.absent = distinct(figure.absent);
    figure.unknown = distinct(figure.unknown);
    figure
}

impl DaysFigure {
    /// The names of the variables to draw, without those that are unknown.
    fn names(&mut self, kind: &Days, first: &PersonDecision) -> Vec<String> {
        let recorded = || first.state.iter().map(|(name, _)| name.as_str());
        if kind.variables.0.is_empty() {
            let own = recorded().filter(|name| !CLOCKS.contains(name) && *name != REWARD);
            let mut names: Vec<String> =
                [REWARD].into_iter().chain(own).map(str::to_owned).collect();
            self.left_out = self.left_out.max(names.len().saturating_sub(MOST_UNNAMED));
            names.truncate(MOST_UNNAMED);
            return names;
        }
        let is_known = |name: &String| name == REWARD || recorded().any(|known| known == name);
        let (known, unknown) = distinct(kind.variables.0.clone()).into_iter().partition(is_known);
        let unknown: Vec<String> = unknown;
        self.unknown.extend(unknown);
        known
    }
}

/// The number of a variable at a decision; NaN if it is not recorded there.
fn number(day: &PersonDecision, name: &str) -> f64 {
    let known = day.state.iter().find(|(known, _)| known == name).map(|(_, number)| *number);
    known.unwrap_or(if name == REWARD { day.reward } else { f64::NAN })
}
