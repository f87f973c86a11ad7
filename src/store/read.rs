//! Reading: what has become of jobs and experiments.

use std::path::{Path, PathBuf};

use rusqlite::{Connection, OptionalExtension};

use crate::plan::{ContentKey, JobKey, Versions};
use crate::record::{Failure, FailureKind};

use super::error::Fault;
use super::liveness::ProcessTable;
use super::session;
use super::state::{Counts, JobState, state_sql};
use super::{StoreError, file, query};

/// The store, open for reading. It never writes and never waits for a writer; every call sees the
/// store as it was last committed.
#[derive(Debug)]
pub struct Reader {
    pub(super) connection: Connection,
    path: PathBuf,
}

/// How many jobs of an experiment are in each state.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ExperimentCounts {
    /// The experiment's name.
    pub experiment: String,
    /// Its jobs, each counted once.
    pub counts: Counts,
}

/// A job that was tried, with what became of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TriedJob {
    /// The job.
    pub key: JobKey,
    /// Its content.
    pub content: ContentKey,
    /// The versions of the code that it is a job of.
    pub versions: Versions,
    /// What became of it.
    pub state: JobState,
}

/// A job of an experiment that failed, with its last failure.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FailedJob {
    /// The experiment's name.
    pub experiment: String,
    /// The job.
    pub job_key: JobKey,
    /// Its agent's name in the experiment.
    pub agent: String,
    /// The attempt that failed, from 1.
    pub attempt: u32,
    /// How it failed.
    pub failure: Failure,
    /// When, in UTC, ISO 8601 with milliseconds.
    pub ended_at: String,
}

/// How long the jobs of an algorithm took, over its latest completed runs.
#[derive(Clone, Debug, PartialEq)]
pub struct Pace {
    /// The algorithm, as the manifest writes it.
    pub algorithm: String,
    /// Runs that this was measured on; at least 1.
    pub runs: u64,
    /// Mean time of a job, in seconds.
    pub seconds_per_job: f64,
    /// Mean time of a training episode with its share of the test, in seconds.
    pub seconds_per_episode: f64,
}

impl Reader {
    /// The store at `path`, for reading.
    ///
    /// **Errors**: there is none, or the file is something else, of an older or of a newer release.
    pub fn open(path: &Path) -> Result<Reader, StoreError> {
        let (mut connection, path) = file::open_reader(path)?;
        query::allow_reading_only(&mut connection)
            .map_err(|source| StoreError::sqlite(&path, "open the store", source))?;
        Ok(Reader { connection, path })
    }

