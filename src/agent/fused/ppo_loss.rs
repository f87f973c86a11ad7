//! PPO's loss and its derivatives by the outputs of the policy and value networks.

use std::ops::Range;

use pulp::{Simd, WithSimd};

use crate::agent::ppo::{Losses, Minibatch, Ppo};
use crate::kernel::{Isa, LANES, math};

/// Number of rows computed at a time.
pub(super) const ROWS: usize = 64;

/// The weights and limits of the loss.
#[derive(Clone, Copy, Debug)]
pub struct Objective {
    clip: f32,
    clip_value_loss: bool,
    entropy_weight: f32,
    value_weight: f32,
}

impl Objective {
    pub(super) fn of(parameters: &Ppo) -> Self {
        Objective {
            clip: parameters.clip as f32,
            clip_value_loss: parameters.clip_value_loss,
            entropy_weight: parameters.ent_coef as f32,
            value_weight: parameters.vf_coef as f32,
        }
    }
}

/// Sums over rows; the losses are their means.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LossSums {
    policy: f64,
    value: f64,
    entropy: f64,
    divergence: f64,
}

impl LossSums {
    pub(super) fn add(&mut self, other: &LossSums) {
        self.policy += other.policy;
        self.value += other.value;
        self.entropy += other.entropy;
        self.divergence += other.divergence;
    }

    /// The mean losses over `rows` rows.
    pub(super) fn losses(&self, objective: &Objective, rows: usize) -> Losses {
        let [policy, value, entropy, divergence] =
            [self.policy, self.value, self.entropy, self.divergence].map(|sum| sum / rows as f64);
        let loss = policy - f64::from(objective.entropy_weight) * entropy
            + f64::from(objective.value_weight) * value;
        Losses {
            loss: loss as f32,
            policy: policy as f32,
            value: value as f32,
            entropy: entropy as f32,
            approx_kl: divergence as f32,
        }
    }
}

/// One number per row.
type Column = [f32; ROWS];

/// The loss of a block of at most [`ROWS`] rows, column by column. Unused rows have weight 0.
#[derive(Clone, Debug)]
pub struct PpoLoss {
    /// Logits, by action; [`PpoLoss::compute`] replaces them by the derivatives by the logits.
    logits: Vec<Column>,
    /// Values; [`PpoLoss::compute`] replaces them by the derivatives by the values.
    values: Column,
    /// 1 for the action taken, by action.
    taken: Vec<Column>,
    old_log_probabilities: Column,
    old_values: Column,
    advantages: Column,
    returns: Column,
    /// 1 for a row that counts, 0 for a padding step or an unused row.
    weights: Column,
    /// 1 for a row that counts and whose action the agent chose.
    choices: Column,
    scratch: Scratch,
}

/// Intermediate results between the outputs and the loss.
#[derive(Clone, Debug)]
struct Scratch {
    log_sums: [f64; ROWS],
    policy: Column,
    squares: Column,
    entropy: Column,
    divergence: Column,
}

impl PpoLoss {
    /// Buffers for this number of actions.
    pub(super) fn new(actions: usize) -> Self {
        let column = [0.0; ROWS];
        PpoLoss {
            logits: vec![column; actions],
            values: column,
            taken: vec![column; actions],
            old_log_probabilities: column,
            old_values: column,
            advantages: column,
            returns: column,
            weights: column,
            choices: column,
            scratch: Scratch {
                log_sums: [0.0; ROWS],
                policy: column,
                squares: column,
                entropy: column,
                divergence: column,
            },
        }
    }

    /// Loads actions, old log-probabilities, old values, advantages and returns of some rows of a
    /// minibatch.
    pub(super) fn load(&mut self, minibatch: &Minibatch, rows: Range<usize>) {
        let fill = |to: &mut Column, from: &[f32]| {
            let from = &from[rows.clone()];
            to[..from.len()].copy_from_slice(from);
            to[from.len()..].fill(0.0);
        };
        fill(&mut self.old_log_probabilities, &minibatch.log_probabilities);
        fill(&mut self.old_values, &minibatch.values);
        fill(&mut self.advantages, &minibatch.advantages);
        fill(&mut self.returns, &minibatch.returns);
        self.weights.fill(0.0);
        let counts = rows.clone().map(|row| minibatch.counts(row));
        let each = self.weights.iter_mut().zip(counts);
        each.for_each(|(weight, counts)| *weight = if counts { 1.0 } else { 0.0 });
        self.choices = self.weights;
        let chosen = self.choices.iter_mut().zip(&minibatch.chosen[rows.clone()]);
        chosen.filter(|(_, chosen)| !**chosen).for_each(|(choice, _)| *choice = 0.0);
        for (action, taken) in self.taken.iter_mut().enumerate() {
            let actions = minibatch.actions[rows.clone()].iter();
            let each = taken.iter_mut().zip(actions);
            each.for_each(|(taken, a)| *taken = if a.index() == action { 1.0 } else { 0.0 });
        }
    }

