//! Linear Thompson sampling: Bayesian linear regressions of the reward on the observation.
//!
//! Each action has its own regression, r = x'θ_a + N(0, noise_sd²), with a Gaussian prior. With
//! action centring, all actions share one regression, in which the regressors of the actions are
//! centred by the probabilities of the actions. The probability of an action is its posterior
//! probability of being the best. The agent first computes the probabilities and then draws the
//! action from them, so that the recorded probability is exact.
//!
//! **Source**: Karine, Murphy and Marlin, "BOTS: Batch Bayesian Optimization of Extended Thompson
//! Sampling for Severely Episode-Limited RL Settings", 2024 (prior, noise, bias per action); Liao
//! et al., "Personalized HeartSteps", 2020, and Greenewald et al., "Action centered contextual
//! bandits", 2017 (centring). The centring extends Liao et al. to several messages.

mod bandit;
mod features;
mod learner;
mod logistic;
mod normal;
mod partial;
mod policy;
mod posterior;
mod prior;
mod regression;
mod sampler;
mod slopes;
mod study;
#[cfg(test)]
mod tests;
mod updates;

use crate::agent::unavailable::Unavailable;
use crate::env::Action;
use crate::key::{Content, ContentFault, Keyed, Kind, choices, keys};

pub use bandit::BanditPolicy;
pub use features::BanditFeatures;
pub use learner::LinearThompsonLearner;
pub use partial::PersonSd;
pub use policy::LinearThompsonPolicy;
pub use posterior::Made;
pub use slopes::{BanditSums, NoSlopes, SmoothPolicy};
pub use study::LinearThompsonStudy;
pub use updates::features_of_state;

pub(super) use features::Design;
pub(super) use posterior::Posterior;
pub(super) use prior::{Prior, subject_of};
pub(super) use sampler::Sampler;

/// One number per action.
const PER_ACTION: Kind = Kind::Reals {
    least: *Action::COUNTS.start(),
    most: *Action::COUNTS.end(),
    min: -1e6,
    max: 1e6,
};

/// One number per feature, or none.
const PER_FEATURE: Kind = Kind::Reals { least: 0, most: 500, min: -1e6, max: 1e6 };
/// One number above 0 per feature, or none.
const POSITIVE_PER_FEATURE: Kind = Kind::Reals { least: 0, most: 500, min: 1e-6, max: 1e6 };

keys! {
    /// Hyper-parameters of linear Thompson sampling, with the defaults of BOTS.
    pub struct LinearThompson {
        /// episodes of training, including the warm-up
        episodes: u32 = 1500, in Kind::EPISODES;
        /// mean of every coefficient before any data
        prior_mean: f64 = 0.0, in Kind::ANY_REAL;
        /// standard deviation of every coefficient before any data
        prior_sd: f64 = 10.0, in Kind::POSITIVE;
        /// standard deviation of a reward around the regression
        noise_sd: f64 = 25.0, in Kind::POSITIVE;
        /// regressors of the reward: "linear", an intercept and the observation, or
        /// "interactions", the products of two features as well
        features: BanditFeatures = BanditFeatures::Linear;
        /// whether all actions share one regression, in which action indicators are centred by
        /// their probabilities; requires pi_min above 0
        action_centring: bool = false;
        /// episodes of uniformly random actions at the start of the training
        warm_up: u32 = 0, in Kind::Integer { min: 0, max: 10_000_000 };
        /// when new data change the policy: "step", at once, "episode", between episodes, or
        /// "once", after the warm-up
        update: BanditUpdate = BanditUpdate::Step;
        /// episodes between two updates with the data of all earlier episodes
        update_interval: u32 = 1, in Kind::EPISODES;
        /// episodes between the warm-up and the first of these updates; 0 for update_interval
        first_update: u32 = 0, in Kind::Integer { min: 0, max: 10_000_000 };
        /// whether the posterior is "carried" from episode to episode, or "reset" to the posterior
        /// after the warm-up
        posterior: BanditPosterior = BanditPosterior::Carried;
        /// whether coefficients are drawn for each "step" or for a whole "episode"
        draw: BanditDraw = BanditDraw::Step;
        /// bias added to the drawn reward of each action before the maximum is taken: one number per
        /// action, or zeros for no bias
        action_bias: Vec<f64> = vec![0.0; 4], in PER_ACTION;
        /// minimum probability of an action: p of n becomes pi_min + (1 - n pi_min) p, and with the clipped allocation
        /// the nearest number from pi_min to 1 - pi_min; at most 1 / n
        pi_min: f64 = 0.0, in Kind::Real { min: 0.0, max: 0.5 };
        /// slope of a softmax over the drawn rewards, in 1/steps, which replaces the maximum; 0 for
        /// the maximum
        smoothing: f64 = 0.0, in Kind::NON_NEGATIVE;
        /// number of draws that compute action probabilities; read with action_centring or
        /// smoothing
        probability_draws: u32 = 1000, in Kind::Integer { min: 100, max: 100_000 };
        /// means of the coefficients of the baseline, one per feature, the intercept first; empty for prior_mean
        baseline_means: Vec<f64> = Vec::new(), before Vec::new(), in PER_FEATURE;
        /// standard deviations of the coefficients of the baseline; empty for prior_sd
        baseline_sds: Vec<f64> = Vec::new(), before Vec::new(), in POSITIVE_PER_FEATURE;
        /// means of the coefficients of every effect, and of its product with a probability; read with
        /// action_centring; empty for prior_mean
        effect_means: Vec<f64> = Vec::new(), before Vec::new(), in PER_FEATURE;
        /// standard deviations of these coefficients; empty for prior_sd
        effect_sds: Vec<f64> = Vec::new(), before Vec::new(), in POSITIVE_PER_FEATURE;
        /// how the effect of the message becomes its probability: by "thompson" sampling, or for two actions
        /// "clipped", the exact posterior probability that the effect is above 0, between pi_min and 1 - pi_min, or
        /// "logistic", the posterior mean of a generalised logistic function of the effect
        allocation: BanditAllocation = BanditAllocation::Thompson, before BanditAllocation::Thompson;
        /// smallest probability of the logistic allocation
        logistic_lower: f64 = 0.2, before 0.2, in Kind::PROBABILITY;
        /// largest probability of the logistic allocation
        logistic_upper: f64 = 0.8, before 0.8, in Kind::PROBABILITY;
        /// slope of the logistic allocation (B), per unit of the reward
        logistic_slope: f64 = 1.0, before 1.0, in Kind::POSITIVE;
        /// odds against a message without an effect in the logistic allocation (C)
        logistic_odds: f64 = 1.0, before 1.0, in Kind::POSITIVE;
        /// what the agent does where no message can be sent: "masked", it makes no choice and learns
        /// from none, or "chosen", it chooses, and learns as if its choice had been taken
        unavailable: Unavailable = Unavailable::Masked, before Unavailable::Masked;
        /// posterior of an earlier job, which is the prior of this one and replaces the keys prior_*, baseline_* and
        /// effect_*
        prior_from: Content = Content::default(), before Content::default(), in Kind::Content(&prior::PRIOR);
        /// with pooling = "partial", the standard deviation of a person's coefficients around the common ones: a number,
        /// a list of one per feature or per coefficient, or "estimated", by the marginal likelihood at every update
        person_sd: PersonSd = PersonSd::Estimated, before PersonSd::Estimated, in PersonSd::KIND;
    }
}

