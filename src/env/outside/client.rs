//! Lanes that a program simulates.

use std::io;
use std::sync::Arc;

use crate::env::contract::Clause;
use crate::env::history::History;
use crate::env::observation::{ObservationSpec, Observations};
use crate::env::outside::program::{EnvironmentProgram, EpisodePhase};
use crate::env::simulation::{Simulated, Simulation};
use crate::env::vector::{
    Action, ActionSpec, EpisodeStatus, LaneSet, LaneStreams, VectorEnvironment,
};
use crate::external::{Observation, Observed, SentNumbers, ToEnvironment};
use crate::state::{Resumable, StateError, StateReader, StateWriter};

/// Up to this number, 32 bits hold every whole number.
const LARGEST_WHOLE: f64 = 16_777_216.0;

/// The lanes of an environment that is an outside program.
///
/// Each episode takes one word from its lane's stream, from which the program gets its seed. A step takes
/// none. After a failure of the program, all lanes have ended and rewards are 0; see
/// [`EnvironmentProgram::failure`].
#[derive(Debug)]
pub struct OutsideEnvironment {
    program: EnvironmentProgram,
    use_of: Use,
    instance: u64,
    history: Option<History>,
    statuses: Vec<EpisodeStatus>,
    /// Number of steps of each lane's episode.
    lengths: Vec<u32>,
    /// \[lanes, shown features\].
    observations: Vec<f32>,
    /// Whether every action is possible in the next step, \[lanes\].
    available: Vec<bool>,
    /// \[lanes, numbers of the state\].
    state: Vec<f64>,
    /// Number of steps of this set of lanes.
    steps: u64,
    /// The lanes of a message, and their actions or seeds.
    lanes: Vec<usize>,
    actions: Vec<u8>,
    seeds: Vec<u64>,
}

/// How lanes are used.
#[derive(Clone, Debug)]
struct Use {
    phase: EpisodePhase,
    records_state: bool,
    /// The numbers of the features that the agent observes.
    shown: Arc<[usize]>,
    /// Number of observations shown at a time.
    history: usize,
    /// The specification of one observation.
    spec: ObservationSpec,
}

impl OutsideEnvironment {
    /// Lanes for a phase, which show these features, by their numbers. With `records_state`, the program
    /// reports its state.
    pub fn new(
        program: &EnvironmentProgram,
        phase: EpisodePhase,
        shown: &[usize],
        records_state: bool,
        lanes: usize,
    ) -> Self {
        let records_state = records_state && !program.description().state.is_empty();
        let spec = program.description().observation_spec(shown);
        let use_of = Use { phase, records_state, shown: shown.into(), history: 1, spec };
        OutsideEnvironment::with_use(program, use_of, lanes)
    }

    fn with_use(program: &EnvironmentProgram, use_of: Use, lanes: usize) -> Self {
        let state = if use_of.records_state { program.description().state.len() } else { 0 };
        // The tests of a job begin with an environment without lanes.
        let instance = match lanes {
            0 => 0,
            lanes => program.begin(lanes, use_of.phase, use_of.records_state),
        };
        OutsideEnvironment {
            program: program.clone(),
            instance,
            history: History::new(use_of.history, lanes, &use_of.spec),
            statuses: vec![EpisodeStatus::Truncated; lanes],
            lengths: vec![0; lanes],
            observations: vec![0.0; lanes * use_of.shown.len()],
            available: vec![true; lanes],
            state: vec![0.0; lanes * state],
            steps: 0,
            lanes: Vec::with_capacity(lanes),
            actions: Vec::with_capacity(lanes),
            seeds: Vec::with_capacity(lanes),
            use_of,
        }
    }

    /// Other lanes of the same program, for the same purpose.
    pub fn with_lanes(&self, lanes: usize) -> Self {
        OutsideEnvironment::with_use(&self.program, self.use_of.clone(), lanes)
    }

    /// The same lanes, which show this number of observations at a time.
    pub fn with_history(mut self, history: usize) -> Self {
        self.history = History::new(history, self.statuses.len(), &self.use_of.spec);
        self.use_of.history = history;
        self
    }

    /// The program.
    pub fn program(&self) -> &EnvironmentProgram {
        &self.program
    }

