//! Copying runs from one store to another, with all that belongs to them.
//!
//! In: an open connection to the source, which is only read, and the target, open for writing. Out:
//! the target with every run that ended in the source and verifies, its job, session, results and
//! weights, and the experiments with their jobs; and for each run what became of it ([`RunCopy`]).
//!
//! - Copying inserts what the target lacks and changes nothing that it has, so copying again inserts
//!   nothing. Row ids are those of the target.
//! - A run is inserted with all its results and verified as it then stands in the target (see
//!   `verify.rs`). A run that does not verify, or breaks a rule of the schema, is rolled back.
//! - The source may be damaged: what cannot be read is left out.
//! - The source is read as one snapshot. The target is written in batches of one transaction each,
//!   so that other writers get their turn; after a kill, copying again completes the rest.

use std::collections::HashMap;

use rusqlite::types::Value;
use rusqlite::{Connection, ErrorCode, OptionalExtension, params_from_iter};

use crate::record::{CURVE_METRICS, METRICS};

use super::decision;
use super::digest;
use super::error::StoreError;
use super::results::{insert_rows, metric_id};
use super::transaction::NOW;
use super::verify::{self, CheckWeights, row_ids};
use super::writer::Store;

/// How a run of the source ended. Runs in progress are not copied: their jobs run again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ended {
    /// With results.
    Completed,
    /// With a failure.
    Failed,
    /// From outside, without results.
    Interrupted,
}

/// What became of a run of the source.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum RunCopy {
    /// It was copied.
    Copied,
    /// The target has this run, or, for a run without results, the job's completed run.
    AlreadyThere,
    /// The target has a completed run of the same job with other results, which it keeps.
    Conflict,
    /// A process is running the job in the target. Copy again when it has ended.
    InProgress,
    /// It does not verify, and was left out.
    Damaged,
}

/// What was copied beside the runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Copied {
    /// Experiments inserted.
    pub(super) experiments: usize,
    /// Jobs inserted.
    pub(super) jobs: usize,
    /// Whether part of the source's list of runs cannot be read.
    pub(super) runs_unreadable: bool,
}

/// Rows of jobs and memberships that one transaction inserts.
const ROWS_PER_BATCH: usize = 10_000;

/// Bytes of runs that one transaction inserts: less than a second of work.
const BYTES_PER_BATCH: usize = 8 << 20;

/// What a run counts for in a batch before its results are counted: a small run takes as long to
/// insert as this many bytes of results.
const BYTES_PER_RUN: usize = 4096;

/// What a row of results counts for in a batch.
const BYTES_PER_ROW: usize = 32;

/// What a row of recorded decisions counts for in a batch.
const BYTES_PER_DECISIONS: usize = 512;

const ACTION: &str = "copy runs to the store";

/// Copies from `from` what `to` lacks. `report` hears the source's row id of every run that ended,
/// how it ended, and what became of it, once that is on the disk.
///
/// **Errors**: `to` cannot be written. Batches that were committed before stay.
pub(super) fn copy(
    from: &Connection,
    to: &mut Store,
    check_weights: CheckWeights<'_>,
    mut report: impl FnMut(i64, Ended, RunCopy),
) -> Result<Copied, StoreError> {
    // Every statement on the source sees the same snapshot.
    let snapshot = from
        .unchecked_transaction()
        .map_err(|source| StoreError::sqlite(&to.path, "read the source of a copy", source))?;
    let mut copier = Copier::new(&snapshot, check_weights);
    let mut copied = Copied {
        experiments: to.write(ACTION, |target| Ok(copier.experiments(target)?))?,
        ..Copied::default()
    };
    for batch in row_ids(&snapshot, "job").0.chunks(ROWS_PER_BATCH) {
        copied.jobs += to.write(ACTION, |target| Ok(copier.jobs(target, batch)?))?;
    }
    for batch in copier.memberships().chunks(ROWS_PER_BATCH) {
        to.write(ACTION, |target| Ok(copier.hold(target, batch)?))?;
    }
    let (runs, whole) = row_ids(&snapshot, "run");
    copied.runs_unreadable = !whole;
    let mut runs = runs.into_iter().peekable();
    while runs.peek().is_some() {
        let batch = to.write_durably(ACTION, |target| Ok(copier.runs(target, &mut runs)?))?;
        batch.into_iter().for_each(|(run, ended, became)| report(run, ended, became));
    }
    to.write_durably(ACTION, |target| Ok(copier.end_sessions(target)?))?;
    Ok(copied)
}

