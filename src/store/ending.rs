//! Ending the row of a run, with the digest of its results or failure.

use rusqlite::{Connection, params};

use crate::job::Failure;

use super::digest;
use super::transaction::NOW;

/// Completes a run whose results are in the file, and stores their digest.
pub(super) fn complete_run(
    connection: &Connection,
    run: i64,
    wall_seconds: f64,
) -> rusqlite::Result<()> {
    let results = digest::of_run(connection, run)?;
    connection
        .prepare_cached(&format!(
            "UPDATE run SET status = 'completed', ended_at = {NOW}, wall_seconds = ?2,
                results_sha256 = ?3
             WHERE id = ?1"
        ))?
        .execute(params![run, wall_seconds, results])?;
    Ok(())
}

/// Ends a run without results.
pub(super) fn end_run(
    connection: &Connection,
    run: i64,
    status: &str,
    failure: Option<&Failure>,
    wall_seconds: f64,
) -> rusqlite::Result<()> {
    let of_failure = |failure: &Failure| {
        let Failure { kind, message, episode } = failure;
        digest::of_failure(connection, run, (kind.word(), message, i64::from(*episode)))
    };
    let digest = failure.map(of_failure).transpose()?;
    connection
        .prepare_cached(&format!(
            "UPDATE run SET status = ?2, ended_at = {NOW}, wall_seconds = ?3,
                failure_kind = ?4, failure_message = ?5, failure_episode = ?6,
                results_sha256 = ?7
             WHERE id = ?1"
        ))?
        .execute(params![
            run,
            status,
            wall_seconds,
            failure.map(|failure| failure.kind.word()),
            failure.map(|failure| &failure.message),
            failure.map(|failure| failure.episode),
            digest,
        ])?;
    Ok(())
}
