//! A trained bandit for observations from any source.

use crate::agent::layers::Shape;
use crate::agent::learner::Actions;
use crate::agent::linear_thompson::features::Design;
use crate::agent::linear_thompson::posterior::{Acting, Decision, Posterior};
use crate::agent::linear_thompson::sampler::Sampler;
use crate::agent::linear_thompson::{BanditDraw, LinearThompson};
use crate::agent::weights::{Weights, WeightsError};
use crate::env::{Action, Interface};

/// The policy of a posterior, without a memory: it draws coefficients for each decision, and learns from those that it is
/// given.
pub struct BanditPolicy {
    design: Design,
    sampler: Sampler,
    acting: Acting,
    decision: Decision,
    /// Coefficients of an episode, which this policy does not draw.
    drawn: Vec<f64>,
}

impl BanditPolicy {
    /// The policy of the weights of a job, which the seed gives its fixed draws.
    ///
    /// **Errors**: the weights are not a posterior of this agent.
    pub fn new(
        parameters: &LinearThompson,
        interface: &Interface,
        weights: &Weights,
        seed: u64,
    ) -> Result<Self, WeightsError> {
        let Interface { observations, actions } = interface;
        let design = Design::new(parameters.features, observations);
        let shape = Shape { inputs: design.width(), actions: *actions };
        let posterior = Posterior::trained(parameters, shape, weights)?;
        BanditPolicy::of(parameters, (design, *actions), posterior, seed)
    }

    /// The policy of an agent before its first decision, whose prior may be the posterior of a file.
    ///
    /// **Errors**: the prior is not positive definite.
    pub fn of_prior(
        parameters: &LinearThompson,
        interface: &Interface,
        seed: u64,
    ) -> Result<Self, WeightsError> {
        let Interface { observations, actions } = interface;
        let design = Design::new(parameters.features, observations);
        let shape = Shape { inputs: design.width(), actions: *actions };
        let prior = Posterior::prior(parameters, shape);
        BanditPolicy::of(parameters, (design, *actions), prior, seed)
    }

    fn of(
        parameters: &LinearThompson,
        (design, actions): (Design, usize),
        posterior: Posterior,
        seed: u64,
    ) -> Result<Self, WeightsError> {
        let by_step = LinearThompson { draw: BanditDraw::Step, ..parameters.clone() };
        Ok(BanditPolicy {
            design,
            sampler: Sampler::new(&by_step, actions, seed),
            acting: Acting::new(posterior).map_err(|_| WeightsError::NotPositiveDefinite)?,
            decision: Decision::among(actions),
            drawn: Vec::new(),
        })
    }

    /// Learns from a decision at an observation, whose one-hot is 1 at `moment`, and whose action was drawn with these
    /// probabilities, as in a trial.
    pub fn learn(
        &mut self,
        (letters, moment): (&[f64], Option<u32>),
        (action, chances): (Action, &[f64]),
        reward: f64,
    ) {
        self.design.fill_exact(letters, moment, &mut self.decision.features);
        self.decision.action = action;
        self.decision.probabilities.copy_from_slice(chances);
        self.acting.learn(&self.decision, reward);
    }

    /// What it knows, as the weights of a job.
    pub fn weights(&self) -> Weights {
        self.acting.posterior().weights()
    }

    /// The action that a random word draws for an observation, whose one-hot is 1 at `moment`, and the probabilities
    /// of all actions.
    pub fn choose(
        &mut self,
        choice: Actions,
        (letters, moment): (&[f64], Option<u32>),
        word: u64,
    ) -> (Action, &[f64]) {
        self.design.fill_exact(letters, moment, &mut self.decision.features);
        let known = (&mut self.acting, &mut self.drawn);
        self.sampler.choose(choice, known, &mut self.decision, word);
        (self.decision.action, &self.decision.probabilities)
    }

    /// The means of the rewards of all actions, with their biases; with action centring, the means of the effects.
    pub fn values(&mut self, (letters, moment): (&[f64], Option<u32>)) -> &[f64] {
        self.design.fill_exact(letters, moment, &mut self.decision.features);
        self.sampler.expect(&mut self.acting, &self.decision.features)
    }

    /// The standard normal deviates by which probabilities are shares of draws, one number per draw and action; empty
    /// if probabilities are integrals.
    pub fn deviates(&self) -> &[f64] {
        self.sampler.deviates()
    }
}
