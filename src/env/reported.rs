//! A simulation of people whose phones do not report before every decision: agents see what was last reported.
//!
//! In: a simulation, and which decisions the phones report before. Out: the same simulation, whose observations, features
//! and recorded state are those of the last report. Everything else is true: outcomes, clocks, statuses, and whether a
//! message can be sent.

use std::any::Any;
use std::sync::Arc;

use crate::env::observation::{ObservationSpec, Observations};
use crate::env::simulation::{Simulated, Simulation};
use crate::env::step_count::PhysicalActivity;
use crate::env::vector::{
    Action, ActionSpec, EpisodeStatus, LaneSet, LaneStreams, VectorEnvironment,
};
use crate::state::resumable;

/// Whether the phones of people report, person by person.
#[derive(Clone, Debug, PartialEq)]
pub struct Reports {
    /// The number of decisions of a person.
    pub decisions: usize,
    /// \[people, decisions\]: whether the phone reports before the decision. Before a person's first decision it always
    /// reports.
    pub reported: Arc<[bool]>,
}

/// A simulation with a person per lane.
#[derive(Debug)]
pub struct Reported {
    real: Simulated,
    reports: Reports,
    /// \[lanes\]: whether the phone reported before the next decision.
    is_reported: Vec<bool>,
    /// What was last reported of each lane: its observation, its features in full precision, and its recorded state.
    seen: Observations,
    exact: Vec<Vec<f64>>,
    states: Vec<Vec<f64>>,
    /// The state that the rules of `step_count` read; `None` in other families.
    read: Option<PhysicalActivity>,
    /// A buffer for the true observations.
    present: Observations,
}

impl Reported {
    /// A simulation whose lanes have all ended.
    pub fn new(real: Simulated, reports: Reports) -> Reported {
        let lanes = real.lanes();
        let mut seen = real.observation_spec().observations();
        real.observe(&mut seen);
        let read = real.downcast().cloned();
        let (is_reported, present) = (vec![true; lanes], seen.clone());
        let exact = vec![Vec::new(); lanes];
        let states = exact.clone();
        Reported { real, reports, is_reported, seen, exact, states, read, present }
    }

    /// Reports the present of these lanes.
    fn report(&mut self, lanes: LaneSet<'_>) {
        self.real.observe(&mut self.present);
        for lane in (0..self.real.lanes()).filter(|lane| lanes.contains(*lane)) {
            self.seen.copy_row(lane, &self.present);
            self.real.exact_features(lane, &self.present, &mut self.exact[lane]);
            self.states[lane].clear();
            self.real.record_state(lane, &mut self.states[lane]);
            if let Some((read, real)) = self.read.as_mut().zip(self.real.downcast()) {
                read.show(lane, real);
            }
        }
    }
}

impl VectorEnvironment for Reported {
    fn action_spec(&self) -> ActionSpec {
        self.real.action_spec()
    }

    fn observation_spec(&self) -> ObservationSpec {
        self.real.observation_spec()
    }

    fn reset(&mut self, lanes: LaneSet<'_>, streams: &mut LaneStreams) {
        self.real.reset(lanes, streams);
        for (lane, is_reported) in self.is_reported.iter_mut().enumerate() {
            *is_reported |= lanes.contains(lane);
        }
        self.report(lanes);
    }

    fn step(&mut self, actions: &[Action], rewards: &mut [f64], streams: &mut LaneStreams) {
        self.real.step(actions, rewards, streams);
        let Reports { decisions, reported } = &self.reports;
        for (lane, is_reported) in self.is_reported.iter_mut().enumerate() {
            let time = self.real.time(lane) as usize;
            *is_reported = time >= *decisions || reported[lane * decisions + time];
        }
        let reported = std::mem::take(&mut self.is_reported);
        self.report(LaneSet::Masked(&reported));
        self.is_reported = reported;
    }

    fn expect(&mut self, probabilities: &[f64]) {
        self.real.expect(probabilities);
    }

    fn statuses(&self) -> &[EpisodeStatus] {
        self.real.statuses()
    }

    fn observe(&self, out: &mut Observations) {
        out.clear();
        out.extend(&self.seen, 0..self.seen.rows());
    }

    fn outcomes<'a>(&'a self, rewards: &'a [f64]) -> &'a [f64] {
        self.real.outcomes(rewards)
    }

    fn can_send(&self, lane: usize) -> bool {
        self.real.can_send(lane)
    }
}

impl Simulation for Reported {
    fn with_lanes(&self, lanes: usize) -> Simulated {
        Box::new(Reported::new(self.real.with_lanes(lanes), self.reports.clone()))
    }

    fn times(&self) -> &[u32] {
        self.real.times()
    }

    fn is_counted(&self, lane: usize) -> bool {
        self.real.is_counted(lane)
    }

    fn is_available(&self, lane: usize) -> bool {
        self.real.is_available(lane)
    }

    fn taken(&self, lane: usize, action: Action) -> Action {
        self.real.taken(lane, action)
    }

    fn has_terminated(&self, lane: usize) -> bool {
        self.real.has_terminated(lane)
    }

