//! Trained weights, found by a prefix of a job key.

use rusqlite::Connection;

use crate::job::{Job, JobKey};

use super::error::{StoreError, StoreFault};
use super::family;
use super::read::Reader;

/// The weights of a completed run, with the job for which they were trained.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredWeights {
    /// The identity of the job.
    pub job_key: JobKey,
    /// The job.
    pub job: Job,
    /// The weights, in the safetensors format; `None` if the run has none.
    pub safetensors: Option<Vec<u8>>,
}

/// The number of keys in an error about an ambiguous prefix.
const KEYS_SHOWN: usize = 3;

impl Reader {
    /// The weights of the only completed job whose key begins with `prefix`.
    ///
    /// **Errors**: `prefix` is not a prefix of a key, no completed job has it, or several have it.
    pub fn weights(&self, prefix: &str) -> Result<StoredWeights, StoreError> {
        let digits = prefix.to_ascii_lowercase();
        let is_key = digits.bytes().all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f'));
        if digits.is_empty() || digits.len() > 32 || !is_key {
            return Err(StoreError::NotAKey { text: prefix.to_owned() });
        }
        self.read("read trained weights", |connection| {
            match completed_jobs(connection, &digits)?.as_slice() {
                [] => Err(not_completed(connection, &digits)?.into()),
                [(job, key)] => load(connection, *job, key),
                several => Err(StoreError::AmbiguousKey {
                    prefix: digits,
                    keys: several.iter().take(KEYS_SHOWN).map(|(_, key)| key.clone()).collect(),
                }
                .into()),
            }
        })
    }
}

/// The first jobs with a completed run whose keys begin with `digits`: row ids and keys.
fn completed_jobs(connection: &Connection, digits: &str) -> rusqlite::Result<Vec<(i64, String)>> {
    // `g` follows every hexadecimal digit.
    let mut statement = connection.prepare_cached(
        "SELECT id, key FROM job WHERE key >= ?1 AND key < ?1 || 'g'
            AND EXISTS (SELECT 1 FROM run WHERE run.job = job.id AND run.status = 'completed')
         ORDER BY key LIMIT ?2",
    )?;
    let rows = statement.query_map((digits, KEYS_SHOWN), |row| Ok((row.get(0)?, row.get(1)?)))?;
    rows.collect()
}

fn not_completed(connection: &Connection, digits: &str) -> rusqlite::Result<StoreError> {
    let key = connection
        .prepare_cached("SELECT min(key) FROM job WHERE key >= ?1 AND key < ?1 || 'g'")?
        .query_row([digits], |row| row.get::<_, Option<String>>(0))?;
    Ok(match key {
        Some(key) => StoreError::NotCompleted { key },
        None => StoreError::NoSuchJob { prefix: digits.to_owned() },
    })
}

fn load(connection: &Connection, job: i64, key: &str) -> Result<StoredWeights, StoreFault> {
    let (job_key, canonical, safetensors, run) = connection
        .prepare_cached(
            "SELECT unhex(job.key), job.canonical, trained_weights.safetensors, run.id
             FROM job
             JOIN run ON run.job = job.id AND run.status = 'completed'
             LEFT JOIN trained_weights ON trained_weights.run = run.id
             WHERE job.id = ?1",
        )?
        .query_row([job], |row| {
            Ok((row.get(0)?, row.get::<_, String>(1)?, row.get(2)?, row.get(3)?))
        })?;
    let job = Job::from_canonical(&canonical).map_err(|error| StoreError::UnreadableJob {
        key: key.to_owned(),
        reason: error.to_string(),
    })?;
    let job = family::described(connection, run, job)?;
    Ok(StoredWeights { job_key: JobKey(job_key), job, safetensors })
}
