//! Sealing: reduces a store to a single file, which can be copied and read where no additional files are
//! possible.

use std::path::Path;

use rusqlite::{Connection, OpenFlags};

use super::error::StoreError;
use super::place::{beside, resolve};

/// Moves the write-ahead log of a store that no process has open into its file, and switches the log off. The
/// file alone is then the store.
///
/// **Errors**: the store cannot be written, or another process has it open.
pub fn seal(path: &Path) -> Result<(), StoreError> {
    let path = &resolve(path)?;
    let error = |source| StoreError::sqlite(path, "seal the store", source);
    let connection =
        Connection::open_with_flags(path, OpenFlags::SQLITE_OPEN_READ_WRITE).map_err(error)?;
    let mode: String = connection
        .query_row("PRAGMA journal_mode = DELETE", [], |row| row.get(0))
        .map_err(error)?;
    drop(connection);
    if mode == "delete" && !beside(path, "-wal").exists() {
        return Ok(());
    }
    let reason = "another process has it open".to_owned();
    Err(StoreError::CannotOpen { path: path.to_owned(), reason })
}
