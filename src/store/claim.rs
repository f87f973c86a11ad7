//! Claims: the right of a session to run a job and to store its outcome.

use std::collections::BTreeMap;

use rusqlite::{Connection, OptionalExtension};

use crate::job::JobKey;
use crate::key::printable;

use super::crash::{self, Record};
use super::ending;
use super::error::{StoreError, StoreFault};
use super::read::Reader;
use super::session::{self, SessionId};
use super::state::{JobState, state_sql};
use super::transaction::NOW;
use super::writer::Store;

/// The right to run a job, with the run that was started for it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Claim {
    pub(super) run: i64,
    pub(super) session: SessionId,
    /// The job.
    pub job_key: JobKey,
    /// The number of the attempt at the job, from 1.
    pub attempt: u32,
    /// The number of attempts just before this one whose processes were killed, back to the latest that wrote a
    /// checkpoint.
    pub deaths: u32,
}

/// The answer to a claim.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Claimed {
    /// The caller may run the job.
    Claimed(Claim),
    /// The job has a completed run.
    Completed,
    /// A living session is running the job.
    HeldElsewhere,
    /// The job failed, and failed jobs are not retried.
    Failed,
    /// A process died, possibly because of the job, so it can only be claimed in isolation.
    Suspect,
}

/// Whether the claiming process runs other jobs at the same time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Isolation {
    /// The process may run other jobs at the same time.
    Shared,
    /// The process runs no other job until this job has ended.
    Alone,
}

/// Whether failed jobs may be claimed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RetryFailed {
    /// Failed jobs are not claimed.
    No,
    /// A failed job may be claimed until it fails in the claiming session.
    Yes,
}

impl Store {
    /// Claims a job for a session, unless it is completed, running in a living session, or failed.
    ///
    /// A job of a dead session is taken over. A suspect runs only in isolation, and is recorded as
    /// failed after too many deaths.
    ///
    /// **Errors**: the job is not registered.
    pub fn claim(
        &mut self,
        session: SessionId,
        key: &JobKey,
        retry: RetryFailed,
        isolation: Isolation,
    ) -> Result<Claimed, StoreError> {
        self.write("claim a job", |transaction| {
            let job = transaction
                .prepare_cached("SELECT id FROM job WHERE key = ?1")?
                .query_row([key.to_string()], |row| row.get(0))
                .optional()?
                .ok_or(StoreError::UnknownJob { key: *key })?;
            match state(transaction, session, job)? {
                JobState::Completed => Ok(Claimed::Completed),
                JobState::Running => Ok(Claimed::HeldElsewhere),
                JobState::Failed if !may_retry(transaction, session, job, retry)? => {
                    Ok(Claimed::Failed)
                }
                JobState::Failed | JobState::Interrupted | JobState::Pending => {
                    match (crash::record(transaction, job)?, isolation) {
                        (Record::Clean, _) | (Record::Suspect, Isolation::Alone) => {
                            begin_run(transaction, session, job, key).map(Claimed::Claimed)
                        }
                        (Record::Suspect, Isolation::Shared) => Ok(Claimed::Suspect),
                        (Record::Guilty(failure), _) => {
                            let claim = begin_run(transaction, session, job, key)?;
                            ending::end_run(transaction, claim.run, "failed", Some(&failure), 0.0)?;
                            Ok(Claimed::Failed)
                        }
                    }
                }
            }
        })
    }
}

impl Store {
    /// Records the files of the outside programs that a claimed run starts, each with its SHA-256.
    pub fn record_programs(
        &mut self,
        claim: &Claim,
        files: &BTreeMap<String, String>,
    ) -> Result<(), StoreError> {
        let files = serde_json::json!(files).to_string();
        self.write("record the files of a program", |transaction| {
            transaction
                .prepare_cached(
                    "UPDATE run SET programs = ?3 WHERE id = ?1 AND session = ?2 AND status = 'running'",
                )?
                .execute((claim.run, claim.session.0, &files))?;
            Ok(())
        })
    }
}