impl Default for LinearThompson {
    fn default() -> Self {
        LinearThompson::with_required(&[])
    }
}

choices! {
    /// How effects become probabilities.
    pub enum BanditAllocation {
        /// The posterior probability of being the best.
        Thompson = "thompson",
        /// The same for two actions, without draws, and cut to a range.
        Clipped = "clipped",
        /// The posterior mean of a generalised logistic function of the effect.
        Logistic = "logistic",
    }
}

choices! {
    /// When observed rewards change the choice of actions.
    pub enum BanditUpdate {
        /// After every step.
        Step = "step",
        /// Between episodes.
        Episode = "episode",
        /// Once, after the warm-up.
        Once = "once",
    }
}

choices! {
    /// The posterior at the start of an episode.
    pub enum BanditPosterior {
        /// The posterior after all earlier episodes.
        Carried = "carried",
        /// The posterior after the warm-up.
        Reset = "reset",
    }
}

choices! {
    /// How long drawn coefficients are used.
    pub enum BanditDraw {
        /// For one step; the probabilities of actions are averaged over draws.
        Step = "step",
        /// For a whole episode.
        Episode = "episode",
    }
}

impl LinearThompson {
    /// The same agent with the posterior of a file as its prior.
    ///
    /// **Errors**: the text has no posterior.
    pub fn with_prior(&self, text: &str) -> Result<LinearThompson, ContentFault> {
        Ok(LinearThompson { prior_from: Content::read(&prior::PRIOR, text)?, ..self.clone() })
    }

    /// Whether the posterior at the start of episodes is updated after this number of finished
    /// episodes.
    fn renews_after(&self, finished: u32) -> bool {
        let Some(after) = finished.checked_sub(self.warm_up).filter(|after| *after > 0) else {
            return finished > 0 && finished == self.warm_up;
        };
        let interval = self.update_interval.max(1);
        let first = if self.first_update == 0 { interval } else { self.first_update };
        let is_due = after >= first && (after - first).is_multiple_of(interval);
        match (self.posterior, self.update) {
            (BanditPosterior::Reset, _) | (_, BanditUpdate::Once) => false,
            (BanditPosterior::Carried, BanditUpdate::Step | BanditUpdate::Episode) => is_due,
        }
    }

    /// Whether a step changes later choices within its own episode.
    fn learns_within(&self) -> bool {
        match self.update {
            BanditUpdate::Step => true,
            BanditUpdate::Episode | BanditUpdate::Once => false,
        }
    }
}
