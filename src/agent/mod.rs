//! The algorithms: how agents learn and how they act.
//!
//! In: hyper-parameters, an environment with its scenario, named random streams. Out: trained
//! episodes, policies and weights. One file an algorithm, written against a trait for the engine
//! that computes its network: `fused` by kernels, `burn` by Burn modules and automatic
//! differentiation. A [`Learner`] is an algorithm on an engine; [`start`] makes the one that a
//! job declares. It knows no job key, no store and no file.
//!
//! Burn's own random generator is global to the process, so nothing here may draw from it: weights
//! are drawn from the job's stream and set.

mod burn;
mod dueling_dqn;
#[cfg(test)]
mod engine_tests;
mod fused;
mod layers;
mod memory;
mod policy;
#[cfg(test)]
mod reference_tests;
mod reinforce;
mod replay;
mod rule;
mod state;
mod weights;

use crate::env::Observer;
use crate::kernel::Isa;
use crate::manifest::{Agent, DuelingDqn, Engine, Environment, Reinforce, Scenario, TestActions};
use crate::rng::{Purpose, Stream};

pub use burn::device::backend_name;
use burn::device::inference;
pub use burn::{BurnDuelingDqn, BurnReinforce, DuelingQNetwork, PolicyNetwork};
pub use dueling_dqn::{Batch, DuelingDqnEngine, DuelingDqnLearner};
pub use fused::{FusedDuelingDqn, FusedDuelingNetwork, FusedPolicyNetwork, FusedReinforce};
pub use memory::{OutOfMemory, reserve, reserve_exact};
pub use policy::{ActionNetwork, EpsilonGreedy, Policy, SoftmaxPolicy};
pub use reinforce::{ReinforceEngine, ReinforceLearner, Trajectories};
pub use replay::{Replay, Transition};
pub use rule::{DecisionRuleError, RulePolicy, read_rule};
pub use state::{Number, Resumable, StateError, StateReader, StateWriter};
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
pub trait Learner: Resumable {
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

/// An agent before its first episode.
pub enum Start {
    /// One that has everything to learn.
    Learner(Box<dyn Learner>),
    /// One that has nothing to learn.
    Rule(RulePolicy),
}

/// An agent at the start of its job.
///
/// **Errors**: there is no memory for its network, or for the trajectories of an update.
pub fn start(
    agent: &Agent,
    environment: &Environment,
    scenario: &Scenario,
    seed: u64,
) -> Result<Start, OutOfMemory> {
    Ok(match agent {
        Agent::DuelingDqn(parameters) => {
            Start::Learner(dueling_dqn_learner(parameters, environment, scenario, seed)?)
        }
        Agent::Reinforce(parameters) => {
            Start::Learner(reinforce_learner(parameters, environment, scenario, seed)?)
        }
        Agent::Rule(rule) => {
            let policy = RulePolicy::new(rule, environment, scenario);
            Start::Rule(
                policy.expect("a manifest has the optimal rule only where it can be computed"),
            )
        }
    })
}

const DRAWN: &str = "the weights were drawn for this network";

fn dueling_dqn_learner(
    parameters: &DuelingDqn,
    environment: &Environment,
    scenario: &Scenario,
    seed: u64,
) -> Result<Box<dyn Learner>, OutOfMemory> {
    let inputs = Observer::new(environment, scenario).inputs();
    let mut stream = Stream::new(seed, Purpose::InitialWeights);
    let stacks = layers::dueling(parameters, inputs);
    require_network(&stacks, COPIES_WITH_TARGET)?;
    let weights = layers::draw(&stacks, &mut stream);
    Ok(match parameters.engine {
        Engine::Fused => {
            let engine = FusedDuelingDqn::new(parameters, inputs, &weights, Isa::chosen());
            let engine = engine.expect(DRAWN);
            Box::new(DuelingDqnLearner::new(engine, parameters, environment, scenario, seed))
        }
        Engine::Burn => {
            let engine = BurnDuelingDqn::new(parameters, inputs, &weights).expect(DRAWN);
            Box::new(DuelingDqnLearner::new(engine, parameters, environment, scenario, seed))
        }
    })
}

fn reinforce_learner(
    parameters: &Reinforce,
    environment: &Environment,
    scenario: &Scenario,
    seed: u64,
) -> Result<Box<dyn Learner>, OutOfMemory> {
    let inputs = Observer::new(environment, scenario).inputs();
    let mut stream = Stream::new(seed, Purpose::InitialWeights);
    let stacks = [layers::policy(parameters, inputs)];
    require_network(&stacks, COPIES)?;
    let weights = layers::draw(&stacks, &mut stream);
    Ok(match parameters.engine {
        Engine::Fused => {
            let engine = FusedReinforce::new(parameters, inputs, &weights, Isa::chosen());
            let engine = engine.expect(DRAWN);
            Box::new(ReinforceLearner::new(engine, parameters, environment, scenario, seed))
        }
        Engine::Burn => {
            let engine = BurnReinforce::new(parameters, inputs, &weights).expect(DRAWN);
            Box::new(ReinforceLearner::new(engine, parameters, environment, scenario, seed))
        }
    })
}

/// Fails unless there is memory for so many copies of the network's weights.
fn require_network(stacks: &[layers::Stack], copies: usize) -> Result<(), OutOfMemory> {
    memory::require(copies * size_of::<f32>() * layers::weights(stacks), "the network")
}

/// The weights as drawn and as trained, their gradient, and Adam's two moments of them.
const COPIES: usize = 5;
/// These, and the target network.
const COPIES_WITH_TARGET: usize = COPIES + 1;

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
) -> Result<Box<dyn Policy>, WeightsError> {
    let inputs = Observer::new(environment, scenario).inputs();
    Ok(match agent {
        Agent::DuelingDqn(parameters) => {
            let epsilon = match actions {
                Actions::AsTrained => weights.number("epsilon")?,
                Actions::Greedy => 0.0,
            };
            match parameters.engine {
                Engine::Fused => Box::new(EpsilonGreedy::new(
                    FusedDuelingNetwork::new(parameters, inputs, weights, Isa::chosen())?,
                    epsilon,
                )),
                Engine::Burn => Box::new(EpsilonGreedy::new(
                    DuelingQNetwork::from_weights(parameters, inputs, weights, &inference())?,
                    epsilon,
                )),
            }
        }
        Agent::Reinforce(parameters) => match parameters.engine {
            Engine::Fused => Box::new(SoftmaxPolicy::new(
                FusedPolicyNetwork::new(parameters, inputs, weights, Isa::chosen())?,
                actions,
            )),
            Engine::Burn => Box::new(SoftmaxPolicy::new(
                PolicyNetwork::from_weights(parameters, inputs, weights, &inference())?,
                actions,
            )),
        },
        Agent::Rule(_) => return Err(WeightsError::NoNetwork),
    })
}