    fn message_cost(&self, lane: usize) -> f64 {
        self.real.message_cost(lane)
    }

    fn complete(&self, lane: usize, reward: f64, state: &mut [f64], cost: &mut f64) {
        self.real.complete(lane, reward, state, cost);
    }

    fn stratum(&self, lane: usize) -> usize {
        self.real.stratum(lane)
    }

    /// The state of the last report, and whether it was before the next decision: 1 or 0.
    fn record_state(&self, lane: usize, state: &mut Vec<f64>) {
        state.extend_from_slice(&self.states[lane]);
        state.push(f64::from(u8::from(self.is_reported[lane])));
    }

    fn exact_features(&self, lane: usize, _: &Observations, out: &mut Vec<f64>) {
        out.clone_from(&self.exact[lane]);
    }

    fn costs_follow(&self) -> bool {
        self.real.costs_follow()
    }

    fn failure(&self) -> Option<&str> {
        self.real.failure()
    }

    fn begin_day(&mut self, day: u32) {
        self.real.begin_day(day);
    }

    fn assign(&mut self, rows: &[u32]) {
        self.real.assign(rows);
    }

    fn leave(&mut self, lane: usize) {
        self.real.leave(lane);
    }

    fn participant(&self, lane: usize, values: &mut Vec<(usize, f64)>) {
        self.real.participant(lane, values);
    }

    fn shown(&self) -> Option<&dyn Any> {
        self.read.as_ref().map(|read| read as &dyn Any)
    }
}

resumable!([] Reported { parts real, seen; each is_reported, exact, states, read });

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::contract;
    use crate::env::step_count::StepCount;
    use crate::rng::{Purpose, Stream};

    const HORIZON: u32 = 5;

    fn plain(lanes: usize) -> PhysicalActivity {
        let parameters =
            StepCount { horizon: HORIZON, time_one_hot: true, ..StepCount::paper(0.6) };
        PhysicalActivity::new(&parameters, &"P-H-D".parse().unwrap(), lanes)
    }

    fn of(lanes: usize, reported: &[bool]) -> Reported {
        let (decisions, reported) = (HORIZON as usize, reported.into());
        Reported::new(Box::new(plain(lanes)), Reports { decisions, reported })
    }

    #[test]
    fn agents_see_the_last_report_while_the_truth_changes() {
        let streams = || LaneStreams::PerLane(vec![Stream::new(1, Purpose::Person); 2]);
        let (mut one, mut other) = (streams(), streams());
        // The second entry of a person is the decision after the first step.
        let all = [[false, false, false, true, false], [false, true, true, false, false]];
        // The step of the last report of each person.
        let last = [[0, 0], [0, 1], [0, 2], [3, 2], [3, 2]];
        let (mut truth, mut lanes) = (plain(2), of(2, all.as_flattened()));
        truth.reset(LaneSet::All, &mut one);
        lanes.reset(LaneSet::All, &mut other);
        let mut seen = truth.observation_spec().observations();
        let (mut history, mut states) = (Vec::new(), Vec::new());
        let actions = [2, 3].map(|number| Action::from_index(number).unwrap());
        for (step, last) in last.iter().enumerate() {
            truth.observe(&mut seen);
            history.push(seen.clone());
            states.push(truth.clone());
            lanes.observe(&mut seen);
            for (lane, reported) in last.iter().copied().enumerate() {
                assert_eq!(seen.row(lane), history[reported].row(lane), "{lane}, {step}");
                assert_eq!(seen.moment(lane), history[reported].moment(lane));
                let mut exact = Vec::new();
                lanes.exact_features(lane, &seen, &mut exact);
                assert!(exact.iter().zip(seen.row(lane)).all(|(one, other)| *one as f32 == *other));
                let (mut state, mut expected) = (Vec::new(), Vec::new());
                lanes.record_state(lane, &mut state);
                states[reported].record_state(lane, &mut expected);
                expected.push(f64::from(u8::from(reported == step)));
                assert_eq!(state, expected);
                // A rule reads the same state.
                let simulation: &dyn Simulation = &lanes;
                let read: &PhysicalActivity = simulation.downcast().unwrap();
                assert_eq!(read.context(lane), states[reported].context(lane));
                assert_eq!(read.times()[lane], reported as u32);
                assert_eq!(read.habituation()[lane], states[reported].habituation()[lane]);
                assert_eq!(lanes.time(lane), step as u32);
            }
            let mut rewards = [[0.0; 2]; 2];
            truth.step(&actions, &mut rewards[0], &mut one);
            lanes.step(&actions, &mut rewards[1], &mut other);
            assert_eq!(rewards[0], rewards[1]);
            assert_eq!(truth.statuses(), lanes.statuses());
        }
    }

    #[test]
    fn the_contract_is_kept() {
        // The contract compares lanes with each other, so that everybody has the same reports.
        let reported = [true, false, true, false, false];
        contract::check(|lanes| of(lanes, &reported.repeat(lanes)), 60).unwrap();
    }
}
