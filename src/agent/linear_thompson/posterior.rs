//! The posterior of the rewards of all actions.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};

use crate::agent::Shape;
use crate::agent::linear_thompson::LinearThompson;
use crate::agent::linear_thompson::features::Design;
use crate::agent::linear_thompson::prior::Prior;
use crate::agent::linear_thompson::regression::{Factored, NotPositiveDefinite, Regression};
use crate::agent::unavailable::certain;
use crate::agent::weights::{Tensor, Weights, WeightsError};
use crate::env::Action;
use crate::state::resumable;

/// A step from which an agent learns.
#[derive(Clone, Debug, Default)]
pub struct Decision {
    /// The features of the state.
    pub features: Vec<f64>,
    /// The probabilities from which the action was drawn, \[actions\].
    pub probabilities: Vec<f64>,
    /// The action taken.
    pub action: Action,
}

/// A decision that is stored elsewhere; see `Decision`.
#[derive(Clone, Copy, Debug)]
pub struct Made<'a> {
    pub features: &'a [f64],
    pub probabilities: &'a [f64],
    pub action: Action,
}

impl Decision {
    /// The decision, borrowed.
    pub fn made(&self) -> Made<'_> {
        let Decision { features, probabilities, action } = self;
        Made { features, probabilities, action: *action }
    }

    /// A decision to be made among this number of actions.
    pub fn among(actions: usize) -> Self {
        let (features, probabilities) = (Vec::new(), vec![0.0; actions]);
        Decision { features, probabilities, action: Action::default() }
    }

    /// Takes action 0, because the agent does not choose.
    pub fn withhold(&mut self) {
        self.action = Action::default();
        certain(self.action, &mut self.probabilities);
    }
}

resumable!([] Decision { grown features, probabilities; parts action });

/// The posterior of all coefficients: one regression per action, or one shared regression with
/// action centring.
#[derive(Clone, Debug)]
pub struct Posterior {
    noise_variance: f64,
    /// One regression per action, or a single shared one.
    regressions: Vec<Regression>,
    /// Buffer for the regressors of a step with action centring.
    row: Vec<f64>,
}

impl Posterior {
    /// The prior of an agent whose states have this number of features.
    pub fn prior(parameters: &LinearThompson, features: Shape) -> Self {
        Self::prior_of(parameters, features, Prior::regressions)
    }

    /// The prior of what people have in common.
    pub fn common_prior(parameters: &LinearThompson, features: Shape) -> Self {
        Self::prior_of(parameters, features, Prior::common)
    }

    fn prior_of(
        parameters: &LinearThompson,
        features: Shape,
        earlier: fn(&Prior) -> &[Regression],
    ) -> Self {
        let (count, width) = regressors(parameters, features);
        let regressions = match parameters.prior_from.parsed::<Prior>() {
            Some(prior) => earlier(&prior).to_vec(),
            None => vec![prior(parameters, features.inputs, width); count],
        };
        Posterior {
            noise_variance: parameters.noise_sd * parameters.noise_sd,
            regressions,
            row: Vec::new(),
        }
    }

    /// A sum over no data, without the prior.
    pub fn without_data(&self) -> Posterior {
        let mut none = self.clone();
        none.regressions.iter_mut().for_each(Regression::clear);
        none
    }

    /// Adds the data of another posterior, which has no prior of its own.
    #[inline(always)]
    pub fn add(&mut self, data: &Posterior) {
        let pairs = self.regressions.iter_mut().zip(&data.regressions);
        pairs.for_each(|(own, data)| own.add(data));
    }

    /// The posterior from weights that [`Posterior::weights`] wrote.
    ///
    /// **Errors**: an array is missing or of another shape.
    pub fn trained(
        parameters: &LinearThompson,
        features: Shape,
        weights: &Weights,
    ) -> Result<Self, WeightsError> {
        let mut posterior = Posterior::prior(parameters, features);
        let (count, width) = regressors(parameters, features);
        let precisions = weights.double("precision", &[count, width, width])?;
        let informations = weights.double("information", &[count, width])?;
        let stored = precisions.values.chunks_exact(width * width);
        let stored = stored.zip(informations.values.chunks_exact(width));
        for (regression, (precision, information)) in posterior.regressions.iter_mut().zip(stored) {
            regression.precision = DMatrix::from_column_slice(width, width, precision);
            regression.information = DVector::from_column_slice(information);
        }
        Ok(posterior)
    }

