//! Rollouts: the steps of all lanes between two phases of learning, and the advantages of their
//! actions.

use crate::agent::memory::{self, OutOfMemory, reserve};
use crate::env::{Action, EpisodeStatus, Observations};
use crate::state::resumable;

/// The purpose of the memory, for messages.
const ROLLOUT: &str = "a rollout";

/// Steps of all lanes. Row t * lanes + l of every array belongs to step t of lane l.
#[derive(Clone, Debug)]
pub(super) struct LaneSteps {
    pub(super) lanes: usize,
    /// The networks' memory before the first step, \[lanes, memory\].
    pub(super) memory: Vec<f32>,
    pub(super) observations: Observations,
    pub(super) actions: Vec<Action>,
    /// Log-probabilities of the actions when they were chosen.
    pub(super) log_probabilities: Vec<f32>,
    /// Values of the observations when the actions were chosen.
    pub(super) values: Vec<f32>,
    /// Rewards after scaling.
    pub(super) rewards: Vec<f64>,
    /// Whether the lane took the step; a lane without an episode is idle.
    pub(super) real: Vec<bool>,
    /// Whether the agent chose the action; it does not where no message can be sent.
    pub(super) chosen: Vec<bool>,
    /// Whether the step is the first of an episode.
    pub(super) firsts: Vec<bool>,
    /// Whether the episode ended with the step.
    pub(super) ended: Vec<bool>,
    /// Advantages of the actions; empty until the rollout is complete.
    pub(super) advantages: Vec<f32>,
}

impl LaneSteps {
    /// An empty rollout.
    pub(super) fn new(lanes: usize, observations: Observations) -> Self {
        LaneSteps {
            lanes,
            memory: Vec::new(),
            observations,
            actions: Vec::new(),
            log_probabilities: Vec::new(),
            values: Vec::new(),
            rewards: Vec::new(),
            real: Vec::new(),
            chosen: Vec::new(),
            firsts: Vec::new(),
            ended: Vec::new(),
            advantages: Vec::new(),
        }
    }

    /// Number of steps of every lane.
    pub(super) fn steps(&self) -> usize {
        self.actions.len() / self.lanes
    }

    pub(super) fn clear(&mut self) {
        self.memory.clear();
        self.observations.clear();
        self.actions.clear();
        self.log_probabilities.clear();
        self.values.clear();
        self.rewards.clear();
        self.real.clear();
        self.chosen.clear();
        self.firsts.clear();
        self.ended.clear();
        self.advantages.clear();
    }

    /// Reserves memory for a step.
    pub(super) fn reserve(&mut self) -> Result<(), OutOfMemory> {
        let rows = self.lanes;
        let bytes =
            (self.observations.rows() + rows) * self.observations.width() * size_of::<f32>();
        let refused = OutOfMemory { what: ROLLOUT, bytes };
        memory::permit(bytes, ROLLOUT)?;
        self.observations.try_reserve(rows).map_err(|_| refused)?;
        reserve(&mut self.actions, rows, ROLLOUT)?;
        reserve(&mut self.log_probabilities, rows, ROLLOUT)?;
        reserve(&mut self.values, rows, ROLLOUT)?;
        reserve(&mut self.rewards, rows, ROLLOUT)?;
        reserve(&mut self.real, rows, ROLLOUT)?;
        reserve(&mut self.chosen, rows, ROLLOUT)?;
        reserve(&mut self.firsts, rows, ROLLOUT)?;
        reserve(&mut self.ended, rows, ROLLOUT)
    }

    /// Adds the part of a step that is known before its reward. All arrays are \[lanes\].
    pub(super) fn choose(
        &mut self,
        observations: &Observations,
        actions: &[Action],
        log_probabilities: impl Iterator<Item = f32>,
        values: &[f32],
        [firsts, chosen]: [&[bool]; 2],
        statuses: &[EpisodeStatus],
    ) {
        self.observations.extend(observations, 0..self.lanes);
        self.actions.extend_from_slice(actions);
        self.log_probabilities.extend(log_probabilities);
        self.values.extend_from_slice(values);
        self.firsts.extend_from_slice(firsts);
        self.chosen.extend_from_slice(chosen);
        self.real.extend(statuses.iter().map(|status| *status == EpisodeStatus::Running));
    }

    /// Whether each lane took the last step, \[lanes\].
    pub(super) fn acted(&self) -> &[bool] {
        &self.real[self.real.len() - self.lanes..]
    }

