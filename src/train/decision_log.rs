//! The log of decisions: every step of the episodes of a training or a test.

use crate::agent::{OutOfMemory, Rewards, StepObserver, Unavailable, reserve};
use crate::env::{Action, EpisodeStatus, Simulated, VectorEnvironment};
use crate::job::{Decision, ParticipantValue, Phase};
use crate::state::resumable;
use crate::train::roll::{ChosenStep, LaneObserver};
use crate::train::study::Study;

/// Records the decisions of one phase of a job.
///
/// A lane at its first step begins the next episode, in lane order. Episodes of lanes in lockstep thus have
/// the same numbers as in the learning curve and the test. In a trial, they have the numbers of people.
#[derive(Debug)]
pub(super) struct DecisionLog {
    phase: Phase,
    /// Whether the agent chooses where no message can be sent.
    unavailable: Unavailable,
    /// In the order of steps; [`DecisionLog::finish`] sorts them by episode.
    decisions: Vec<Decision>,
    /// Whether decisions are kept after their step.
    is_kept: bool,
    /// The parameters of participants whose episodes have begun. A test records its participants itself.
    participants: Vec<ParticipantValue>,
    /// The number of episodes that have begun.
    begun: u32,
    /// The episode of every lane, from 1.
    episodes: Vec<u32>,
    /// The index of the last decision of every lane.
    last: Vec<u64>,
    /// The lanes of the most recent decisions.
    acting: Vec<usize>,
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
            is_kept: true,
            participants: Vec::new(),
            begun: 0,
            episodes: Vec::new(),
            last: Vec::new(),
            acting: Vec::new(),
            refused: None,
        }
    }

    /// A log that keeps its decisions after their step, or does not.
    pub(super) fn keeping(self, is_kept: bool) -> Self {
        DecisionLog { is_kept, ..self }
    }

    /// The decisions of the present step.
    pub(super) fn latest(&self) -> &[Decision] {
        &self.decisions[self.decisions.len() - self.acting.len()..]
    }

    /// Ends a step.
    pub(super) fn end_step(&mut self, statuses: &[EpisodeStatus]) {
        self.acting.clear();
        if !self.is_kept {
            return self.decisions.clear();
        }
        // An episode may end with a step that does not count, after its last decision.
        self.ended(statuses);
    }

    /// Records which episodes have ended, in the last decision of each.
    pub(super) fn ended(&mut self, statuses: &[EpisodeStatus]) {
        for (index, status) in self.last.iter().zip(statuses) {
            if let Some(decision) = self.decisions.get_mut(*index as usize) {
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

    /// The number of the episode that began in a lane with its first step.
    fn episode(&mut self, lane: usize, step: u32) -> u32 {
        if step == 0 {
            self.begun += 1;
            self.episodes[lane] = self.begun;
        }
        self.episodes[lane]
    }

    /// Records the decisions of a step of a trial, or of other episodes.
    fn record(
        &mut self,
        lanes: &Simulated,
        actions: &[Action],
        probabilities: &[f64],
        study: Option<&Study>,
    ) {
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
            let mut state = Vec::new();
            lanes.record_state(lane, &mut state);
            let episode = match study {
                Some(study) => {
                    state.extend(study.beside(lane, step));
                    lane as u32 + 1
                }
                None => lanes.person(lane).unwrap_or_else(|| self.episode(lane, step)),
            };
            if step == 0 && self.phase == Phase::Train {
                self.record_participant(lanes, lane, episode);
            }
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

    /// Records the parameters of the participant in a lane.
    fn record_participant(&mut self, lanes: &Simulated, lane: usize, episode: u32) {
        let (phase, mut values) = (self.phase, Vec::new());
        lanes.participant(lane, &mut values);
        let recorded = values.into_iter().map(|(index, value)| {
            let parameter = index as u8;
            ParticipantValue { phase, episode, parameter, value }
        });
        self.participants.extend(recorded);
    }

    /// Sets the outcomes of the decisions of the present step.
    fn pay(&mut self, lanes: &Simulated, rewards: &[f64]) {
        let outcomes = lanes.outcomes(rewards);
        let first = self.decisions.len() - self.acting.len();
        for (decision, lane) in self.decisions[first..].iter_mut().zip(&self.acting) {
            decision.reward = outcomes[*lane];
            lanes.complete(*lane, rewards[*lane], &mut decision.state, &mut decision.cost);
        }
    }
}

/// Sees the decisions of every step.
pub(super) trait DecisionObserver {
    /// Sees decisions before their step is taken. Does nothing by default.
    fn decided(&mut self, step: &ChosenStep<'_, Simulated>, decisions: &[Decision]) {
        let _ = (step, decisions);
    }

    /// Sees the same decisions with their outcomes, and the rewards of all lanes.
    fn paid(&mut self, decisions: &[Decision], rewards: Rewards<'_>);
}

/// In training, nobody else reads the decisions of a step.
impl StepObserver<Simulated> for DecisionLog {
    fn chosen(&mut self, lanes: &Simulated, actions: &[Action], probabilities: &[f64]) {
        self.record(lanes, actions, probabilities, None);
    }

    fn paid(&mut self, lanes: &Simulated, rewards: &[f64]) {
        self.pay(lanes, rewards);
        self.end_step(lanes.statuses());
    }
}

impl LaneObserver<Simulated> for DecisionLog {
    fn chosen(&mut self, step: &ChosenStep<'_, Simulated>) {
        self.record(step.environment, step.actions, step.probabilities, step.study);
    }

    fn paid(&mut self, lanes: &Simulated, rewards: Rewards<'_>) {
        self.pay(lanes, rewards.values);
    }
}

// Between two steps, every decision has its reward.
resumable!([] DecisionLog {
    parts begun, decisions, participants; grown episodes, last; then set_phase
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
