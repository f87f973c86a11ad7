//! Completed runs as a report reads them.

use std::collections::HashMap;

use rusqlite::{Connection, OptionalExtension};

use crate::plan::{JobKey, PlannedJob};
use crate::record::{
    ActionCount, CompletedRun, DataSet, Failure, JobRecord, JobStatus, Provenance,
};

use super::state::JobState;
use super::{Reader, StoreError};

/// Which results of a run are read beside its metrics.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Parts {
    /// Points of the learning curve of the mean return.
    pub curve: bool,
    /// Choices of action in the test.
    pub actions: bool,
    /// Returns of the test episodes.
    pub returns: bool,
}

impl Reader {
    /// The planned jobs of an experiment with what the store knows of them. `see` is shown each as
    /// it is read, and may drop what is not needed.
    pub fn data_set(
        &self,
        experiment: &str,
        planned: impl IntoIterator<Item = PlannedJob>,
        parts: Parts,
        mut see: impl FnMut(&mut JobRecord),
    ) -> Result<DataSet, StoreError> {
        let failed = self.failed_jobs()?.into_iter();
        let failures: HashMap<JobKey, Failure> =
            failed.map(|failed| (failed.job_key, failed.failure)).collect();
        let jobs = planned.into_iter().map(|planned| {
            let key = planned.form.key();
            let status = match self.job_states([&key])?[0] {
                JobState::Pending => JobStatus::Pending,
                JobState::Interrupted => JobStatus::Interrupted,
                JobState::Running => JobStatus::Running,
                JobState::Failed => match failures.get(&key) {
                    Some(failure) => JobStatus::Failed(failure.clone()),
                    None => JobStatus::Interrupted,
                },
                JobState::Completed => match self.completed_run(key, parts)? {
                    Some(run) => JobStatus::Completed(Box::new(run)),
                    None => JobStatus::Pending,
                },
            };
            let mut job = JobRecord::new(&planned, key, status);
            see(&mut job);
            Ok(job)
        });
        Ok(DataSet { experiment: experiment.to_owned(), jobs: jobs.collect::<Result<_, _>>()? })
    }

    /// The completed run of a job; `None` if it has none.
    pub fn completed_run(
        &self,
        key: JobKey,
        parts: Parts,
    ) -> Result<Option<CompletedRun>, StoreError> {
        self.read("read a completed run", |connection| {
            let mut statement = connection.prepare_cached(
                "SELECT run.id, run.ended_at, run.wall_seconds, session.code_version,
                    session.git_revision, session.backend, session.host, session.processor
                 FROM job
                 JOIN run ON run.job = job.id AND run.status = 'completed'
                 JOIN session ON session.id = run.session
                 WHERE job.key = ?1",
            )?;
            let found = statement
                .query_row([key.to_string()], |row| Ok((row.get(0)?, head(row)?)))
                .optional()?;
            let Some((run, mut completed)) = found else { return Ok(None) };
            completed.metrics = metrics(connection, run)?;
            if parts.curve {
                completed.curve = curve(connection, run)?;
            }
            if parts.actions {
                completed.actions = actions(connection, run)?;
            }
            if parts.returns {
                completed.returns = returns(connection, run)?;
            }
            Ok(Some(completed))
        })
    }
}

/// The run without its results.
fn head(row: &rusqlite::Row<'_>) -> rusqlite::Result<CompletedRun> {
    Ok(CompletedRun {
        metrics: Vec::new(),
        curve: Vec::new(),
        actions: Vec::new(),
        returns: Vec::new(),
        ended_at: row.get(1)?,
        wall_seconds: row.get(2)?,
        provenance: Provenance {
            code_version: row.get(3)?,
            git_revision: row.get(4)?,
            backend: row.get(5)?,
            host: row.get(6)?,
            processor: row.get(7)?,
        },
    })
}

fn metrics(connection: &Connection, run: i64) -> rusqlite::Result<Vec<(String, f64)>> {
    let mut statement = connection.prepare_cached(
        "SELECT metric_name.name, run_metric.value FROM run_metric
         JOIN metric_name ON metric_name.id = run_metric.metric
         WHERE run_metric.run = ?1 ORDER BY metric_name.name",
    )?;
    statement.query_map([run], |row| Ok((row.get(0)?, row.get(1)?)))?.collect()
}

fn curve(connection: &Connection, run: i64) -> rusqlite::Result<Vec<(u32, f64)>> {
    let mut statement = connection.prepare_cached(
        "SELECT episode, value FROM curve_point
         WHERE run = ?1 AND metric = (SELECT id FROM metric_name WHERE name = 'mean_return')
         ORDER BY episode",
    )?;
    statement.query_map([run], |row| Ok((row.get(0)?, row.get(1)?)))?.collect()
}

fn actions(connection: &Connection, run: i64) -> rusqlite::Result<Vec<ActionCount>> {
    let mut statement = connection.prepare_cached(
        "SELECT bin, context, action, count FROM action_count
         WHERE run = ?1 ORDER BY bin, context, action",
    )?;
    let rows = statement.query_map([run], |row| {
        Ok(ActionCount {
            bin: row.get(0)?,
            context: row.get(1)?,
            action: row.get(2)?,
            count: row.get(3)?,
        })
    })?;
    rows.collect()
}

fn returns(connection: &Connection, run: i64) -> rusqlite::Result<Vec<f64>> {
    let mut statement = connection
        .prepare_cached("SELECT total_reward FROM test_episode WHERE run = ?1 ORDER BY episode")?;
    statement.query_map([run], |row| row.get(0))?.collect()
}