    /// The regressions as arrays: `precision` Λ, `information` Λm, and for readers the `mean` m.
    /// The mean is NaN if the precision is not positive definite.
    pub fn weights(&self) -> Weights {
        let (count, width) = (self.regressions.len(), self.regressions[0].information.len());
        let all = |values: fn(&Regression) -> &[f64]| -> Vec<f64> {
            self.regressions.iter().flat_map(|one| values(one).iter().copied()).collect()
        };
        let mean = |regression: &Regression| {
            let factored = Factored::new(regression);
            factored.map_or(vec![f64::NAN; width], |factored| factored.mean().to_vec())
        };
        let precision = all(|one| one.precision.as_slice());
        let information = all(|one| one.information.as_slice());
        let mean = self.regressions.iter().flat_map(mean).collect();
        Weights {
            doubles: BTreeMap::from([
                ("mean".to_owned(), Tensor { shape: vec![count, width], values: mean }),
                (
                    "precision".to_owned(),
                    Tensor { shape: vec![count, width, width], values: precision },
                ),
                (
                    "information".to_owned(),
                    Tensor { shape: vec![count, width], values: information },
                ),
            ]),
            ..Weights::default()
        }
    }

    /// Copies another posterior of the same shape.
    pub fn copy_from(&mut self, other: &Posterior) {
        let pairs = self.regressions.iter_mut().zip(&other.regressions);
        pairs.for_each(|(own, other)| own.copy_from(other));
    }

    /// Learns the reward of a step; returns the index of the regression that changed.
    pub fn learn(&mut self, decision: &Decision, reward: f64) -> usize {
        self.learn_made(decision.made(), reward)
    }

    /// [`Posterior::learn`], compiled into its caller.
    #[inline(always)]
    pub fn learn_made(&mut self, decision: Made<'_>, reward: f64) -> usize {
        if let [joint] = &mut self.regressions[..] {
            centred(decision, &mut self.row);
            joint.learn(&self.row, reward, self.noise_variance);
            return 0;
        }
        let index = decision.action.index();
        self.regressions[index].learn(decision.features, reward, self.noise_variance);
        index
    }

    /// The regressions.
    pub fn regressions(&self) -> &[Regression] {
        &self.regressions
    }

    /// The regressions, to be replaced.
    pub fn regressions_mut(&mut self) -> &mut [Regression] {
        &mut self.regressions
    }
}

/// The number of regressions of an agent, and the number of regressors of each.
pub(super) fn regressors(parameters: &LinearThompson, features: Shape) -> (usize, usize) {
    Design::regressors(features.inputs, features.actions, parameters.action_centring)
}

/// The prior of a regression with this number of regressors, in blocks of `features`: the first block has the prior of
/// the baseline, the others that of the effects.
fn prior(parameters: &LinearThompson, features: usize, width: usize) -> Regression {
    let LinearThompson { prior_mean, prior_sd, .. } = parameters;
    let all = |list: &[f64], number: f64| match list {
        [] => vec![number; features],
        list => list.to_vec(),
    };
    let blocks = |baseline: &[f64], effects: &[f64], number: f64| {
        let mut all_blocks = all(baseline, number);
        while all_blocks.len() < width {
            all_blocks.extend(all(effects, number));
        }
        all_blocks
    };
    let means = blocks(&parameters.baseline_means, &parameters.effect_means, *prior_mean);
    Regression::prior(&means, &blocks(&parameters.baseline_sds, &parameters.effect_sds, *prior_sd))
}

/// Writes the regressors of a step with action centring: the features f; p_k f for each message k;
/// and (1\[A = k\] - p_k) f for each message k.
#[inline(always)]
pub(super) fn centred(Made { features, probabilities, action }: Made<'_>, row: &mut Vec<f64>) {
    row.clear();
    row.extend_from_slice(features);
    for probability in &probabilities[1..] {
        row.extend(features.iter().map(|feature| probability * feature));
    }
    for (message, probability) in (1..).zip(&probabilities[1..]) {
        let indicator = if action.index() == message { 1.0 } else { 0.0 };
        row.extend(features.iter().map(|feature| (indicator - probability) * feature));
    }
}

resumable!([] Posterior { each regressions });

/// A posterior with the factors of its precisions, from which actions are chosen.
#[derive(Clone, Debug)]
pub struct Acting {
    posterior: Posterior,
    factored: Vec<Factored>,
    /// Whether a regression has changed since it was last factored, per regression.
    stale: Vec<bool>,
}

