//! The store: one SQLite file that holds every experiment, job, run and result. The only module
//! that knows SQL.
//!
//! In: jobs ([`crate::plan`]) and how their runs ended ([`crate::record`]). Out: states, summaries,
//! weights and answers to queries. A [`Store`] writes, a [`Reader`] reads; the tables are made by
//! `migrations/*.sql`, and `docs/store.md` describes the views that others may rely on.
//!
//! - Every write is one immediate transaction: writers wait for each other, readers for nobody.
//! - The end of a run is on the disk when [`Store::finish_all`] returns. Whatever else is written, the
//!   next run would write again, so it waits for no disk.
//! - A job has at most one run that is running or completed, whatever processes share the file. The
//!   file itself refuses a second one.
//! - A completed run has all its results and never changes; every other run has none.
//! - A run ends only by the session that claimed it, or when that session is known to be dead
//!   (`liveness.rs`). Whoever lost a claim cannot write ([`StoreError::ClaimLost`]).
//! - A completed run keeps a digest of its results (`digest.rs`), by which [`examine`] and [`salvage`]
//!   know whether they are still those that were stored.
//! - Nothing is ever deleted but an experiment's hold on a job that its manifest dropped.
//!
//! It does not know how jobs are trained, in what order they are claimed, or what is printed. It
//! changes no setting outside its own connections.

mod claim;
mod completed;
mod counts;
mod crash;
mod digest;
mod doctor;
mod error;
mod experiment;
mod file;
mod liveness;
mod migrate;
mod mount;
mod provided;
mod query;
mod read;
mod results;
mod salvage;
mod schema;
mod session;
mod state;
mod weights;

use std::path::{Path, PathBuf};

use rusqlite::{Connection, Transaction, TransactionBehavior};

pub use claim::{Claim, Claimed, Company, RetryFailed};
pub use completed::Parts;
pub use counts::ExperimentCounts;
pub use doctor::{Diagnosis, Finding, Loads, examine};
pub use error::{QueryError, StoreError};
pub use experiment::{Experiment, Registered};
pub use liveness::host_name;
pub use provided::Provided;
pub use query::{Answer, Interrupter, VIEWS, Value};
pub use read::{FailedJob, Pace, Reader};
pub use results::{Finished, RunEnd};
pub use salvage::{Salvaged, salvage};
pub use session::SessionId;
pub use state::{Counts, JobState};
pub use weights::StoredWeights;

use crate::kill_point::{self, KillPoint};

use error::Fault;

/// The version of the schema that this program reads and writes.
pub const SCHEMA_VERSION: u32 = migrate::MIGRATIONS.len() as u32;

/// The store, open for writing. A process has one, owned by one thread.
#[derive(Debug)]
pub struct Store {
    connection: Connection,
    path: PathBuf,
}

impl Store {
    /// The store at `path`, made if there is none, migrated (after a backup copy beside it) if it
    /// is of an earlier release.
    ///
    /// **Errors**: the path cannot hold a store, or holds something else or a store of a newer
    /// release; those files are left untouched.
    pub fn open(path: &Path) -> Result<Store, StoreError> {
        let (connection, path) = file::open_writer(path)?;
        Ok(Store { connection, path })
    }

    /// Where its file is, from the root.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// As [`Store::write`]; when it returns, not even a power cut undoes what was written.
    fn write_durably<T>(
        &mut self,
        action: &'static str,
        body: impl FnOnce(&Transaction<'_>) -> Result<T, Fault>,
    ) -> Result<T, StoreError> {
        let synchronous =
            |connection: &Connection, level| connection.pragma_update(None, "synchronous", level);
        synchronous(&self.connection, "FULL")
            .map_err(|source| StoreError::sqlite(&self.path, action, source))?;
        let done = self.write(action, body);
        synchronous(&self.connection, "NORMAL")
            .map_err(|source| StoreError::sqlite(&self.path, action, source))?;
        done
    }

    /// Does `body` in one transaction that holds the store's write lock from its start.
    ///
    /// `action` completes "failed to …" in errors.
    fn write<T>(
        &mut self,
        action: &'static str,
        body: impl FnOnce(&Transaction<'_>) -> Result<T, Fault>,
    ) -> Result<T, StoreError> {
        let path = &self.path;
        let transaction = self
            .connection
            .transaction_with_behavior(TransactionBehavior::Immediate)
            .map_err(|source| StoreError::sqlite(path, action, source))?;
        // A newer program may have migrated the file since it was opened.
        file::require_current(&transaction, path)?;
        let done = body(&transaction).map_err(|fault| fault.at(path, action))?;
        commit(transaction).map_err(|source| StoreError::sqlite(path, action, source))?;
        Ok(done)
    }
}

/// Commits; every transaction that writes to a store ends here.
fn commit(transaction: Transaction<'_>) -> rusqlite::Result<()> {
    kill_point::pass(KillPoint::BeforeCommit);
    transaction.commit()?;
    kill_point::pass(KillPoint::AfterCommit);
    Ok(())
}

/// SQL for the present instant, as the tables keep it.
const NOW: &str = "strftime('%Y-%m-%dT%H:%M:%fZ', 'now')";
