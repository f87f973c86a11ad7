//! Values of all states on a grid by backward induction, and the policy they define.

use crate::env::{Action, Belief, DisengagementReward, apply_action};
use crate::env::{FirstContext, StepCount};

use super::action_values::ActionValues;
use super::axis::{Cubic, GridAxis, Linear};
use super::expectation::Expectation;

/// The resolution of a grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Resolution {
    /// The minimum number of intervals of habituation from 0 to 1.
    pub habituation: usize,
    /// The number of even intervals of disengagement risk from 0 to the threshold.
    pub disengagement: usize,
    /// The maximum number of jumps of the value that have their own nodes.
    pub jumps: usize,
}

impl Resolution {
    /// The grid on which optima are computed.
    const FINE: Resolution = Resolution { habituation: 160, disengagement: 300, jumps: 200 };
    /// The grid for values that do not depend on disengagement risk.
    const FINE_WITHOUT_RISK: Resolution =
        Resolution { habituation: 4000, disengagement: 1, jumps: 0 };

    /// The grid for an environment and a belief.
    pub fn fine(e: &StepCount, belief: Belief) -> Resolution {
        // If the context is known, no wrong message is sent, unless it pays to end the episode.
        let pays_to_go_on = e.rho_2 >= 0.0 && e.mu[0] + e.mu[1] >= 0.0;
        match belief {
            Belief::Certain if pays_to_go_on => Resolution::FINE_WITHOUT_RISK,
            _ => Resolution::FINE,
        }
    }

    /// A grid with twice the spacing.
    pub fn coarser(self) -> Resolution {
        let Resolution { habituation, disengagement, jumps } = self;
        Resolution {
            habituation: habituation / 2,
            disengagement: disengagement.div_ceil(2),
            jumps: jumps / 2,
        }
    }
}

/// The values of a grid's nodes for every number of steps left, and the policy they define.
#[derive(Clone, Debug)]
pub(super) struct Solution {
    /// Without baseline rewards, which no action affects.
    environment: StepCount,
    belief: Belief,
    /// Baseline reward in context 0 and in context 1.
    baseline: [f64; 2],
    expectation: Expectation,
    habituation: GridAxis,
    disengagement: GridAxis,
    /// **Shapes**: \[steps left, from 0\]\[habituation × disengagement risk\].
    layers: Vec<Vec<f64>>,
}

/// The results of the actions at the nodes of one habituation.
struct Row {
    rested: Cubic,
    messaged: Cubic,
    /// Reward of an untailored message, without the baseline and less its cost.
    untailored: f64,
    /// Reward of a suitable message, without the baseline and less its cost.
    suitable: f64,
    /// Reward of an unsuitable message, without the baseline and less its cost: if the episode continues, and if it ends.
    unsuitable: f64,
    disengaging: f64,
}

/// The results of the actions at the nodes of one disengagement risk.
struct Column {
    after_suitable: Linear,
    /// `None` if the episode ends.
    after_unsuitable: Option<Linear>,
}

impl Solution {
    /// The values on a grid of the environment for an agent with this belief.
    pub fn new(environment: &StepCount, belief: Belief, resolution: Resolution) -> Solution {
        let Resolution { habituation, disengagement, jumps } = resolution;
        let unbiased = StepCount { mu: [0.0; 2], ..environment.clone() };
        let mut solution = Solution {
            habituation: GridAxis::habituation(&unbiased, habituation),
            disengagement: GridAxis::disengagement(&unbiased, disengagement, jumps),
            environment: unbiased,
            belief,
            baseline: environment.mu,
            expectation: Expectation::new(belief),
            layers: Vec::new(),
        };
        solution.induce();
        solution
    }

    /// Computes all layers, starting with no steps left.
    fn induce(&mut self) {
        let (rows, columns) = (self.rows(), self.columns());
        let mut later = vec![0.0; rows.len() * columns.len()];
        let mut messaged = vec![0.0; columns.len()];
        for _ in 1..self.environment.horizon {
            let mut now = vec![0.0; later.len()];
            for (row, now) in rows.iter().zip(now.chunks_exact_mut(columns.len())) {
                interpolate(row.rested, &later, now);
                interpolate(row.messaged, &later, &mut messaged);
                for (column, now) in columns.iter().zip(now) {
                    let calm = column.after_suitable.of(&messaged);
                    let unsuitable = match column.after_unsuitable {
                        Some(at) => row.unsuitable + at.of(&messaged),
                        None => row.disengaging,
                    };
                    *now = self.mean_of_best(&ActionValues {
                        nothing: *now,
                        untailored: row.untailored + calm,
                        suitable: row.suitable + calm,
                        unsuitable,
                    });
                }
            }
            self.layers.push(std::mem::replace(&mut later, now));
        }
        self.layers.push(later);
    }

    fn rows(&self) -> Vec<Row> {
        let row = |h: &f64| {
            let after = |action| apply_action(&self.environment, 0, action, *h, 0.0);
            let suitable = after(Action::tailored_to(0));
            let cost = self.environment.message_cost;
            let unsuitable = after(Action::tailored_to(1)).reward - cost;
            Row {
                rested: self.habituation.cubic(after(Action::NONE).habituation),
                messaged: self.habituation.cubic(suitable.habituation),
                untailored: after(Action::UNTAILORED).reward - cost,
                suitable: suitable.reward - cost,
                unsuitable,
                disengaging: self.disengaging(unsuitable),
            }
        };
        self.habituation.nodes().iter().map(row).collect()
    }

