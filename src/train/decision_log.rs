//! The log of decisions: every step of the episodes of a training or a test.

use std::sync::Arc;

use crate::agent::{OutOfMemory, StepObserver, Unavailable, reserve};
use crate::env::{Action, EpisodeStatus, Simulated, VectorEnvironment};
use crate::estimate::Estimation;
use crate::job::{Decision, EstimateDeclaration, Estimates, ParticipantValue, Phase};
use crate::state::resumable;

/// Records the decisions of one phase of a job.
///
/// A lane at its first step begins the next episode, in lane order. Episodes of lanes in lockstep thus have
/// the same numbers as in the learning curve and the test.
#[derive(Debug)]
pub(super) struct DecisionLog {
    phase: Phase,
    /// Whether the agent chooses where no message can be sent.
    unavailable: Unavailable,
    /// In the order of steps; [`DecisionLog::finish`] sorts them by episode.
    decisions: Vec<Decision>,
    /// Estimates, which read each decision once it has its reward.
    estimations: Vec<Estimation>,
    /// Whether decisions are kept after that.
    is_kept: bool,
    /// The parameters of participants whose episodes have begun. A test records its participants itself.
    participants: Vec<ParticipantValue>,
    /// The number of episodes that have begun.
    begun: u32,
    /// The episode of every lane, from 1.
    episodes: Vec<u32>,
    /// The place of the last decision of every lane.
    last: Vec<u64>,
    /// The lanes of the most recent decisions, whose rewards are still missing.
    acting: Vec<usize>,
    /// In a trial, numbers that follow the state of every lane, \[lanes, numbers\], and episodes are the numbers of lanes;
    /// empty otherwise.
    beside: Vec<f64>,
    /// The first failed allocation; nothing is recorded afterwards.
    refused: Option<OutOfMemory>,
}

impl DecisionLog {
    /// An empty log of a phase of a job, whose agent has this value of the key `unavailable`.
    pub(super) fn new(unavailable: Unavailable, phase: Phase) -> Self {
        DecisionLog {
            phase,
            unavailable,
            decisions: Vec::new(),
            estimations: Vec::new(),
            is_kept: true,
            participants: Vec::new(),
            begun: 0,
            episodes: Vec::new(),
            last: Vec::new(),
            acting: Vec::new(),
            beside: Vec::new(),
            refused: None,
        }
    }

    /// A log that estimates effects, and keeps its decisions if `is_kept`.
    pub(super) fn estimating(self, estimations: Vec<Estimation>, is_kept: bool) -> Self {
        DecisionLog { estimations, is_kept, ..self }
    }

    /// The declarations of its estimates.
    pub(super) fn declarations(&self) -> impl Iterator<Item = &Arc<EstimateDeclaration>> {
        self.estimations.iter().map(Estimation::declaration)
    }

    /// The estimates of all decisions so far.
    pub(super) fn estimates(&self) -> Vec<Estimates> {
        self.estimations.iter().map(Estimation::finish).collect()
    }

    /// Records these numbers behind the state of every lane, \[lanes, numbers\], in the next step of a trial.
    pub(super) fn stand_beside(&mut self, numbers: impl Iterator<Item = f64>) {
        self.beside.clear();
        self.beside.extend(numbers);
    }

    /// Records which episodes have ended, in the last decision of each.
    pub(super) fn ended(&mut self, statuses: &[EpisodeStatus]) {
        for (place, status) in self.last.iter().zip(statuses) {
            if let Some(decision) = self.decisions.get_mut(*place as usize) {
                decision.terminated = *status == EpisodeStatus::Terminated;
                decision.truncated = *status == EpisodeStatus::Truncated;
            }
        }
    }

    /// Reports a failed allocation. **Errors**: there was not enough memory for a decision.
    pub(super) fn check(&self) -> Result<(), OutOfMemory> {
        self.refused.map_or(Ok(()), Err)
    }

