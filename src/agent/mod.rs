//! The algorithms: how agents learn and how they act.
//!
//! In: hyper-parameters, a [`VectorEnvironment`], named random streams. Out: trained episodes, actors
//! and weights. There is one file per algorithm, written against a trait for the engine that computes
//! its network: `fused` with kernels, `burn` with Burn modules and automatic differentiation. A
//! [`Learner`] is an algorithm on an engine in training; [`start`] makes the one that a job declares. An
//! [`Actor`] chooses the actions of episodes: trained networks and decision rules are actors, and
//! rollouts know nothing else. The module knows no job key, no store and no file.
//!
//! Burn's own random generator is global to the process, so nothing here may draw from it: weights
//! are drawn from the job's stream and set.

mod actor;
mod burn;
mod dueling_dqn;
#[cfg(test)]
mod engine_tests;
mod fused;
mod layers;
mod memory;
mod parameters;
mod policy;
#[cfg(test)]
mod reference_tests;
mod reinforce;
mod replay;
mod rule;
mod weights;

use std::io;

use crate::env::{Action, Environment, Observer, PhysicalActivity, Scenario, VectorEnvironment};

pub use crate::state::{Resumable, StateError, StateReader, StateWriter};
pub use actor::Actor;
pub use burn::device::backend_name;
pub use burn::{BurnDuelingDqn, BurnReinforce, DuelingQNetwork, PolicyNetwork};
pub use dueling_dqn::{
    Batch, DuelingDqnEngine, DuelingDqnLearner, learner_in as dueling_dqn_learner,
    trained as trained_dueling_dqn,
};
pub use fused::{FusedDuelingDqn, FusedDuelingNetwork, FusedPolicyNetwork, FusedReinforce};
pub use memory::{OutOfMemory, reserve, reserve_exact};
pub use parameters::{
    Activation, Agent, Algorithm, DecisionRule, DuelingDqn, Engine, Reinforce, Rule,
    TerminalTarget, Trunk,
};
pub use policy::{ActionNetwork, EpsilonGreedy, SoftmaxPolicy};
pub use reinforce::{
    ReinforceEngine, ReinforceLearner, Trajectories, learner_in as reinforce_learner,
    trained as trained_reinforce,
};
pub use replay::{Replay, Transition};
pub use rule::{DecisionRuleError, RulePolicy, read_rule};
pub use weights::{Tensor as WeightTensor, Weights, WeightsError};

/// A training episode that has just ended.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
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

impl Resumable for TrainedEpisode {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        out.one(self.total_reward)?;
        out.one(self.length)?;
        out.one(u8::from(self.disengaged))?;
        out.one(self.loss_sum)?;
        out.one(self.updates)?;
        out.many(self.epsilon.as_slice())
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        *self = TrainedEpisode {
            total_reward: from.one()?,
            length: from.one()?,
            disengaged: from.one::<u8>()? != 0,
            loss_sum: from.one()?,
            updates: from.one()?,
            epsilon: from.many(1, "exploration rates")?.first().copied(),
        };
        Ok(())
    }
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

/// Why a training cannot go on.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum LearnerError {
    /// Its loss is of no use.
    #[error(transparent)]
    Diverged(#[from] Diverged),
    /// There is no memory for what it has to remember.
    #[error(transparent)]
    OutOfMemory(#[from] OutOfMemory),
}

/// How a span of training ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Span {
    /// At its end.
    Whole,
    /// Broken off, because a pause was asked for.
    BrokenOff,
}

/// An agent in training. Its state can be written down whenever it is not at work.
pub trait Learner<Env: VectorEnvironment = PhysicalActivity>: Resumable {
    /// Trains for the shortest span the algorithm has (an episode, or the episodes of one update)
    /// and appends the episodes that ended. `pause` is asked at every step; once it says yes the
    /// span is broken off, and the next call goes on with it, to the same bits.
    ///
    /// **Errors**: the loss is not finite, or memory is short; the learner is then of no further use.
    fn advance(
        &mut self,
        finished: &mut Vec<TrainedEpisode>,
        pause: &dyn Fn() -> bool,
    ) -> Result<Span, LearnerError>;

    /// The policy as it would act now in training, or greedily.
    fn policy(&self, actions: Actions) -> Box<dyn Actor<Env>>;

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

/// An agent before its first episode.
pub enum Start {
    /// An agent that has to be trained.
    Learner(Box<dyn Learner>),
    /// An agent that acts without training, such as a decision rule.
    Actor(Box<dyn Actor>),
}

/// The agent of a job before its first episode.
///
/// **Errors**: there is no memory for its network.
pub fn start(
    agent: &Agent,
    environment: &Environment,
    scenario: &Scenario,
    seed: u64,
) -> Result<Start, OutOfMemory> {
    Ok(match agent {
        Agent::DuelingDqn(parameters) => {
            Start::Learner(dueling_dqn::learner(parameters, environment, scenario, seed)?)
        }
        Agent::Reinforce(parameters) => {
            Start::Learner(reinforce::learner(parameters, environment, scenario, seed)?)
        }
        Agent::Rule(parameters) => Start::Actor(rule::actor(parameters, environment, scenario)),
    })
}

/// Why a training cannot start.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum StartError {
    /// There is no memory for what it needs.
    #[error(transparent)]
    OutOfMemory(#[from] OutOfMemory),
    /// The environment has another number of actions.
    #[error(
        "the environment has {actions} actions; the agents choose among exactly {}",
        Action::COUNT
    )]
    Actions {
        /// Its actions.
        actions: usize,
    },
    /// The environment has another number of lanes.
    #[error("the environment has {lanes} lanes; this agent trains on {expected}")]
    Lanes {
        /// Its lanes.
        lanes: usize,
        /// The lanes that the agent trains on.
        expected: usize,
    },
}

impl StartError {
    /// Fails unless an environment has so many lanes, and as many actions as agents have.
    fn unless_fit(environment: &impl VectorEnvironment, expected: usize) -> Result<(), StartError> {
        let (actions, lanes) = (environment.action_spec().count, environment.lanes());
        if actions != Action::COUNT {
            return Err(StartError::Actions { actions });
        }
        if lanes == expected { Ok(()) } else { Err(StartError::Lanes { lanes, expected }) }
    }

    /// The one error there can be where the simulation was made for the agent.
    fn of_simulation(self) -> OutOfMemory {
        match self {
            StartError::OutOfMemory(error) => error,
            StartError::Actions { .. } | StartError::Lanes { .. } => {
                unreachable!("the simulation has four actions and the lanes that were asked for")
            }
        }
    }
}

/// The policy of an agent that was trained before, on the engine that trained it. A dueling DQN
/// explores at the rate that is kept with its weights.
///
/// **Errors**: the weights do not fit the agent's network; a rule has none.
pub fn trained_policy(
    agent: &Agent,
    environment: &Environment,
    scenario: &Scenario,
    weights: &Weights,
    actions: Actions,
) -> Result<Box<dyn Actor>, WeightsError> {
    let observations = Observer::new(environment, scenario).spec();
    match agent {
        Agent::DuelingDqn(parameters) => {
            dueling_dqn::trained(parameters, &observations, weights, actions)
        }
        Agent::Reinforce(parameters) => {
            reinforce::trained(parameters, &observations, weights, actions)
        }
        Agent::Rule(_) => Err(WeightsError::NoNetwork),
    }
}
