//! One job, from its declaration to its outcome.
//!
//! In: a [`Job`](crate::job::Job) and a [`TrainingControl`]. Out: an [`Outcome`](crate::job::Outcome)
//! that depends only on the job and the code, however often the training was stopped and resumed.
//! The module uses no database, no workers and no other jobs. [`Checkpoints`] decides where
//! checkpoints are kept and when they are due.

mod after_study;
mod afterwards;
mod checkpoint;
mod control;
mod curve;
mod decision_log;
mod environment_program;
mod excursions;
mod observers;
mod once_more;
mod outside;
mod policy_courses;
mod progress;
mod roll;
mod run;
mod sightings;
mod study;
mod test;
mod trace;
mod training;
mod truth;
mod watched;

pub use crate::agent::StepObserver;
pub use after_study::{BanditTrace, NoAfterStudy};
pub use afterwards::Afterwards;
pub use checkpoint::{
    CheckpointError, CheckpointFile, Checkpoints, KeptNowhere, ReadCheckpoint, Resumed,
    WriteCheckpoint,
};
pub use control::{StopHandle, TrainingControl, Uncontrolled};
pub use environment_program::misfit;
pub use once_more::{after_study_covariance, bandit_trace, trace};
pub use progress::TrainingProgress;
pub use roll::{RollStreams, Rollout, begin, play, roll};
pub use run::run;
pub use study::{Study, TracedUpdate};
pub use trace::{NoTrace, Trace, TracedDecision};
