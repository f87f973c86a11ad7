//! How the action probabilities of a bandit in a trial depend on the sums that an update has of the data.
//!
//! In: the sums of an update, which are the precision Λ and Λm of every regression, and the features of a state. Out:
//! probabilities, and their derivatives by the sums. Standard errors that account for the learning need them.

use nalgebra::{DMatrix, DVector};

use super::logistic::slopes_of_logistic;
use super::normal::slopes;
use super::posterior::{Made, Posterior, centred, regressors};
use super::regression::{Factored, Regression};
use super::sampler::Logistic;
use super::{BanditAllocation, BanditDraw, Design, LinearThompson};
use crate::agent::layers::Shape;

/// Why the derivatives are not known.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoSlopes {
    /// Probabilities are means over simulated draws.
    #[error(
        "the agent's probabilities are means over draws, which are not smooth; use `allocation = \"logistic\"`, or leave \
         out `smoothing` and `action_centring`"
    )]
    ByDraws,
    /// Probabilities are cut to a range.
    #[error(
        "the agent's probabilities are cut to a range, and not smooth there; use `allocation = \"logistic\"`"
    )]
    Clipped,
    /// The data of an update are not those of the last posterior alone.
    #[error(
        "a posterior of an earlier job, `prior_from`, or `draw = \"episode\"` is not supported"
    )]
    Unsupported,
    /// The precision of a regression is not positive definite.
    #[error("the precision of a regression is not positive definite")]
    Singular,
}

/// The sums of a bandit: the number of regressions, and the width of each.
#[derive(Clone, Debug)]
pub struct BanditSums {
    parameters: LinearThompson,
    design: Design,
    actions: usize,
    regressions: usize,
    width: usize,
}

impl BanditSums {
    /// The sums of a bandit that observes this number of letters without a one-hot, and has this number of actions.
    ///
    /// **Errors**: the probabilities of the bandit are not smooth, or not supported.
    pub fn new(
        parameters: &LinearThompson,
        letters: usize,
        actions: usize,
    ) -> Result<BanditSums, NoSlopes> {
        if parameters.allocation == BanditAllocation::Clipped {
            return Err(NoSlopes::Clipped);
        }
        let is_logistic = parameters.allocation == BanditAllocation::Logistic;
        if !is_logistic && (parameters.action_centring || parameters.smoothing > 0.0) {
            return Err(NoSlopes::ByDraws);
        }
        if parameters.draw != BanditDraw::Step || !parameters.prior_from.is_none() {
            return Err(NoSlopes::Unsupported);
        }
        let design = Design::of(parameters.features, letters, 0);
        let shape = Shape { inputs: design.width(), actions };
        let (regressions, width) = regressors(parameters, shape);
        let parameters = parameters.clone();
        Ok(BanditSums { parameters, design, actions, regressions, width })
    }

    /// The number of regressions, and the number of regressors of each.
    pub fn shape(&self) -> (usize, usize) {
        (self.regressions, self.width)
    }

    /// The number of sums of a regression: the packed lower triangle of the precision, row by row, and Λm.
    fn of_one(&self) -> usize {
        self.width * (self.width + 1) / 2 + self.width
    }

    /// The number of all sums.
    pub fn count(&self) -> usize {
        self.regressions * self.of_one()
    }

    /// The features of a state, from what the agent observed.
    pub fn features(&self, observed: &[f64]) -> Vec<f64> {
        let mut features = Vec::new();
        self.design.fill_exact(observed, None, &mut features);
        features
    }

    /// The sums of the prior.
    pub fn prior(&self) -> Vec<f64> {
        let shape = Shape { inputs: self.design.width(), actions: self.actions };
        let prior = Posterior::prior(&self.parameters, shape);
        prior.regressions().iter().flat_map(|one| self.packed(one)).collect()
    }

    fn packed(&self, one: &Regression) -> Vec<f64> {
        let triangle = (0..self.width).flat_map(|i| (0..=i).map(move |j| (i, j)));
        let precision = triangle.map(|at| one.precision[at]);
        precision.chain(one.information.iter().copied()).collect()
    }

    /// Adds a decision with its reward to sums.
    pub fn add(&self, decision: Made<'_>, reward: f64, sums: &mut [f64]) {
        let noise = self.parameters.noise_sd * self.parameters.noise_sd;
        let (index, row) = self.regressors(decision);
        let own = &mut sums[index * self.of_one()..(index + 1) * self.of_one()];
        let mut at = 0;
        for (i, one) in row.iter().enumerate() {
            for other in &row[..=i] {
                own[at] += one * other / noise;
                at += 1;
            }
        }
        own[at..].iter_mut().zip(&row).for_each(|(sum, one)| *sum += one * reward / noise);
    }

    /// The regression of a decision and its regressors.
    fn regressors(&self, decision: Made<'_>) -> (usize, Vec<f64>) {
        if !self.parameters.action_centring {
            return (decision.action.index(), decision.features.to_vec());
        }
        let mut row = Vec::new();
        centred(decision, &mut row);
        (0, row)
    }

    /// Adds to `out` a multiple of the derivative of a decision's part in the sums by the probability of action 1, which
    /// stands in the regressors with action centring; nothing without it.
    pub fn add_slope(&self, decision: Made<'_>, reward: f64, out: &mut [f64]) {
        if !self.parameters.action_centring {
            return;
        }
        let noise = self.parameters.noise_sd * self.parameters.noise_sd;
        let (_, row) = self.regressors(decision);
        let features = decision.features;
        let mut slope = vec![0.0; features.len()];
        slope.extend_from_slice(features);
        slope.extend(features.iter().map(|feature| -feature));
        let mut at = 0;
        for i in 0..row.len() {
            for j in 0..=i {
                out[at] += (slope[i] * row[j] + row[i] * slope[j]) / noise;
                at += 1;
            }
        }
        out[at..].iter_mut().zip(&slope).for_each(|(sum, one)| *sum += one * reward / noise);
    }

