//! Simulations of jobs: vector environments of any family, with what tests and records need from them.

use std::any::Any;
use std::fmt;
use std::io;

use crate::env::observation::{ObservationSpec, Observations};
use crate::env::vector::{
    Action, ActionSpec, EpisodeStatus, LaneSet, LaneStreams, VectorEnvironment,
};
use crate::state::{Resumable, StateError, StateReader, StateWriter};

/// One number of the state of every lane, \[lanes\].
#[derive(Clone, Copy, Debug)]
pub enum StateColumn<'a> {
    /// True or false.
    Flags(&'a [bool]),
    /// Small whole numbers.
    Bytes(&'a [u8]),
    /// Any numbers.
    Reals(&'a [f64]),
}

impl StateColumn<'_> {
    /// The number of a lane; 0 or 1 for a flag.
    pub fn at(self, lane: usize) -> f64 {
        match self {
            StateColumn::Flags(flags) => f64::from(u8::from(flags[lane])),
            StateColumn::Bytes(numbers) => f64::from(numbers[lane]),
            StateColumn::Reals(numbers) => numbers[lane],
        }
    }
}

/// A vector environment that jobs can train and test in.
pub trait Simulation: VectorEnvironment + Any + fmt::Debug + Send + Sync {
    /// The same simulation with another number of lanes, all ended.
    fn with_lanes(&self, lanes: usize) -> Simulated;

    /// The same lanes in the same state.
    ///
    /// **Errors**: the state cannot be saved.
    fn copied(&self) -> io::Result<Simulated> {
        let mut bytes = Vec::new();
        self.save(&mut StateWriter::new(&mut bytes))?;
        let mut copy = self.with_lanes(self.lanes());
        copy.restore(&mut StateReader::new(&mut &bytes[..])).map_err(io::Error::other)?;
        Ok(copy)
    }

    /// The number of steps taken in each lane's episode, \[lanes\].
    fn times(&self) -> &[u32];

    /// The number of steps taken in a lane's episode.
    fn time(&self, lane: usize) -> u32 {
        self.times()[lane]
    }

    /// Whether a lane's next step is part of its episode. True by default.
    fn is_counted(&self, lane: usize) -> bool {
        let _ = lane;
        true
    }

    /// Whether a message is available in a lane's next step, apart from any budget of messages. The default is
    /// [`VectorEnvironment::can_send`].
    fn is_available(&self, lane: usize) -> bool {
        self.can_send(lane)
    }

    /// The action that a lane takes if `action` is chosen: action 0 where no message can be sent.
    fn taken(&self, lane: usize, action: Action) -> Action {
        if self.can_send(lane) { action } else { Action::default() }
    }

    /// Whether a lane's episode, which has ended, was terminated within its counted steps.
    fn has_terminated(&self, lane: usize) -> bool {
        self.statuses()[lane] == EpisodeStatus::Terminated
    }

    /// The cost of a message to the person in a lane. 0 by default.
    fn message_cost(&self, lane: usize) -> f64 {
        let _ = lane;
        0.0
    }

    /// Whether what a decision costs is known with its reward alone, which is less than its outcome by the cost. False by
    /// default.
    fn costs_follow(&self) -> bool {
        false
    }

    /// The action that a lane's next step takes whatever is chosen, and the probabilities of all actions that it was drawn
    /// from, in a trial that happened; `None`, the default, in a simulation.
    fn recorded(&self, lane: usize) -> Option<(Action, &[f64])> {
        let _ = lane;
        None
    }

    /// The number of the person in a lane, from 1, in a trial that happened; `None`, the default, in a simulation.
    fn person(&self, lane: usize) -> Option<u32> {
        let _ = lane;
        None
    }

    /// The lanes the outcomes of whose last steps can reach an agent; by default all.
    fn reached(&self) -> LaneSet<'_> {
        LaneSet::All
    }

    /// Whether a lane's person has no further step that counts.
    fn is_over(&self, lane: usize) -> bool {
        self.statuses()[lane] != EpisodeStatus::Running || !self.is_counted(lane)
    }

    /// The stratum of a lane's next decision, below the number of strata of its model. 0 by default.
    fn stratum(&self, lane: usize) -> usize {
        let _ = lane;
        0
    }

    /// Calls `show` with the names and columns of the state before the next step, which programs show beside
    /// observations. None by default.
    fn show_state<'s>(&'s self, show: &mut dyn FnMut(&'s str, StateColumn<'s>)) {
        let _ = show;
    }

    /// The state of a lane as a text. The default has the name and the number of every column.
    fn described_state(&self, lane: usize) -> String {
        let mut shown: Vec<String> = Vec::new();
        self.show_state(&mut |name, column| {
            shown.push(match column {
                StateColumn::Reals(numbers) => format!("{name} {:.2}", numbers[lane]),
                column => format!("{name} {}", column.at(lane)),
            });
        });
        shown.join(", ")
    }

    /// Appends the recorded state of a lane before its next step: one number for each name of its model. The default
    /// has the columns of [`Simulation::show_state`].
    fn record_state(&self, lane: usize, state: &mut Vec<f64>) {
        self.show_state(&mut |_, column| state.push(column.at(lane)));
    }

    /// Completes the record of a lane's last decision: the numbers of its state that follow the choice, and its cost, which
    /// the reward that was paid is less than the outcome. Does nothing by default.
    fn complete(&self, lane: usize, reward: f64, state: &mut [f64], cost: &mut f64) {
        let _ = (lane, reward, state, cost);
    }

    /// Finite bounds for features whose specification has infinite ones. Those of `f32` by default.
    fn finite_bounds(&self) -> [f32; 2] {
        [f32::MIN, f32::MAX]
    }

    /// Replaces `out` by the features of a lane's observation in full precision. The default has the precision of
    /// `observations`, those of all lanes.
    fn exact_features(&self, lane: usize, observations: &Observations, out: &mut Vec<f64>) {
        out.clear();
        out.extend(observations.row(lane).iter().copied().map(f64::from));
    }

    /// Whether [`Simulation::exact_features`] reads `observations`; true by default.
    fn exact_features_read_observations(&self) -> bool {
        true
    }

    /// Makes the people of lanes that are reset those in these rows of the file of people, \[lanes\]. Does nothing
    /// by default.
    fn assign(&mut self, rows: &[u32]) {
        let _ = rows;
    }

    /// Why the simulation cannot go on; its numbers mean nothing then. None by default.
    fn failure(&self) -> Option<&str> {
        None
    }

    /// Hears that a day of a trial begins, counted from 0. Does nothing by default.
    fn begin_day(&mut self, day: u32) {
        let _ = day;
    }

    /// Ends the episode of a lane, whose person leaves.
    fn leave(&mut self, lane: usize);

    /// Appends the values drawn for the participant in a lane, with the indices of their parameters. None by default.
    fn participant(&self, lane: usize, values: &mut Vec<(usize, f64)>) {
        let _ = (lane, values);
    }

    /// The simulation whose state a rule reads instead of this one's; `None`, the default, for this one's.
    fn shown(&self) -> Option<&dyn Any> {
        None
    }
}

