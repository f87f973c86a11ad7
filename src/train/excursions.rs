//! Excursions from a trial: what other actions lead to at each of its decisions.

use crate::agent::Rewards;
use crate::env::{Action, EpisodeStatus, Simulated, Simulation, VectorEnvironment};
use crate::job::Decision;
use crate::state::resumable;
use crate::train::decision_log::DecisionObserver;
use crate::train::roll::ChosenStep;

/// An outcome of a decision.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ProximalOutcome {
    /// Its index in the recorded state; `None` for the reward.
    pub(super) index: Option<usize>,
    /// Whether it stands in the state of its own decision.
    pub(super) is_own: bool,
    /// Whether the reward counts the cost of the message.
    pub(super) less_costs: bool,
}

impl ProximalOutcome {
    /// The outcome of a lane's last decision, given the rewards of all lanes; NaN if the episode has ended before it. `state`
    /// is a buffer.
    pub(super) fn of(
        self,
        lanes: &dyn Simulation,
        lane: usize,
        rewards: &[f64],
        state: &mut Vec<f64>,
    ) -> f64 {
        match self.index {
            None if self.less_costs => rewards[lane],
            None => lanes.outcomes(rewards)[lane],
            Some(_) if !self.is_own && lanes.statuses()[lane] != EpisodeStatus::Running => f64::NAN,
            Some(index) => {
                state.clear();
                lanes.record_state(lane, state);
                lanes.complete(lane, rewards[lane], state, &mut 0.0);
                state[index]
            }
        }
    }
}

/// The outcomes of every action at the decisions of a trial.
#[derive(Debug)]
pub(super) struct Excursions {
    outcomes: Vec<ProximalOutcome>,
    excursions: Vec<Excursion>,
}

/// The outcomes of every action at a decision.
#[derive(Debug, Default)]
pub(super) struct Excursion {
    /// The number of the person, from 1, and the person's step.
    pub(super) episode: u32,
    pub(super) step: u32,
    /// \[actions, outcomes\]; NaN where the episode ends before the outcome.
    values: Vec<f64>,
}

impl Excursions {
    /// No decision yet.
    pub(super) fn new(outcomes: Vec<ProximalOutcome>) -> Excursions {
        Excursions { outcomes, excursions: Vec::new() }
    }

    /// The excursions by episode and step.
    pub(super) fn finish(mut self) -> Excursions {
        self.excursions.sort_unstable_by_key(|one| (one.episode, one.step));
        self
    }

    /// The excursions, each with this outcome of every action, \[actions\]; none if the outcome was not observed.
    pub(super) fn by_decision(
        &self,
        outcome: ProximalOutcome,
    ) -> impl Iterator<Item = (&Excursion, Vec<f64>)> {
        let index = self.outcomes.iter().position(|known| *known == outcome);
        let excursions = if index.is_some() { &self.excursions[..] } else { &[] };
        excursions.iter().map(move |one| {
            let outcomes = one.values.iter().skip(index.unwrap_or(0)).step_by(self.outcomes.len());
            (one, outcomes.copied().collect())
        })
    }
}

impl DecisionObserver for Excursions {
    /// Takes every action in a copy of the lanes, with copies of the streams.
    fn decided(&mut self, step: &ChosenStep<'_, Simulated>, decisions: &[Decision]) {
        let first = self.excursions.len();
        let due = decisions.iter().filter(|decision| decision.can_send);
        self.excursions.extend(due.map(|Decision { episode, step, .. }| Excursion {
            episode: *episode,
            step: *step,
            values: Vec::new(),
        }));
        if self.excursions.len() == first {
            return;
        }
        let lanes = step.environment;
        let mut rewards = vec![0.0; lanes.lanes()];
        let mut state = Vec::new();
        for action in (0..lanes.action_spec().count).filter_map(Action::from_index) {
            let mut copy = lanes.copied().expect("a state is saved in memory");
            let actions = vec![action; rewards.len()];
            copy.step(&actions, &mut rewards, &mut step.streams.clone());
            for excursion in &mut self.excursions[first..] {
                let lane = excursion.episode as usize - 1;
                for outcome in &self.outcomes {
                    excursion.values.push(outcome.of(&*copy, lane, &rewards, &mut state));
                }
            }
        }
    }

    fn paid(&mut self, _: &[Decision], _: Rewards<'_>) {}
}

resumable!([] Excursion { parts episode, step; grown values });
resumable!([] Excursions { parts excursions });
