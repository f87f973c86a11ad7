//! The scheduler: from planned jobs to stored runs.
//!
//! In: a queue of jobs, an open store, a way to train. Out: a stored run for every job that was
//! missing one, and a [`Tally`].
//!
//! - One thread, the caller's, owns the store; workers never see it. It claims jobs, hands them
//!   out, writes outcomes and tells the [`EventSink`] what happened, so that all events have one order.
//! - A worker holds one job at a time; nothing of it survives but its outcome and its checkpoint.
//! - Outcomes that come within a twentieth of a second are stored together, while the workers are at
//!   their next jobs: however slow the disk is, short jobs do not wait for it one by one. Nothing
//!   is told of an outcome before it is on the disk.
//! - Whether a job is free is decided by the store in the transaction that claims it, never from
//!   memory: other processes may work on the same store.
//! - A panic is an outcome of its job, not the end of its worker.
//! - A job whose process crashed is a suspect: it runs when nothing else does, so that it brings
//!   down no other, and a further crash has no other suspect.
//! - A job that fails is not tried again in the same sweep. Those that failed in earlier sweeps are
//!   tried again all or none, whatever their agent, parameters or way to fail.

mod checkpoint;
mod estimate;
mod event;
mod panic;
mod provenance;
mod queued;
mod selection;
mod sweep;
mod whole;
mod worker;

pub use checkpoint::{CheckpointFolder, CheckpointNote};
pub use estimate::{Episodes, Estimate, Speeds};
pub use event::{Event, EventSink, Found};
pub use provenance::of_this_process;
pub use queued::Queued;
pub use selection::Selection;
pub use sweep::{Context, MOST_WORKERS, OnFailure, Options, SweepError, Tally, one_per_core, run};
pub use whole::{Remaining, register_experiment, run_manifests, run_queue};
pub use worker::Train;
