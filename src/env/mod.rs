//! Environments: the contract that learners and actors rely on, and the families that implement it.
//!
//! In: parameters, actions and random streams. Out: rewards, episode statuses and observations.
//! [`VectorEnvironment`] is the contract: many episodes, one per lane, stepped together as structures of
//! arrays. Any lane can be reset while others continue, and the whole state can be saved. The module
//! [`contract`] tests any implementation. A family declares keys and makes environments: `step_count`, the
//! simulation of Karine et al. (2023) with the dynamics of StepCountJITAI (2024); [`declared`], models in
//! files of users; [`recorded`], trials that happened; and [`outside`], programs of users. `docs/environment.md`,
//! `docs/models.md`, `docs/recorded.md` and `docs/outside-environments.md` describe them. The module does not depend on agents or training.

mod companion_words;
pub mod contract;
pub mod declared;
mod families;
mod family;
mod history;
mod observation;
pub mod outside;
pub mod recorded;
mod reported;
mod retired;
mod scenario;
mod simulation;
mod step_count;
mod variates;
mod vector;

pub use family::{Environment, Family, Meaning, Model, WithParameters};
pub use history::History;
pub use observation::{FeatureSpec, ObservationSpec, Observations};
pub use reported::{Reported, Reports};
pub use scenario::{Scenario, ScenarioError};
pub use simulation::{Simulated, Simulation, StateColumn};
pub use step_count::*;
pub use vector::{
    Action, ActionSpec, EpisodeStatus, Interface, LaneSet, LaneStreams, VectorEnvironment,
};
