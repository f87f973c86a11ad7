//! Completed runs as a report reads them.

use std::collections::hash_map::Entry;
use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use rusqlite::Connection;

use crate::job::metric::{MEAN_RETURN, NET_RETURN};
use crate::job::{ActionCount, EstimateDeclaration, Failure, MetricName, Provenance};
use crate::job::{JobKey, PlannedJob, Score};
use crate::record::{CompletedRun, DataSet, JobRecord, JobStatus, SharedSettings};

use super::estimate;
use super::family;
use super::job_states::JobStates;
use super::posterior;
use super::read::failure_kind;
use super::state::JobState;
use super::{Reader, StoreError};

/// A learning curve in one metric: training episodes finished, and values.
pub type Curve = Vec<(u32, f64)>;

/// The results of a run that are read in addition to its metrics.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Parts {
    /// Points of the learning curve of the mean return.
    pub curve: bool,
    /// Choices of action in the test.
    pub actions: bool,
    /// Returns of the test episodes.
    pub returns: bool,
    /// Estimates.
    pub estimates: bool,
    /// Posteriors at the updates of trials.
    pub posteriors: bool,
}

impl Parts {
    /// The parts that one of both has.
    #[must_use]
    pub fn or(self, other: Parts) -> Parts {
        Parts {
            curve: self.curve || other.curve,
            actions: self.actions || other.actions,
            returns: self.returns || other.returns,
            estimates: self.estimates || other.estimates,
            posteriors: self.posteriors || other.posteriors,
        }
    }
}

impl Reader {
    /// The given jobs of an experiment with their status and results, in their order.
    pub fn data_set(
        &self,
        experiment: &str,
        jobs: impl IntoIterator<Item = PlannedJob>,
        parts: Parts,
    ) -> Result<DataSet, StoreError> {
        self.data_set_of(experiment, jobs, |_| parts, |_| {})
    }

    /// The given jobs of an experiment with their status and results. `parts` chooses the results that are
    /// read of a job. `see` receives each job as it is read, and may drop data that is not needed.
    pub fn data_set_of(
        &self,
        experiment: &str,
        planned: impl IntoIterator<Item = PlannedJob>,
        parts: impl Fn(&JobRecord) -> Parts,
        mut see: impl FnMut(&mut JobRecord),
    ) -> Result<DataSet, StoreError> {
        let mut planned = planned.into_iter();
        let mut states = JobStates::of(self);
        let (mut shared, mut seen) = (SharedSettings::default(), SharedNames::default());
        let mut jobs = Vec::new();
        loop {
            let first = jobs.len();
            jobs.extend(planned.by_ref().take(JobStates::TOGETHER).map(|planned| {
                let key = planned.form.key();
                JobRecord::sharing(&mut shared, &planned, key, JobStatus::Pending)
            }));
            let batch = &mut jobs[first..];
            if batch.is_empty() {
                let description = self.description_of(&jobs)?;
                return Ok(DataSet { experiment: experiment.to_owned(), jobs, description });
            }
            let keys: Vec<JobKey> = batch.iter().map(|job| job.job_key).collect();
            self.read_statuses(batch, states.ask(&keys)?, (&parts, &mut seen))?;
            batch.iter_mut().for_each(&mut see);
        }
    }

    /// The description in the first completed run of these jobs that has one.
    fn description_of(&self, jobs: &[JobRecord]) -> Result<Option<String>, StoreError> {
        let completed = jobs.iter().find(|job| job.completed().is_some());
        let Some(job) = completed else { return Ok(None) };
        self.read("read the description of an environment", |connection| {
            Ok(family::description_of(connection, &job.job_key.to_string())?)
        })
    }