    /// Loads the outputs of some rows: the logits, \[actions\], and the value of each.
    pub(super) fn load_outputs<'r>(&mut self, rows: impl Iterator<Item = (&'r [f32], f32)>) {
        let mut count = 0;
        for (row, (logits, value)) in rows.enumerate() {
            for (column, logit) in self.logits.iter_mut().zip(logits) {
                column[row] = *logit;
            }
            self.values[row] = value;
            count = row + 1;
        }
        for column in self.logits.iter_mut().chain([&mut self.values]) {
            column[count..].fill(0.0);
        }
    }

    /// Writes the derivatives by the outputs after [`PpoLoss::compute`]; rows as in
    /// [`PpoLoss::load_outputs`].
    pub(super) fn store<'r>(&self, rows: impl Iterator<Item = (&'r mut [f32], &'r mut f32)>) {
        for (row, (by_logits, by_value)) in rows.enumerate() {
            for (by_logit, column) in by_logits.iter_mut().zip(&self.logits) {
                *by_logit = column[row];
            }
            *by_value = self.values[row];
        }
    }

    /// Replaces the outputs in place by the derivatives of the mean loss over `rows` rows; returns
    /// the sums over this block.
    pub(super) fn compute(&mut self, isa: Isa, objective: &Objective, rows: usize) -> LossSums {
        isa.run(Compute { loss: self, objective: *objective, scale: 1.0 / rows as f32 })
    }
}

struct Compute<'a> {
    loss: &'a mut PpoLoss,
    objective: Objective,
    /// 1 / rows of the minibatch.
    scale: f32,
}

impl WithSimd for Compute<'_> {
    type Output = LossSums;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> LossSums {
        let Compute { loss, objective, scale } = self;
        loss.differentiate_policy(objective, scale);
        loss.differentiate_value(objective, scale);
        let Scratch { policy, squares, entropy, divergence, .. } = &loss.scratch;
        let sum = |column| sum_of(column, &loss.choices);
        LossSums {
            policy: sum(policy),
            value: 0.5 * sum_of(squares, &loss.weights),
            entropy: sum(entropy),
            divergence: sum(divergence),
        }
    }
}

impl PpoLoss {
    /// Computes the policy loss and the entropy, and the derivatives by the logits. With p the
    /// softmax of the logits and H its entropy, the derivative of ln p_a by logit j is \[j = a\] -
    /// p_j, and the derivative of H is -p_j (ln p_j + H).
    #[inline(always)]
    fn differentiate_policy(&mut self, objective: Objective, scale: f32) {
        if self.logits.len() == 4 {
            self.differentiate_four(objective, scale);
        } else {
            self.differentiate_any(objective, scale);
        }
    }

    /// [`PpoLoss::differentiate_policy`] for four actions, whose numbers stay in registers.
    #[inline(always)]
    #[allow(clippy::needless_range_loop)]
    fn differentiate_four(&mut self, objective: Objective, scale: f32) {
        let [first, second, third, fourth] = &mut self.logits[..] else { return };
        let [is_first, is_second, is_third, is_fourth] = &self.taken[..] else { return };
        let log_sums = &mut self.scratch.log_sums;
        for i in 0..ROWS {
            let (a, b) = (first[i].max(second[i]), third[i].max(fourth[i]));
            let highest = a.max(b);
            let relative = [first[i], second[i], third[i], fourth[i]].map(|l| l - highest);
            let [a, b, c, d] = relative.map(math::exp_f32);
            log_sums[i] = f64::from((a + b) + (c + d));
            [first[i], second[i], third[i], fourth[i]] = relative;
        }
        log_sums.iter_mut().for_each(|sum| *sum = math::ln(*sum));
        for i in 0..ROWS {
            let log_sum = self.scratch.log_sums[i] as f32;
            // Log-probabilities of the actions, then the probabilities.
            let logs = [first[i], second[i], third[i], fourth[i]].map(|l| l - log_sum);
            let p = logs.map(math::exp_f32);
            let taken = [is_first[i], is_second[i], is_third[i], is_fourth[i]];
            let chosen = (taken[0] * logs[0] + taken[1] * logs[1])
                + (taken[2] * logs[2] + taken[3] * logs[3]);
            let h = -((p[0] * logs[0] + p[1] * logs[1]) + (p[2] * logs[2] + p[3] * logs[3]));
            let step = (chosen, self.old_log_probabilities[i], self.advantages[i]);
            let by_chosen = self.scratch.lose(objective, i, step, h);
            let weight = self.choices[i] * scale;
            let mut by = [0.0; 4];
            for j in 0..4 {
                let of_entropy = objective.entropy_weight * (p[j] * (logs[j] + h));
                by[j] = weight * (by_chosen * (taken[j] - p[j]) + of_entropy);
            }
            [first[i], second[i], third[i], fourth[i]] = by;
        }
    }

