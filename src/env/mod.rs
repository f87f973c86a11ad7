//! Environments: the contract that learners and actors rely on, and the simulation of the paper.
//!
//! In: parameters, actions and random streams. Out: rewards, episode statuses and observations.
//! [`VectorEnvironment`] is the contract: many episodes, one per lane, stepped together as structures of
//! arrays. Any lane can be reset while others continue, and the whole state can be saved. The module
//! [`contract`] tests any implementation. [`PhysicalActivity`] implements the contract: the simulation of
//! Karine et al. (2023), section 3.1, in f64 as in the authors' simulator, with the stochastic dynamics of
//! StepCountJITAI (2024). `docs/environment.md` states the model. The module does not depend on
//! agents or training.

mod companion_words;
pub mod contract;
mod families;
mod family;
mod history;
mod observation;
pub mod oralytics;
pub mod outside;
mod reported;
mod scenario;
mod simulation;
mod step_count;
mod variates;
mod vector;

pub use family::{Environment, Family, Meaning, Model};
pub use history::History;
pub use observation::{FeatureSpec, ObservationSpec, Observations};
pub use reported::{Reported, Reports};
pub use scenario::{Scenario, ScenarioError};
pub use simulation::{Simulated, Simulation, StateColumn};
pub use step_count::*;
pub use vector::{
    Action, ActionSpec, EpisodeStatus, Interface, LaneSet, LaneStreams, VectorEnvironment,
};
