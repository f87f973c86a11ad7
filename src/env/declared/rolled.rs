//! A whole trial of a world with actions at random, so that its author sees where its numbers go.

use std::time::Instant;

use serde::Serialize;

use crate::env::declared::family::DeclaredModel;
use crate::env::family::Model;
use crate::env::simulation::Simulation;
use crate::env::vector::{Action, LaneSet, LaneStreams, VectorEnvironment};
use crate::rng::{Purpose, Stream};

/// The number of people of a trial without a file of people, and the most people of a trial.
const PEOPLE: usize = 200;
const MOST_PEOPLE: usize = 2000;
/// The most decisions of a trial of several people.
const MOST_DECISIONS: u64 = 2_000_000;
/// The size from which a number explodes.
const EXPLODED: f64 = 1e12;

/// The recorded numbers of a trial with actions at random.
#[derive(Clone, Debug, Serialize)]
pub struct Rolled {
    /// The number of people.
    pub people: usize,
    /// The number of their decisions.
    pub decisions: u64,
    /// The recorded variables, each with its smallest and largest number.
    pub ranges: Vec<(String, f64, f64)>,
    /// Decisions per second.
    pub speed: f64,
}

impl DeclaredModel {
    /// Rolls a trial of every person of the file, or of 200 people without one, with actions at random.
    ///
    /// **Errors**: a number is missing or explodes; the text names the variable, the person and the decision.
    pub fn rolled(&self) -> Result<Rolled, String> {
        let people = self.people_to_draw().filter(|people| *people > 0).unwrap_or(PEOPLE);
        // Long trials have fewer people.
        let few = MOST_DECISIONS / u64::from(self.longest_episode()).max(1);
        let people = people.min(MOST_PEOPLE).min(few.max(1) as usize);
        let environment = self.fresh().expect("a world can be fresh");
        let own: &DeclaredModel = environment.model().expect("it is of the same family");
        let mut world = own.simulation(&crate::env::Scenario::all(), 1, people);
        let streams = |person| Stream::of_person(1, Purpose::Person, person);
        let mut streams = LaneStreams::PerLane((0..people as u32).map(streams).collect());
        let mut choices = Stream::new(1, Purpose::Exploration);
        let names = self.state_names();
        let mut rolled = Rolled {
            people,
            decisions: 0,
            ranges: names
                .into_iter()
                .map(|name| (name, f64::INFINITY, f64::NEG_INFINITY))
                .collect(),
            speed: 0.0,
        };
        // Everybody of the file takes part.
        world.assign(&(0..people as u32).collect::<Vec<_>>());
        let begun = Instant::now();
        let failed = || own.failure().map_or(Ok(()), Err);
        world.begin_day(0);
        world.reset(LaneSet::All, &mut streams);
        failed()?;
        let actions = world.action_spec().count as u32;
        let mut rewards = vec![0.0; people];
        while world.any_running() {
            let chosen =
                |()| Action::from_index(choices.below(actions) as usize).unwrap_or_default();
            let chosen: Vec<Action> = vec![(); people].into_iter().map(chosen).collect();
            let running: Vec<bool> = world.running().collect();
            let unknown = vec![1.0 / f64::from(actions); people * actions as usize];
            world.expect(&unknown);
            let times = world.times().to_vec();
            let mut states = vec![Vec::new(); people];
            for (lane, state) in states.iter_mut().enumerate() {
                world.record_state(lane, state);
            }
            world.step(&chosen, &mut rewards, &mut streams);
            failed()?;
            for (lane, state) in states.iter_mut().enumerate().filter(|(lane, _)| running[*lane]) {
                world.complete(lane, rewards[lane], state, &mut 0.0);
                rolled.add(lane, times[lane], state)?;
            }
        }
        rolled.speed = rolled.decisions as f64 / begun.elapsed().as_secs_f64();
        Ok(rolled)
    }
}

impl Rolled {
    /// Adds the recorded numbers of a decision.
    fn add(&mut self, lane: usize, time: u32, state: &[f64]) -> Result<(), String> {
        self.decisions += 1;
        for ((name, least, most), value) in self.ranges.iter_mut().zip(state) {
            (*least, *most) = (least.min(*value), most.max(*value));
            if value.abs() >= EXPLODED {
                let person = lane + 1;
                return Err(format!(
                    "model: `{name}` explodes: it is {value:.3e} for person {person} at decision {time}"
                ));
            }
        }
        Ok(())
    }
}
