//! Completed runs as a report reads them.

use std::collections::HashMap;

use rusqlite::Connection;

use crate::manifest::Manifest;
use crate::plan::{self, JobKey, PlannedJob};
use crate::record::{
    ActionCount, CompletedRun, DataSet, Failure, JobRecord, JobStatus, Provenance,
};

use super::state::JobState;
use super::{Reader, StoreError};

/// The results of a run that are read in addition to its metrics.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Parts {
    /// Points of the learning curve of the mean return.
    pub curve: bool,
    /// Choices of action in the test.
    pub actions: bool,
    /// Returns of the test episodes.
    pub returns: bool,
}

/// The number of jobs whose states are read at once.
const JOBS_PER_QUESTION: usize = 1000;

impl Reader {
    /// The jobs of a manifest with their status and results, in the manifest's order.
    pub fn data_set(&self, manifest: &Manifest, parts: Parts) -> Result<DataSet, StoreError> {
        self.data_set_of(&manifest.name, plan::jobs(manifest), parts, |_| {})
    }

    /// The given jobs of an experiment with their status and results. `see` receives each job as it is read,
    /// and may drop data that is not needed.
    pub fn data_set_of(
        &self,
        experiment: &str,
        planned: impl IntoIterator<Item = PlannedJob>,
        parts: Parts,
        mut see: impl FnMut(&mut JobRecord),
    ) -> Result<DataSet, StoreError> {
        let mut planned = planned.into_iter();
        let mut jobs = Vec::new();
        loop {
            let batch: Vec<(PlannedJob, JobKey)> = planned
                .by_ref()
                .take(JOBS_PER_QUESTION)
                .map(|planned| {
                    let key = planned.form.key();
                    (planned, key)
                })
                .collect();
            if batch.is_empty() {
                return Ok(DataSet { experiment: experiment.to_owned(), jobs });
            }
            let statuses = self.statuses(batch.iter().map(|(_, key)| key), parts)?;
            for ((planned, key), status) in batch.into_iter().zip(statuses) {
                let mut job = JobRecord::new(&planned, key, status);
                see(&mut job);
                jobs.push(job);
            }
        }
    }

    /// The statuses of jobs with their results, in the order of `keys`.
    fn statuses<'k>(
        &self,
        keys: impl Iterator<Item = &'k JobKey> + Clone,
        parts: Parts,
    ) -> Result<Vec<JobStatus>, StoreError> {
        let states = self.job_states(keys.clone())?;
        let completed = keys.clone().zip(&states);
        let completed = completed.filter(|(_, state)| **state == JobState::Completed);
        let runs = self.completed_runs(completed.map(|(key, _)| *key), parts)?;
        // Read after the states, so that every job found as failed already has its failure.
        let failed = match states.contains(&JobState::Failed) {
            true => self.failed_jobs()?,
            false => Vec::new(),
        };
        let failures: HashMap<JobKey, Failure> =
            failed.into_iter().map(|failed| (failed.job_key, failed.failure)).collect();
        let status = |key: &JobKey, state| match state {
            JobState::Pending => JobStatus::Pending,
            JobState::Interrupted => JobStatus::Interrupted,
            JobState::Running => JobStatus::Running,
            // If the failure is gone, another process has started the job again.
            JobState::Failed => {
                failures.get(key).cloned().map_or(JobStatus::Running, JobStatus::Failed)
            }
            // Two agents with equal content share a job.
            JobState::Completed => match runs.get(key) {
                Some(run) => JobStatus::Completed(Box::new(run.clone())),
                None => JobStatus::Pending,
            },
        };
        Ok(keys.zip(states).map(|(key, state)| status(key, state)).collect())
    }

    /// The completed runs of jobs, by job; jobs without a completed run are omitted.
    fn completed_runs(
        &self,
        keys: impl Iterator<Item = JobKey>,
        parts: Parts,
    ) -> Result<HashMap<JobKey, CompletedRun>, StoreError> {
        let keys: Vec<String> = keys.map(|key| key.to_string()).collect();
        self.read("read completed runs", |connection| {
            let mut runs = heads(connection, &keys)?;
            add_metrics(connection, &mut runs)?;
            let mut completed = HashMap::new();
            for (id, (key, mut run)) in runs {
                if parts.curve {
                    run.curve = curve(connection, id)?;
                }
                if parts.actions {
                    run.actions = actions(connection, id)?;
                }
                if parts.returns {
                    run.returns = returns(connection, id)?;
                }
                completed.insert(key, run);
            }
            Ok(completed)
        })
    }
}

/// Completed runs without their results, by row id.
fn heads(
    connection: &Connection,
    keys: &[String],
) -> rusqlite::Result<HashMap<i64, (JobKey, CompletedRun)>> {
    // CROSS JOIN fixes the join order. Otherwise SQLite would search the list for every completed run.
    let mut statement = connection.prepare_cached(
        "SELECT run.id, run.ended_at, run.wall_seconds, session.code_version,
            session.git_revision, session.backend, session.host, session.processor,
            unhex(job.key)
         FROM json_each(?1) AS wanted
         CROSS JOIN job ON job.key = wanted.value
         CROSS JOIN run ON run.job = job.id AND run.status = 'completed'
         JOIN session ON session.id = run.session",
    )?;
    let rows = statement
        .query_map([json(keys)], |row| Ok((row.get(0)?, (JobKey(row.get(8)?), head(row)?))))?;
    rows.collect()
}

/// Adds the metrics of runs, ordered by name.
fn add_metrics(
    connection: &Connection,
    runs: &mut HashMap<i64, (JobKey, CompletedRun)>,
) -> rusqlite::Result<()> {
    let mut statement = connection.prepare_cached(
        "SELECT run_metric.run, metric_name.name, run_metric.value
         FROM json_each(?1) AS wanted
         CROSS JOIN run_metric ON run_metric.run = wanted.value
         JOIN metric_name ON metric_name.id = run_metric.metric
         ORDER BY metric_name.name",
    )?;
    let ids: Vec<i64> = runs.keys().copied().collect();
    let mut rows = statement.query([json(&ids)])?;
    while let Some(row) = rows.next()? {
        if let Some((_, run)) = runs.get_mut(&row.get(0)?) {
            run.metrics.push((row.get(1)?, row.get(2)?));
        }
    }
    Ok(())
}

/// A list in the form that SQL takes as a parameter.
fn json<T: serde::Serialize>(list: &[T]) -> String {
    serde_json::to_string(list).expect("texts and numbers are written as JSON")
}

/// A run without its results.
fn head(row: &rusqlite::Row<'_>) -> rusqlite::Result<CompletedRun> {
    Ok(CompletedRun {
        metrics: Vec::new(),
        curve: Vec::new(),
        actions: Vec::new(),
        returns: Vec::new(),
        among: Vec::new(),
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
