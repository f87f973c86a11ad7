//! The writing connection, and its transactions.

use std::path::{Path, PathBuf};

use rusqlite::{Connection, Transaction, TransactionBehavior};

use super::command::{self, Command};
use super::error::{StoreError, StoreFault};
use super::file;
use super::transaction::commit;

/// The store, open for writing. A process has only one, owned by one thread.
#[derive(Debug)]
pub struct Store {
    pub(super) connection: Connection,
    pub(super) path: PathBuf,
    /// The command that will be recorded with the first change.
    command: Option<Command>,
}

impl Store {
    /// Opens the store at `path`. Creates it if it does not exist, and migrates it, after a backup copy, if
    /// it is of an earlier release.
    ///
    /// **Errors**: the path cannot hold a store, or holds another file or a store of a newer release, which
    /// is left untouched.
    pub fn open(path: &Path) -> Result<Store, StoreError> {
        let (connection, path) = file::open_writer(path)?;
        Ok(Store { connection, path, command: None })
    }

    /// Records `command` in the store, in the transaction of its first change.
    pub fn changed_by(self, command: Command) -> Store {
        Store { command: Some(command), ..self }
    }

    /// Records the command now.
    ///
    /// **Errors**: the store fails.
    pub fn record_command(&mut self) -> Result<(), StoreError> {
        let command = self.command.take();
        self.write("record the command", |transaction| {
            command.iter().try_for_each(|command| Ok(command::record(transaction, command)?))
        })
    }

    /// The absolute path of the store's file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Like [`Store::write`], but the writes survive a power failure once this returns.
    pub(super) fn write_durably<T>(
        &mut self,
        action: &'static str,
        body: impl FnOnce(&Transaction<'_>) -> Result<T, StoreFault>,
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

    /// Runs `body` in one transaction that holds the store's write lock from the start.
    ///
    /// `action` completes "failed to …" in errors.
    pub(super) fn write<T>(
        &mut self,
        action: &'static str,
        body: impl FnOnce(&Transaction<'_>) -> Result<T, StoreFault>,
    ) -> Result<T, StoreError> {
        let path = &self.path;
        let transaction = self
            .connection
            .transaction_with_behavior(TransactionBehavior::Immediate)
            .map_err(|source| StoreError::sqlite(path, action, source))?;
        // A newer program may have migrated the file since this process opened it.
        file::require_current(&transaction, path)?;
        let before = transaction.total_changes();
        let done = body(&transaction).map_err(|fault| fault.at(path, action))?;
        let has_changed = transaction.total_changes() > before;
        let command = self.command.take_if(|_| has_changed);
        command
            .map_or(Ok(()), |command| command::record(&transaction, &command))
            .and_then(|()| commit(transaction))
            .map_err(|source| StoreError::sqlite(path, action, source))?;
        Ok(done)
    }
}
