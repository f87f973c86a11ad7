//! Simulated pilots: the people of a fit at the pilot's decisions, under the pilot's probabilities.

use std::ops::Range;
use std::sync::{Arc, OnceLock};

use crate::env::declared::model::{NeededColumn, ReplayOrder};
use crate::env::declared::pilot::terms::Pilot;
use crate::env::declared::program::compile;
use crate::env::declared::rows::Numbers;
use crate::env::declared::world::{World, WorldParts};
use crate::env::observation::Observations;
use crate::env::simulation::Simulation;
use crate::env::vector::{Action, LaneSet, LaneStreams, VectorEnvironment};
use crate::rng::{Purpose, Stream};

/// A world of the people of a fit.
#[derive(Debug)]
pub struct PilotWorld {
    parts: Arc<WorldParts>,
    /// \[people\]: their decisions in the pilot.
    decisions: Vec<Range<usize>>,
    /// \[decisions\]: the probability that an action is taken.
    probabilities: Vec<f64>,
}

/// People of a long simulation, about.
const MOST_LANES: usize = 1000;

/// The decisions of all people of one simulated pilot; NaN for people who take no part.
#[derive(Clone, Debug)]
pub struct SimulatedDecisions {
    /// \[decisions\].
    pub outcomes: Vec<f64>,
    /// \[decisions\].
    pub actions: Vec<f64>,
    /// \[features, decisions\].
    pub features: Vec<Vec<f64>>,
}

/// What a long simulation shows of the recursion.
#[derive(Clone, Copy, Debug)]
pub struct LongRun {
    /// The number of decisions of each person.
    pub decisions: usize,
    /// The largest outcome, by size.
    pub largest: f64,
    /// The mean outcome in each quarter of the time.
    pub quarters: [f64; 4],
}

impl Pilot {
    /// The world of the people in this text of `people.csv`, who are those that take part, with these parameters.
    ///
    /// **Errors**: the text lacks a column.
    pub fn world(
        &self,
        people: &str,
        takes_part: &[bool],
        parameters: &[(String, f64)],
    ) -> Result<PilotWorld, String> {
        let model = Arc::clone(&self.model);
        let value = |name: &str| parameters.iter().find(|(known, _)| known == name);
        let of = model.parameters.iter();
        let parameters: Vec<f64> =
            of.map(|one| value(&one.name).map_or(one.default, |(_, value)| *value)).collect();
        let numbers = Numbers::people(people)?;
        let column = |one: &NeededColumn| {
            one.find(&numbers).map_err(|_| format!("`{}` is no column of the people", one.name))
        };
        let columns = model.columns.iter().map(column).collect::<Result<Vec<usize>, String>>()?;
        let people = self.people.iter().zip(takes_part).filter(|(_, takes_part)| **takes_part);
        let decisions: Vec<Range<usize>> = people.map(|(one, _)| one.decisions.clone()).collect();
        let replayed = self.clamped.replayed();
        let contexts: Vec<Vec<f64>> =
            replayed.into_iter().map(|(_, values)| self.filled(values)).collect();
        let width = contexts.len();
        let rows = self.used.len();
        let mut all = Vec::with_capacity(rows * width);
        (0..rows).for_each(|row| all.extend(contexts.iter().map(|values| values[row])));
        let replay = (width > 0).then(|| Arc::new(Numbers::of(width, all)));
        let parts = WorldParts {
            program: Arc::new(compile(&model, &parameters)),
            shown: (0..model.roles.features.len()).collect(),
            parameters,
            people: (!columns.is_empty()).then(|| Arc::new(numbers)),
            columns,
            rows: if replay.is_some() { decisions.clone() } else { Vec::new() },
            replay,
            replayed: (0..width).collect(),
            failure: Arc::new(OnceLock::new()),
            model,
        };
        Ok(PilotWorld { parts: Arc::new(parts), decisions, probabilities: self.probabilities() })
    }

