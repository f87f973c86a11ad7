//! The store: one SQLite file with all experiments, jobs, runs and results. Only this module uses
//! SQLite.
//!
//! In: jobs and the outcomes of their runs ([`crate::job`]). Out: states, summaries,
//! weights and results of queries. A [`Store`] writes, a [`Reader`] reads. `migrations/*.sql` creates the
//! tables, and `docs/store.md` documents the public views.
//!
//! - A store has one name, to which links lead, and everything beside it has that name (`place.rs`).
//! - Every write is an immediate transaction. Writers wait for each other; readers never wait.
//! - The end of a run is on the disk when [`Store::finish_all`] returns. Other writes do not wait for the
//!   disk, because the next run repeats writes that a power failure undoes.
//! - A job has at most one running or completed run, even if several processes share the file. The schema
//!   itself rejects a second one.
//! - A completed run has all its results and never changes; all other runs have no results.
//! - A run is ended by the session that claimed it, or by another session once that session is known to be
//!   dead (`liveness.rs`). A session that lost its claim cannot write ([`Finished::ClaimLost`]).
//! - A completed run keeps a digest of its results (`digest.rs`). [`examine`] and [`salvage()`] compare it
//!   with the current results (`verify.rs`).
//! - Rows are never deleted, with two exceptions: an experiment releases jobs that its manifest dropped, and
//!   [`Store::forget`] removes an experiment on request.
//!
//! The store does not depend on how jobs are trained, which algorithms have weights, in what order
//! jobs are claimed, or what is printed. It changes no settings outside its own connections.
//! Imports between the files of this module have no cycles.

mod choice;
mod claim;
mod command;
mod completed;
mod conflict;
mod copy;
mod counts;
mod crash;
mod data_query;
mod decision;
mod declared;
mod diagnosand;
mod digest;
mod doctor;
mod earlier_manifest;
mod ending;
mod episode_ending;
mod error;
mod estimate;
mod experiment;
mod export;
mod family;
mod file;
mod folder;
mod forget;
mod implied;
mod insert;
mod job_states;
mod liveness;
mod merge;
mod migrate;
mod mount;
mod participant;
mod place;
mod posterior;
mod query;
mod read;
mod recorded;
mod results;
mod salvage;
#[cfg(test)]
mod sample;
mod sandbox;
mod schema;
mod seal;
mod seed_group;
mod session;
mod state;
mod tables;
mod transaction;
mod verify;
mod view;
mod weights;
mod writer;

pub use claim::{Claim, Claimed, Isolation, RetryFailed};
pub use command::Command;
pub use completed::{Curve, Parts};
pub use copy::Origin;
pub use counts::ExperimentCounts;
pub use crash::{CHECKPOINTS, STOPPED, checkpoint_name};
pub use data_query::{DataQuery, mean_returns};
pub use declared::ColumnType;
pub use diagnosand::{Diagnosed, diagnosand_fault};
pub use doctor::{Diagnosis, Discovery, examine};
pub use earlier_manifest::UsedManifest;
pub use error::StoreError;
pub use estimate::{Added, FailedEstimates};
pub use experiment::{Experiment, Registered};
pub use export::{VIEWS, ViewColumn, columns};
pub use folder::{Contender, FolderFault, contend, try_folder};
pub use forget::{Belongings, Forgotten};
pub use job_states::JobStates;
pub use liveness::host_name;
pub use merge::{
    Conflict, Damage, MergeProgress, Merged, OtherManifest, Sources, merge, stores_of,
};
pub use migrate::SCHEMA_VERSION;
pub use place::{beside, require_one_name, resolve};
pub use query::{Answer, Interrupter, QueryError, SqlValue};
pub use read::{FailedJob, Pace, Reader, StoredArm};
pub use results::{Finished, RunEnd, results_digest};
pub use salvage::{Salvaged, salvage};
pub use seal::seal;
pub use session::SessionId;
pub use state::{Counts, JobState};
pub use verify::CheckWeights;
pub use weights::StoredWeights;
pub use writer::Store;