    /// The policy of these sums.
    ///
    /// **Errors**: a precision is not positive definite.
    pub fn policy(&self, sums: &[f64]) -> Result<SmoothPolicy<'_>, NoSlopes> {
        let factored = sums.chunks_exact(self.of_one()).map(|own| {
            let (triangle, information) = own.split_at(own.len() - self.width);
            let entry = |i: usize, j: usize| triangle[i.max(j) * (i.max(j) + 1) / 2 + i.min(j)];
            let precision = DMatrix::from_fn(self.width, self.width, entry);
            let information = DVector::from_column_slice(information);
            Factored::new(&Regression { precision, information }).map_err(|_| NoSlopes::Singular)
        });
        Ok(SmoothPolicy { of: self, factored: factored.collect::<Result<_, _>>()? })
    }
}

/// The policy of the sums of an update.
#[derive(Debug)]
pub struct SmoothPolicy<'s> {
    of: &'s BanditSums,
    factored: Vec<Factored>,
}

impl SmoothPolicy<'_> {
    /// Adds to `out` the derivative of Σ w_a π_a by the sums, for the probabilities π in a state and weights w of the
    /// actions.
    pub fn add_slopes(&mut self, features: &[f64], weights: &[f64], out: &mut [f64]) {
        let parameters = &self.of.parameters;
        let rest = 1.0 - self.of.actions as f64 * parameters.pi_min;
        let bias = |action: usize| parameters.action_bias.get(action).copied().unwrap_or(0.0);
        if parameters.action_centring {
            let first = self.of.width - features.len();
            let mut row = vec![0.0; first];
            row.extend_from_slice(features);
            let (mean, sd) = self.normal(0, &row);
            let by = rest * (weights[1] - weights[0]);
            let [by_mean, by_sd] = self.logistic(mean + bias(1) - bias(0), sd);
            return self.add_normal((0, &row), (by * by_mean, by * by_sd / (2.0 * sd)), out);
        }
        let normals: Vec<(f64, f64)> =
            (0..self.of.actions).map(|action| self.normal(action, features)).collect();
        let means: Vec<f64> =
            normals.iter().enumerate().map(|(action, one)| one.0 + bias(action)).collect();
        let sds: Vec<f64> = normals.iter().map(|one| one.1).collect();
        if parameters.allocation == BanditAllocation::Logistic {
            let sd = (sds[0] * sds[0] + sds[1] * sds[1]).sqrt();
            let by = rest * (weights[1] - weights[0]);
            let [by_mean, by_sd] = self.logistic(means[1] - means[0], sd);
            for (action, sign) in [(0, -1.0), (1, 1.0)] {
                let slopes = (sign * by * by_mean, by * by_sd / (2.0 * sd));
                self.add_normal((action, features), slopes, out);
            }
            return;
        }
        let [by_mean, by_sd] = slopes(&means, &sds, weights);
        for action in 0..self.of.actions {
            let slopes = (rest * by_mean[action], rest * by_sd[action] / (2.0 * sds[action]));
            self.add_normal((action, features), slopes, out);
        }
    }

    /// The mean and the standard deviation of a prediction of a regression.
    fn normal(&mut self, index: usize, row: &[f64]) -> (f64, f64) {
        let one = &mut self.factored[index];
        let mean = one.predict(row);
        let whitened = one.whiten(row);
        (mean, whitened.iter().map(|value| value * value).sum::<f64>().sqrt())
    }

    /// The derivatives of the probability of action 1 by the mean and the standard deviation of the effect.
    fn logistic(&self, mean: f64, sd: f64) -> [f64; 2] {
        let logistic = Logistic::of(&self.of.parameters).expect("the allocation is logistic");
        let Logistic { lower, upper, slope, log_odds } = logistic;
        slopes_of_logistic(slope * mean - log_odds, slope * sd)
            .map(|by| (upper - lower) * slope * by)
    }

    /// Adds the derivatives by the sums of a regression, given those by the mean and the variance of a prediction: with
    /// w = Λ⁻¹x, the mean x'Λ⁻¹b has the differential w'db - w'dΛ m, and the variance x'Λ⁻¹x has -w'dΛ w.
    fn add_normal(&self, (index, row): (usize, &[f64]), by: (f64, f64), out: &mut [f64]) {
        let own = &mut out[index * self.of.of_one()..(index + 1) * self.of.of_one()];
        let (by_mean, by_variance) = by;
        let one = &self.factored[index];
        let (solved, mean) = (one.solve(row), one.mean());
        let mut at = 0;
        for i in 0..solved.len() {
            for j in 0..=i {
                // An entry off the diagonal stands at two places.
                let twice = if i == j { 0.5 } else { 1.0 };
                let of_mean = by_mean * (solved[i] * mean[j] + solved[j] * mean[i]);
                let of_variance = 2.0 * by_variance * solved[i] * solved[j];
                own[at] -= twice * (of_mean + of_variance);
                at += 1;
            }
        }
        own[at..].iter_mut().zip(&solved).for_each(|(sum, one)| *sum += by_mean * one);
    }
}
