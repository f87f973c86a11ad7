//! Dueling DQN: Q-learning from a replay buffer, with a periodically updated copy of the network
//! for the targets.
//!
//! **Source**: Mnih et al., "Playing Atari with deep reinforcement learning", 2013; Wang et al.,
//! 2016 (the network). The maximum is taken over the target network's own values (no double
//! Q-learning).

mod episodes;
#[cfg(test)]
mod episodes_tests;
mod experience;
mod learner;
mod play;
mod transitions;

use crate::agent::network::{
    Activation, BEFORE_GRU, Engine, LAYER_WIDTHS, LEARNING_RATE, Recurrent, UNITS,
};
use crate::agent::policy::{ActionNetwork, best};
use crate::agent::replay::{TerminalTarget, Transition};
use crate::agent::unavailable::Unavailable;
use crate::agent::weights::Weights;
use crate::env::{EpisodeStatus, Observations};
use crate::key::{Keyed, Kind, choices, keys};
use crate::state::Resumable;

pub use episodes::{EpisodeReplay, Episodes, SequenceBatch};
pub use experience::Experience;
pub use learner::DuelingDqnLearner;
pub use transitions::Transitions;

keys! {
    /// Hyper-parameters of the dueling DQN; the defaults reproduce the published figures.
    pub struct DuelingDqn {
        /// episodes of training
        episodes: u32 = 1000, in Kind::EPISODES;
        /// widths of the hidden layers, input side first
        layers: Vec<u32> = vec![128, 128], in LAYER_WIDTHS;
        /// activation of the hidden layers
        activation: Activation = Activation::Relu;
        /// whether state value and advantages share their hidden layers
        trunk: Trunk = Trunk::Shared;
        /// memory of the episode: "none", or a "gru" that learns from episodes instead of transitions
        recurrent: Recurrent = Recurrent::None, before Recurrent::None;
        /// units of the GRU
        units: u32 = 64, before 64, in UNITS;
        /// hidden layers in front of the GRU; the others follow it
        layers_before_gru: u32 = 1, before 1, in BEFORE_GRU;
        /// length of the sequences that a GRU learns from, in steps; 0 for whole episodes
        sequence: u32 = 0, before 0, in Kind::Integer { min: 0, max: 10_000 };
        /// steps before a sequence that only warm up the state of the GRU
        burn_in: u32 = 0, before 0, in Kind::Integer { min: 0, max: 10_000 };
        /// Adam's step size
        learning_rate: f64 = 5e-4, in LEARNING_RATE;
        /// discount factor per step
        gamma: f64 = 0.99, in Kind::PROBABILITY;
        /// transitions per batch, or episodes with a GRU; learning starts once this number is
        /// stored
        batch: u32 = 64, in Kind::Integer { min: 1, max: 65_536 };
        /// capacity of the replay buffer, in transitions
        buffer: u32 = 1_000_000, in Kind::Integer { min: 1, max: 100_000_000 };
        /// steps of an episode between two updates
        update_interval: u32 = 1, before 1, in Kind::Integer { min: 1, max: 10_000_000 };
        /// divisor of rewards for learning; metrics stay as they are
        reward_scale: f64 = 1.0, before 1.0, in Kind::POSITIVE;
        /// exploration rate at the start
        epsilon_start: f64 = 1.0, in Kind::PROBABILITY;
        /// decrease of the exploration rate per update
        epsilon_decrement: f64 = 1e-3, in Kind::PROBABILITY;
        /// exploration rate at which the decrease stops
        epsilon_floor: f64 = 0.01, in Kind::PROBABILITY;
        /// updates between two copies of the weights to the target network
        target_period: u32 = 1000, in Kind::Integer { min: 1, max: 1_000_000_000 };
        /// target of a transition that ends its episode: 0 (the authors' code), or the reward, with
        /// bootstrapping at the horizon
        terminal_target: TerminalTarget = TerminalTarget::Zero;
        /// which code performs the updates: "fused", kernels with the same results on every
        /// processor, or "burn", Burn's modules and gradients, many times slower, with results that depend
        /// on the processor
        engine: Engine = Engine::Fused;
        /// what the agent does where no message can be sent: "masked", it makes no choice and learns
        /// about action 0, or "chosen", it chooses, and learns as if its choice had been taken
        unavailable: Unavailable = Unavailable::Masked, before Unavailable::Masked;
    }
}

impl Default for DuelingDqn {
    fn default() -> Self {
        DuelingDqn::with_required(&[])
    }
}

choices! {
    /// Whether the two streams of the dueling network share their hidden layers.
    pub enum Trunk {
        /// One stack of hidden layers with two linear heads, as in the published code.
        Shared = "shared",
        /// A separate stack of hidden layers for each head, as in the text of the paper.
        Separate = "separate",
    }
}

/// The engine of the dueling DQN, which trains a dueling network.
pub trait DuelingDqnEngine: Resumable {
    /// The network at the time of the call, which chooses actions.
    type Network: ActionNetwork + Send + 'static;
    /// What the network learns from: [`Transitions`], or [`Episodes`] if it has a memory.
    type Experience: Experience;

    /// Size of the network's memory of an episode, in numbers.
    fn memory(&self) -> usize;

    /// Replaces `out` by the action values for the next observations, \[rows, actions\]; `memory`
    /// is as in [`ActionNetwork::recall`].
    fn values(&mut self, observations: &Observations, memory: &mut [f32], out: &mut Vec<f32>);

    /// Replaces `out` by the action values of the target network, \[rows, actions\].
    fn target_values(&mut self, states: &States<Self>, out: &mut Vec<f32>);

    /// Copies the network into the target network.
    fn renew_target(&mut self);

    /// One step of Adam on the mean squared difference between Q(s, a) and the targets, over the
    /// rows that count; returns this loss. If the loss is not finite, the engine may leave the
    /// network unchanged.
    fn update(&mut self, batch: &BatchOf<Self>) -> f32;

    /// The current network.
    fn network(&self) -> Self::Network;

    /// The weights of the current network.
    fn weights(&self) -> Weights;
}

/// The batches that an engine learns from.
pub type BatchOf<E> = <<E as DuelingDqnEngine>::Experience as Experience>::Batch;
/// The states that the target network of an engine evaluates.
pub type States<E> = <<E as DuelingDqnEngine>::Experience as Experience>::States;

/// The value of the state s' after a transition: max Q(s', ·), or Q(s', 0) if no message can be sent there.
///
/// **Shapes**: `values`, the values Q(s', ·), is \[actions\].
fn value_after(transition: &Transition, values: &[f32]) -> f32 {
    if transition.is_withheld { values[0] } else { values[best(values).index()] }
}

/// The regression target of a transition: r + gamma V(s'), or at the end of an episode what
/// `terminal_target` says.
pub fn target(
    transition: &Transition,
    next_value: f32,
    gamma: f64,
    terminal_target: TerminalTarget,
) -> f32 {
    match (transition.status, terminal_target) {
        (EpisodeStatus::Running, _) | (EpisodeStatus::Truncated, TerminalTarget::Standard) => {
            transition.reward + gamma as f32 * next_value
        }
        (EpisodeStatus::Terminated, TerminalTarget::Standard) => transition.reward,
        (EpisodeStatus::Terminated | EpisodeStatus::Truncated, TerminalTarget::Zero) => 0.0,
    }
}
