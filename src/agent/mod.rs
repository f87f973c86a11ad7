//! The algorithms: how agents learn and how they act.
//!
//! In: hyper-parameters, a [`crate::env::VectorEnvironment`], named random streams. Out: trained
//! episodes, actors and weights. An algorithm with a network is written against a trait for the
//! engine that computes it: `fused` with kernels, `burn` with Burn modules and automatic
//! differentiation (a feature of the build). Rules, bandits and outside programs have no network. A [`Learner`] is an algorithm in training on an engine. An [`Actor`] chooses
//! the actions of episodes. Trained networks and decision rules are actors, and rollouts depend
//! only on this trait. The registry holds every [`Algorithm`]: name, version, keys, constraints and
//! constructor. An [`Agent`] is an algorithm with values of its keys. The module uses no job keys,
//! no store and no files.
//!
//! Burn's own random generator is global to the process, so nothing here may draw from it. Weights
//! are drawn from the job's stream and then set.

#[cfg(test)]
mod actions_tests;
mod actor;
mod architecture;
#[cfg(feature = "burn")]
mod burn;
mod constraint;
mod control_group;
mod dueling_dqn;
mod effect_posterior;
#[cfg(all(test, feature = "burn"))]
mod engine_tests;
mod external;
mod fused;
mod layers;
mod learner;
mod learner_error;
mod linear_thompson;
mod memory;
mod network;
mod orthogonal;
mod policy;
mod ppo;
#[cfg(all(test, feature = "burn"))]
mod ppo_tests;
#[cfg(all(test, feature = "burn"))]
mod recurrent_dqn_tests;
#[cfg(all(test, feature = "burn"))]
mod recurrent_tests;
#[cfg(all(test, feature = "burn"))]
mod reference_tests;
mod registry;
mod reinforce;
mod replay;
mod rule;
mod unavailable;
mod weights;

pub use actor::{Actor, Rewards, StepObserver, StudyAgent, StudyUpdate};
pub use architecture::{Architecture, GruNames, NetworkPolicy, StackNames};
#[cfg(feature = "burn")]
pub use burn::device::{inference as inference_device, training as training_device};
#[cfg(feature = "burn")]
pub use burn::{
    ActorCritic, AutodiffPolicy, BurnActorCritic, BurnDuelingDqn, BurnPpo, BurnRecurrentDqn,
    BurnReinforce, DuelingQNetwork, PolicyGradient, PolicyNetwork, RecurrentActorCritic,
    RecurrentDuelingQNetwork,
};
#[cfg(feature = "burn")]
pub use burn::{column as action_tensor, input as observation_tensor};
pub use constraint::{HORIZON, longest_episode, recorded_decisions};
pub use dueling_dqn::{
    DuelingDqn, DuelingDqnEngine, DuelingDqnLearner, EpisodeReplay, Episodes, Experience,
    SequenceBatch, Transitions, Trunk,
};
pub use effect_posterior::EffectPosterior;
pub use external::External;
pub use fused::{
    FusedActorCritic, FusedDuelingDqn, FusedDuelingNetwork, FusedPolicyNetwork, FusedPpo,
    FusedRecurrentActorCritic, FusedRecurrentDqn, FusedRecurrentDuelingNetwork, FusedReinforce,
};
pub use layers::Shape;
pub use learner::{Actions, Diverged, Learner, LearnerError, SpanEnd, TrainedEpisode};
pub use linear_thompson::{
    BanditAllocation, BanditDraw, BanditFeatures, BanditPolicy, BanditPosterior, BanditSums,
    BanditUpdate, LinearThompson, LinearThompsonLearner, LinearThompsonPolicy, LinearThompsonStudy,
    Made, NoSlopes, PersonSd, SmoothPolicy, features_of_state,
};
pub use memory::{OutOfMemory, reserve, reserve_exact};
pub use network::{Activation, Engine, NoEngine, Recurrent, backend_name};
pub use policy::{ActionNetwork, Choice, NetworkActor};
pub use ppo::{
    AtHorizon, Losses, Minibatch, Ppo, PpoEngine, PpoLearner, Sequences,
    advantages as generalised_advantages,
};
pub use registry::{
    Agent, Algorithm, AlgorithmParameters, RegistrationError, Sharing, Start, StartError,
    StudyPlan, Task, Trained, Work, dueling_dqn_learner, linear_thompson_learner, ppo_learner,
    register_algorithm, reinforce_learner, trained_linear_thompson,
};
pub use reinforce::{Reinforce, ReinforceEngine, ReinforceLearner, Trajectories};
pub use replay::{Batch, Replay, TerminalTarget, Transition};
pub use rule::{DecisionRule, DecisionRuleError, RuleParameters, RulePolicy, RuleState, read_rule};
pub use unavailable::{UNAVAILABLE, Unavailable, certain};
pub use weights::{Tensor as WeightTensor, Weights, WeightsError};
