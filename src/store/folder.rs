//! A trial of the folder of a store: whether its file system has what a store needs.
//!
//! A write-ahead log needs memory that processes share, and locks that hold between processes. File systems that
//! lack one of them mostly open files without an error and lose transactions later, so that only a second process
//! shows the difference.

use std::fs;
use std::path::{Path, PathBuf};
use std::process;
use std::time::Duration;

use rusqlite::{Connection, ErrorCode, OpenFlags};

use super::error::StoreError;
use super::place::beside;
use super::writer::Store;

/// What a second process can do with a store.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Contender {
    /// Whether it sees the row that the first process adds.
    pub sees_the_row: bool,
    /// Whether it gets the lock of writers.
    pub can_write: bool,
}

/// Why a folder cannot hold a store.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FolderFault {
    /// A store cannot be made there.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The second process did not end as it should.
    #[error("the second process failed: {0}")]
    Process(String),
    /// Two processes can write at the same time.
    #[error("two processes can lock a file at the same time there; use a local disk for stores")]
    NoLocks,
    /// A process does not see what another one has committed, or sees what it has not committed.
    #[error("processes do not share a write-ahead log there; use a local disk for stores")]
    NoSharedLog,
    /// The lock of a writer remains.
    #[error("a lock remains after its writer has released it")]
    LockRemains,
}

/// The name of the row.
const ROW: &str = "self-test";

/// A store for one trial, which is removed at the end.
struct Scratch(PathBuf);

impl Drop for Scratch {
    fn drop(&mut self) {
        for ending in ["", "-wal", "-shm"] {
            // What was never made need not be removed.
            let _ = fs::remove_file(beside(&self.0, ending));
        }
    }
}

/// Tries a folder with a store that is made and removed. `contend` must call [`contend`] with the path of this store
/// in another process.
///
/// **Errors**: the folder cannot hold a store.
pub fn try_folder(
    folder: &Path,
    mut contend: impl FnMut(&Path) -> Result<Contender, String>,
) -> Result<(), FolderFault> {
    let scratch = Scratch(folder.join(format!(".jitai-self-test-{}.sqlite", process::id())));
    let path = &scratch.0;
    let mut store = Store::open(path)?;
    let mut ask = || contend(path).map_err(FolderFault::Process);
    // The other process is asked while this one holds the lock, and again after the commit.
    let during = store.write("try the folder of a store", |transaction| {
        transaction.execute("INSERT INTO metric_name (name) VALUES (?1)", [ROW])?;
        Ok(ask())
    })??;
    let after = ask()?;
    match (during, after) {
        (Contender { can_write: true, .. }, _) => Err(FolderFault::NoLocks),
        (Contender { sees_the_row: true, .. }, _) | (_, Contender { sees_the_row: false, .. }) => {
            Err(FolderFault::NoSharedLog)
        }
        (_, Contender { can_write: false, .. }) => Err(FolderFault::LockRemains),
        (
            Contender { sees_the_row: false, can_write: false },
            Contender { sees_the_row: true, can_write: true },
        ) => Ok(()),
    }
}

/// What this process can do with the store of a trial in another process.
pub fn contend(path: &Path) -> Result<Contender, StoreError> {
    let found = || -> rusqlite::Result<Contender> {
        let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let connection = Connection::open_with_flags(path, flags)?;
        connection.busy_timeout(Duration::ZERO)?;
        let sql = "SELECT EXISTS (SELECT 1 FROM metric_name WHERE name = ?1)";
        let sees_the_row = connection.query_row(sql, [ROW], |row| row.get(0))?;
        let can_write = match connection.execute_batch("BEGIN IMMEDIATE; ROLLBACK") {
            Ok(()) => true,
            Err(error) if error.sqlite_error_code() == Some(ErrorCode::DatabaseBusy) => false,
            Err(error) => return Err(error),
        };
        Ok(Contender { sees_the_row, can_write })
    };
    found().map_err(|source| StoreError::sqlite(path, "open the store", source))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tried(contenders: [[bool; 2]; 2]) -> String {
        let folder = tempfile::tempdir().unwrap();
        let mut contenders = contenders.into_iter();
        let result = try_folder(folder.path(), |_| {
            let [sees_the_row, can_write] = contenders.next().unwrap();
            Ok(Contender { sees_the_row, can_write })
        });
        let left = fs::read_dir(folder.path()).unwrap().count();
        assert_eq!(left, 0, "the store of the trial is removed");
        result.map_or_else(|fault| fault.to_string(), |()| "ok".to_owned())
    }

    #[test]
    fn what_a_second_process_sees_shows_what_a_folder_lacks() {
        assert_eq!(tried([[false, false], [true, true]]), "ok");
        assert!(tried([[false, true], [true, true]]).starts_with("two processes can lock a file"));
        assert!(tried([[true, false], [true, true]]).starts_with("processes do not share"));
        assert!(tried([[false, false], [false, true]]).starts_with("processes do not share"));
        assert!(tried([[false, false], [true, false]]).starts_with("a lock remains"));
    }

    #[test]
    fn a_second_connection_is_locked_out_until_the_commit() {
        let folder = tempfile::tempdir().unwrap();
        let mut seen = Vec::new();
        try_folder(folder.path(), |path| {
            let contender = contend(path).map_err(|error| error.to_string())?;
            seen.push(contender);
            Ok(contender)
        })
        .unwrap();
        let seen = seen.iter().map(|seen| (seen.sees_the_row, seen.can_write));
        assert!(seen.eq([(false, false), (true, true)]));
    }
}
