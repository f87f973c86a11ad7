//! Environments: the contract that learners and actors rely on, and the simulation of the paper.
//!
//! In: parameters, actions and random streams. Out: rewards, episode statuses and observations.
//! [`VectorEnvironment`] is the contract: many episodes, one per lane, stepped together as structures of
//! arrays. Any lane can be reset while others continue, and the whole state can be saved. The module
//! [`contract`] tests any implementation. [`PhysicalActivity`] implements the contract: the simulation of
//! Karine et al. (2023), section 3.1, in f64 as in the authors' simulator, with the stochastic dynamics of
//! StepCountJITAI (2024). `docs/environment.md` states the model. The module does not depend on
//! agents or training.

mod belief;
mod context;
pub mod contract;
mod dynamics;
mod full_step;
mod history;
mod intervention;
mod noise;
mod observation;
mod observer;
pub mod outside;
mod parameters;
mod participants;
mod physical_activity;
mod plain_step;
mod population;
mod scenario;
mod variates;
mod vector;

pub use belief::Belief;
pub use context::{
    ContextDraw, ContextDrawsAhead, context_error, inference_error, probability_of_zero,
};
pub use dynamics::{Effect, apply_action, fewest_steps};
pub use full_step::INITIAL_STEPS;
pub use history::History;
pub use noise::ForcedNoise;
pub use observation::{FeatureSpec, ObservationSpec, Observations};
pub use observer::{LaneStates, Observer};
pub use parameters::{
    DisengagementReward, Environment, FirstContext, RewardHabituation, StateNoise, StepNoise,
    TimeIndicator, VERSION,
};
pub use physical_activity::PhysicalActivity;
pub use population::{ParticipantSampler, Population, PopulationPhases};
pub use scenario::{Feature, Scenario, ScenarioError};
pub use vector::{
    Action, ActionProbabilities, ActionSpec, EpisodeStatus, LaneSet, LaneStreams, VectorEnvironment,
};
