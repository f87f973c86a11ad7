//! A recorded trial as an environment: a lane per person, whose steps are those of the file.

use std::sync::Arc;

use crate::env::observation::{FeatureSpec, ObservationSpec, Observations};
use crate::env::recorded::log::RecordedLog;
use crate::env::simulation::{Simulated, Simulation};
use crate::env::vector::{
    Action, ActionSpec, EpisodeStatus, LaneSet, LaneStreams, VectorEnvironment,
};
use crate::state::resumable;

/// The people of a recorded trial, of whom the first are those after the people of the simulation that it was made from.
#[derive(Clone, Debug)]
pub struct RecordedWorld {
    log: Arc<RecordedLog>,
    /// Whether the state says what reached the agent of the trial.
    can_miss: bool,
    /// The indices of the features that agents see.
    shown: Arc<[usize]>,
    /// The person in the first lane.
    first: u32,
    statuses: Vec<EpisodeStatus>,
    times: Vec<u32>,
    /// \[lanes\]: whether the outcome of the last step can reach an agent.
    reached: Vec<bool>,
}

impl RecordedWorld {
    /// The trial with this number of lanes, all ended, which shows these numbers of the state.
    pub(super) fn new(log: Arc<RecordedLog>, shown: Arc<[usize]>, lanes: usize) -> RecordedWorld {
        RecordedWorld {
            can_miss: log.can_miss(),
            log,
            shown,
            first: 0,
            statuses: vec![EpisodeStatus::Truncated; lanes],
            times: vec![0; lanes],
            reached: vec![true; lanes],
        }
    }

    /// The index of a lane's next decision, or of the last one.
    fn decision(&self, lane: usize) -> usize {
        let person = &self.log.people[(self.first as usize + lane) % self.log.people.len()];
        person.first + self.times[lane].min(person.decisions - 1) as usize
    }

    fn state(&self, lane: usize) -> &[f64] {
        let width = self.log.names.len();
        let decision = self.decision(lane);
        &self.log.state[decision * width..(decision + 1) * width]
    }

    fn probabilities(&self, decision: usize) -> &[f64] {
        &self.log.probabilities[decision * self.log.actions..(decision + 1) * self.log.actions]
    }
}

impl VectorEnvironment for RecordedWorld {
    fn action_spec(&self) -> ActionSpec {
        ActionSpec {
            count: self.log.actions,
            lowest_reward: f64::NEG_INFINITY,
            highest_reward: f64::INFINITY,
        }
    }

    fn observation_spec(&self) -> ObservationSpec {
        spec(self.shown.iter().map(|index| self.log.names[*index].as_str()))
    }

    fn reset(&mut self, lanes: LaneSet<'_>, _: &mut LaneStreams) {
        for lane in (0..self.times.len()).filter(|lane| lanes.contains(*lane)) {
            (self.statuses[lane], self.times[lane]) = (EpisodeStatus::Running, 0);
        }
    }

    fn step(&mut self, _: &[Action], rewards: &mut [f64], _: &mut LaneStreams) {
        for (lane, reward) in rewards.iter_mut().enumerate() {
            let decision = self.decision(lane);
            let is_used =
                self.log.is_used[decision] && self.statuses[lane] == EpisodeStatus::Running;
            *reward = if is_used { self.log.outcomes[decision] } else { 0.0 };
            self.reached[lane] = is_used && self.log.is_reached[decision];
            if self.statuses[lane] == EpisodeStatus::Running {
                self.times[lane] += 1;
                if self.decision(lane) == decision {
                    self.statuses[lane] = EpisodeStatus::Truncated;
                }
            }
        }
    }

    fn statuses(&self) -> &[EpisodeStatus] {
        &self.statuses
    }

    fn observe(&self, out: &mut Observations) {
        out.clear();
        for lane in 0..self.times.len() {
            let state = self.state(lane);
            out.features.extend(self.shown.iter().map(|index| state[*index] as f32));
        }
    }

    fn can_send(&self, lane: usize) -> bool {
        let decision = self.decision(lane);
        self.log.is_used[decision] && self.log.is_available[decision]
    }
}

/// Features without bounds.
pub(super) fn spec<'n>(names: impl Iterator<Item = &'n str>) -> ObservationSpec {
    let feature = |name: &str| FeatureSpec {
        name: name.to_owned(),
        low: f32::NEG_INFINITY,
        high: f32::INFINITY,
    };
    ObservationSpec { features: names.map(feature).collect(), one_hot: 0 }
}

impl Simulation for RecordedWorld {
    fn with_lanes(&self, lanes: usize) -> Simulated {
        let first = self.first + self.times.len() as u32;
        let (log, shown) = (Arc::clone(&self.log), Arc::clone(&self.shown));
        Box::new(RecordedWorld { first, ..RecordedWorld::new(log, shown, lanes) })
    }

    fn times(&self) -> &[u32] {
        &self.times
    }

    fn is_counted(&self, lane: usize) -> bool {
        self.log.is_used[self.decision(lane)]
    }

    /// A decision that the file skips ends nobody's stay.
    fn is_over(&self, lane: usize) -> bool {
        self.statuses[lane] != EpisodeStatus::Running
    }

    fn recorded(&self, lane: usize) -> Option<(Action, &[f64])> {
        let decision = self.decision(lane);
        let action = Action::from_index(self.log.taken[decision].into())?;
        Some((action, self.probabilities(decision)))
    }

    fn person(&self, lane: usize) -> Option<u32> {
        Some(self.first + lane as u32 + 1)
    }

    fn reached(&self) -> LaneSet<'_> {
        LaneSet::Masked(&self.reached)
    }

    fn record_state(&self, lane: usize, state: &mut Vec<f64>) {
        state.extend_from_slice(self.state(lane));
        let decision = self.decision(lane);
        if self.can_miss {
            state.push(f64::from(u8::from(self.log.is_reached[decision])));
        }
        state.push(self.probabilities(decision)[usize::from(self.log.taken[decision])]);
    }

    fn exact_features(&self, lane: usize, _: &Observations, out: &mut Vec<f64>) {
        let state = self.state(lane);
        out.clear();
        out.extend(self.shown.iter().map(|index| state[*index]));
    }

    fn exact_features_read_observations(&self) -> bool {
        false
    }

    fn leave(&mut self, lane: usize) {
        self.statuses[lane] = EpisodeStatus::Truncated;
    }
}

// The file is part of the job.
resumable!([] RecordedWorld { parts first; each statuses; fixed times; each reached });