    /// The state of each job, in the order of `keys`; those unknown to the store are pending.
    pub fn job_states<'k>(
        &self,
        keys: impl IntoIterator<Item = &'k JobKey>,
    ) -> Result<Vec<JobState>, StoreError> {
        self.read("read the states of jobs", |connection| {
            let alive = alive(connection)?;
            let state = state_sql("job.id", "?2");
            let mut statement =
                connection.prepare_cached(&format!("SELECT {state} FROM job WHERE key = ?1"))?;
            keys.into_iter()
                .map(|key| {
                    let state = statement
                        .query_row((key.to_string(), &alive), |row| row.get(0))
                        .optional()?;
                    Ok(state.unwrap_or(JobState::Pending))
                })
                .collect()
        })
    }

    /// Shows `see` every job that was ever tried; the others are pending.
    pub fn tried(&self, mut see: impl FnMut(TriedJob)) -> Result<(), StoreError> {
        self.read("read the states of jobs", |connection| {
            let state = state_sql("job.id", "?1");
            let mut statement = connection.prepare_cached(&format!(
                "SELECT unhex(key), unhex(content_key), environment_version, algorithm_version,
                    {state}
                 FROM (SELECT DISTINCT job FROM run) AS tried JOIN job ON job.id = tried.job"
            ))?;
            let mut rows = statement.query([alive(connection)?])?;
            while let Some(row) = rows.next()? {
                see(TriedJob {
                    key: JobKey(row.get(0)?),
                    content: ContentKey(row.get(1)?),
                    versions: Versions { environment: row.get(2)?, algorithm: row.get(3)? },
                    state: row.get(4)?,
                });
            }
            Ok(())
        })
    }

    /// The jobs of every experiment by state, in the order the experiments were first run.
    pub fn experiment_counts(&self) -> Result<Vec<ExperimentCounts>, StoreError> {
        self.read("count jobs", |connection| {
            let state = state_sql("held.job", "?1");
            let mut statement = connection.prepare_cached(&format!(
                "SELECT experiment.name, state, count(held) FROM experiment LEFT JOIN (
                    SELECT experiment, 1 AS held, {state} AS state
                    FROM (SELECT DISTINCT experiment, job FROM experiment_job) AS held
                 ) AS job ON job.experiment = experiment.id
                 GROUP BY experiment.id, state ORDER BY experiment.id"
            ))?;
            let mut rows = statement.query([alive(connection)?])?;
            let mut experiments: Vec<ExperimentCounts> = Vec::new();
            while let Some(row) = rows.next()? {
                let experiment: String = row.get(0)?;
                if experiments.last().is_none_or(|last| last.experiment != experiment) {
                    experiments.push(ExperimentCounts { experiment, counts: Counts::default() });
                }
                let last = experiments.last_mut().expect("one was pushed if there was none");
                last.counts.add(row.get(1)?, row.get(2)?);
            }
            Ok(experiments)
        })
    }

    /// The failed jobs of every experiment, in the order of the experiments and their manifests.
    pub fn failed_jobs(&self) -> Result<Vec<FailedJob>, StoreError> {
        self.read("read failures", |connection| {
            let state = state_sql("run.job", "?1");
            let mut statement = connection.prepare_cached(&format!(
                "SELECT experiment.name, unhex(job.key), experiment_job.agent, run.attempt,
                    run.failure_kind, run.failure_message, run.failure_episode, run.ended_at
                 FROM run
                 JOIN job ON job.id = run.job
                 JOIN experiment_job ON experiment_job.job = job.id
                 JOIN experiment ON experiment.id = experiment_job.experiment
                 WHERE run.status = 'failed' AND {state} = 2
                    AND NOT EXISTS (SELECT 1 FROM run AS later WHERE later.job = run.job
                        AND later.status = 'failed' AND later.attempt > run.attempt)
                 ORDER BY experiment.id, experiment_job.position"
            ))?;
            let rows = statement.query_map([alive(connection)?], failed_job)?;
            Ok(rows.collect::<rusqlite::Result<_>>()?)
        })
    }

    /// The versions of the code, other than `current`, under which this content was completed.
    pub fn superseded(
        &self,
        content: &ContentKey,
        current: Versions,
    ) -> Result<Vec<Versions>, StoreError> {
        self.read("look for earlier versions of a job", |connection| {
            let mut statement = connection.prepare_cached(
                "SELECT environment_version, algorithm_version FROM job
                 WHERE content_key = ?1 AND (environment_version, algorithm_version) <> (?2, ?3)
                    AND EXISTS (SELECT 1 FROM run
                        WHERE run.job = job.id AND run.status = 'completed')
                 ORDER BY environment_version, algorithm_version",
            )?;
            let parameters = (content.to_string(), current.environment, current.algorithm);
            let rows = statement.query_map(parameters, |row| {
                Ok(Versions { environment: row.get(0)?, algorithm: row.get(1)? })
            })?;
            Ok(rows.collect::<rusqlite::Result<_>>()?)
        })
    }

    /// How long jobs took, by algorithm, over the latest ten thousand completed runs.
    pub fn paces(&self) -> Result<Vec<Pace>, StoreError> {
        self.read("read the times of runs", |connection| {
            let mut statement = connection.prepare_cached(
                "SELECT json_extract(job.canonical, '$.agent.algorithm') AS algorithm, count(*),
                    avg(wall_seconds),
                    sum(wall_seconds) / sum(json_extract(job.canonical, '$.agent.episodes'))
                 FROM (SELECT job, wall_seconds FROM run
                    WHERE status = 'completed' ORDER BY id DESC LIMIT 10000)
                 JOIN job ON job.id = job
                 GROUP BY algorithm ORDER BY algorithm",
            )?;
            let rows = statement.query_map([], |row| {
                Ok(Pace {
                    algorithm: row.get(0)?,
                    runs: row.get(1)?,
                    seconds_per_job: row.get(2)?,
                    seconds_per_episode: row.get(3)?,
                })
            })?;
            Ok(rows.collect::<rusqlite::Result<_>>()?)
        })
    }

    /// Does `body`; `action` completes "failed to …" in errors.
    pub(super) fn read<T>(
        &self,
        action: &'static str,
        body: impl FnOnce(&Connection) -> Result<T, Fault>,
    ) -> Result<T, StoreError> {
        body(&self.connection).map_err(|fault| fault.at(&self.path, action))
    }
}

/// The living sessions that hold runs, as a JSON list.
pub(super) fn alive(connection: &Connection) -> rusqlite::Result<String> {
    let this = ProcessTable::of_this_system().this_process();
    session::holders(connection, &this).map(|holders| holders.alive_json())
}

fn failed_job(row: &rusqlite::Row<'_>) -> rusqlite::Result<FailedJob> {
    let kind: String = row.get(4)?;
    let kind = FailureKind::from_name(&kind)
        .ok_or_else(|| rusqlite::Error::InvalidColumnName(format!("failure kind {kind}")))?;
    Ok(FailedJob {
        experiment: row.get(0)?,
        job_key: JobKey(row.get(1)?),
        agent: row.get(2)?,
        attempt: row.get(3)?,
        failure: Failure { kind, message: row.get(5)?, episode: row.get(6)? },
        ended_at: row.get(7)?,
    })
}
