//! The physical-activity simulation of Karine et al. (2023), section 3.1.
//!
//! In: parameters, actions and a random stream. Out: rewards, endings and observations. Episodes
//! advance in lockstep, as structure of arrays: one call steps every lane. Numbers are f64, as in
//! the authors' simulator, whose trajectories this one repeats. It knows no agent and no budget.

mod belief;
mod context;
mod episodes;
mod observation;
mod parameters;
mod scenario;

pub use belief::Belief;
pub use context::{Signal, SignalsAhead, inference_error, probability_of_zero};
pub use episodes::{Action, Effect, Ending, Episodes, Lane, respond};
pub use observation::{Observations, Observer};
pub use parameters::{Environment, FirstContext, TimeIndicator, VERSION};
pub use scenario::{Feature, Scenario, ScenarioError};