/// A simulation of any family.
pub type Simulated = Box<dyn Simulation>;

impl dyn Simulation {
    /// The simulation, or the one that it shows instead, if it is of this type.
    pub fn downcast<S: Simulation>(&self) -> Option<&S> {
        self.shown().unwrap_or(self as &dyn Any).downcast_ref()
    }

    /// The simulation to change, if it is of this type.
    pub fn downcast_mut<S: Simulation>(&mut self) -> Option<&mut S> {
        (self as &mut dyn Any).downcast_mut()
    }
}

impl VectorEnvironment for Simulated {
    fn lanes(&self) -> usize {
        (**self).lanes()
    }

    fn action_spec(&self) -> ActionSpec {
        (**self).action_spec()
    }

    fn observation_spec(&self) -> ObservationSpec {
        (**self).observation_spec()
    }

    fn reset(&mut self, lanes: LaneSet<'_>, streams: &mut LaneStreams) {
        (**self).reset(lanes, streams);
    }

    fn step(&mut self, actions: &[Action], rewards: &mut [f64], streams: &mut LaneStreams) {
        (**self).step(actions, rewards, streams);
    }

    fn expect(&mut self, probabilities: &[f64]) {
        (**self).expect(probabilities);
    }

    fn statuses(&self) -> &[EpisodeStatus] {
        (**self).statuses()
    }

    fn observe(&self, out: &mut Observations) {
        (**self).observe(out);
    }

    fn outcomes<'a>(&'a self, rewards: &'a [f64]) -> &'a [f64] {
        (**self).outcomes(rewards)
    }

    fn can_send(&self, lane: usize) -> bool {
        (**self).can_send(lane)
    }
}

impl Resumable for Simulated {
    fn save(&self, out: &mut StateWriter<'_>) -> std::io::Result<()> {
        (**self).save(out)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        (**self).restore(from)
    }
}
