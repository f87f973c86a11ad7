//! Opening a source of a merge, which is only read.

use std::path::{Path, PathBuf};
use std::time::Duration;

use rusqlite::Connection;
use rusqlite::backup::Backup;

use crate::store::error::StoreError;
use crate::store::migrate::{self, SCHEMA_VERSION};
use crate::store::{file, schema};

/// The number of pages per step of the backup.
const PAGES_AT_A_TIME: i32 = 1024;

/// A connection to the store at `path` with this program's schema, in a transaction. Every statement sees the
/// same snapshot, even if other processes write. A store of an earlier release is migrated in a private
/// temporary copy.
///
/// **Errors**: `path` does not exist, is not a store, or is a store of a newer release.
pub(super) fn open(path: &Path) -> Result<Connection, StoreError> {
    let (connection, path) = open_as_it_is(path)?;
    let failed = |source| StoreError::sqlite(&path, "read the store", source);
    let version: u32 = connection
        .query_row("SELECT user_version FROM pragma_user_version", [], |row| row.get(0))
        .map_err(failed)?;
    if version == SCHEMA_VERSION {
        return Ok(connection);
    }
    // An unnamed temporary file, which is deleted with its connection.
    let mut copy = Connection::open("").map_err(failed)?;
    let copied = Backup::new(&connection, &mut copy)
        .and_then(|backup| backup.run_to_completion(PAGES_AT_A_TIME, Duration::ZERO, None));
    copied.map_err(failed)?;
    migrate::migrate_copy(&mut copy, &path)?;
    copy.execute_batch("PRAGMA query_only = ON; BEGIN").map_err(failed)?;
    Ok(copy)
}

/// The number of runs that a merge copies from the store at `path`.
///
/// **Errors**: as [`open`].
pub(super) fn count(path: &Path) -> Result<usize, StoreError> {
    let (connection, _) = open_as_it_is(path)?;
    let count = "SELECT count(*) FROM run WHERE status IN ('completed', 'failed')";
    // An error here occurs again when the runs are read.
    Ok(connection.query_row(count, [], |row| row.get(0)).unwrap_or(0))
}

/// A connection to the store with its own schema, in a transaction, and the name of its file.
fn open_as_it_is(path: &Path) -> Result<(Connection, PathBuf), StoreError> {
    let opened = file::open_reader(path);
    let (connection, path) = opened.map_err(|error| in_words_of_a_merge(path, error))?;
    connection
        .execute_batch("BEGIN")
        .map_err(|source| StoreError::sqlite(&path, "read the store", source))?;
    schema::require(&connection, &path)?;
    Ok((connection, path))
}

/// Converts an error of opening a store at `source` to one without advice about the target.
fn in_words_of_a_merge(source: &Path, error: StoreError) -> StoreError {
    let not_mergeable =
        |path, reason: &str| StoreError::NotMergeable { path, reason: reason.to_owned() };
    match error {
        StoreError::Missing { path } | StoreError::MissingFolder { path, .. } => {
            let reason = match source.is_symlink() {
                true => format!("it is a link to `{}`, which does not exist", path.display()),
                false => "it does not exist".to_owned(),
            };
            StoreError::NotMergeable { path: source.to_owned(), reason }
        }
        StoreError::Empty { path } => not_mergeable(path, "it is an empty file"),
        StoreError::NotAStore { path, what } => not_mergeable(path, &format!("it is {what}")),
        StoreError::Foreign { path } => {
            not_mergeable(path, "it is a SQLite file of another program")
        }
        other => other,
    }
}