    /// The recorded state of a lane before its next step; empty unless it is recorded.
    pub fn state(&self, lane: usize) -> &[f64] {
        let width = self.state.len() / self.statuses.len();
        &self.state[lane * width..(lane + 1) * width]
    }

    /// Reads an answer about [`OutsideEnvironment::lanes`], or ends all episodes after a failure.
    fn take(&mut self, answer: Option<Observed>, rewards: Option<&mut [f64]>) {
        let read = answer.map(|answer| self.read(&answer, rewards));
        match read {
            Some(Ok(())) => return,
            Some(Err(fault)) => self.program.broke(format!("{fault} {}", self.moment())),
            None => {}
        }
        self.statuses.fill(EpisodeStatus::Truncated);
    }

    /// What the program is doing, for messages.
    fn moment(&self) -> String {
        format!("in step {} of phase \"{}\"", self.steps, self.use_of.phase.word())
    }

    /// **Errors**: a description of the fault in the answer, with the clause of the contract.
    fn read(&mut self, answer: &Observed, rewards: Option<&mut [f64]>) -> Result<(), String> {
        let Observed { message, observations, terminated, truncated, available, state, .. } =
            answer;
        let expected = if rewards.is_some() { Observation::Stepped } else { Observation::Began };
        if *message != expected {
            return Err(format!("expected {expected:?}, found {message:?}").to_lowercase());
        }
        self.read_rewards(answer.rewards.as_ref(), rewards)?;
        self.read_observations(observations)?;
        self.read_available(available.as_ref())?;
        self.read_state(state.as_ref())?;
        self.read_ends(terminated.as_ref(), truncated.as_ref(), expected)
    }

    fn read_rewards(
        &self,
        found: Option<&SentNumbers>,
        rewards: Option<&mut [f64]>,
    ) -> Result<(), String> {
        let (found, rewards) = match (found, rewards) {
            (Some(found), Some(rewards)) => (found, rewards),
            (None, None) => return Ok(()),
            (Some(_), None) => return Err("expected no `rewards` after a reset".to_owned()),
            (None, Some(_)) => return Err("expected `rewards`, found none".to_owned()),
        };
        let description = self.program.description();
        let low = description.lowest_reward.unwrap_or(f64::NEG_INFINITY);
        let high = description.highest_reward.unwrap_or(f64::INFINITY);
        for (lane, reward) in self.lanes.iter().zip(self.flat("rewards", found)?) {
            if !(reward.is_finite() && (low..=high).contains(reward)) {
                let clause = Clause::RewardBounds;
                return Err(format!(
                    "expected a reward from {low} to {high} in lane {lane}, found {reward} ({clause})"
                ));
            }
            rewards[*lane] = *reward;
        }
        Ok(())
    }

    fn read_observations(&mut self, found: &SentNumbers) -> Result<(), String> {
        let features = &self.program.description().features;
        let rows = self.rows("observations", found, features.len())?;
        let Use { shown, spec, .. } = &self.use_of;
        for (lane, row) in self.lanes.iter().zip(rows) {
            let entries = &mut self.observations[lane * shown.len()..(lane + 1) * shown.len()];
            let each = entries.iter_mut().zip(shown.iter()).zip(&spec.features);
            for ((entry, number), feature) in each {
                *entry = row[*number] as f32;
                let is_rounded = row[*number].fract() == 0.0 && f64::from(*entry) != row[*number];
                if is_rounded && entry.is_finite() && row[*number].abs() > LARGEST_WHOLE {
                    let (name, found) = (&feature.name, row[*number]);
                    return Err(format!(
                        "expected `{name}` in lane {lane} as a number that 32 bits hold, found {found}: whole numbers \
                         above 16,777,216 are rounded; scale the feature or make it two"
                    ));
                }
                if !(entry.is_finite() && (feature.low..=feature.high).contains(entry)) {
                    let (name, low, high) = (&feature.name, feature.low, feature.high);
                    let (found, clause) = (row[*number], Clause::ObservationBounds);
                    return Err(format!(
                        "expected `{name}` from {low} to {high} in lane {lane}, found {found} \
                         ({clause})"
                    ));
                }
            }
        }
        Ok(())
    }