/// The row ids that rows of the source have in the target.
#[derive(Default)]
struct RowIds {
    experiments: HashMap<i64, i64>,
    jobs: HashMap<i64, i64>,
    sessions: HashMap<i64, i64>,
    metrics: HashMap<i64, i64>,
}

struct Copier<'a> {
    from: &'a Connection,
    check_weights: CheckWeights<'a>,
    /// Names of the source's metrics.
    metric_names: HashMap<i64, String>,
    to: RowIds,
    /// Bytes of runs in the present batch, as [`BYTES_PER_BATCH`] counts them.
    bytes: usize,
}

/// Columns that tell one session from another, and what made its runs.
const SESSION: [&str; 10] = [
    "host",
    "boot_id",
    "pid_namespace",
    "process_id",
    "process_started",
    "code_version",
    "git_revision",
    "backend",
    "processor",
    "started_at",
];

impl<'a> Copier<'a> {
    fn new(from: &'a Connection, check_weights: CheckWeights<'a>) -> Self {
        let metric_names = metric_names(from);
        Copier { from, check_weights, metric_names, to: RowIds::default(), bytes: 0 }
    }

    /// Copies the experiments that the target does not know by name; returns how many.
    fn experiments(&mut self, target: &Connection) -> rusqlite::Result<usize> {
        let columns = "name, question, hypothesis, manifest, created_at, updated_at";
        let select = format!("SELECT {columns} FROM experiment NOT INDEXED WHERE id = ?1");
        let insert = format!("INSERT INTO experiment ({columns}) VALUES (?1, ?2, ?3, ?4, ?5, ?6)");
        let mut inserted = 0;
        for id in row_ids(self.from, "experiment").0 {
            let Some(row) = read_row::<6>(self.from, &select, id) else { continue };
            let known = find(target, "SELECT id FROM experiment WHERE name = ?1", &row[..1])?;
            let own = match known {
                Some(own) => own,
                None => match write(target, &insert, &row)? {
                    Written::Yes => target.last_insert_rowid(),
                    Written::Refused => continue,
                },
            };
            inserted += usize::from(known.is_none());
            self.to.experiments.insert(id, own);
        }
        Ok(inserted)
    }

    /// Copies the jobs that the target does not know by key; returns how many.
    fn jobs(&mut self, target: &Connection, ids: &[i64]) -> rusqlite::Result<usize> {
        let columns = "key, environment_version, algorithm_version, canonical";
        let select = format!("SELECT {columns} FROM job NOT INDEXED WHERE id = ?1");
        let insert = format!("INSERT INTO job ({columns}) VALUES (?1, ?2, ?3, ?4)");
        let mut inserted = 0;
        for &id in ids {
            let Ok((_, None)) = verify::job_fault(self.from, id) else { continue };
            let Some(row) = read_row::<4>(self.from, &select, id) else { continue };
            let known = find(target, "SELECT id FROM job WHERE key = ?1", &row[..1])?;
            let own = match known {
                Some(own) => own,
                None => match write(target, &insert, &row)? {
                    Written::Yes => target.last_insert_rowid(),
                    Written::Refused => continue,
                },
            };
            inserted += usize::from(known.is_none());
            self.to.jobs.insert(id, own);
        }
        Ok(inserted)
    }

    /// Which experiments hold which jobs: experiment, job, agent and position, as in the source.
    fn memberships(&self) -> Vec<[Value; 4]> {
        let columns = "SELECT experiment, job, agent, position FROM experiment_job";
        let all = format!("{columns} ORDER BY experiment, job, agent");
        read_rows(self.from, &all, &[]).unwrap_or_else(|| {
            // Part of the table cannot be read; what is behind that part is found pair by pair.
            let pair = format!("{columns} WHERE experiment = ?1 AND job = ?2");
            let jobs = self.to.jobs.keys();
            let pairs = jobs.flat_map(|job| self.to.experiments.keys().map(move |e| [*e, *job]));
            pairs.filter_map(|pair_ids| read_rows(self.from, &pair, &pair_ids)).flatten().collect()
        })
    }

