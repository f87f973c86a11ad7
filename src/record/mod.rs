//! The jobs of an experiment with their status and results, as analysis reads them.

mod job;
mod settings;

pub use job::{
    AmongParticipants, CompletedRun, DataSet, JobRecord, JobStatus, PersonDecision,
    ReplayedDecision, ReplayedDecisions,
};
pub use settings::{Settings, SharedSettings};