    /// Numbers by decision, in which a missing one is the one before it of the same person, or else the next.
    fn filled(&self, mut values: Vec<f64>) -> Vec<f64> {
        for person in &self.people {
            let own = &mut values[person.decisions.clone()];
            let mut last = own.iter().copied().find(|value| !value.is_nan()).unwrap_or(0.0);
            for value in own {
                *value = if value.is_nan() { last } else { *value };
                last = *value;
            }
        }
        values
    }

    /// The probability of an action at each decision: the recorded one, or else the share of actions; 0 where nothing was
    /// available.
    pub fn probabilities(&self) -> Vec<f64> {
        let [actions, probabilities, available] = &self.actions;
        let could = |decision: &usize| available[*decision] != 0.0 && !actions[*decision].is_nan();
        let (mut taken, mut count) = (0.0, 0.0);
        for decision in (0..actions.len()).filter(|one| could(one) && self.used[*one]) {
            taken += f64::from(u8::from(actions[decision] > 0.0));
            count += 1.0;
        }
        let share = if count > 0.0 { taken / count } else { 0.0 };
        let own = |decision: usize| match (available[decision], probabilities[decision]) {
            (0.0, _) => 0.0,
            (_, known) if !known.is_nan() => known,
            _ => share,
        };
        (0..actions.len()).map(own).collect()
    }
}

impl PilotWorld {
    /// The number of people.
    pub fn people(&self) -> usize {
        self.decisions.len()
    }

    /// The number of decisions of one pilot.
    pub fn decisions(&self) -> usize {
        self.decisions.iter().map(ExactSizeIterator::len).sum()
    }

    /// A copy of the parts, so that one failure does not stop another simulation. Each decision has its own row; behind the
    /// last one, rows begin again.
    fn fresh(&self, days: u32) -> Arc<WorldParts> {
        let WorldParts {
            program, parameters, people, columns, replay: rows, replayed, shown, ..
        } = &*self.parts;
        let mut model = (*self.parts.model).clone();
        model.days = model.days.max(days);
        model.replay = model.replay.map(|_| ReplayOrder::Cyclic);
        Arc::new(WorldParts {
            model: Arc::new(model),
            program: Arc::clone(program),
            parameters: parameters.clone(),
            people: people.clone(),
            columns: columns.clone(),
            replay: rows.clone(),
            replayed: replayed.clone(),
            rows: self.parts.rows.clone(),
            shown: shown.clone(),
            failure: Arc::new(OnceLock::new()),
        })
    }