    /// Computes the advantages, given the values of the observations after the last step,
    /// \[lanes\].
    pub(super) fn finish(
        &mut self,
        last_values: &[f32],
        gamma: f64,
        lambda: f64,
    ) -> Result<(), OutOfMemory> {
        reserve(&mut self.advantages, self.values.len(), ROLLOUT)?;
        self.advantages.resize(self.values.len(), 0.0);
        let LaneSteps { rewards, values, ended, advantages: out, .. } = self;
        advantages(rewards, values, ended, last_values, [gamma, lambda], out);
        Ok(())
    }
}

/// Writes advantages by generalised advantage estimation: A_t = delta_t + gamma lambda A_t+1 with
/// delta_t = r_t + gamma V_t+1 - V_t, where V_t+1 and A_t+1 are 0 after the end of an episode.
///
/// **Shapes**: `rewards`, `values`, `ended` and `out` are \[steps, lanes\], row by row;
/// `last_values`, the values of the observations after the last step, is \[lanes\].
///
/// **Source**: Schulman et al., "High-dimensional continuous control using generalized advantage
/// estimation", 2016, equation 16.
pub fn advantages(
    rewards: &[f64],
    values: &[f32],
    ended: &[bool],
    last_values: &[f32],
    [gamma, lambda]: [f64; 2],
    out: &mut [f32],
) {
    let lanes = last_values.len();
    for (lane, last_value) in last_values.iter().enumerate() {
        let (mut next_value, mut next_advantage) = (f64::from(*last_value), 0.0);
        for row in (lane..rewards.len()).step_by(lanes).rev() {
            let goes_on = if ended[row] { 0.0 } else { 1.0 };
            let value = f64::from(values[row]);
            let difference = rewards[row] + gamma * goes_on * next_value - value;
            next_advantage = difference + gamma * lambda * goes_on * next_advantage;
            next_value = value;
            out[row] = next_advantage as f32;
        }
    }
}

// Saves the steps so far. A complete rollout includes its advantages.
resumable!([] LaneSteps {
    parts observations, actions, real, chosen, firsts, ended;
    grown memory, log_probabilities, values, rewards, advantages;
    check fits, "rollout"
});

impl LaneSteps {
    /// Whether the restored arrays are of one length.
    fn fits(&self) -> bool {
        let rows = self.observations.rows();
        let each = [
            self.actions.len(),
            self.log_probabilities.len(),
            self.values.len(),
            self.rewards.len(),
            self.real.len(),
            self.chosen.len(),
            self.firsts.len(),
            self.ended.len(),
        ];
        rows.is_multiple_of(self.lanes)
            && each.iter().all(|len| *len == rows)
            && [0, rows].contains(&self.advantages.len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn advantages_are_those_worked_by_hand() {
        // Two lanes, three steps; gamma 0.5, lambda 0.5. The episode of the first lane continues;
        // the episode of the second lane ends with its second step.
        let rewards = [1.0, 4.0, 2.0, 5.0, 3.0, 6.0];
        let values = [0.5, 1.0, 1.5, 2.0, 2.5, 3.0];
        let ended = [false, false, false, true, false, false];
        let mut out = [0.0; 6];
        advantages(&rewards, &values, &ended, &[4.0, 8.0], [0.5, 0.5], &mut out);
        // Lane 0: 3 + 2 - 2.5 = 2.5; 2 + 1.25 - 1.5 + 2.5 / 4 = 2.375;
        // 1 + 0.75 - 0.5 + 2.375 / 4 = 1.84375.
        // Lane 1: 6 + 4 - 3 = 7; 5 - 2 = 3; 4 + 1 - 1 + 3 / 4 = 4.75.
        assert_eq!(out, [1.84375, 4.75, 2.375, 3.0, 2.5, 7.0]);
    }

    #[test]
    fn advantages_with_lambda_one_are_returns_less_values() {
        let rewards = [1.0, 2.0, 4.0];
        let values = [3.0, 5.0, 7.0];
        let mut out = [0.0; 3];
        advantages(&rewards, &values, &[false, false, true], &[9.0], [0.5, 1.0], &mut out);
        // Returns to go: 1 + 1 + 1 = 3, 2 + 2 = 4, 4.
        assert_eq!(out, [0.0, -1.0, -3.0]);
        advantages(&rewards, &values, &[false; 3], &[8.0], [0.5, 1.0], &mut out);
        assert_eq!(out, [1.0, 1.0, 1.0]);
    }
}
