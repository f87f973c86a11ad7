//! The scheduler: from planned jobs to stored runs.
//!
//! In: a queue of jobs, an open store, and a function that trains a job. Out: a stored run for every job that
//! lacked one, and a [`Tally`].
//!
//! - The caller's thread owns the store; workers have no access to it. It claims jobs, hands them out, writes
//!   outcomes and sends every event to the [`EventSink`], so all events have one order.
//! - A worker holds one job at a time; only the job's outcome and its checkpoint persist.
//! - Outcomes within 50 ms are stored in one transaction while the workers train their next jobs, so a slow
//!   disk does not delay every short job. An outcome is reported only after it is on the disk.
//! - The store decides whether a job is free, in the transaction that claims it, because other processes may
//!   work on the same store.
//! - A panic is an outcome of its job and does not end its worker.
//! - A job that may have caused the death of a process is a suspect. It runs last and alone, so that a further
//!   death interrupts no other job and has one possible cause.
//! - A failed job is not retried in the same sweep. Of the jobs that failed in earlier sweeps, either all or
//!   none are retried, so that retries do not bias a comparison of arms.

mod checkpoint;
mod curve;
mod ending;
mod estimate;
mod estimates;
mod event;
mod event_log;
mod manifests;
mod panic;
mod preview;
mod programs;
mod provenance;
mod queued;
mod race;
mod runner;
mod selection;
mod survey;
mod sweep;
mod worker;

pub use checkpoint::{CheckpointFolder, CheckpointNote};
pub use curve::RunningCurve;
pub use ending::{Cause, End};
pub use estimate::{Left, Speeds, spoken};
pub use estimates::{Estimated, trains_again};
pub use event::{Event, EventSink, Found};
pub use event_log::EventLog;
pub use manifests::{removal, stored_manifest};
pub use preview::Preview;
pub use programs::ChangedPrograms;
pub use provenance::{command, of_this_process};
pub use queued::{Queued, QueuedFor};
pub use race::{race_lines, race_notes, races, races_ended};
pub use runner::{Caller, EndedRun, register, run_manifests};
pub use selection::{Filtered, Selection};
pub use survey::{Change, Reason, Remaining, Sharing, Survey, Surveyed};
pub use sweep::{Context, MOST_WORKERS, OnFailure, Options, SweepError, Tally, one_per_core, run};
pub use worker::Train;