    /// Makes the target's experiments hold these jobs, where they do not yet.
    fn hold(&self, target: &Connection, memberships: &[[Value; 4]]) -> rusqlite::Result<()> {
        let insert = "INSERT INTO experiment_job (experiment, job, agent, position)
             VALUES (?1, ?2, ?3, ?4) ON CONFLICT (experiment, job, agent) DO NOTHING";
        for [experiment, job, agent, position] in memberships {
            let experiment = translate(&self.to.experiments, experiment);
            let job = translate(&self.to.jobs, job);
            if let (Some(experiment), Some(job)) = (experiment, job) {
                write(target, insert, &[experiment, job, agent.clone(), position.clone()])?;
            }
        }
        Ok(())
    }

    /// Copies runs until the batch is full or none is left.
    fn runs(
        &mut self,
        target: &Connection,
        runs: &mut impl Iterator<Item = i64>,
    ) -> rusqlite::Result<Vec<(i64, Ended, RunCopy)>> {
        self.bytes = 0;
        let mut batch = Vec::new();
        while self.bytes < BYTES_PER_BATCH
            && let Some(id) = runs.next()
        {
            self.bytes += BYTES_PER_RUN;
            let Some(run) = Run::read(self.from, id) else { continue };
            let became = self.run(target, &run)?;
            batch.push((id, run.ended, became));
        }
        Ok(batch)
    }

    fn run(&mut self, target: &Connection, run: &Run) -> rusqlite::Result<RunCopy> {
        let Some(job) = translate(&self.to.jobs, &run.job) else { return Ok(RunCopy::Damaged) };
        let current: Option<(bool, Option<Vec<u8>>)> = target
            .prepare_cached(
                "SELECT status = 'completed', results_sha256 FROM run
                 WHERE job = ?1 AND status IN ('running', 'completed')",
            )?
            .query_row([&job], |row| Ok((row.get(0)?, row.get(1)?)))
            .optional()?;
        match (run.ended, current) {
            (_, Some((false, _))) => Ok(RunCopy::InProgress),
            (Ended::Completed, Some((true, stored))) => {
                let stored = stored.map_or(Value::Null, Value::Blob);
                let verifies = || {
                    let digest = digest::of_run(self.from, run.id);
                    digest.is_ok_and(|digest| run.digest == Value::Blob(digest.into()))
                };
                Ok(match run.digest == stored {
                    true => RunCopy::AlreadyThere,
                    false if verifies() => RunCopy::Conflict,
                    false => RunCopy::Damaged,
                })
            }
            (Ended::Failed | Ended::Interrupted, Some((true, _))) => Ok(RunCopy::AlreadyThere),
            (Ended::Failed | Ended::Interrupted, None) if has_attempt(target, &job, run)? => {
                Ok(RunCopy::AlreadyThere)
            }
            (Ended::Completed | Ended::Failed | Ended::Interrupted, None) => {
                Ok(match self.insert(target, &job, run)? {
                    Written::Yes => RunCopy::Copied,
                    Written::Refused => RunCopy::Damaged,
                })
            }
        }
    }

    /// Inserts a run with its results, or nothing of it.
    fn insert(&mut self, target: &Connection, job: &Value, run: &Run) -> rusqlite::Result<Written> {
        let Some(session) = self.session(target, &run.session)? else {
            return Ok(Written::Refused);
        };
        target.prepare_cached("SAVEPOINT run")?.execute([])?;
        let written = self.insert_whole(target, job, session, run)?;
        if let Written::Refused = written {
            target.prepare_cached("ROLLBACK TO run")?.execute([])?;
            // Some of them may have been inserted with the run.
            self.to.metrics.clear();
        }
        target.prepare_cached("RELEASE run")?.execute([])?;
        Ok(written)
    }

