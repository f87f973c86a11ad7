//! The algorithms: how agents learn and how they act.
//!
//! In: hyper-parameters, an environment with its scenario, named random streams. Out: trained
//! episodes, policies and weights. One file an algorithm; networks are Burn modules. A [`Learner`]
//! is the seam between an algorithm and the engine that runs its updates: [`learner`] picks one by
//! the job's `engine`, everything else is written against the trait. It knows no job key, no store
//! and no file.
//!
//! Burn's own random generator is global to the process, so nothing here may draw from it: weights
//! are drawn from the job's stream and set.

mod device;
mod dueling_dqn;
mod network;
mod policy;
#[cfg(test)]
mod reference_tests;
mod reinforce;
mod replay;
mod rule;
mod weights;

use crate::env::Observer;
use crate::manifest::{Agent, Engine, Environment, Scenario, TestActions};

pub use device::backend_name;
pub use dueling_dqn::{Batch, DuelingDqnLearner};
pub use network::{DuelingQNetwork, PolicyNetwork};
pub use policy::{EpsilonGreedy, Policy, SoftmaxPolicy};
pub use reinforce::{ReinforceLearner, Trajectories};
pub use replay::{Replay, Transition};
pub use rule::{Rule, RuleError};
pub use weights::{Tensor as WeightTensor, Weights, WeightsError};

/// A training episode that has just ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrainedEpisode {
    /// Undiscounted return, in steps walked.
    pub total_reward: f64,
    /// Steps of the simulation.
    pub length: u32,
    /// Whether it ended in disengagement.
    pub disengaged: bool,
    /// Sum of the losses of the updates since the episode before.
    pub loss_sum: f64,
    /// Number of those updates.
    pub updates: u32,
    /// Exploration rate at its end, where the algorithm has one.
    pub epsilon: Option<f64>,
}

/// A loss that became infinite or not a number.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("the loss of update {update} is {loss}")]
pub struct Diverged {
    /// Updates made, this one included.
    pub update: u64,
    /// The loss.
    pub loss: f32,
}

/// How a span of training ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Span {
    /// At its end.
    Whole,
    /// Broken off, because a stop was asked for.
    BrokenOff,
}

/// An agent in training.
pub trait Learner {
    /// Trains for the shortest span the algorithm has (an episode, or the episodes of one update)
    /// and appends the episodes that ended. `stop` is asked at every step; once it says yes the
    /// span is broken off, and the learner is of no further use.
    ///
    /// **Errors**: the loss is not finite; the learner is then of no further use.
    fn advance(
        &mut self,
        finished: &mut Vec<TrainedEpisode>,
        stop: &dyn Fn() -> bool,
    ) -> Result<Span, Diverged>;

    /// The policy as it would act now in training, or greedily.
    fn policy(&self, actions: Actions) -> Box<dyn Policy>;

    /// The weights as they are now.
    fn weights(&self) -> Weights;
}

/// How a trained agent chooses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Actions {
    /// As in training: with its exploration.
    AsTrained,
    /// The best action, always.
    Greedy,
}

impl From<TestActions> for Actions {
    fn from(actions: TestActions) -> Self {
        match actions {
            TestActions::AsTrained => Actions::AsTrained,
            TestActions::Greedy => Actions::Greedy,
        }
    }
}

/// A learner for an agent, at the start of its training.
pub fn learner(
    agent: &Agent,
    environment: &Environment,
    scenario: &Scenario,
    seed: u64,
) -> Box<dyn Learner> {
    match agent {
        Agent::DuelingDqn(parameters) => match parameters.engine {
            Engine::Burn => {
                Box::new(DuelingDqnLearner::new(parameters, environment, scenario, seed))
            }
        },
        Agent::Reinforce(parameters) => match parameters.engine {
            Engine::Burn => {
                Box::new(ReinforceLearner::new(parameters, environment, scenario, seed))
            }
        },
    }
}

/// The policy of an agent that was trained before.
///
/// `epsilon` is the exploration rate at the end of its training, for agents that have one.
///
/// **Errors**: the weights do not fit the agent's network.
pub fn trained_policy(
    agent: &Agent,
    environment: &Environment,
    scenario: &Scenario,
    weights: &Weights,
    actions: Actions,
) -> Result<Box<dyn Policy>, WeightsError> {
    let width = Observer::new(environment, scenario).width();
    let device = device::inference();
    Ok(match agent {
        Agent::DuelingDqn(parameters) => {
            let network = DuelingQNetwork::from_weights(parameters, width, weights, &device)?;
            let epsilon = match actions {
                Actions::AsTrained => weights.number("epsilon")?,
                Actions::Greedy => 0.0,
            };
            Box::new(EpsilonGreedy::new(network, epsilon))
        }
        Agent::Reinforce(parameters) => {
            let network = PolicyNetwork::from_weights(parameters, width, weights, &device)?;
            Box::new(SoftmaxPolicy::new(network, actions))
        }
    })
}
