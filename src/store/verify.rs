//! Verification of stored jobs and runs: keys, digests, weights.

use rusqlite::{Connection, OptionalExtension};

use crate::job::{Job, JobError, JobKey, Versions};
use crate::key::CanonicalError;

use super::digest::DigestForm;
use super::{digest, family};

/// Checks the weights of a completed run of a job, because the store cannot interpret them. Returns an error
/// if the weights do not fit the job, or are missing.
pub type CheckWeights<'a> = &'a dyn Fn(&Job, Option<&[u8]>) -> Result<(), String>;

/// The fault in the results of a completed run, if there is one.
pub(super) fn run_fault(
    connection: &Connection,
    run: i64,
    check_weights: CheckWeights<'_>,
) -> Option<String> {
    fault_of(connection, run, check_weights)
        .unwrap_or_else(|error| Some(format!("its results: {error}")))
}

/// The fault in the stored failure of a failed run, if there is one.
pub(super) fn failure_fault(connection: &Connection, run: i64) -> Option<String> {
    let is_as_stored = || -> rusqlite::Result<bool> {
        let (kind, message, episode, stored): (String, String, i64, Option<[u8; 32]>) = connection
            .prepare_cached(
                "SELECT failure_kind, failure_message, failure_episode, results_sha256
                 FROM run WHERE id = ?1",
            )?
            .query_row([run], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?)))?;
        Ok(stored == Some(digest::of_failure(connection, run, (&kind, &message, episode))?))
    };
    match is_as_stored() {
        Ok(true) => None,
        Ok(false) => Some("its failure does not match its digest".to_owned()),
        Err(error) => Some(format!("its failure: {error}")),
    }
}

fn fault_of(
    connection: &Connection,
    run: i64,
    check_weights: CheckWeights<'_>,
) -> rusqlite::Result<Option<String>> {
    let (job, stored, has_instants): (i64, Option<[u8; 32]>, bool) = connection
        .prepare_cached(
            "SELECT job, results_sha256,
                strftime('%Y-%m-%dT%H:%M:%fZ', started_at) IS started_at
                AND strftime('%Y-%m-%dT%H:%M:%fZ', ended_at) IS ended_at
             FROM run WHERE id = ?1",
        )?
        .query_row([run], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)))?;
    if !has_instants {
        return Ok(Some("invalid `started_at` or `ended_at`".to_owned()));
    }
    if digest::form_of(connection, run, stored)?.is_none() {
        return Ok(Some("its results do not match their digest".to_owned()));
    }
    if let (_, Some(fault)) = job_fault(connection, job)? {
        return Ok(Some(fault));
    }
    weights_fault(connection, run, check_weights)
}

/// Whether the digest of a completed run does not cover its recorded steps.
pub(super) fn leaves_out_steps(connection: &Connection, run: i64) -> rusqlite::Result<bool> {
    if !digest::may_leave_out_steps(connection, run)? {
        return Ok(false);
    }
    let stored = "SELECT results_sha256 FROM run WHERE id = ?1";
    let stored = connection.prepare_cached(stored)?.query_row([run], |row| row.get(0))?;
    Ok(digest::form_of(connection, run, stored)? == Some(DigestForm::WithoutSteps))
}

/// The fault in the weights of a completed run, if there is one.
pub(super) fn weights_fault(
    connection: &Connection,
    run: i64,
    check_weights: CheckWeights<'_>,
) -> rusqlite::Result<Option<String>> {
    let (canonical, weights): (String, Option<Vec<u8>>) = connection
        .prepare_cached(
            "SELECT canonical, safetensors FROM run JOIN job ON job.id = run.job
             LEFT JOIN trained_weights ON trained_weights.run = run.id
             WHERE run.id = ?1",
        )?
        .query_row([run], |row| Ok((row.get(0)?, row.get(1)?)))?;
    // This release may not be able to read the jobs of another release.
    let Ok(job) = Job::from_canonical(&canonical) else { return Ok(None) };
    let job = family::described(connection, run, job)?;
    let checked = check_weights(&job, weights.as_deref());
    Ok(checked.err().map(|reason| format!("its weights do not load: {reason}")))
}

/// The key of a job, and the fault in its row, if there is one.
pub(super) fn job_fault(
    connection: &Connection,
    job: i64,
) -> rusqlite::Result<(String, Option<String>)> {
    let (key, environment, algorithm, canonical): (String, u32, u32, String) = connection
        .prepare_cached(
            "SELECT key, environment_version, algorithm_version, canonical FROM job NOT INDEXED
             WHERE id = ?1",
        )?
        .query_row([job], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?)))?;
    let JobKey(hash) = Versions { environment, algorithm }.key_of(&canonical);
    let rewritten =
        serde_json::from_str::<serde_json::Value>(&canonical).map(|value| value.to_string());
    let fault = match rewritten {
        Err(error) => Some(format!("its parameters are not JSON: {error}")),
        Ok(rewritten) if rewritten != canonical => {
            Some("its parameters are not in canonical form".into())
        }
        Ok(_) if JobKey(hash).to_string() != key => {
            Some("its key does not match its parameters".to_owned())
        }
        Ok(_) => match Job::from_canonical(&canonical) {
            Err(
                error @ (JobError::Spelling(_)
                | JobError::Keys { error: CanonicalError::Redundant(_), .. }),
            ) => Some(format!("its parameters are not in canonical form: {error}")),
            // This release may not be able to read the jobs of another release.
            Ok(_) | Err(_) => None,
        },
    };
    Ok((key, fault))
}

/// The ids of a table's readable rows in order, and whether all rows are readable.
///
/// An unreadable page ends a scan. Rows after it are found by a scan from the other end, and rows between two
/// unreadable pages by lookups of single ids.
pub(super) fn row_ids(connection: &Connection, table: &str) -> (Vec<i64>, bool) {
    let (mut ids, end) = scan(connection, table, "ASC");
    if end.is_ok() {
        return (ids, true);
    }
    let (mut behind, _) = scan(connection, table, "DESC");
    behind.reverse();
    let (first, last) = (ids.last().map_or(1, |id| id + 1), behind.first().copied());
    let one = format!("SELECT id FROM {table} NOT INDEXED WHERE id = ?1");
    if let (Some(last), Ok(mut one)) = (last, connection.prepare(&one)) {
        let mut missed = 0;
        for id in first..last {
            match one.query_row([id], |row| row.get(0)).optional() {
                Ok(Some(id)) => {
                    ids.push(id);
                    missed = 0;
                }
                _ => missed += 1,
            }
            if missed > MOST_MISSED {
                break;
            }
        }
    }
    ids.extend(behind.into_iter().filter(|id| *id >= first));
    (ids, false)
}

/// The number of consecutive missing ids after which the search ends, because a damaged id can be any number.
/// It exceeds the number of rows in a subtree of a table's B-tree; the search takes 0.1 s.
const MOST_MISSED: usize = 100_000;

/// The ids of a table's rows, up to the first unreadable row.
fn scan(connection: &Connection, table: &str, order: &str) -> (Vec<i64>, rusqlite::Result<()>) {
    let mut ids = Vec::new();
    let sql = format!("SELECT id FROM {table} NOT INDEXED ORDER BY id {order}");
    let end = connection.prepare(&sql).and_then(|mut statement| {
        let mut rows = statement.query([])?;
        while let Some(row) = rows.next()? {
            ids.push(row.get(0)?);
        }
        Ok(())
    });
    (ids, end)
}
