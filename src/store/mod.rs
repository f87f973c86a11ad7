//! The store: one SQLite file that holds every experiment, job, run and result. The only module
//! that knows SQL.
//!
//! In: jobs ([`crate::plan`]) and how their runs ended ([`crate::record`]). Out: states, summaries,
//! weights and answers to queries. A [`Store`] writes, a [`Reader`] reads. `migrations/*.sql` makes
//! the tables, and `docs/store.md` describes the views that others may rely on.
//!
//! - Every write is an immediate transaction. Writers wait for each other; readers never wait.
//! - The end of a run is on the disk when [`Store::finish_all`] returns. Other writes do not wait for
//!   the disk, because the next run repeats those that a power cut undoes.
//! - A job has at most one run that is running or completed, whatever processes share the file. The
//!   file itself refuses a second one.
//! - A completed run has all its results and never changes; every other run has none.
//! - A run is ended by the session that claimed it, or by another one when that session is known to
//!   be dead (`liveness.rs`). A session that lost its claim cannot write ([`Finished::ClaimLost`]).
//! - A completed run keeps a digest of its results (`digest.rs`). [`examine`] and [`salvage()`] compare
//!   it with the results as they are now (`verify.rs`).
//! - Rows are never deleted, except that an experiment lets go of jobs that its manifest dropped.
//!
//! The store does not know how jobs are trained, which algorithms have weights, in what order jobs
//! are claimed, or what is printed. It changes no setting outside its own connections.
//! No file of this module imports, directly or through others, a file that imports it.

mod beside;
mod claim;
mod completed;
mod copy;
mod counts;
mod crash;
mod data_query;
mod decision;
mod digest;
mod doctor;
mod ending;
mod error;
mod experiment;
mod file;
mod implied;
mod liveness;
mod merge;
mod migrate;
mod mount;
mod query;
mod read;
mod results;
mod salvage;
#[cfg(test)]
mod sample;
mod sandbox;
mod schema;
mod seal;
mod session;
mod state;
mod transaction;
mod verify;
mod weights;
mod writer;

pub use claim::{Claim, Claimed, Isolation, RetryFailed};
pub use completed::Parts;
pub use copy::Origin;
pub use counts::ExperimentCounts;
pub use data_query::DataQuery;
pub use doctor::{Diagnosis, Finding, examine};
pub use error::StoreError;
pub use experiment::{Experiment, Registered};
pub use liveness::host_name;
pub use merge::{Conflict, Damage, MergeProgress, Merged, OtherManifest, merge, stores_of};
pub use migrate::SCHEMA_VERSION;
pub use query::{Answer, Interrupter, QueryError, VIEWS, Value};
pub use read::{FailedJob, Pace, Reader};
pub use results::{Finished, RunEnd};
pub use salvage::{Salvaged, salvage};
pub use seal::seal;
pub use session::SessionId;
pub use state::{Counts, JobState};
pub use verify::CheckWeights;
pub use weights::StoredWeights;
pub use writer::Store;
