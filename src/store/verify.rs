//! Whether jobs and runs are as they were stored: keys, digests, weights.

use rusqlite::{Connection, OptionalExtension};

use crate::key::CanonicalError;
use crate::plan::{Job, JobError, JobKey, Versions};

use super::digest;

/// Says what is wrong with the weights of a completed run of a job, if anything is: they make no
/// policy for the job, or its algorithm has weights and the run has none. The store knows neither.
pub type CheckWeights<'a> = &'a dyn Fn(&Job, Option<&[u8]>) -> Result<(), String>;

/// What is wrong with the results of a completed run, if anything is.
pub(super) fn run_fault(
    connection: &Connection,
    run: i64,
    check_weights: CheckWeights<'_>,
) -> Option<String> {
    fault_of(connection, run, check_weights)
        .unwrap_or_else(|error| Some(format!("its results: {error}")))
}

/// What is wrong with the stored failure of a failed run, if anything is.
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
        Ok(false) => Some("its failure is not the one that was stored".to_owned()),
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
    if stored != Some(digest::of_run(connection, run)?) {
        return Ok(Some("its results are not those that were stored".to_owned()));
    }
    if let (_, Some(fault)) = job_fault(connection, job)? {
        return Ok(Some(fault));
    }
    weights_fault(connection, run, check_weights)
}

/// What is wrong with the weights of a completed run, if anything is.
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
    // The jobs of another release may mean nothing to this one.
    let Ok(job) = Job::from_canonical(&canonical) else { return Ok(None) };
    let checked = check_weights(&job, weights.as_deref());
    Ok(checked.err().map(|reason| format!("its weights do not load: {reason}")))
}

/// The key of a job, and what is wrong with its row, if anything is.
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
            Some("its parameters are not written in the one way that a key is taken from".into())
        }
        Ok(_) if JobKey(hash).to_string() != key => {
            Some("its key is not that of its parameters".to_owned())
        }
        Ok(_) => match Job::from_canonical(&canonical) {
            Err(
                error @ (JobError::Spelling(_)
                | JobError::Keys { error: CanonicalError::Redundant(_), .. }),
            ) => Some(format!("its parameters have another spelling: {error}")),
            // The jobs of another release may mean nothing to this one.
            Ok(_) | Err(_) => None,
        },
    };
    Ok((key, fault))
}

/// The ids of the rows of a table that can be read, in their order, and whether these are all.
///
/// A page that cannot be read ends a scan; what lies behind it is found from the other end, and
/// what lies between two such pages one by one.
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

/// Missing ids in a row after which the search ends. It is more than a branch of a table's tree holds,
/// and takes a tenth of a second; a damaged id can be any number.
const MOST_MISSED: usize = 100_000;

/// The ids of a table's rows, up to the first that cannot be read, if there is one.
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
