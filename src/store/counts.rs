//! The jobs of experiments, counted by state.

use std::collections::{BTreeSet, HashMap};

use rusqlite::Connection;

use crate::job::Job;

use super::error::StoreError;
use super::read::{Reader, holders};
use super::seed_group::SeedGroups;
use super::session::living_filters;
use super::state::{Counts, JobState, RunStates};

/// The number of an experiment's jobs in each state, and the jobs that remain to be done.
#[derive(Clone, Debug, PartialEq)]
pub struct ExperimentCounts {
    /// The experiment's name.
    pub experiment: String,
    /// The experiment's jobs, each counted once.
    pub counts: Counts,
    /// The pending, interrupted and running jobs: one job for each group that differs only in seeds, with the
    /// size of the group. Jobs that this release cannot read are omitted.
    pub left: Vec<(Job, u64)>,
}

impl Reader {
    /// The jobs of every experiment by state, in the order the experiments were first run.
    pub fn experiment_counts(&self) -> Result<Vec<ExperimentCounts>, StoreError> {
        self.read("count jobs", |connection| {
            let mut counted = count(connection)?;
            let mut statement =
                connection.prepare_cached("SELECT id, name FROM experiment ORDER BY id")?;
            let rows = statement.query_map([], |row| {
                let Counted { counts, left } = counted.remove(&row.get(0)?).unwrap_or_default();
                let left = left.into_iter().collect();
                Ok(ExperimentCounts { experiment: row.get(1)?, counts, left })
            })?;
            Ok(rows.collect::<rusqlite::Result<_>>()?)
        })
    }
}

impl Reader {
    /// The number of running jobs. A job of several experiments counts once.
    pub fn running(&self) -> Result<u64, StoreError> {
        self.read("count running jobs", |connection| {
            let sql = "SELECT count(*) FROM run WHERE status = 'running'";
            Ok(connection.query_row(sql, [], |row| row.get(0))?)
        })
    }
}

impl Reader {
    /// The filters of the living sessions that run jobs of an experiment; empty if one of them has no filter.
    pub fn filters(&self, experiment: &str) -> Result<Vec<String>, StoreError> {
        // Stores of earlier versions do not have the column.
        if !self.has_column("session", "filter")? {
            return Ok(Vec::new());
        }
        self.read("read the filters of sessions", |connection| {
            let mut works_on = connection.prepare_cached(
                "SELECT 1 FROM run JOIN experiment_job ON experiment_job.job = run.job
                 WHERE run.session = ?1
                    AND experiment = (SELECT id FROM experiment WHERE name = ?2)",
            )?;
            let mut filters = BTreeSet::new();
            for (session, filter) in living_filters(connection)? {
                if works_on.exists((session, experiment))? {
                    filters.insert(filter);
                }
            }
            Ok(filters.into_iter().collect::<Option<_>>().unwrap_or_default())
        })
    }
}

#[derive(Default)]
struct Counted {
    counts: Counts,
    left: SeedGroups<u64>,
}

/// The counts of every experiment that has jobs, by row id.
fn count(connection: &Connection) -> rusqlite::Result<HashMap<i64, Counted>> {
    let states = RunStates::read(connection, &holders(connection)?.alive)?;
    let mut content = connection.prepare_cached("SELECT canonical FROM job WHERE id = ?1")?;
    let mut counted: HashMap<i64, Counted> = HashMap::new();
    for_each_held(connection, |experiment, job| {
        let counted = counted.entry(experiment).or_default();
        let state = states.of(job);
        counted.counts.add(state, 1);
        match state {
            // These jobs do not run again.
            JobState::Completed | JobState::Failed => Ok(()),
            JobState::Pending | JobState::Interrupted | JobState::Running => {
                let mut rows = content.query([job])?;
                if let Some(row) = rows.next()?
                    && let Some(jobs) = counted.left.of(row.get_ref(0)?.as_str()?)
                {
                    *jobs += 1;
                }
                Ok(())
            }
        }
    })?;
    Ok(counted)
}

/// Calls `see` with the row ids of every experiment and each of its jobs, once per pair, ordered by
/// experiment.
fn for_each_held(
    connection: &Connection,
    mut see: impl FnMut(i64, i64) -> rusqlite::Result<()>,
) -> rusqlite::Result<()> {
    let mut statement = connection
        .prepare_cached("SELECT experiment, job FROM experiment_job ORDER BY experiment, job")?;
    let mut rows = statement.query([])?;
    let mut last = None;
    while let Some(row) = rows.next()? {
        let held = (row.get(0)?, row.get(1)?);
        // Two agents of an experiment may share a job.
        if last.replace(held) != Some(held) {
            see(held.0, held.1)?;
        }
    }
    Ok(())
}