    fn columns(&self) -> Vec<Column> {
        let threshold = self.environment.disengagement_threshold;
        let column = |d: &f64| {
            let after = |action| apply_action(&self.environment, 0, action, 0.0, *d).disengagement;
            let [calm, annoyed] = [0, 1].map(|context| after(Action::tailored_to(context)));
            let at_annoyed = || self.disengagement.linear(annoyed);
            Column {
                after_suitable: self.disengagement.linear(calm),
                after_unsuitable: (annoyed < threshold).then(at_annoyed),
            }
        };
        self.disengagement.nodes().iter().map(column).collect()
    }

    /// The environment, without its baseline rewards.
    pub fn environment(&self) -> &StepCount {
        &self.environment
    }

    /// The policy's belief about the context.
    pub fn belief(&self) -> Belief {
        self.belief
    }

    /// The value of a state in a running episode, interpolated between nodes.
    fn interpolated(&self, left: u32, habituation: f64, disengagement: f64) -> f64 {
        let (layer, width) = (&self.layers[left as usize], self.disengagement.nodes().len());
        let column = self.disengagement.linear(disengagement);
        let Cubic { node, weights } = self.habituation.cubic(habituation);
        let rows = layer[node * width..].chunks_exact(width);
        weights.iter().zip(rows).map(|(weight, row)| weight * column.of(row)).sum()
    }

    /// The value of a state with `left` steps left, by one step of lookahead on the interpolated values; 0 if
    /// the episode has ended.
    pub fn value(&self, left: u32, habituation: f64, disengagement: f64) -> f64 {
        if left == 0 || disengagement >= self.environment.disengagement_threshold {
            return 0.0;
        }
        let later = |h, d| {
            let has_ended = d >= self.environment.disengagement_threshold;
            if has_ended { 0.0 } else { self.interpolated(left - 1, h, d) }
        };
        self.mean_of_best(&self.values_before(habituation, disengagement, later))
    }

    /// The action values of a state with `left` steps left after the action.
    pub fn action_values(&self, left: u32, habituation: f64, disengagement: f64) -> ActionValues {
        self.values_before(habituation, disengagement, |h, d| self.value(left, h, d))
    }

    /// The action values of a state, given the values of the next states.
    fn values_before(&self, h: f64, d: f64, later: impl Fn(f64, f64) -> f64) -> ActionValues {
        let e = &self.environment;
        let effect = |action| apply_action(e, 0, action, h, d);
        let [nothing, untailored, suitable, unsuitable] =
            [Action::NONE, Action::UNTAILORED, Action::tailored_to(0), Action::tailored_to(1)]
                .map(effect);
        let [rested, calm, annoyed] = [nothing, suitable, unsuitable]
            .map(|effect| later(effect.habituation, effect.disengagement));
        ActionValues {
            nothing: rested,
            untailored: untailored.reward - e.message_cost + calm,
            suitable: suitable.reward - e.message_cost + calm,
            unsuitable: match unsuitable.disengagement >= e.disengagement_threshold {
                true => self.disengaging(unsuitable.reward - e.message_cost) + annoyed,
                false => unsuitable.reward - e.message_cost + annoyed,
            },
        }
    }

    /// The reward, without the baseline and less the cost, of a wrong message that ends the episode and would
    /// otherwise pay `reward`.
    fn disengaging(&self, reward: f64) -> f64 {
        match self.environment.disengagement_reward {
            DisengagementReward::Paid => reward,
            // Both baselines are equal; `check` ensures this.
            DisengagementReward::Zero => -self.baseline[0] - self.environment.message_cost,
        }
    }

    /// The mean over contexts of the best action value plus the baseline reward.
    #[inline(always)]
    pub fn mean_of_best(&self, values: &ActionValues) -> f64 {
        (self.baseline[0] + self.baseline[1]) / 2.0 + self.expectation.of_best(values)
    }

    /// The value at the start of an episode.
    pub fn value_of_start(&self) -> f64 {
        let e = &self.environment;
        let start = (e.initial_habituation, e.initial_disengagement);
        let values = self.action_values(e.horizon - 1, start.0, start.1);
        match e.first_context {
            FirstContext::Fixed => self.baseline[0] + Expectation::Certain.of_best(&values),
            FirstContext::Sampled => self.mean_of_best(&values),
        }
    }

    /// The best action at a time, counted from 0, if context 0 has the probability `believed`. A fixed first
    /// context is known.
    pub fn choose(&self, time: u32, believed: f64, habituation: f64, disengagement: f64) -> Action {
        let e = &self.environment;
        let is_known = time == 0 && e.first_context == FirstContext::Fixed;
        let Some(left) = (e.horizon - 1).checked_sub(time) else {
            // In the unpaid last step, the action makes no difference.
            return Action::NONE;
        };
        let values = self.action_values(left, habituation, disengagement);
        values.best(if is_known { 1.0 } else { believed })
    }
}

/// Interpolates a row of a layer.
fn interpolate(at: Cubic, layer: &[f64], out: &mut [f64]) {
    let width = out.len();
    let row = |i: usize| &layer[(at.node + i) * width..][..width];
    let ([a, b, c, d], [first, second, third, fourth]) = (at.weights, [0, 1, 2, 3].map(row));
    for (i, out) in out.iter_mut().enumerate() {
        *out = a * first[i] + b * second[i] + c * third[i] + d * fourth[i];
    }
}