    /// Simulates pilots of these numbers. Each number has its own random streams.
    ///
    /// **Errors**: a number of a simulation is missing or out of its range; the text says which.
    pub fn pilots(
        &self,
        seed: u64,
        numbers: Range<u32>,
    ) -> Result<Vec<SimulatedDecisions>, String> {
        let people = self.decisions.len();
        let longest = self.decisions.iter().map(ExactSizeIterator::len).max().unwrap_or(0);
        let days = longest.div_ceil(self.parts.model.decisions_per_day as usize);
        let parts = self.fresh(days as u32);
        let all = numbers.len();
        let lanes = people * all;
        let mut world = World::new(Arc::clone(&parts), 1, lanes);
        let first = numbers.start * people as u32;
        let person = |lane| Stream::of_person(seed, Purpose::Person, first + lane);
        let mut streams = LaneStreams::PerLane((0..lanes as u32).map(person).collect());
        let mut choices: Vec<Stream> =
            numbers.map(|number| Stream::of_person(seed, Purpose::TestActions, number)).collect();
        world.assign(&(0..lanes).map(|lane| (lane % people) as u32).collect::<Vec<_>>());
        world.begin_day(0);
        world.reset(LaneSet::All, &mut streams);
        if let Some(failure) = parts.failure.get() {
            return Err(failure.clone());
        }
        let size = self.probabilities.len();
        let features = parts.shown.len();
        let empty = SimulatedDecisions {
            outcomes: vec![f64::NAN; size],
            actions: vec![f64::NAN; size],
            features: vec![vec![f64::NAN; size]; features],
        };
        let mut out = vec![empty; all];
        let count = world.action_spec().count;
        let mut expected = vec![0.0; lanes * count];
        let (mut chosen, mut rewards) = (vec![Action::default(); lanes], vec![0.0; lanes]);
        let (nothing, mut seen) = (Observations::new(features, 0), Vec::new());
        for time in 0..longest {
            for lane in 0..lanes {
                let (number, own) = (lane / people, &self.decisions[lane % people]);
                // A person who has left draws as well, so that others do not depend on it.
                let drawn = choices[number].unit();
                let Some(decision) = own.clone().nth(time) else {
                    world.leave(lane);
                    continue;
                };
                let p = self.probabilities[decision];
                let row = &mut expected[lane * count..(lane + 1) * count];
                row.fill(p / (count - 1) as f64);
                row[0] = 1.0 - p;
                let index = match drawn < p {
                    true => 1 + ((drawn / p * (count - 1) as f64) as usize).min(count - 2),
                    false => 0,
                };
                chosen[lane] = Action::from_index(index).unwrap_or_default();
                let pilot = &mut out[number];
                let taken = if world.can_send(lane) { index as f64 } else { 0.0 };
                pilot.actions[decision] = taken;
                world.exact_features(lane, &nothing, &mut seen);
                for (values, value) in pilot.features.iter_mut().zip(&seen) {
                    values[decision] = *value;
                }
            }
            world.expect(&expected);
            world.step(&chosen, &mut rewards, &mut streams);
            if let Some(failure) = parts.failure.get() {
                return Err(failure.clone());
            }
            for (lane, outcome) in world.outcomes(&rewards).iter().enumerate() {
                if let Some(decision) = self.decisions[lane % people].clone().nth(time) {
                    out[lane / people].outcomes[decision] = *outcome;
                }
            }
        }
        Ok(out)
    }

    /// Simulates everybody for the days of the model, with actions at the mean probability.
    ///
    /// **Errors**: as [`PilotWorld::pilots`].
    pub fn long_run(&self, seed: u64) -> Result<LongRun, String> {
        let parts = self.fresh(1);
        let copies = MOST_LANES.div_ceil(self.decisions.len().max(1));
        let people = copies * self.decisions.len();
        let mut world = World::new(Arc::clone(&parts), 1, people);
        let person = |lane| Stream::of_person(seed, Purpose::Person, u32::MAX - lane);
        let mut streams = LaneStreams::PerLane((0..people as u32).map(person).collect());
        let mut choices = Stream::new(seed, Purpose::TestActions);
        let p = self.probabilities.iter().sum::<f64>() / self.probabilities.len().max(1) as f64;
        world.assign(&(0..people).map(|lane| (lane / copies) as u32).collect::<Vec<_>>());
        world.begin_day(0);
        world.reset(LaneSet::All, &mut streams);
        let (mut sums, mut largest) = ([0.0; 4], 0.0f64);
        let horizon = parts.model.horizon() as usize;
        let mut counts = [0.0; 4];
        let mut rewards = vec![0.0; people];
        let count = world.action_spec().count;
        for time in 0..horizon {
            let choose = |()| {
                let index =
                    if choices.unit() < p { 1 + choices.below(count as u32 - 1) } else { 0 };
                Action::from_index(index as usize).unwrap_or_default()
            };
            let chosen: Vec<Action> = vec![(); people].into_iter().map(choose).collect();
            let row: Vec<f64> = (0..count)
                .map(|one| if one == 0 { 1.0 - p } else { p / (count - 1) as f64 })
                .collect();
            world.expect(&row.repeat(people));
            world.step(&chosen, &mut rewards, &mut streams);
            if let Some(failure) = parts.failure.get() {
                return Err(failure.clone());
            }
            for outcome in world.outcomes(&rewards) {
                largest = largest.max(outcome.abs());
                sums[time * 4 / horizon] += outcome;
                counts[time * 4 / horizon] += 1.0;
            }
        }
        let quarters = [0, 1, 2, 3].map(|index| sums[index] / counts[index]);
        Ok(LongRun { decisions: horizon, largest, quarters })
    }
}