    fn insert_whole(
        &mut self,
        target: &Connection,
        job: &Value,
        session: i64,
        run: &Run,
    ) -> rusqlite::Result<Written> {
        // Another attempt at the job may have taken the number in the target.
        let begin = "INSERT INTO run (job, attempt, session, status, started_at)
             SELECT ?1, CASE WHEN EXISTS (SELECT 1 FROM run WHERE job = ?1 AND attempt = ?2)
                THEN (SELECT max(attempt) + 1 FROM run WHERE job = ?1) ELSE ?2 END,
                ?3, 'running', ?4";
        let begun = [job.clone(), run.attempt.clone(), session.into(), run.started_at.clone()];
        if let Written::Refused = write(target, begin, &begun)? {
            return Ok(Written::Refused);
        }
        let own = target.last_insert_rowid();
        if let Written::Refused = self.results(target, run.id, own)? {
            return Ok(Written::Refused);
        }
        let finish = "UPDATE run SET status = ?2, ended_at = ?3, wall_seconds = ?4,
                failure_kind = ?5, failure_message = ?6, failure_episode = ?7, suspects = ?8,
                results_sha256 = ?9
             WHERE id = ?1";
        let mut ended = vec![own.into(), Value::Text(run.ended.status().to_owned())];
        ended.extend_from_slice(&run.end);
        ended.push(run.digest.clone());
        if let Written::Refused = write(target, finish, &ended)? {
            return Ok(Written::Refused);
        }
        let fault = match run.ended {
            Ended::Completed => verify::run_fault(target, own, self.check_weights),
            Ended::Failed => verify::failure_fault(target, own),
            Ended::Interrupted => None,
        };
        Ok(if fault.is_none() { Written::Yes } else { Written::Refused })
    }

    /// Copies the results of run `run` of the source as those of run `own` of the target.
    fn results(&mut self, target: &Connection, run: i64, own: i64) -> rusqlite::Result<Written> {
        let whole = self.metric_rows::<3>(target, "run_metric", run, own)?
            && self.metric_rows::<4>(target, "curve_point", run, own)?
            && self.rows::<5>(target, "test_episode", run, own)?
            && self.rows::<5>(target, "action_count", run, own)?
            && self.decisions(target, run, own)?
            && self.rows::<2>(target, "trained_weights", run, own)?;
        Ok(if whole { Written::Yes } else { Written::Refused })
    }

    /// Copies the decisions of a run; whether all were.
    fn decisions(&mut self, target: &Connection, run: i64, own: i64) -> rusqlite::Result<bool> {
        let copied = refused_or(decision::copy(self.from, run, target, own))?.flatten();
        self.bytes += copied.unwrap_or_default() * BYTES_PER_DECISIONS;
        Ok(copied.is_some())
    }

    /// Copies the rows of a run in a table whose second column is a metric; whether all were.
    fn metric_rows<const COLUMNS: usize>(
        &mut self,
        target: &Connection,
        table: &str,
        run: i64,
        own: i64,
    ) -> rusqlite::Result<bool> {
        let Some(mut rows) = self.read_results::<COLUMNS>(table, run) else { return Ok(false) };
        for row in &mut rows {
            match self.metric(target, &row[1])? {
                Some(metric) => row[1] = metric.into(),
                None => return Ok(false),
            }
        }
        self.insert_results(target, table, own, rows)
    }

    /// Copies the rows of a run in a table; whether all were.
    fn rows<const COLUMNS: usize>(
        &mut self,
        target: &Connection,
        table: &str,
        run: i64,
        own: i64,
    ) -> rusqlite::Result<bool> {
        match self.read_results::<COLUMNS>(table, run) {
            Some(rows) => self.insert_results(target, table, own, rows),
            None => Ok(false),
        }
    }

    fn read_results<const COLUMNS: usize>(
        &self,
        table: &str,
        run: i64,
    ) -> Option<Vec<[Value; COLUMNS]>> {
        read_rows(self.from, &format!("SELECT * FROM {table} WHERE run = ?1"), &[run])
    }

    fn insert_results<const COLUMNS: usize>(
        &mut self,
        target: &Connection,
        table: &str,
        own: i64,
        mut rows: Vec<[Value; COLUMNS]>,
    ) -> rusqlite::Result<bool> {
        for row in &mut rows {
            row[0] = own.into();
            self.bytes += BYTES_PER_ROW;
            if let Value::Blob(bytes) = &row[COLUMNS - 1] {
                self.bytes += bytes.len();
            }
        }
        let inserted = insert_rows(target, table, rows.into_iter());
        Ok(matches!(refused_or(inserted)?, Some(())))
    }

