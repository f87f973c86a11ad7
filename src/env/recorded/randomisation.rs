//! Whether actions were drawn with the recorded probabilities: counts by person, day, decision of the day and state.

use std::collections::BTreeMap;
use std::iter;

use crate::env::recorded::drawn::{DrawnGroup, Grouping, Randomisation};
use crate::env::recorded::log::{LogPerson, RecordedLog};

/// The most values of a state by which decisions are counted one by one; by quarters otherwise.
const FEW: usize = 6;

/// The word of the grouping of all decisions.
const ALL: &str = "all";
/// The word of the grouping by person.
const PERSON: &str = "person";

/// The most messages that are counted by person, day and state, each alone.
const MOST_MESSAGES: usize = 5;

/// Available decisions, each with what it is grouped by.
struct Groups<'l> {
    log: &'l RecordedLog,
    /// The action that is counted; any above 0 without one.
    action: Option<usize>,
    groups: BTreeMap<u64, DrawnGroup>,
}

impl Groups<'_> {
    fn add(&mut self, key: u64, decision: usize) {
        let group = self.groups.entry(key).or_default();
        let (taken, first) = (usize::from(self.log.taken[decision]), decision * self.log.actions);
        let (is_counted, p) = match self.action {
            Some(action) => (taken == action, self.log.probabilities[first + action]),
            None => (taken > 0, 1.0 - self.log.probabilities[first]),
        };
        group.decisions += 1;
        group.taken += u64::from(is_counted);
        group.expected += p;
        let variance = p * (1.0 - p);
        group.variance += variance;
        group.fourth_cumulant += variance * (1.0 - 6.0 * variance);
    }
}

impl Randomisation {
    /// The counts of a log.
    pub(super) fn of(log: &RecordedLog) -> Randomisation {
        let is_drawn = &log.is_drawn[..];
        let count = |by: &str,
                     action: Option<usize>,
                     key: &dyn Fn(usize, usize, u32) -> Option<u64>,
                     name: &dyn Fn(u64) -> String| {
            let mut groups = Groups { log, action, groups: BTreeMap::new() };
            for (person, own) in log.people.iter().enumerate() {
                for step in 0..own.decisions {
                    let decision = own.first + step as usize;
                    let key = key(decision, person, step).filter(|_| is_drawn[decision]);
                    key.into_iter().for_each(|key| groups.add(key, decision));
                }
            }
            let named = |(key, group): (u64, DrawnGroup)| DrawnGroup { name: name(key), ..group };
            let groups = groups.groups.into_iter().map(named).collect();
            Grouping { by: by.to_owned(), action, groups }
        };
        // Of two actions, the share of one says all.
        let messages = if log.actions > 2 { log.actions - 1 } else { 0 };
        let grouping = |by: &str,
                        key: &dyn Fn(usize, usize, u32) -> Option<u64>,
                        name: &dyn Fn(u64) -> String| {
            let each = if by == ALL || messages <= MOST_MESSAGES { messages } else { 0 };
            let actions = iter::once(None).chain((1..=each).map(Some));
            actions.map(|action| count(by, action, key, name)).collect::<Vec<_>>()
        };
        let per_day = log.per_day;
        let number = |key: u64| key.to_string();
        let day = |_: usize, person: usize, step: u32| {
            Some(u64::from(log.people[person].start_day + step / per_day))
        };
        let mut groupings = grouping(ALL, &|_, _, _| Some(0), &|_| ALL.to_owned());
        groupings.extend(grouping(PERSON, &|_, person, _| Some(person as u64 + 1), &number));
        groupings.extend(grouping("day of the trial", &day, &number));
        if per_day > 1 {
            let slot = |_: usize, _: usize, step: u32| Some(u64::from(step % per_day));
            groupings.extend(grouping("decision of the day", &slot, &number));
        }
        let before = |decision: usize, _: usize, step: u32| {
            let before = (step > 0).then(|| decision - 1).filter(|one| is_drawn[*one])?;
            Some(u64::from(log.taken[before]))
        };
        groupings.extend(grouping("the action before", &before, &number));
        for (index, name) in log.names.iter().enumerate() {
            let value = |decision: usize| log.state[decision * log.names.len() + index];
            let ends = ends((0..is_drawn.len()).filter(|one| is_drawn[*one]).map(value));
            let key = |decision: usize, _: usize, _: u32| {
                let value = value(decision);
                ends.iter().position(|(_, last)| value <= *last).map(|group| group as u64)
            };
            let within = |group: u64| match ends[group as usize] {
                (first, last) if first == last => first.to_string(),
                (first, last) => format!("{first:.3} to {last:.3}"),
            };
            groupings.extend(grouping(name, &key, &within));
        }
        groupings.retain(|grouping| grouping.by == ALL || grouping.groups.len() > 1);
        Randomisation { groupings, counts: counts(log, is_drawn) }
    }