    fn read_available(&mut self, found: Option<&SentNumbers>) -> Result<(), String> {
        match (found, self.program.description().availability) {
            (Some(_), false) => {
                return Err("expected `available` only with \"availability\": true".to_owned());
            }
            (None, true) => {
                return Err("expected `available`, because of \"availability\": true; found none"
                    .to_owned());
            }
            (Some(_), true) | (None, false) => {}
        }
        let all = found.map(|found| self.truths("available", found)).transpose()?;
        for (number, lane) in self.lanes.iter().enumerate() {
            self.available[*lane] = all.is_none_or(|all| all[number] != 0.0);
        }
        Ok(())
    }

    fn read_state(&mut self, found: Option<&SentNumbers>) -> Result<(), String> {
        if !self.use_of.records_state {
            return Ok(());
        }
        let found = found.ok_or("expected `state`, which is recorded; found none")?;
        let width = self.program.description().state.len();
        for (lane, row) in self.lanes.iter().zip(self.rows("state", found, width)?) {
            if let Some(value) = row.iter().find(|value| !value.is_finite()) {
                return Err(format!(
                    "expected finite numbers as the state of lane {lane}, found {value}"
                ));
            }
            self.state[lane * width..(lane + 1) * width].copy_from_slice(row);
        }
        Ok(())
    }

    /// Reads which episodes have ended.
    fn read_ends(
        &mut self,
        terminated: Option<&SentNumbers>,
        truncated: Option<&SentNumbers>,
        message: Observation,
    ) -> Result<(), String> {
        let terminated = terminated.map(|found| self.truths("terminated", found)).transpose()?;
        let truncated = truncated.map(|found| self.truths("truncated", found)).transpose()?;
        let horizon = self.program.description().horizon;
        for (number, lane) in self.lanes.iter().copied().enumerate() {
            let has_ended = |ends: Option<&[f64]>| ends.is_some_and(|ends| ends[number] != 0.0);
            let status = match (has_ended(terminated), has_ended(truncated)) {
                (true, _) => EpisodeStatus::Terminated,
                (false, true) => EpisodeStatus::Truncated,
                (false, false) => EpisodeStatus::Running,
            };
            let is_running = status == EpisodeStatus::Running;
            if message == Observation::Began && !is_running {
                let clause = Clause::Reset;
                return Err(format!(
                    "expected a running episode in lane {lane} after its reset ({clause})"
                ));
            }
            if is_running && self.lengths[lane] >= horizon {
                return Err(format!(
                    "expected the episode of lane {lane} to end within the horizon, {horizon} steps; set \
                     `truncated` in its last step"
                ));
            }
            self.statuses[lane] = status;
        }
        Ok(())
    }

    /// A value for each lane of the message.
    fn flat<'n>(&self, name: &str, found: &'n SentNumbers) -> Result<&'n [f64], String> {
        let lanes = self.lanes.len();
        match found.values.len() == lanes && found.width.is_none() {
            true => Ok(&found.values),
            false => Err(format!(
                "expected {lanes} numbers as `{name}`, one for each lane of the message, found {}",
                shape(found)
            )),
        }
    }

    /// 0 or 1 for each lane of the message.
    fn truths<'n>(&self, name: &str, found: &'n SentNumbers) -> Result<&'n [f64], String> {
        let all = self.flat(name, found)?;
        match all.iter().find(|value| ![0.0, 1.0].contains(*value)) {
            Some(value) => Err(format!("expected true or false as `{name}`, found {value}")),
            None => Ok(all),
        }
    }

    /// A row of `width` values for each lane of the message.
    fn rows<'n>(
        &self,
        name: &str,
        found: &'n SentNumbers,
        width: usize,
    ) -> Result<std::slice::ChunksExact<'n, f64>, String> {
        let lanes = self.lanes.len();
        let has_rows = found.width.is_none_or(|found| found == width);
        match has_rows && found.values.len() == lanes * width {
            true => Ok(found.values.chunks_exact(width)),
            false => Err(format!(
                "expected {lanes} rows of {width} numbers as `{name}`, one for each lane of the message, \
                 found {}",
                shape(found)
            )),
        }
    }
}

fn shape(of: &SentNumbers) -> String {
    match of.width {
        Some(width) if width > 0 => format!("{} rows of {width}", of.values.len() / width),
        _ => of.values.len().to_string(),
    }
}