impl Reader {
    /// The files of outside programs with which a completed job ran; empty if they are not known.
    pub fn programs(&self, key: &JobKey) -> Result<BTreeMap<String, String>, StoreError> {
        // Stores of earlier versions do not have the column.
        if !self.has_column("run", "programs")? {
            return Ok(BTreeMap::new());
        }
        self.read("read the files of a program", |connection| {
            let files: Option<Option<String>> = connection
                .prepare_cached(
                    "SELECT programs FROM job JOIN run ON run.job = job.id AND status = 'completed'
                     WHERE key = ?1",
                )?
                .query_row([key.to_string()], |row| row.get(0))
                .optional()?;
            let files = files.flatten().and_then(|files| serde_json::from_str(&files).ok());
            Ok(files.unwrap_or_default())
        })
    }

    /// A sentence for each file of an outside program of which the completed jobs of an experiment ran with several
    /// contents under one `version`.
    pub fn mixed_programs(&self, experiment: &str) -> Result<Vec<String>, StoreError> {
        if !self.has_column("run", "programs")? {
            return Ok(Vec::new());
        }
        self.read("read the files of programs", |connection| {
            let mut statement = connection.prepare_cached(
                "SELECT file.key, count(DISTINCT file.value) FROM experiment
                 JOIN experiment_job AS held ON held.experiment = experiment.id
                 JOIN job ON job.id = held.job
                 JOIN run ON run.job = job.id AND run.status = 'completed' AND run.programs IS NOT NULL
                 JOIN json_each(run.programs) AS file
                 WHERE experiment.name = ?1
                 GROUP BY file.key, json_extract(canonical, '$.agent.version', '$.environment.version')
                 HAVING count(DISTINCT file.value) > 1",
            )?;
            let said = |file: String, contents: u64| {
                format!(
                    "jobs with {contents} contents of {} stand side by side under the same `version`; raise it after \
                     a change, and run the manifest again with --replace",
                    printable(&file)
                )
            };
            let rows = statement.query_map([experiment], |row| Ok(said(row.get(0)?, row.get(1)?)))?;
            Ok(rows.collect::<rusqlite::Result<_>>()?)
        })
    }
}

/// The state of a job. First interrupts a run of the job that a dead session holds.
fn state(connection: &Connection, session: SessionId, job: i64) -> rusqlite::Result<JobState> {
    let holder: Option<i64> = connection
        .prepare_cached("SELECT session FROM run WHERE job = ?1 AND status = 'running'")?
        .query_row([job], |row| row.get(0))
        .optional()?;
    let mut alive = String::from("[]");
    if let Some(holder) = holder {
        let this = session::process_of(connection, session)?;
        let holders = session::holders(connection, &this)?;
        if holders.dead.contains(&holder) {
            session::release_dead(connection, holder)?;
        }
        alive = holders.alive_json();
    }
    connection
        .prepare_cached(&format!("SELECT {}", state_sql("?1", "?2")))?
        .query_row((job, alive), |row| row.get(0))
}

fn may_retry(
    connection: &Connection,
    session: SessionId,
    job: i64,
    retry: RetryFailed,
) -> rusqlite::Result<bool> {
    match retry {
        RetryFailed::No => Ok(false),
        RetryFailed::Yes => connection
            .prepare_cached(
                "SELECT NOT EXISTS (SELECT 1 FROM run
                    WHERE job = ?1 AND session = ?2 AND status = 'failed')",
            )?
            .query_row([job, session.0], |row| row.get(0)),
    }
}

fn begin_run(
    connection: &Connection,
    session: SessionId,
    job: i64,
    key: &JobKey,
) -> Result<Claim, StoreFault> {
    let deaths = crash::deaths(connection, job)?;
    let (run, attempt) = connection
        .prepare_cached(&format!(
            "INSERT INTO run (job, attempt, session, status, started_at)
             VALUES (?1, 1 + (SELECT coalesce(max(attempt), 0) FROM run WHERE job = ?1), ?2,
                'running', {NOW})
             RETURNING id, attempt"
        ))?
        .query_row([job, session.0], |row| Ok((row.get(0)?, row.get(1)?)))?;
    Ok(Claim { run, session, job_key: *key, attempt, deaths })
}
