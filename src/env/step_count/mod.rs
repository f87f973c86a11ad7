//! The family `step_count`: the simulation of the paper.
//!
//! Karine et al. (2023), section 3.1, in f64 as in the authors' simulator, with the stochastic dynamics of
//! StepCountJITAI (2024). `docs/environment.md` states the model.

mod belief;
mod constraints;
mod context;
mod dynamics;
mod family;
mod filter;
mod full_step;
mod intervention;
mod meaning;
mod noise;
mod observer;
mod parameters;
mod participants;
mod physical_activity;
mod plain_step;
mod population;
mod scenario;
mod simulated;
mod symbols;

pub use belief::Belief;
pub use constraints::{CONSTRAINTS, PEOPLE_CONSTRAINTS, population};
pub use context::{
    ContextDraw, ContextDrawsAhead, context_error, inference_error, probability_of_zero,
};
pub use dynamics::{StateChange, apply_action, fewest_steps};
pub use family::{FAMILY, StepCountModel};
pub use filter::Beliefs;
pub use full_step::INITIAL_STEPS;
pub use intervention::OPTIONS;
pub use noise::ForcedNoise;
pub use observer::{LaneStates, Observer};
pub use parameters::{
    DisengagementReward, FirstContext, RewardHabituation, StateNoise, StepCount, StepNoise,
    TimeIndicator, VERSION,
};
pub use physical_activity::PhysicalActivity;
pub use population::{ParticipantSampler, Population, PopulationPhases};
pub use scenario::{Feature, letters};
pub use simulated::PROBABILITY_BINS;
pub use symbols::{SYMBOLS, Symbol};