    /// The target's id of a metric of the source; `None` if its name cannot be read.
    fn metric(&mut self, target: &Connection, metric: &Value) -> rusqlite::Result<Option<i64>> {
        let Value::Integer(metric) = metric else { return Ok(None) };
        if let Some(&own) = self.to.metrics.get(metric) {
            return Ok(Some(own));
        }
        let Some(name) = self.metric_names.get(metric) else { return Ok(None) };
        let own = refused_or(metric_id(target, name))?;
        own.inspect(|own| {
            self.to.metrics.insert(*metric, *own);
        });
        Ok(own)
    }

    /// The target's id of a session of the source, copied if the target lacks it. It has not ended,
    /// as the schema demands of a session that takes runs; [`Copier::end_sessions`] ends it.
    ///
    /// A session that cannot be read is replaced by one whose process is unknown, so that its runs
    /// have one.
    fn session(&mut self, target: &Connection, session: &Value) -> rusqlite::Result<Option<i64>> {
        let Value::Integer(session) = *session else { return Ok(None) };
        if let Some(&own) = self.to.sessions.get(&session) {
            return Ok(Some(own));
        }
        let own = match self.copy_session(target, session)? {
            Some(own) => own,
            None => unknown_session(target)?,
        };
        self.to.sessions.insert(session, own);
        Ok(Some(own))
    }

    fn copy_session(&self, target: &Connection, id: i64) -> rusqlite::Result<Option<i64>> {
        let columns = SESSION.join(", ");
        let select = format!("SELECT {columns}, heartbeat_at FROM session WHERE id = ?1");
        let Some(row) = read_row::<11>(self.from, &select, id) else { return Ok(None) };
        let same = SESSION.map(|column| format!("{column} IS ?")).join(" AND ");
        let sql = format!("SELECT id FROM session WHERE ended_at IS NULL AND {same}");
        if let Some(own) = find(target, &sql, &row[..SESSION.len()])? {
            return Ok(Some(own));
        }
        let insert = format!(
            "INSERT INTO session ({columns}, heartbeat_at)
             VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11)"
        );
        Ok(match write(target, &insert, &row)? {
            Written::Yes => Some(target.last_insert_rowid()),
            Written::Refused => None,
        })
    }

    /// Ends the copied sessions that have ended in the source.
    fn end_sessions(&self, target: &Connection) -> rusqlite::Result<()> {
        for (&id, &own) in &self.to.sessions {
            let ended = read_row(self.from, "SELECT ended_at FROM session WHERE id = ?1", id);
            if let Some([ended_at @ Value::Text(_)]) = ended {
                let end = "UPDATE session SET ended_at = ?2 WHERE id = ?1 AND ended_at IS NULL";
                write(target, end, &[own.into(), ended_at])?;
            }
        }
        Ok(())
    }
}

/// A run of the source that has ended.
struct Run {
    id: i64,
    ended: Ended,
    job: Value,
    attempt: Value,
    session: Value,
    started_at: Value,
    /// `ended_at`, `wall_seconds`, `failure_kind`, `failure_message`, `failure_episode`, `suspects`.
    end: [Value; 6],
    digest: Value,
}

impl Run {
    /// The run, if it can be read and has ended.
    fn read(from: &Connection, id: i64) -> Option<Run> {
        let select = "SELECT status, job, attempt, session, started_at, results_sha256, ended_at,
                wall_seconds, failure_kind, failure_message, failure_episode, suspects
             FROM run NOT INDEXED WHERE id = ?1";
        let [status, job, attempt, session, started_at, digest, end @ ..] =
            read_row::<12>(from, select, id)?;
        let Value::Text(status) = status else { return None };
        let ended = [Ended::Completed, Ended::Failed, Ended::Interrupted]
            .into_iter()
            .find(|ended| ended.status() == status)?;
        Some(Run { id, ended, job, attempt, session, started_at, end, digest })
    }
}

impl Ended {
    /// The run's status in the tables.
    fn status(self) -> &'static str {
        match self {
            Ended::Completed => "completed",
            Ended::Failed => "failed",
            Ended::Interrupted => "interrupted",
        }
    }
}