impl VectorEnvironment for OutsideEnvironment {
    fn action_spec(&self) -> ActionSpec {
        let description = self.program.description();
        ActionSpec {
            count: description.actions.len(),
            lowest_reward: description.lowest_reward.unwrap_or(f64::NEG_INFINITY),
            highest_reward: description.highest_reward.unwrap_or(f64::INFINITY),
        }
    }

    fn observation_spec(&self) -> ObservationSpec {
        self.use_of.spec.stacked(self.use_of.history)
    }

    fn reset(&mut self, lanes: LaneSet<'_>, streams: &mut LaneStreams) {
        self.lanes.clear();
        self.seeds.clear();
        for lane in (0..self.statuses.len()).filter(|lane| lanes.contains(*lane)) {
            self.lanes.push(lane);
            // Programs in every language can read whole numbers below 2^53.
            self.seeds.push(streams.of(lane).bits() >> 11);
            self.lengths[lane] = 0;
        }
        if self.lanes.is_empty() {
            return;
        }
        let OutsideEnvironment { instance, lanes: named, seeds, .. } = &*self;
        let message = ToEnvironment::Reset { instance: *instance, lanes: named, seeds };
        let answer = self.program.ask(&message, "\"began\"", &self.moment());
        self.take(answer, None);
        if let Some(history) = &mut self.history {
            history.reset(lanes);
        }
    }

    fn step(&mut self, actions: &[Action], rewards: &mut [f64], _: &mut LaneStreams) {
        rewards.fill(0.0);
        self.lanes.clear();
        self.actions.clear();
        for (lane, action) in actions.iter().enumerate() {
            if self.statuses[lane] == EpisodeStatus::Running {
                self.lanes.push(lane);
                self.actions.push(self.taken(lane, *action).index() as u8);
                self.lengths[lane] += 1;
            }
        }
        if self.lanes.is_empty() {
            return;
        }
        if let Some(mut history) = self.history.take() {
            history.remember(&self.statuses, |out| self.observe_present(out));
            self.history = Some(history);
        }
        self.steps += 1;
        let OutsideEnvironment { instance, lanes, actions, .. } = &*self;
        let message = ToEnvironment::Step { instance: *instance, lanes, actions };
        let answer = self.program.ask(&message, "\"stepped\"", &self.moment());
        self.take(answer, Some(&mut *rewards));
        if self.program.failure().is_some() {
            rewards.fill(0.0);
        }
    }

    fn statuses(&self) -> &[EpisodeStatus] {
        &self.statuses
    }

    fn observe(&self, out: &mut Observations) {
        self.observe_present(out);
        if let Some(history) = &self.history {
            history.stack(&mut out.features);
        }
    }

    fn can_send(&self, lane: usize) -> bool {
        self.available[lane]
    }
}

impl OutsideEnvironment {
    fn observe_present(&self, out: &mut Observations) {
        out.clear();
        out.features.extend_from_slice(&self.observations);
    }
}

impl Simulation for OutsideEnvironment {
    fn with_lanes(&self, lanes: usize) -> Simulated {
        Box::new(OutsideEnvironment::with_lanes(self, lanes))
    }

    fn times(&self) -> &[u32] {
        &self.lengths
    }

    fn leave(&mut self, lane: usize) {
        self.statuses[lane] = EpisodeStatus::Truncated;
    }

    fn record_state(&self, lane: usize, state: &mut Vec<f64>) {
        state.extend_from_slice(self.state(lane));
    }
}

/// Closes the lanes in the program.
impl Drop for OutsideEnvironment {
    fn drop(&mut self) {
        if self.instance > 0 {
            self.program.send(&ToEnvironment::Close { instance: self.instance });
        }
    }
}

/// The state of a program cannot be saved: its jobs start over.
impl Resumable for OutsideEnvironment {
    fn save(&self, _: &mut StateWriter<'_>) -> io::Result<()> {
        Err(io::Error::new(io::ErrorKind::Unsupported, "the state of a program cannot be saved"))
    }

    fn restore(&mut self, _: &mut StateReader<'_>) -> Result<(), StateError> {
        Err(StateError::Misfit("lanes of a program"))
    }
}