    /// Reads the statuses of jobs with their results.
    fn read_statuses(
        &self,
        jobs: &mut [JobRecord],
        states: Vec<JobState>,
        (parts, shared): (impl Fn(&JobRecord) -> Parts, &mut SharedNames),
    ) -> Result<(), StoreError> {
        let with = |wanted| {
            let both = jobs.iter().zip(&states).filter(move |(_, state)| **state == wanted);
            both.map(|(job, _)| job)
        };
        // Two agents with equal content share a job.
        let mut completed: HashMap<JobKey, Parts> = HashMap::new();
        for job in with(JobState::Completed) {
            let wanted = completed.entry(job.job_key).or_default();
            *wanted = wanted.or(parts(job));
        }
        let runs = self.completed_runs(&completed, shared)?;
        // Read after the states, so that every job found as failed already has its failure.
        let failures = self.failures(with(JobState::Failed).map(|job| job.job_key).collect())?;
        for (job, state) in jobs.iter_mut().zip(states) {
            job.status = match state {
                JobState::Pending => JobStatus::Pending,
                JobState::Interrupted => JobStatus::Interrupted,
                JobState::Running => JobStatus::Running,
                // If the failure is gone, another process has started the job again.
                JobState::Failed => failures
                    .get(&job.job_key)
                    .cloned()
                    .map_or(JobStatus::Running, JobStatus::Failed),
                JobState::Completed => match runs.get(&job.job_key) {
                    Some(run) => JobStatus::Completed(run.clone()),
                    None => JobStatus::Pending,
                },
            };
        }
        Ok(())
    }

    /// The completed runs of jobs, by job; jobs without a completed run are omitted.
    fn completed_runs(
        &self,
        wanted: &HashMap<JobKey, Parts>,
        shared: &mut SharedNames,
    ) -> Result<HashMap<JobKey, Arc<CompletedRun>>, StoreError> {
        let keys: Vec<String> = wanted.keys().map(JobKey::to_string).collect();
        self.read_at_once("read completed runs", |connection| {
            let mut runs = heads(connection, &keys, shared)?;
            add_metrics(connection, &mut runs, shared)?;
            let mut completed = HashMap::new();
            for (id, (key, mut run)) in runs {
                let parts = wanted.get(&key).copied().unwrap_or_default();
                if parts.curve {
                    run.curve = curve(connection, id, MEAN_RETURN)?;
                }
                if parts.actions {
                    run.actions = actions(connection, id)?;
                }
                if parts.returns {
                    run.returns = returns(connection, id)?;
                }
                if parts.estimates {
                    run.estimates = estimate::of_run(connection, id, &mut shared.declarations)?;
                }
                if parts.posteriors {
                    run.posteriors = posterior::of_run(connection, id)?;
                }
                completed.insert(key, Arc::new(run));
            }
            Ok(completed)
        })
    }

    /// The learning curves of completed jobs in a metric; other jobs are omitted.
    pub fn curves(
        &self,
        keys: &[JobKey],
        metric: MetricName,
    ) -> Result<Vec<(JobKey, Curve)>, StoreError> {
        let keys: Vec<String> = keys.iter().map(JobKey::to_string).collect();
        self.read("read learning curves", |connection| {
            let heads = heads(connection, &keys, &mut SharedNames::default())?;
            let curves =
                heads.into_iter().map(|(id, (key, _))| Ok((key, curve(connection, id, metric)?)));
            Ok(curves.collect::<rusqlite::Result<_>>()?)
        })
    }

    /// The values of a metric of completed jobs; jobs without it are omitted.
    pub fn values(
        &self,
        keys: &[JobKey],
        metric: MetricName,
    ) -> Result<Vec<(JobKey, f64)>, StoreError> {
        let keys: Vec<String> = keys.iter().map(JobKey::to_string).collect();
        self.read("read a metric", |connection| {
            let mut statement = connection.prepare_cached(
                "SELECT unhex(job.key), run_metric.value
                 FROM json_each(?1) AS wanted
                 CROSS JOIN job ON job.key = wanted.value
                 CROSS JOIN run ON run.job = job.id AND run.status = 'completed'
                 CROSS JOIN run_metric ON run_metric.run = run.id AND run_metric.metric =
                    (SELECT id FROM metric_name WHERE name = ?2)",
            )?;
            let rows = statement.query_map((json(&keys), metric.text()), |row| {
                Ok((JobKey(row.get(0)?), row.get(1)?))
            })?;
            Ok(rows.collect::<rusqlite::Result<_>>()?)
        })
    }