    /// [`PpoLoss::differentiate_policy`] for any number of actions, one column after the other.
    #[inline(always)]
    #[allow(clippy::needless_range_loop)]
    fn differentiate_any(&mut self, objective: Objective, scale: f32) {
        let PpoLoss { logits, taken, scratch, .. } = self;
        let mut highest = [f32::NEG_INFINITY; ROWS];
        for column in &*logits {
            highest.iter_mut().zip(column).for_each(|(high, logit)| *high = high.max(*logit));
        }
        scratch.log_sums.fill(0.0);
        for column in &mut *logits {
            for i in 0..ROWS {
                column[i] -= highest[i];
                scratch.log_sums[i] += f64::from(math::exp_f32(column[i]));
            }
        }
        scratch.log_sums.iter_mut().for_each(|sum| *sum = math::ln(*sum));
        let (mut chosen, mut h, mut by_chosen) = ([0.0; ROWS], [0.0; ROWS], [0.0; ROWS]);
        for (column, taken) in logits.iter_mut().zip(&*taken) {
            for i in 0..ROWS {
                // From here on the log-probabilities.
                column[i] -= scratch.log_sums[i] as f32;
                chosen[i] += taken[i] * column[i];
                h[i] -= math::exp_f32(column[i]) * column[i];
            }
        }
        for i in 0..ROWS {
            let step = (chosen[i], self.old_log_probabilities[i], self.advantages[i]);
            by_chosen[i] = scratch.lose(objective, i, step, h[i]);
        }
        for (column, taken) in logits.iter_mut().zip(&*taken) {
            for i in 0..ROWS {
                let (weight, p) = (self.choices[i] * scale, math::exp_f32(column[i]));
                let of_entropy = objective.entropy_weight * (p * (column[i] + h[i]));
                column[i] = weight * (by_chosen[i] * (taken[i] - p) + of_entropy);
            }
        }
    }

    /// Computes the value loss and its derivative: of half the squared error, or with clipping, of
    /// half the larger of the squared errors of the value and of the clipped value. The clipped
    /// value has derivative 0 beyond the limits.
    #[inline(always)]
    #[allow(clippy::needless_range_loop)]
    fn differentiate_value(&mut self, objective: Objective, scale: f32) {
        // Without clipping, the limit is infinite.
        let limit = if objective.clip_value_loss { objective.clip } else { f32::INFINITY };
        for i in 0..ROWS {
            let error = self.values[i] - self.returns[i];
            let moved = self.values[i] - self.old_values[i];
            let clipped = if moved < -limit { -limit } else { moved };
            let clipped = if clipped > limit { limit } else { clipped };
            let other = self.old_values[i] + clipped - self.returns[i];
            let is_outside = moved.abs() > limit;
            let is_clipped = is_outside && other * other > error * error;
            let weight = self.weights[i] * scale * objective.value_weight;
            self.scratch.squares[i] = if is_clipped { other * other } else { error * error };
            self.values[i] = if is_clipped { 0.0 } else { weight * error };
        }
    }
}

impl Scratch {
    /// Writes the policy loss, the entropy `h` and the divergence of a row, whose action has the log-probability
    /// `chosen`; returns the derivative of the loss by it.
    #[inline(always)]
    fn lose(
        &mut self,
        objective: Objective,
        row: usize,
        (chosen, old, advantage): (f32, f32, f32),
        h: f32,
    ) -> f32 {
        let (low, high) = (1.0 - objective.clip, 1.0 + objective.clip);
        let log_ratio = chosen - old;
        let ratio = math::exp_f32(log_ratio);
        let clipped = if ratio < low { low } else { ratio };
        let clipped = if clipped > high { high } else { clipped };
        let (plain, bounded) = (-advantage * ratio, -advantage * clipped);
        self.policy[row] = if plain < bounded { bounded } else { plain };
        self.entropy[row] = h;
        self.divergence[row] = (ratio - 1.0) - log_ratio;
        if plain < bounded { 0.0 } else { plain }
    }
}

/// The sum of a column over the rows that count, accumulated in [`LANES`] virtual lanes.
#[inline(always)]
fn sum_of(column: &Column, weights: &Column) -> f64 {
    let mut sums = [0.0f64; LANES];
    for (column, weights) in column.chunks_exact(LANES).zip(weights.chunks_exact(LANES)) {
        let terms = column.iter().zip(weights);
        sums.iter_mut().zip(terms).for_each(|(sum, (x, w))| *sum += f64::from(x * w));
    }
    sums.iter().sum()
}
