//! Proximal policy optimisation: rollouts of many lanes in lockstep, and several passes over each
//! rollout with a clipped objective.
//!
//! **Source**: Schulman et al., "Proximal policy optimization algorithms", 2017; Schulman et al.,
//! "High-dimensional continuous control using generalized advantage estimation", 2016; Huang et al.,
//! "The 37 implementation details of proximal policy optimization", 2022, whose code (CleanRL,
//! `ppo.py`) is followed in the order of its steps. Deviations: rewards are divided by a constant,
//! and the budget is a number of episodes (see [`PpoLearner`]).

mod learner;
mod minibatch;
mod resume;
mod rollout;
#[cfg(test)]
mod tests;

use crate::agent::network::{
    Activation, BEFORE_GRU, Engine, LAYER_WIDTHS, LEARNING_RATE, Recurrent, UNITS,
};
use crate::agent::policy::ActionNetwork;
use crate::agent::unavailable::Unavailable;
use crate::agent::weights::Weights;
use crate::env::Observations;
use crate::kernel::Isa;
use crate::key::{Keyed, Kind, choices, keys};
use crate::state::Resumable;

pub use learner::PpoLearner;
pub use minibatch::{Minibatch, Sequences};
pub use rollout::advantages;

/// Adam's epsilon in CleanRL's PPO.
pub(super) const ADAM_EPSILON: f32 = 1e-5;

keys! {
    /// Hyper-parameters of PPO.
    pub struct Ppo {
        /// episodes of training
        episodes: u32 = 15_000, in Kind::EPISODES;
        /// widths of the hidden layers, input side first, of the policy and of the value each
        layers: Vec<u32> = vec![64, 64], in LAYER_WIDTHS;
        /// activation of the hidden layers
        activation: Activation = Activation::Tanh;
        /// memory of the episode: "none", or a "gru" that policy and value share, with
        /// all layers
        recurrent: Recurrent = Recurrent::None;
        /// units of the GRU
        units: u32 = 64, in UNITS;
        /// hidden layers in front of the GRU; the others follow it
        layers_before_gru: u32 = 1, in BEFORE_GRU;
        /// number of episodes played in parallel
        lanes: u32 = 16, in Kind::Integer { min: 1, max: 10_000 };
        /// steps per lane between two phases of learning
        steps: u32 = 50, in Kind::Integer { min: 1, max: 10_000 };
        /// minibatches per rollout, with one update per minibatch and epoch
        minibatches: u32 = 4, in Kind::Integer { min: 1, max: 10_000 };
        /// passes over a rollout
        epochs: u32 = 4, in Kind::Integer { min: 1, max: 1000 };
        /// Adam's step size
        learning_rate: f64 = 1e-3, in LEARNING_RATE;
        /// whether the step size falls linearly to 0 with the episodes played
        anneal: bool = true;
        /// discount factor per step
        gamma: f64 = 0.99, in Kind::PROBABILITY;
        /// decay per step of the weights of temporal differences in an advantage (GAE lambda)
        gae_lambda: f64 = 0.95, in Kind::PROBABILITY;
        /// whether the advantages of a minibatch are normalised to mean 0 and standard deviation 1
        norm_adv: bool = true;
        /// clipping range of the ratio of new to old probability, around 1
        clip: f64 = 0.2, in Kind::PositiveReal { max: 1e6 };
        /// whether the value loss is clipped as well, at the same distance from the old value
        clip_value_loss: bool = false;
        /// weight of the entropy in the loss
        ent_coef: f64 = 0.01, in Kind::NON_NEGATIVE;
        /// weight of the value loss
        vf_coef: f64 = 0.5, in Kind::NON_NEGATIVE;
        /// maximum norm of a gradient; a larger one is scaled down
        max_grad_norm: f64 = 0.5, in Kind::POSITIVE;
        /// approximate KL divergence from the old policy above which the remaining epochs are
        /// skipped; 0 for no limit
        target_kl: f64 = 0.0, in Kind::NON_NEGATIVE;
        /// divisor of rewards for learning; metrics stay as they are
        reward_scale: f64 = 200.0, in Kind::POSITIVE;
        /// how the horizon ends an episode: as a "termination", with value 0 afterwards, or as a
        /// "truncation", with the value of the last observation
        at_horizon: AtHorizon = AtHorizon::Truncation, earlier AtHorizon::Termination;
        /// which code performs the updates: "fused", kernels with the same results on every
        /// processor, or "burn", Burn's modules and gradients, many times slower, with results that depend
        /// on the processor
        engine: Engine = Engine::Fused;
        /// what the agent does where no message can be sent: "masked", it makes no choice and learns
        /// from none, or "chosen", it chooses, and learns as if its choice had been taken
        unavailable: Unavailable = Unavailable::Masked, before Unavailable::Masked;
    }
}

impl Default for Ppo {
    fn default() -> Self {
        Ppo::with_required(&[])
    }
}

choices! {
    /// The role of the horizon for the values of states.
    pub enum AtHorizon {
        /// The end of the task: the value of what follows is 0.
        Termination = "termination",
        /// A cut: the value of the last observation counts.
        Truncation = "truncation",
    }
}

/// The losses of an update, before its step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Losses {
    /// The loss that was minimised.
    pub loss: f32,
    /// Its policy part: the mean of max(-A ratio, -A clip(ratio)).
    pub policy: f32,
    /// Its value part: half the mean squared error, before its weight.
    pub value: f32,
    /// The mean entropy of the policy, before its weight.
    pub entropy: f32,
    /// The mean of (ratio - 1) - ln ratio, an estimate of the divergence from the old policy.
    pub approx_kl: f32,
}

/// The engine of PPO, which trains a policy with a value.
pub trait PpoEngine: Resumable {
    /// The policy at the time of the call, which chooses actions.
    type Network: ActionNetwork + Send + 'static;

    /// The instruction set for the algorithm's computations outside the engine.
    fn isa(&self) -> Isa {
        Isa::chosen()
    }

    /// Size of the networks' memory of an episode, in numbers; 0 by default.
    fn memory(&self) -> usize {
        0
    }

    /// Replaces `logits` by the logits of the actions for every observation, \[rows, actions\], and
    /// `values` by the values, \[rows\]. `memory` is as in [`ActionNetwork::recall`].
    fn evaluate(
        &mut self,
        observations: &Observations,
        memory: &mut [f32],
        logits: &mut Vec<f32>,
        values: &mut Vec<f32>,
    );

    /// One step of Adam with this step size on the loss of a minibatch. If the loss is not finite,
    /// the engine may leave the network unchanged.
    fn update(&mut self, minibatch: &Minibatch, learning_rate: f64) -> Losses;

    /// The current policy.
    fn network(&self) -> Self::Network;

    /// All weights.
    fn weights(&self) -> Weights;
}
