//! The reading connection: states, failures and times of jobs and experiments.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use rusqlite::{Connection, OptionalExtension};

use crate::job::{CanonicalForm, Job, JobKey, Versions, seed_of, without_seed};
use crate::job::{Failure, FailureKind};

use super::command::{self, Command};
use super::error::{StoreError, StoreFault};
use super::liveness::ProcessTable;
use super::migrate::{self, SCHEMA_VERSION};
use super::seed_group::SeedGroups;
use super::session::{self, Holders};
use super::state::{JobState, RunStates, state_sql};
use super::writer::Store;
use super::{file, sandbox, schema, view};

/// The store, open for reading. It never writes and never waits for a writer. Every call sees the latest
/// committed state.
#[derive(Debug)]
pub struct Reader {
    pub(super) connection: Connection,
    path: PathBuf,
}

/// A job of an experiment that failed, with its last failure.
#[derive(Clone, Debug, PartialEq)]
pub struct FailedJob {
    /// The experiment's name.
    pub experiment: String,
    /// The job.
    pub job_key: JobKey,
    /// The content of the job; `None` if this release cannot read it.
    pub job: Option<Job>,
    /// The name of the job's agent in the experiment.
    pub agent: String,
    /// The number of the failed attempt, from 1.
    pub attempt: u32,
    /// The failure.
    pub failure: Failure,
    /// When the run ended, in UTC, ISO 8601 with milliseconds.
    pub ended_at: String,
}

/// The jobs of an experiment that differ only in their seeds.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredArm {
    /// The name of the agent in the experiment.
    pub agent: String,
    /// One of the jobs.
    pub job: Job,
    /// The keys of the jobs.
    pub keys: Vec<JobKey>,
    /// The seeds of the jobs.
    pub seeds: Vec<u64>,
}

/// The measured time of jobs that differ only in their seeds.
#[derive(Clone, Debug, PartialEq)]
pub struct Pace {
    /// One of the jobs.
    pub job: Job,
    /// The number of measured runs; at least 1.
    pub runs: u64,
    /// The total time of these runs, in seconds.
    pub seconds: f64,
}

impl Reader {
    /// Opens the store at `path` for reading.
    ///
    /// **Errors**: `path` does not exist, is not a store, or is a store of a newer release.
    pub fn open(path: &Path) -> Result<Reader, StoreError> {
        let (connection, path) = file::open_reader(path)?;
        Reader::of(connection, path)
    }