    /// The results of jobs for a comparison in a metric, in the order of `keys`.
    pub fn scores(&self, keys: &[JobKey], metric: MetricName) -> Result<Vec<Score>, StoreError> {
        // Read before the values, so that every job found as completed has its value.
        let states = self.job_states(keys)?;
        let mut values: HashMap<JobKey, f64> = HashMap::new();
        if metric == NET_RETURN {
            // It is recorded only where messages cost something.
            values.extend(self.values(keys, MEAN_RETURN)?);
        }
        values.extend(self.values(keys, metric)?);
        let score = |(key, state)| match state {
            JobState::Completed => match values.get(key) {
                Some(value) if value.is_finite() => Score::Value(*value),
                Some(_) | None => Score::Lost,
            },
            JobState::Failed => Score::Lost,
            JobState::Pending | JobState::Running | JobState::Interrupted => Score::Open,
        };
        Ok(keys.iter().zip(states).map(score).collect())
    }

    /// The last failures of jobs, by job.
    fn failures(&self, keys: HashSet<JobKey>) -> Result<HashMap<JobKey, Failure>, StoreError> {
        if keys.is_empty() {
            return Ok(HashMap::new());
        }
        let keys: Vec<String> = keys.iter().map(JobKey::to_string).collect();
        self.read("read failures", |connection| {
            let mut statement = connection.prepare_cached(
                "SELECT unhex(job.key), run.failure_kind, run.failure_message, run.failure_episode
                 FROM json_each(?1) AS wanted
                 CROSS JOIN job ON job.key = wanted.value
                 CROSS JOIN run ON run.job = job.id AND run.status = 'failed'
                 ORDER BY run.attempt",
            )?;
            // The last attempt replaces the ones before it.
            let rows = statement.query_map([json(&keys)], |row| {
                let (kind, message, episode) = (failure_kind(row, 1)?, row.get(2)?, row.get(3)?);
                Ok((JobKey(row.get(0)?), Failure { kind, message, episode }))
            })?;
            Ok(rows.collect::<rusqlite::Result<_>>()?)
        })
    }
}

/// What many runs have in common, kept once.
#[derive(Default)]
struct SharedNames {
    /// The provenance of the runs of each session.
    sessions: HashMap<i64, Arc<Provenance>>,
    /// The names of metrics, by row id.
    metrics: HashMap<i64, Arc<str>>,
    /// The declarations of estimates, by canonical text.
    declarations: HashMap<String, Arc<EstimateDeclaration>>,
}

/// Completed runs without their results, by row id.
fn heads(
    connection: &Connection,
    keys: &[String],
    shared: &mut SharedNames,
) -> rusqlite::Result<HashMap<i64, (JobKey, CompletedRun)>> {
    // CROSS JOIN fixes the join order. Otherwise SQLite would search the list for every completed run.
    let mut statement = connection.prepare_cached(
        "SELECT run.id, run.ended_at, run.wall_seconds, session.code_version,
            session.git_revision, session.backend, session.host, session.processor,
            unhex(job.key), session.id
         FROM json_each(?1) AS wanted
         CROSS JOIN job ON job.key = wanted.value
         CROSS JOIN run ON run.job = job.id AND run.status = 'completed'
         JOIN session ON session.id = run.session",
    )?;
    let rows = statement.query_map([json(keys)], |row| {
        Ok((row.get(0)?, (JobKey(row.get(8)?), head(row, shared)?)))
    })?;
    rows.collect()
}

