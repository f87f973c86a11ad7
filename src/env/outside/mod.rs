//! Environments that are outside programs.
//!
//! In: a command with its parameters, and actions. Out: a [`Description`] of the environment, and an
//! [`OutsideEnvironment`], whose lanes the program simulates. `docs/outside-environments.md` has the
//! protocol. One [`EnvironmentProgram`] serves all lanes of a job, those of the training and those of the
//! test.
//!
//! The contract of environments knows no errors. After a failure, therefore, all lanes have ended and
//! rewards are 0, and [`EnvironmentProgram::failure`] has the reason.

mod client;
mod description;
mod family;
mod program;
mod trial;

pub use client::OutsideEnvironment;
pub use description::{DescribedFeature, Description};
pub use family::{FAMILY, OutsideModel, OutsideParameters};
pub use program::{EnvironmentProgram, EpisodePhase, Launch};
pub use trial::{Trial, TrialError, try_program};
