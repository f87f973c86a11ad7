//! Excursions from a trial: what other actions lead to at each of its decisions.

use crate::env::{Action, EpisodeStatus, LaneStreams, Simulated, VectorEnvironment};

/// The outcomes of every action at the decisions of a trial.
#[derive(Debug, Default)]
pub(super) struct Excursions {
    /// The place of the outcome in the recorded state; `None` for the reward.
    outcome: Option<usize>,
    /// Whether the reward counts the cost of the message.
    less_costs: bool,
    /// Episode from 1 and step of a decision, and the outcomes, \[actions\]; NaN where the episode ends before the outcome.
    rows: Vec<(u32, u32, Vec<f64>)>,
}

impl Excursions {
    /// No decision yet.
    pub(super) fn new(outcome: Option<usize>, less_costs: bool) -> Excursions {
        Excursions { outcome, less_costs, rows: Vec::new() }
    }

    /// The rows by episode and step.
    pub(super) fn finish(mut self) -> Vec<(u32, u32, Vec<f64>)> {
        self.rows.sort_unstable_by_key(|(episode, step, _)| (*episode, *step));
        self.rows
    }

    /// Takes every action in a copy of the environment, whose next step has these streams.
    pub(super) fn see(&mut self, environment: &Simulated, streams: &LaneStreams) {
        let can_send = |lane: &usize| {
            environment.statuses()[*lane] == EpisodeStatus::Running
                && environment.is_counted(*lane)
                && environment.can_send(*lane)
        };
        let due: Vec<usize> = (0..environment.lanes()).filter(can_send).collect();
        if due.is_empty() {
            return;
        }
        let first = self.rows.len();
        let row = |lane: &usize| (*lane as u32 + 1, environment.time(*lane), Vec::new());
        self.rows.extend(due.iter().map(row));
        let mut rewards = vec![0.0; environment.lanes()];
        let mut state = Vec::new();
        for action in (0..environment.action_spec().count).filter_map(Action::from_index) {
            let mut copy = environment.copied().expect("a state is saved in memory");
            let actions = vec![action; rewards.len()];
            copy.step(&actions, &mut rewards, &mut streams.clone());
            let outcomes = if self.less_costs { &rewards[..] } else { copy.outcomes(&rewards) };
            for ((.., row), lane) in self.rows[first..].iter_mut().zip(&due) {
                row.push(match self.outcome {
                    None => outcomes[*lane],
                    Some(_) if copy.statuses()[*lane] != EpisodeStatus::Running => f64::NAN,
                    Some(place) => {
                        state.clear();
                        copy.record_state(*lane, &mut state);
                        state[place]
                    }
                });
            }
        }
    }
}
