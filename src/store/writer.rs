//! The writing connection, and its transactions.

use std::path::{Path, PathBuf};

use rusqlite::{Connection, Transaction, TransactionBehavior};

use super::error::{Fault, StoreError};
use super::file;
use super::transaction::commit;

/// The store, open for writing. A process has one, owned by one thread.
#[derive(Debug)]
pub struct Store {
    pub(super) connection: Connection,
    pub(super) path: PathBuf,
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
    pub(super) fn write_durably<T>(
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
    pub(super) fn write<T>(
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
