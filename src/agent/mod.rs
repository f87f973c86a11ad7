//! The algorithms: how agents learn and how they act.
//!
//! In: hyper-parameters, a [`crate::env::VectorEnvironment`], named random streams. Out: trained episodes, actors
//! and weights. There is one file per algorithm, written against a trait for the engine that computes
//! its network: `fused` with kernels, `burn` with Burn modules and automatic differentiation. A
//! [`Learner`] is an algorithm on an engine in training. An [`Actor`] chooses the actions of
//! episodes: trained networks and decision rules are actors, and rollouts know nothing else. The
//! registry holds every [`Algorithm`]: name, version, keys, constraints and constructor; an
//! [`Agent`] is one of them with values of its keys. The module knows no job key, no store and no
//! file.
//!
//! Burn's own random generator is global to the process, so nothing here may draw from it: weights
//! are drawn from the job's stream and set.

mod actor;
mod burn;
mod constraint;
mod dueling_dqn;
#[cfg(test)]
mod engine_tests;
mod fused;
mod layers;
mod learner;
mod memory;
mod network;
mod policy;
#[cfg(test)]
mod reference_tests;
mod registry;
mod reinforce;
mod replay;
mod rule;
mod weights;

pub use actor::{Actor, StepObserver};
pub use burn::device::{backend_name, inference as inference_device, training as training_device};
pub use burn::{
    AutodiffPolicy, BurnDuelingDqn, BurnReinforce, DuelingQNetwork, PolicyGradient, PolicyNetwork,
};
pub use burn::{column as action_tensor, input as observation_tensor};
pub use constraint::{Assignment, Constraint, Violation};
pub use dueling_dqn::{DuelingDqn, DuelingDqnEngine, DuelingDqnLearner, Trunk};
pub use fused::{FusedDuelingDqn, FusedDuelingNetwork, FusedPolicyNetwork, FusedReinforce};
pub use learner::{Actions, Diverged, Learner, LearnerError, Span, TrainedEpisode};
pub use memory::{OutOfMemory, reserve, reserve_exact};
pub use network::{Activation, Engine};
pub use policy::{ActionNetwork, EpsilonGreedy, SoftmaxPolicy};
pub use registry::{
    Agent, Algorithm, AlgorithmParameters, RegistrationError, Start, StartError, Task, Trained,
    Work, dueling_dqn_learner, register_algorithm, reinforce_learner, trained_dueling_dqn,
    trained_reinforce,
};
pub use reinforce::{Reinforce, ReinforceEngine, ReinforceLearner, Trajectories};
pub use replay::{Batch, Replay, TerminalTarget, Transition};
pub use rule::{DecisionRule, DecisionRuleError, RuleParameters, RulePolicy, read_rule};
pub use weights::{Tensor as WeightTensor, Weights, WeightsError};
