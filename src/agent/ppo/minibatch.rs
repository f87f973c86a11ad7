//! Minibatches of PPO: the steps of a rollout from which an update learns.

use crate::agent::memory::{self, OutOfMemory, reserve};
use crate::agent::ppo::rollout::LaneSteps;
use crate::env::{Action, Observations};

/// Added to the standard deviation by which advantages are divided.
const LEAST_DEVIATION: f64 = 1e-8;

/// Steps of a rollout; row i of every array belongs to step i. For networks with memory, a
/// minibatch consists of whole sequences: row t * lanes + l is step t of lane l.
#[derive(Clone, Debug)]
pub struct Minibatch {
    /// The states.
    pub observations: Observations,
    /// \[rows\]: the actions taken in these states.
    pub actions: Vec<Action>,
    /// \[rows\]: whether the agent chose the action. The policy learns from these rows alone, the values
    /// from all.
    pub chosen: Vec<bool>,
    /// \[rows\]: log-probabilities of these actions when they were chosen.
    pub log_probabilities: Vec<f32>,
    /// \[rows\]: values of the states when the actions were chosen.
    pub values: Vec<f32>,
    /// \[rows\]: advantages of the actions, normalised if so declared.
    pub advantages: Vec<f32>,
    /// \[rows\]: targets of the values: the advantages before normalisation plus the old values.
    pub returns: Vec<f32>,
    /// The division of the rows into sequences; `None` for networks without memory.
    pub sequences: Option<Sequences>,
}

/// Sequences of steps, one per lane.
#[derive(Clone, Debug)]
pub struct Sequences {
    /// The number of sequences.
    pub lanes: usize,
    /// \[lanes, memory\]: the networks' memory before the first step.
    pub memory: Vec<f32>,
    /// \[rows\]: whether the step is the first of an episode, at which the memory is zero.
    pub firsts: Vec<bool>,
    /// \[rows\]: whether the step was taken; other rows are padding and do not count.
    pub real: Vec<bool>,
}

impl Minibatch {
    /// An empty minibatch.
    pub(super) fn new(observations: Observations) -> Self {
        Minibatch {
            observations,
            actions: Vec::new(),
            chosen: Vec::new(),
            log_probabilities: Vec::new(),
            values: Vec::new(),
            advantages: Vec::new(),
            returns: Vec::new(),
            sequences: None,
        }
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.actions.len()
    }

    /// Number of rows that count.
    pub fn steps(&self) -> usize {
        match &self.sequences {
            None => self.rows(),
            Some(sequences) => sequences.real.iter().filter(|real| **real).count(),
        }
    }

    /// Whether a row counts.
    pub fn counts(&self, row: usize) -> bool {
        self.sequences.as_ref().is_none_or(|sequences| sequences.real[row])
    }

    /// Replaces the minibatch by these rows of a rollout.
    pub(super) fn gather(&mut self, rollout: &LaneSteps, rows: &[u32]) -> Result<(), OutOfMemory> {
        self.clear();
        self.reserve(rows.len())?;
        rows.iter().for_each(|row| self.push(rollout, *row as usize));
        Ok(())
    }

    /// Replaces the minibatch by all rows of some lanes of a rollout.
    pub(super) fn gather_lanes(
        &mut self,
        rollout: &LaneSteps,
        lanes: &[u32],
    ) -> Result<(), OutOfMemory> {
        const WHAT: &str = "a minibatch";
        self.clear();
        let rows = rollout.steps() * lanes.len();
        self.reserve(rows)?;
        let mut sequences = self.sequences.take().unwrap_or_else(Sequences::none);
        sequences.clear(lanes.len());
        let width = rollout.memory.len() / rollout.lanes;
        reserve(&mut sequences.memory, lanes.len() * width, WHAT)?;
        reserve(&mut sequences.firsts, rows, WHAT)?;
        reserve(&mut sequences.real, rows, WHAT)?;
        for &lane in lanes {
            let from = lane as usize * width;
            sequences.memory.extend_from_slice(&rollout.memory[from..from + width]);
        }
        for step in 0..rollout.steps() {
            for &lane in lanes {
                let row = step * rollout.lanes + lane as usize;
                self.push(rollout, row);
                sequences.firsts.push(rollout.firsts[row]);
                sequences.real.push(rollout.real[row]);
            }
        }
        self.sequences = Some(sequences);
        Ok(())
    }