impl Acting {
    /// The posterior at the start of an episode.
    ///
    /// **Errors**: a precision is not positive definite.
    pub fn new(posterior: Posterior) -> Result<Self, NotPositiveDefinite> {
        let factored = posterior.regressions.iter().map(Factored::new);
        Ok(Acting {
            factored: factored.collect::<Result<_, _>>()?,
            stale: vec![false; posterior.regressions.len()],
            posterior,
        })
    }

    /// Starts another episode with the given posterior.
    pub fn begin(&mut self, known: &Posterior) {
        self.posterior.copy_from(known);
        self.expire();
    }

    /// The posterior.
    pub fn posterior(&self) -> &Posterior {
        &self.posterior
    }

    /// A regression of the posterior, to be replaced and factored anew.
    pub fn regression_mut(&mut self, index: usize) -> &mut Regression {
        self.stale[index] = true;
        &mut self.posterior.regressions[index]
    }

    /// Learns the reward of a step.
    pub fn learn(&mut self, decision: &Decision, reward: f64) {
        let changed = self.posterior.learn(decision, reward);
        self.stale[changed] = true;
    }

    /// Factors the regressions that have changed.
    ///
    /// **Errors**: a precision is not positive definite; its previous factor remains.
    pub fn refresh(&mut self) -> Result<(), NotPositiveDefinite> {
        let regressions = self.factored.iter_mut().zip(&self.posterior.regressions);
        for ((factored, regression), stale) in regressions.zip(&mut self.stale) {
            if std::mem::take(stale) {
                factored.renew(regression)?;
            }
        }
        Ok(())
    }

    /// The regressions as last factored.
    pub fn factored(&mut self) -> &mut [Factored] {
        &mut self.factored
    }

    /// The posterior of the effect of each message, as last factored: the mean and the covariance of the coefficients
    /// of the state's features, of this number.
    pub fn effects(&self, features: usize) -> Vec<(Vec<f64>, DMatrix<f64>)> {
        if let [joint] = &self.factored[..] {
            let covariance = joint.covariance();
            // Behind the baseline and as many blocks of probabilities.
            let messages = (joint.mean().len() / features - 1) / 2;
            let effect = |message| {
                let first = (1 + messages + message) * features;
                let block = covariance.view((first, first), (features, features)).into_owned();
                (joint.mean()[first..first + features].to_vec(), block)
            };
            return (0..messages).map(effect).collect();
        }
        // Regressions of different actions are independent.
        let (nothing, messages) = self.factored.split_first().expect("there is an action 0");
        let without = nothing.covariance();
        let effect = |message: &Factored| {
            let means = message.mean().iter().zip(nothing.mean());
            (means.map(|(with, without)| with - without).collect(), message.covariance() + &without)
        };
        messages.iter().map(effect).collect()
    }

    /// The reward that the posterior means predict for a decision.
    pub fn predict(&mut self, decision: &Decision) -> f64 {
        if let [joint] = &self.factored[..] {
            centred(decision.made(), &mut self.posterior.row);
            return joint.predict(&self.posterior.row);
        }
        self.factored[decision.action.index()].predict(&decision.features)
    }

    /// Appends coefficients of all regressions, one regression after the other, to the empty
    /// `drawn`; `deviate` returns standard normal deviates.
    pub fn draw(&mut self, drawn: &mut Vec<f64>, mut deviate: impl FnMut() -> f64) {
        let width = self.factored[0].mean().len();
        drawn.extend((0..self.factored.len() * width).map(|_| deviate()));
        let coefficients = drawn.chunks_exact_mut(width);
        coefficients.zip(&mut self.factored).for_each(|(some, factored)| factored.draw(some));
    }

    /// Number of coefficients that [`Acting::draw`] draws.
    pub fn coefficients(&self) -> usize {
        self.factored.len() * self.factored[0].mean().len()
    }

    /// Whether coefficients drawn for an episode are of all regressions, or none.
    pub fn fits(&self, drawn: &[f64]) -> bool {
        drawn.is_empty() || drawn.len() == self.coefficients()
    }

    /// Has all regressions factored anew.
    fn expire(&mut self) {
        self.stale.fill(true);
    }
}

// The factors are recomputed.
resumable!([] Acting { parts posterior; then expire });