/// Adds the metrics of runs, ordered by name.
fn add_metrics(
    connection: &Connection,
    runs: &mut HashMap<i64, (JobKey, CompletedRun)>,
    shared: &mut SharedNames,
) -> rusqlite::Result<()> {
    let mut statement = connection.prepare_cached(
        "SELECT run_metric.run, run_metric.metric, run_metric.value, metric_name.name
         FROM json_each(?1) AS wanted
         CROSS JOIN run_metric ON run_metric.run = wanted.value
         JOIN metric_name ON metric_name.id = run_metric.metric
         -- Undefined for one episode; the file has 0.
         WHERE metric_name.name <> 'sd_return'
            OR (SELECT max(episode) FROM test_episode WHERE run = run_metric.run) IS NOT 1
         ORDER BY metric_name.name",
    )?;
    let ids: Vec<i64> = runs.keys().copied().collect();
    let mut rows = statement.query([json(&ids)])?;
    while let Some(row) = rows.next()? {
        if let Some((_, run)) = runs.get_mut(&row.get(0)?) {
            let name = match shared.metrics.entry(row.get(1)?) {
                Entry::Occupied(known) => known.get().clone(),
                Entry::Vacant(new) => new.insert(row.get(3)?).clone(),
            };
            run.metrics.push((name, row.get(2)?));
        }
    }
    Ok(())
}

/// A list in the form that SQL takes as a parameter.
fn json<T: serde::Serialize>(list: &[T]) -> String {
    serde_json::to_string(list).expect("texts and numbers are written as JSON")
}

/// A run without its results.
fn head(row: &rusqlite::Row<'_>, shared: &mut SharedNames) -> rusqlite::Result<CompletedRun> {
    let provenance = match shared.sessions.entry(row.get(9)?) {
        Entry::Occupied(known) => known.get().clone(),
        Entry::Vacant(new) => new.insert(Arc::new(provenance(row)?)).clone(),
    };
    Ok(CompletedRun {
        metrics: Vec::new(),
        curve: Vec::new(),
        actions: Vec::new(),
        returns: Vec::new(),
        among: Vec::new(),
        estimates: Vec::new(),
        posteriors: Vec::new(),
        days: Vec::new(),
        description: None,
        replayed: None,
        mean_outcome: None,
        ended_at: row.get(1)?,
        wall_seconds: row.get(2)?,
        provenance,
    })
}

fn provenance(row: &rusqlite::Row<'_>) -> rusqlite::Result<Provenance> {
    Ok(Provenance {
        code_version: row.get(3)?,
        git_revision: row.get(4)?,
        backend: row.get(5)?,
        host: row.get(6)?,
        processor: row.get(7)?,
    })
}

fn curve(connection: &Connection, run: i64, metric: MetricName) -> rusqlite::Result<Curve> {
    let mut statement = connection.prepare_cached(
        "SELECT episode, value FROM curve_point
         WHERE run = ?1 AND metric = (SELECT id FROM metric_name WHERE name = ?2)
         ORDER BY episode",
    )?;
    statement.query_map((run, metric.text()), |row| Ok((row.get(0)?, row.get(1)?)))?.collect()
}

fn actions(connection: &Connection, run: i64) -> rusqlite::Result<Vec<ActionCount>> {
    let mut statement = connection.prepare_cached(
        "SELECT bin, context, action, count FROM action_count
         WHERE run = ?1 ORDER BY bin, context, action",
    )?;
    let rows = statement.query_map([run], |row| {
        Ok(ActionCount {
            stratum: Some(2 * row.get::<_, u8>(0)? + row.get::<_, u8>(1)?),
            action: row.get(2)?,
            count: row.get(3)?,
        })
    })?;
    let mut actions = rows.collect::<rusqlite::Result<Vec<_>>>()?;
    actions.extend(family::actions(connection, run)?);
    Ok(actions)
}

fn returns(connection: &Connection, run: i64) -> rusqlite::Result<Vec<f64>> {
    let mut statement = connection
        .prepare_cached("SELECT total_reward FROM test_episode WHERE run = ?1 ORDER BY episode")?;
    statement.query_map([run], |row| row.get(0))?.collect()
}