    fn push(&mut self, rollout: &LaneSteps, row: usize) {
        self.observations.extend(&rollout.observations, row..row + 1);
        self.actions.push(rollout.actions[row]);
        self.chosen.push(rollout.chosen[row]);
        self.log_probabilities.push(rollout.log_probabilities[row]);
        self.values.push(rollout.values[row]);
        self.advantages.push(rollout.advantages[row]);
        self.returns.push(rollout.advantages[row] + rollout.values[row]);
    }

    /// Normalises the advantages of the choices to mean 0 and standard deviation 1.
    pub(super) fn normalise(&mut self) {
        let Minibatch { advantages, chosen, sequences, .. } = self;
        match sequences {
            None => normalise(advantages, |row| chosen[row]),
            Some(sequences) => normalise(advantages, |row| chosen[row] && sequences.real[row]),
        }
    }

    fn clear(&mut self) {
        self.observations.clear();
        self.actions.clear();
        self.chosen.clear();
        self.log_probabilities.clear();
        self.values.clear();
        self.advantages.clear();
        self.returns.clear();
    }

    fn reserve(&mut self, rows: usize) -> Result<(), OutOfMemory> {
        const WHAT: &str = "a minibatch";
        let bytes = rows * self.observations.width() * size_of::<f32>();
        let refused = OutOfMemory { what: WHAT, bytes };
        memory::permit(bytes, WHAT)?;
        self.observations.try_reserve(rows).map_err(|_| refused)?;
        reserve(&mut self.actions, rows, WHAT)?;
        reserve(&mut self.chosen, rows, WHAT)?;
        reserve(&mut self.log_probabilities, rows, WHAT)?;
        reserve(&mut self.values, rows, WHAT)?;
        reserve(&mut self.advantages, rows, WHAT)?;
        reserve(&mut self.returns, rows, WHAT)
    }
}

impl Sequences {
    fn none() -> Self {
        Sequences { lanes: 0, memory: Vec::new(), firsts: Vec::new(), real: Vec::new() }
    }

    fn clear(&mut self, lanes: usize) {
        self.lanes = lanes;
        self.memory.clear();
        self.firsts.clear();
        self.real.clear();
    }
}

/// Normalises the numbers that count to mean 0 and standard deviation 1: (x - mean) / (sd + 1e-8),
/// with n - 1 in the variance. A single number becomes 0, and so do numbers that do not count.
fn normalise(numbers: &mut [f32], counts: impl Fn(usize) -> bool) {
    let (mut n, mut sum, mut squares) = (0.0, 0.0, 0.0);
    for (_, x) in numbers.iter().enumerate().filter(|(row, _)| counts(*row)) {
        n += 1.0;
        sum += f64::from(*x);
    }
    let mean = sum / n;
    for (_, x) in numbers.iter().enumerate().filter(|(row, _)| counts(*row)) {
        squares += (f64::from(*x) - mean).powi(2);
    }
    let deviation = (squares / f64::max(n - 1.0, 1.0)).sqrt() + LEAST_DEVIATION;
    for (row, x) in numbers.iter_mut().enumerate() {
        *x = if counts(row) { ((f64::from(*x) - mean) / deviation) as f32 } else { 0.0 };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_normalised_by_hand() {
        // Mean 3, sum of squares 4 + 1 + 9 = 14, standard deviation sqrt(7).
        let mut numbers = [1.0, 2.0, 500.0, 6.0];
        normalise(&mut numbers, |row| row != 2);
        for (ours, hand) in numbers.into_iter().zip([-2.0, -1.0, 0.0, 3.0]) {
            assert!((ours - hand / 7f32.sqrt()).abs() < 1e-6, "{ours}");
        }
        let mut alone = [5.0];
        normalise(&mut alone, |_| true);
        assert_eq!(alone, [0.0]);
    }
}