/// Whether the target has this attempt at a job, under whatever number.
fn has_attempt(target: &Connection, job: &Value, run: &Run) -> rusqlite::Result<bool> {
    let same = "SELECT id FROM run
         WHERE job = ?1 AND status = ?2 AND started_at = ?3 AND ended_at = ?4";
    let status = Value::Text(run.ended.status().to_owned());
    let ids = [job.clone(), status, run.started_at.clone(), run.end[0].clone()];
    Ok(find(target, same, &ids)?.is_some())
}

/// A session of the target whose process is unknown, inserted if there is none.
fn unknown_session(target: &Connection) -> rusqlite::Result<i64> {
    let known = "SELECT id FROM session
         WHERE host = 'unknown' AND code_version = 'unknown' AND ended_at IS NULL";
    if let Some(id) = find(target, known, &[])? {
        return Ok(id);
    }
    target
        .prepare_cached(&format!(
            "INSERT INTO session (host, process_id, code_version, git_revision, backend, processor,
                started_at, heartbeat_at)
             VALUES ('unknown', 1, 'unknown', 'unknown', 'unknown', 'unknown', {NOW}, {NOW})"
        ))?
        .insert([])
}

/// The names of metrics by row id. They stand in the table and in its index; where a damaged store
/// has two names for one id, a name that this program gives is the right one.
fn metric_names(from: &Connection) -> HashMap<i64, String> {
    let known = |name: &str| METRICS.iter().chain(CURVE_METRICS).any(|(metric, _)| *metric == name);
    let mut names: HashMap<i64, String> = HashMap::new();
    for sql in [
        "SELECT id, name FROM metric_name NOT INDEXED",
        "SELECT id, name FROM metric_name ORDER BY name",
    ] {
        for row in read_rows(from, sql, &[]).unwrap_or_default() {
            let [Value::Integer(id), Value::Text(name)] = row else { continue };
            if names.get(&id).is_none_or(|earlier| !known(earlier)) {
                names.insert(id, name);
            }
        }
    }
    names
}

/// The target's id for an id of the source.
fn translate(ids: &HashMap<i64, i64>, id: &Value) -> Option<Value> {
    match id {
        Value::Integer(id) => ids.get(id).map(|own| Value::Integer(*own)),
        _ => None,
    }
}

/// The row of an answer of the source; `None` if there is none or it cannot be read.
fn read_row<const COLUMNS: usize>(
    from: &Connection,
    sql: &str,
    id: i64,
) -> Option<[Value; COLUMNS]> {
    read_rows(from, sql, &[id])?.pop()
}

/// The rows of an answer of the source; `None` if one of them cannot be read.
fn read_rows<const COLUMNS: usize>(
    from: &Connection,
    sql: &str,
    ids: &[i64],
) -> Option<Vec<[Value; COLUMNS]>> {
    let mut statement = from.prepare_cached(sql).ok()?;
    let rows = statement.query_map(params_from_iter(ids), |row| {
        let mut values = [const { Value::Null }; COLUMNS];
        for (column, value) in values.iter_mut().enumerate() {
            *value = row.get(column)?;
        }
        Ok(values)
    });
    rows.ok()?.collect::<rusqlite::Result<_>>().ok()
}

/// The id that a query of the target finds first.
fn find(target: &Connection, sql: &str, values: &[Value]) -> rusqlite::Result<Option<i64>> {
    let mut statement = target.prepare_cached(sql)?;
    statement.query_row(params_from_iter(values), |row| row.get(0)).optional()
}

/// Whether the target took what was written.
#[derive(Clone, Copy)]
enum Written {
    Yes,
    /// A rule of its schema refused it.
    Refused,
}

fn write(target: &Connection, sql: &str, values: &[Value]) -> rusqlite::Result<Written> {
    let rows = target.prepare_cached(sql)?.execute(params_from_iter(values));
    Ok(refused_or(rows)?.map_or(Written::Refused, |_| Written::Yes))
}

/// `None` if a rule of the target's schema refused a statement.
fn refused_or<T>(result: rusqlite::Result<T>) -> rusqlite::Result<Option<T>> {
    match result {
        Ok(value) => Ok(Some(value)),
        Err(error) => match error.sqlite_error_code() {
            Some(ErrorCode::ConstraintViolation | ErrorCode::TypeMismatch) => Ok(None),
            _ => Err(error),
        },
    }
}
