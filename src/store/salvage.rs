//! Copies the intact data of a damaged store to a new store.
//!
//! In: the paths of the damaged and the new store, and a check of weights. Out: a store that passes
//! [`super::examine`], with all data that `copy` could read and verify; and the counts in [`Salvaged`]. The
//! damaged file is only read; a lost header or schema is replaced in a copy.

use std::fs;
use std::path::{Path, PathBuf};

use rusqlite::Connection;

use super::copy::{Copied, Ended, RunCopy, copy};
use super::error::StoreError;
use super::file;
use super::migrate;
use super::place::{beside, resolve};
use super::verify::CheckWeights;
use super::writer::Store;

/// The counts of a salvage.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Salvaged {
    /// The number of experiments.
    pub experiments: usize,
    /// The number of jobs.
    pub jobs: usize,
    /// The number of completed runs, each with all its results.
    pub completed: usize,
    /// The number of completed runs that did not verify. Their jobs run again.
    pub lost: usize,
    /// Whether part of the list of runs is unreadable, so that more runs may be lost.
    pub lost_more: bool,
    /// The number of failed and interrupted runs.
    pub others: usize,
}

/// Copies the readable data of the store at `damaged` to a new store at `new`.
///
/// **Errors**: `new` already exists or cannot be created; `damaged` is not a store, or is of another release.
/// In these cases, nothing remains at `new`.
pub fn salvage(
    damaged: &Path,
    new: &Path,
    check_weights: CheckWeights<'_>,
) -> Result<Salvaged, StoreError> {
    if new.symlink_metadata().is_ok() {
        return Err(StoreError::InTheWay { path: new.to_owned() });
    }
    // The new store gets its name only when it is complete. A killed salvage leaves its partial store.
    let (damaged, partial) = (&resolve(damaged)?, beside(new, ".partial"));
    remove(&partial);
    let salvaged = write_new(damaged, &partial, check_weights).and_then(|salvaged| {
        let renamed = fs::rename(&partial, new).map_err(|error| StoreError::CannotOpen {
            path: new.to_owned(),
            reason: error.to_string(),
        });
        renamed.map(|()| salvaged)
    });
    if salvaged.is_err() {
        remove(&partial);
    }
    salvaged
}

fn write_new(
    damaged: &Path,
    new: &Path,
    check_weights: CheckWeights<'_>,
) -> Result<Salvaged, StoreError> {
    // Opens and closes the store once, so that all data is in its one file.
    drop(Store::open(new)?);
    let mut store = Store::open(new)?;
    let source = Source::open(damaged, &store)?;
    let mut salvaged = Salvaged::default();
    let copied = copy(&source.connection, &mut store, check_weights, |run, became| {
        let count = match (run.ended, became) {
            (Ended::Completed, RunCopy::Copied) => &mut salvaged.completed,
            // The new store was empty, so it can only have another run of the job if the damaged store has
            // two.
            (Ended::Completed, _) => &mut salvaged.lost,
            (Ended::Failed | Ended::Interrupted, RunCopy::Copied) => &mut salvaged.others,
            (Ended::Failed | Ended::Interrupted, _) => return,
        };
        *count += 1;
    })?;
    // After its schema was replaced, any file looks like a store.
    if source.repaired.is_some() && copied.jobs == 0 {
        return Err(StoreError::NothingToSave { path: damaged.to_owned() });
    }
    let Copied { experiments, jobs, runs_unreadable, .. } = copied;
    Ok(Salvaged { experiments, jobs, lost_more: runs_unreadable, ..salvaged })
}

/// Removes a store and its additional files. Failures are ignored.
fn remove(path: &Path) {
    for ending in ["", "-wal", "-shm"] {
        let _ = fs::remove_file(beside(path, ending));
    }
}

/// The damaged store, as far as it can be opened.
struct Source {
    connection: Connection,
    /// A repaired copy that is read instead.
    repaired: Option<PathBuf>,
}

impl Drop for Source {
    fn drop(&mut self) {
        if let Some(path) = &self.repaired {
            remove(path);
        }
    }
}

impl Source {
    /// Opens the file itself, or a copy with the header and schema of a new store if its own are damaged.
    fn open(damaged: &Path, new: &Store) -> Result<Source, StoreError> {
        match file::open_damaged(damaged) {
            Ok(connection) => return Ok(Source { connection, repaired: None }),
            // The header or schema is damaged; other errors are returned.
            Err(StoreError::Damaged { .. }) => {}
            Err(error) => return Err(error),
        }
        let path = beside(&new.path, ".salvaging");
        let cannot = |error: std::io::Error| StoreError::CannotOpen {
            path: damaged.to_owned(),
            reason: error.to_string(),
        };
        let mut bytes = fs::read(damaged).map_err(cannot)?;
        let (template, pages) = first_schema(&beside(&new.path, ".template"))?;
        put_schema(&mut bytes, &template, &pages);
        let log = beside(damaged, "-wal");
        if log.exists() {
            fs::copy(log, beside(&path, "-wal")).map_err(cannot)?;
        }
        fs::write(&path, bytes).map_err(cannot)?;
        let opened = file::open_damaged(&path);
        let repaired = Some(path);
        match opened {
            Ok(connection) => Ok(Source { connection, repaired }),
            Err(_) => {
                remove(&beside(&new.path, ".salvaging"));
                Err(StoreError::NothingToSave { path: damaged.to_owned() })
            }
        }
    }
}

/// The bytes of an empty store with the first schema, and the pages that hold it. The first migration puts
/// the tables on the same pages in every store. The pages used by later migrations depend on the contents of
/// the store at the time.
fn first_schema(path: &Path) -> Result<(Vec<u8>, Vec<usize>), StoreError> {
    let failed = |source| StoreError::sqlite(path, "create an empty store", source);
    let mut connection = Connection::open(path).map_err(failed)?;
    // Every store has this mode in its header.
    connection.pragma_update(None, "journal_mode", "WAL").map_err(failed)?;
    migrate::migrate(&mut connection, path, &migrate::MIGRATIONS[..1])?;
    let pages = schema_pages(&connection).map_err(failed)?;
    drop(connection);
    let bytes = fs::read(path).map_err(|error| StoreError::CannotOpen {
        path: path.to_owned(),
        reason: error.to_string(),
    });
    remove(path);
    Ok((bytes?, pages))
}

/// The pages that hold the schema, from 1.
fn schema_pages(connection: &Connection) -> rusqlite::Result<Vec<usize>> {
    let mut statement =
        connection.prepare("SELECT pageno FROM dbstat WHERE name = 'sqlite_schema'")?;
    let pages = statement.query_map([], |row| row.get::<_, u32>(0).map(|page| page as usize))?;
    pages.collect()
}

/// Replaces the header and schema in the bytes of a store by the header and schema of an empty
/// store. If the tables of a file are on other pages, no run verifies.
fn put_schema(damaged: &mut [u8], template: &[u8], pages: &[usize]) {
    let size = match u16::from_be_bytes([template[16], template[17]]) {
        1 => 65_536,
        size => usize::from(size),
    };
    for page in pages {
        let range = (page - 1) * size..page * size;
        if let (Some(to), Some(from)) = (damaged.get_mut(range.clone()), template.get(range)) {
            to.copy_from_slice(from);
        }
    }
    // The header gets the actual number of pages and an empty list of free pages.
    let count = u32::try_from(damaged.len() / size).unwrap_or(u32::MAX);
    if let Some(header) = damaged.get_mut(28..40) {
        header[..4].copy_from_slice(&count.to_be_bytes());
        header[4..].fill(0);
    }
}