    /// Replaces the numbers of people by these names.
    pub(super) fn name_people(&mut self, names: &[String]) {
        let of_people = self.groupings.iter_mut().filter(|grouping| grouping.by == PERSON);
        for group in of_people.flat_map(|grouping| &mut grouping.groups) {
            let number: usize = group.name.parse().unwrap_or(0);
            let name = number.checked_sub(1).and_then(|index| names.get(index));
            group.name = name.cloned().unwrap_or_default();
        }
    }
}

/// The first and last value of each group: of each value if there are few, of each quarter otherwise.
fn ends(values: impl Iterator<Item = f64>) -> Vec<(f64, f64)> {
    let mut values: Vec<f64> = values.filter(|value| !value.is_nan()).collect();
    values.sort_by(f64::total_cmp);
    let mut distinct = values.clone();
    distinct.dedup();
    if distinct.len() <= FEW {
        return distinct.into_iter().map(|value| (value, value)).collect();
    }
    let mut ends: Vec<(f64, f64)> = Vec::new();
    for quarter in 1..=4 {
        let last = values[(values.len() * quarter / 4).max(1) - 1];
        let after = ends.last().map_or(f64::NEG_INFINITY, |(_, last)| *last);
        if let Some(first) =
            values.iter().find(|value| **value > after).filter(|first| **first <= last)
        {
            ends.push((*first, last));
        }
    }
    ends
}

fn counts(log: &RecordedLog, is_drawn: &[bool]) -> Vec<(String, u64)> {
    let drawn = || (0..is_drawn.len()).filter(|decision| is_drawn[*decision]);
    let chances =
        |decision: usize| &log.probabilities[decision * log.actions..(decision + 1) * log.actions];
    let mut distinct: Vec<u64> = drawn().map(|one| chances(one)[0].to_bits()).collect();
    distinct.sort_unstable();
    distinct.dedup();
    let certain = drawn().filter(|one| chances(*one).contains(&1.0)).count();
    let unavailable = log.is_used.iter().zip(&log.is_available);
    let unavailable = unavailable.filter(|(used, available)| **used && !**available).count();
    let longest = log.people.iter().map(|person| person.decisions).max().unwrap_or(0);
    let is_early = |person: &&LogPerson| {
        let own = person.first..person.first + person.decisions as usize;
        let last = own.clone().rev().find(|one| log.is_used[*one] || is_drawn[*one]);
        let known = last.map_or(0, |last| last + 1 - person.first);
        (known as f64) < 0.9 * f64::from(longest)
    };
    let count = |what: &str, number: usize| (what.to_owned(), number as u64);
    vec![
        count("people", log.people.len()),
        count(
            "people who stop before nine tenths of the longest stay",
            log.people.iter().filter(is_early).count(),
        ),
        count("decisions at which an action could be drawn", drawn().count()),
        count("decisions without availability, all with action 0", unavailable),
        count("decisions whose action was certain", certain),
        count("different probabilities", distinct.len()),
    ]
}