    /// The decisions by episode and step, and the participants by episode.
    pub(super) fn finish(mut self) -> (Vec<Decision>, Vec<ParticipantValue>) {
        self.decisions.sort_unstable_by_key(|decision| (decision.episode, decision.step));
        (self.decisions, self.participants)
    }

    /// The number of the current episode in a lane, which is at `step`.
    fn episode(&mut self, lane: usize, step: u32) -> u32 {
        if !self.beside.is_empty() {
            return lane as u32 + 1;
        }
        if step == 0 {
            self.begun += 1;
            self.episodes[lane] = self.begun;
        }
        self.episodes[lane]
    }
}

impl StepObserver<Simulated> for DecisionLog {
    fn chosen(&mut self, lanes: &Simulated, actions: &[Action], probabilities: &[f64]) {
        let count = probabilities.len() / actions.len();
        self.acting.clear();
        self.episodes.resize(lanes.lanes(), 0);
        self.last.resize(lanes.lanes(), u64::MAX);
        match reserve(&mut self.decisions, lanes.lanes(), "the record of decisions") {
            Ok(()) if self.refused.is_none() => {}
            refused => return self.refused = self.refused.or(refused.err()),
        }
        for (lane, status) in lanes.statuses().iter().enumerate() {
            if *status != EpisodeStatus::Running || !lanes.is_counted(lane) {
                continue;
            }
            let step = lanes.time(lane);
            let mut row = probabilities[lane * count..(lane + 1) * count].to_vec();
            let chosen = self.unavailable.choice(lanes, lane, actions[lane], &mut row);
            let episode = self.episode(lane, step);
            if step == 0 && self.phase == Phase::Train {
                let phase = self.phase;
                let mut values = Vec::new();
                lanes.participant(lane, &mut values);
                self.participants.extend(values.into_iter().map(|(place, value)| {
                    ParticipantValue { phase, episode, parameter: place as u8, value }
                }));
            }
            let mut state = Vec::new();
            lanes.record_state(lane, &mut state);
            let width = self.beside.len() / lanes.lanes();
            state.extend(&self.beside[lane * width..(lane + 1) * width]);
            let action = lanes.taken(lane, chosen);
            let is_sent = action != Action::default();
            let decision = Decision {
                phase: self.phase,
                episode,
                step,
                state: state.into(),
                available: lanes.is_available(lane),
                can_send: lanes.can_send(lane),
                chosen: chosen.index() as u8,
                action: action.index() as u8,
                probabilities: row.into(),
                reward: 0.0,
                cost: if is_sent { lanes.message_cost(lane) } else { 0.0 },
                terminated: false,
                truncated: false,
            };
            self.last[lane] = self.decisions.len() as u64;
            self.decisions.push(decision);
            self.acting.push(lane);
        }
    }

    fn paid(&mut self, lanes: &Simulated, rewards: &[f64]) {
        let outcomes = lanes.outcomes(rewards);
        let first = self.decisions.len() - self.acting.len();
        for (decision, lane) in self.decisions[first..].iter_mut().zip(&self.acting) {
            decision.reward = outcomes[*lane];
            self.estimations.iter_mut().for_each(|estimation| estimation.add(decision));
        }
        if !self.is_kept {
            self.decisions.clear();
            self.acting.clear();
            return;
        }
        // An episode may end with a step that does not count, after its last decision.
        self.ended(lanes.statuses());
    }
}

// Between two steps, every decision has its reward.
resumable!([] DecisionLog {
    parts begun, decisions, participants; grown episodes, last; each estimations; then set_phase
});

resumable!([] Decision {
    parts episode, step, state, available, can_send, chosen, action, probabilities, reward, cost, terminated, truncated
});

resumable!([] ParticipantValue { parts episode, parameter, value });

impl DecisionLog {
    /// Sets the phase of restored decisions and participants.
    fn set_phase(&mut self) {
        self.decisions.iter_mut().for_each(|decision| decision.phase = self.phase);
        self.participants.iter_mut().for_each(|value| value.phase = self.phase);
    }
}