    /// The store's file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    fn of(mut connection: Connection, path: PathBuf) -> Result<Reader, StoreError> {
        schema::require(&connection, &path)?;
        let renew = |version| match version == SCHEMA_VERSION as usize {
            true => view::renew_for_reading(&connection),
            false => Ok(()),
        };
        migrate::version(&connection)
            .and_then(renew)
            .and_then(|()| sandbox::allow_reading_only(&mut connection))
            .map_err(|source| StoreError::sqlite(&path, "open the store", source))?;
        Ok(Reader { connection, path })
    }

    /// Whether the store has a public view, which stores of earlier versions may lack.
    pub fn has_view(&self, name: &str) -> Result<bool, StoreError> {
        self.read("read the schema", |connection| {
            let named = "SELECT EXISTS (SELECT 1 FROM pragma_table_list WHERE name = ?1)";
            Ok(connection.prepare_cached(named)?.query_row([name], |row| row.get(0))?)
        })
    }

    /// Whether a view has a column, which it may lack in stores of earlier versions.
    pub fn has_column(&self, view: &str, name: &str) -> Result<bool, StoreError> {
        self.read("read the schema", |connection| Ok(schema::has_column(connection, view, name)?))
    }

    /// The state of each job, in the order of `keys`; a job unknown to the store is pending.
    pub fn job_states<'k>(
        &self,
        keys: impl IntoIterator<Item = &'k JobKey>,
    ) -> Result<Vec<JobState>, StoreError> {
        self.read("read the states of jobs", |connection| {
            let alive = holders(connection)?.alive_json();
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

    /// Calls `see` with each job that has a run, and its state. All other jobs are pending.
    pub fn tried(&self, mut see: impl FnMut(JobKey, JobState)) -> Result<(), StoreError> {
        self.read("read the states of jobs", |connection| {
            let states = RunStates::read(connection, &holders(connection)?.alive)?;
            let mut statement = connection.prepare_cached("SELECT id, unhex(key) FROM job")?;
            let mut rows = statement.query([])?;
            while let Some(row) = rows.next()? {
                match states.of(row.get(0)?) {
                    JobState::Pending => {}
                    state => see(JobKey(row.get(1)?), state),
                }
            }
            Ok(())
        })
    }

    /// Calls `see` once with each job of an experiment. An unknown experiment has no jobs.
    pub fn jobs_of(&self, experiment: &str, mut see: impl FnMut(JobKey)) -> Result<(), StoreError> {
        self.read("read the jobs of an experiment", |connection| {
            let mut statement = connection.prepare_cached(
                "SELECT unhex(key) FROM job WHERE id IN (
                    SELECT job FROM experiment_job
                    WHERE experiment = (SELECT id FROM experiment WHERE name = ?1))",
            )?;
            let mut rows = statement.query([experiment])?;
            while let Some(row) = rows.next()? {
                see(JobKey(row.get(0)?));
            }
            Ok(())
        })
    }

    /// A number that changes when other jobs belong to an experiment: the sum of their row ids.
    pub fn membership(&self, experiment: &str) -> Result<i64, StoreError> {
        self.read("read the jobs of an experiment", |connection| {
            let mut statement = connection.prepare_cached(
                "SELECT coalesce(sum(job), 0) FROM experiment_job
                 WHERE experiment = (SELECT id FROM experiment WHERE name = ?1)",
            )?;
            Ok(statement.query_row([experiment], |row| row.get(0))?)
        })
    }

    /// The jobs of an experiment in the order of its manifest, grouped by content without the seed. An unknown
    /// experiment has no jobs. Jobs that this release cannot read are omitted.
    pub fn arms(&self, experiment: &str) -> Result<Vec<StoredArm>, StoreError> {
        self.read("read the jobs of an experiment", |connection| {
            let mut statement = connection.prepare_cached(
                "SELECT experiment_job.agent, job.canonical, unhex(job.key)
                 FROM experiment_job JOIN job ON job.id = experiment_job.job
                 WHERE experiment = (SELECT id FROM experiment WHERE name = ?1)
                 ORDER BY experiment_job.position",
            )?;
            let mut indices: HashMap<(String, String), Option<usize>> = HashMap::new();
            let mut arms: Vec<StoredArm> = Vec::new();
            let mut rows = statement.query([experiment])?;
            while let Some(row) = rows.next()? {
                let (agent, canonical): (String, String) = (row.get(0)?, row.get(1)?);
                let stem = without_seed(&canonical).into_owned();
                let seed = seed_of(&canonical);
                let index = indices.entry((agent, stem)).or_insert_with_key(|(agent, _)| {
                    let job = Job::from_canonical(&canonical).ok()?;
                    arms.push(StoredArm {
                        agent: agent.clone(),
                        job,
                        keys: Vec::new(),
                        seeds: Vec::new(),
                    });
                    Some(arms.len() - 1)
                });
                if let Some((index, seed)) = index.zip(seed) {
                    arms[index].keys.push(JobKey(row.get(2)?));
                    arms[index].seeds.push(seed);
                }
            }
            Ok(arms)
        })
    }

    /// The failed jobs of every experiment, in the order of the experiments and their manifests.
    pub fn failed_jobs(&self) -> Result<Vec<FailedJob>, StoreError> {
        self.read("read failures", |connection| {
            let state = state_sql("run.job", "?1");
            let mut statement = connection.prepare_cached(&format!(
                "SELECT experiment.name, unhex(job.key), experiment_job.agent, run.attempt,
                    run.failure_kind, run.failure_message, run.failure_episode, run.ended_at,
                    job.canonical
                 FROM run
                 JOIN job ON job.id = run.job
                 JOIN experiment_job ON experiment_job.job = job.id
                 JOIN experiment ON experiment.id = experiment_job.experiment
                 WHERE run.status = 'failed' AND {state} = 2
                    AND NOT EXISTS (SELECT 1 FROM run AS later WHERE later.job = run.job
                        AND later.status = 'failed' AND later.attempt > run.attempt)
                 ORDER BY experiment.id, experiment_job.position"
            ))?;
            let rows = statement.query_map([holders(connection)?.alive_json()], failed_job)?;
            Ok(rows.collect::<rusqlite::Result<_>>()?)
        })
    }

    /// The latest manifest of an experiment, as it was read from its file; `None` for an unknown experiment.
    pub fn manifest(&self, experiment: &str) -> Result<Option<String>, StoreError> {
        self.read("read a manifest", |connection| {
            let mut statement =
                connection.prepare_cached("SELECT manifest FROM experiment WHERE name = ?1")?;
            Ok(statement.query_row([experiment], |row| row.get(0)).optional()?)
        })
    }

    /// The commands that changed the store, each with the time of its first change, the earliest first.
    pub fn log(&self) -> Result<Vec<(String, Command)>, StoreError> {
        self.read("read the log", |connection| Ok(command::recorded(connection)?))
    }

    /// The versions of the code earlier than `current` under which the job's content was completed.
    pub fn superseded(
        &self,
        form: &CanonicalForm,
        current: Versions,
    ) -> Result<Vec<Versions>, StoreError> {
        self.read("look for earlier versions of a job", |connection| {
            let mut completed = connection.prepare_cached(
                "SELECT 1 FROM job JOIN run ON run.job = job.id AND run.status = 'completed'
                 WHERE job.key = ?1",
            )?;
            let mut superseded = Vec::new();
            for versions in current.earlier() {
                if completed.exists([form.key_under(versions).to_string()])? {
                    superseded.push(versions);
                }
            }
            Ok(superseded)
        })
    }

    /// The times of the latest ten thousand completed runs. Jobs that this release cannot read are omitted.
    pub fn paces(&self) -> Result<Vec<Pace>, StoreError> {
        self.read("read the times of runs", |connection| {
            let mut statement = connection.prepare_cached(
                "SELECT job.canonical, wall_seconds
                 FROM (SELECT job, wall_seconds FROM run NOT INDEXED
                    WHERE status = 'completed' ORDER BY id DESC LIMIT 10000)
                 JOIN job ON job.id = job",
            )?;
            let mut groups = SeedGroups::<(u64, f64)>::default();
            let mut rows = statement.query([])?;
            while let Some(row) = rows.next()? {
                let canonical: String = row.get(0)?;
                if let Some((runs, seconds)) = groups.of(&canonical) {
                    *runs += 1;
                    *seconds += row.get::<_, f64>(1)?;
                }
            }
            let pace = |(job, (runs, seconds))| Pace { job, runs, seconds };
            Ok(groups.into_iter().map(pace).collect())
        })
    }

    /// Runs `body`; `action` completes "failed to …" in errors.
    pub(super) fn read<T>(
        &self,
        action: &'static str,
        body: impl FnOnce(&Connection) -> Result<T, StoreFault>,
    ) -> Result<T, StoreError> {
        body(&self.connection).map_err(|fault| fault.at(&self.path, action))
    }

    /// [`Reader::read`] of several statements, all of which see the store at one moment.
    pub(super) fn read_at_once<T>(
        &self,
        action: &'static str,
        body: impl FnOnce(&Connection) -> Result<T, StoreFault>,
    ) -> Result<T, StoreError> {
        self.read(action, |connection| {
            // A reading connection begins no transactions, but an unfinished statement holds its snapshot.
            let mut unfinished = connection.prepare_cached("SELECT 1 FROM sqlite_schema")?;
            let mut rows = unfinished.query([])?;
            rows.next()?;
            body(connection)
        })
    }
}

/// The row id of the completed run of the job with this key.
pub(super) fn completed_run(connection: &Connection, key: &str) -> rusqlite::Result<Option<i64>> {
    connection
        .prepare_cached(
            "SELECT run.id FROM job JOIN run ON run.job = job.id AND run.status = 'completed'
             WHERE job.key = ?1",
        )?
        .query_row([key], |row| row.get(0))
        .optional()
}

impl Store {
    /// Opens the store for reading, under the name by which it is open. It may have got another name since.
    ///
    /// **Errors**: as [`Reader::open`].
    pub fn reader(&self) -> Result<Reader, StoreError> {
        Reader::of(file::open_reader_at(&self.path)?, self.path.clone())
    }
}

/// The sessions that hold runs, as seen from this process.
pub(super) fn holders(connection: &Connection) -> rusqlite::Result<Holders> {
    session::holders(connection, &ProcessTable::of_this_system().this_process())
}

/// The kind of a failure in this column.
pub(super) fn failure_kind(
    row: &rusqlite::Row<'_>,
    column: usize,
) -> rusqlite::Result<FailureKind> {
    let kind: String = row.get(column)?;
    FailureKind::named(&kind)
        .ok_or_else(|| rusqlite::Error::InvalidColumnName(format!("failure kind {kind}")))
}

fn failed_job(row: &rusqlite::Row<'_>) -> rusqlite::Result<FailedJob> {
    let kind = failure_kind(row, 4)?;
    Ok(FailedJob {
        experiment: row.get(0)?,
        job_key: JobKey(row.get(1)?),
        job: Job::from_canonical(row.get_ref(8)?.as_str()?).ok(),
        agent: row.get(2)?,
        attempt: row.get(3)?,
        failure: Failure { kind, message: row.get(5)?, episode: row.get(6)? },
        ended_at: row.get(7)?,
    })
}
