//! Crashes: processes that ended through their own fault, and the jobs they were running.
//!
//! The jobs of a process that was killed (by a person, a batch system, or the kernel when memory is short)
//! run again, however often that happens. A process that aborts (a failed allocation, a stack overflow, a
//! panic within a panic) may have crashed because of one of its jobs, which would crash every later process,
//! too. Such a process leaves a mark, and all its jobs become suspects. From then on, a suspect runs in
//! isolation, so that the next crash has only one suspect. After three crashes, the last of them in
//! isolation, the job has failed.

use std::fs;
use std::path::{Path, PathBuf};

use rusqlite::Connection;

use crate::record::{Failure, FailureKind};

use super::beside::beside;

/// The number of crashes after which a job has failed, if the last crash happened in isolation.
const MOST_CRASHES: u32 = 3;

/// Separates the store's name from the session's number in the name of a mark.
const MARK: &str = "-session-";

/// Whether a dead process crashed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Crashed {
    /// The process ended through its own fault.
    Yes,
    /// The process was killed, or the reason is unknown.
    No,
}

/// The file that a session marks when it crashes.
pub(super) fn mark(store: &Path, session: i64) -> PathBuf {
    beside(store, &format!("{MARK}{session}"))
}

/// The sessions that have a mark file.
pub(super) fn marked(store: &Path) -> Vec<i64> {
    let (Some(folder), Some(name)) = (store.parent(), mark_name(store)) else { return Vec::new() };
    // If the folder cannot be listed, its marks stay as they are.
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let number =
        |entry: fs::DirEntry| entry.file_name().to_str()?.strip_prefix(&name)?.parse().ok();
    entries.filter_map(number).collect()
}

/// The prefix of the names of a store's marks; `None` if the store's name is not valid text.
fn mark_name(store: &Path) -> Option<String> {
    Some(format!("{}{MARK}", store.file_name()?.to_str()?))
}

/// Removes the mark of a session, if there is one.
pub(super) fn unmark(store: &Path, session: i64) {
    // If the removal fails, the next process that looks for marks tries again.
    let _ = fs::remove_file(mark(store, session));
}

/// Returns whether a dead session left a mark, and removes the mark. If the caller's transaction is not
/// committed, this crash is not counted.
pub(super) fn take(connection: &Connection, session: i64) -> Crashed {
    let Some(store) = connection.path() else { return Crashed::No };
    let store = Path::new(store);
    let crashed = match fs::metadata(mark(store, session)) {
        Ok(metadata) if metadata.len() > 0 => Crashed::Yes,
        Ok(_) | Err(_) => Crashed::No,
    };
    unmark(store, session);
    crashed
}

/// The crash record of a job.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Record {
    /// No process crashed while it ran the job.
    Clean,
    /// A process crashed, possibly because of this job.
    Suspect,
    /// Processes crashed too often, the last one while it ran the job in isolation.
    Guilty(Failure),
}

/// The crash record of a job since its last failure.
pub(super) fn record(connection: &Connection, job: i64) -> rusqlite::Result<Record> {
    let (crashes, last): (u32, Option<u32>) = connection
        .prepare_cached(
            "SELECT count(suspects), (SELECT suspects FROM run WHERE job = ?1
                AND suspects IS NOT NULL ORDER BY attempt DESC LIMIT 1)
             FROM run WHERE job = ?1 AND attempt > (SELECT coalesce(max(attempt), 0) FROM run
                WHERE job = ?1 AND status = 'failed')",
        )?
        .query_row([job], |row| Ok((row.get(0)?, row.get(1)?)))?;
    Ok(match (crashes, last) {
        (0, _) => Record::Clean,
        (MOST_CRASHES.., Some(1)) => Record::Guilty(Failure {
            kind: FailureKind::Crashed,
            message: format!(
                "the process crashed in {crashes} attempts at this job, in the last one without \
                 other jobs; see the output of that `jitai run` for the cause"
            ),
            episode: 0,
        }),
        _ => Record::Suspect,
    })
}
