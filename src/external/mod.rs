//! Outside programs: their processes, and the lines that they exchange with jitai.
//!
//! In: the words of a command, and a folder. Out: a [`Program`] that receives and sends messages of the
//! protocols in `docs/external.md` and `docs/outside-environments.md`, or a [`ProgramError`] with the reason,
//! the exit code and the last lines of the program's standard error.
//!
//! A program is the leader of a process group. The whole group is killed whenever a job ends; a watchdog
//! process kills it if jitai is killed. Every wait can be interrupted. The module does not depend
//! on jobs or episodes.

use std::sync::Arc;

mod environment;
mod error;
mod message;
mod output;
mod pipes;
mod process;
mod watchdog;

pub use environment::{
    Declared, DeclaredFeature, ENVIRONMENT_PROTOCOL, LONGEST_ENVIRONMENT_LINE, Observation,
    Observed, SentNumbers, ToEnvironment,
};
pub use error::ProgramError;
pub use message::{
    Choices, FromProgram, LONGEST_LINE, Message, OwnEpisodes, PROTOCOL, Probabilities, Reset,
    SentRows, StepRequest, ToProgram, Update,
};
pub use output::output_within;
pub use process::{Program, shown};

/// Whether a wait for a program should end, because its job is being stopped.
pub type StopRequested = Arc<dyn Fn() -> bool + Send + Sync>;
