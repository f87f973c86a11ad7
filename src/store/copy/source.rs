//! Reading the source: selects, checks and batches the data to copy.

use std::collections::HashMap;
use std::sync::Arc;

use rusqlite::Connection;
use rusqlite::types::Value;

use crate::store::conflict;
use crate::store::digest::{self, DigestForm};
use crate::store::earlier_manifest;
use crate::store::estimate;
use crate::store::schema::has_column;
use crate::store::verify::{self, CheckWeights, row_ids};

use super::results::{MetricNames, ResultRows};
use super::rows::{
    ConflictRow, CopiedRun, CopyBatch, EarlierManifests, Ended, ExperimentRow, JobRow,
    MembershipRow, NamedRow, RunContent, SESSION, SessionRow,
};
use super::sql::{read_row, read_rows};

/// The number of rows of jobs and memberships per transaction.
const ROWS_PER_BATCH: usize = 10_000;

/// The number of bytes of runs per transaction: less than a second of work.
const BYTES_PER_BATCH: usize = 8 << 20;

/// The size of a run in the accounting of batches, without its results: inserting a small run takes as long
/// as this many bytes of results.
const BYTES_PER_RUN: usize = 4096;

/// The part of a store that is copied.
#[derive(Clone, Copy)]
pub(in crate::store) enum Extent<'a> {
    /// All readable data whose weights pass this check.
    Everything(CheckWeights<'a>),
    /// Completed and failed runs, and the declarations of the experiments. Skips results that the target
    /// already has, according to this connection.
    Results(&'a Connection),
}

impl Extent<'_> {
    fn includes(self, ended: Ended) -> bool {
        match (self, ended) {
            (Extent::Results(_), Ended::Interrupted) => false,
            (Extent::Results(_), Ended::Completed | Ended::Failed) | (Extent::Everything(_), _) => {
                true
            }
        }
    }
}

/// A source whose statements all see the same snapshot.
pub(in crate::store) struct CopySource<'a> {
    connection: &'a Connection,
    extent: Extent<'a>,
    metrics: Arc<MetricNames>,
    /// The keys of the intact jobs, as numbers.
    job_keys: HashMap<i64, u128>,
    /// The sessions of runs; `None` for a session that cannot be read.
    sessions: HashMap<i64, Option<Arc<SessionRow>>>,
}

impl<'a> CopySource<'a> {
    /// The source as a connection sees it. The caller has begun a transaction on the connection.
    pub(in crate::store) fn new(connection: &'a Connection, extent: Extent<'a>) -> Self {
        let metrics = Arc::new(MetricNames::read(connection));
        let (job_keys, sessions) = (HashMap::new(), HashMap::new());
        CopySource { connection, extent, metrics, job_keys, sessions }
    }

    /// Passes every batch to `give`; returns whether part of the list of runs is unreadable.
    ///
    /// **Errors**: the errors of `give`.
    pub(in crate::store) fn read<E>(
        mut self,
        mut give: impl FnMut(CopyBatch) -> Result<(), E>,
    ) -> Result<bool, E> {
        let experiments = self.experiments();
        let experiment_ids: Vec<i64> = experiments.iter().map(|row| row.id).collect();
        let earlier = self.earlier_manifests(&experiment_ids);
        give(CopyBatch::Experiments(experiments, earlier))?;
        for ids in self.job_ids().chunks(ROWS_PER_BATCH) {
            let jobs = self.jobs(ids);
            give(CopyBatch::Jobs(jobs))?;
        }
        self.memberships(&experiment_ids, |rows| give(CopyBatch::Memberships(rows)))?;
        let (runs, whole) = row_ids(self.connection, "run");
        let mut runs = runs.into_iter().peekable();
        while runs.peek().is_some() {
            let batch = self.runs(&mut runs);
            give(CopyBatch::Runs(batch))?;
        }
        give(CopyBatch::Conflicts(self.conflicts()))?;
        give(CopyBatch::Sessions(self.sessions.into_values().flatten().collect()))?;
        Ok(!whole)
    }

    /// The earlier manifests of these experiments, as far as they are readable.
    fn earlier_manifests(&self, experiments: &[i64]) -> Vec<EarlierManifests> {
        if !earlier_manifest::are_known(self.connection).unwrap_or(false) {
            return Vec::new();
        }
        let read_texts = |experiment: &i64| {
            let texts = earlier_manifest::intact(self.connection, *experiment).unwrap_or_default();
            EarlierManifests { experiment: *experiment, texts }
        };
        experiments.iter().map(read_texts).collect()
    }

    /// The conflicts that earlier merges found, as far as they are readable.
    fn conflicts(&self) -> Vec<ConflictRow> {
        if !conflict::are_known(self.connection).unwrap_or(false) {
            return Vec::new();
        }
        let select =
            format!("SELECT job, {} FROM recorded_conflict WHERE id = ?1", conflict::COLUMNS);
        let row = |id| read_row(self.connection, &select, id);
        row_ids(self.connection, "recorded_conflict").0.into_iter().filter_map(row).collect()
    }

    fn experiments(&self) -> Vec<ExperimentRow> {
        // Stores of earlier versions do not have the column.
        let is_known = has_column(self.connection, "experiment", "estimates").unwrap_or(false);
        let estimates = match is_known {
            true => "CASE WHEN json_valid(estimates) THEN estimates END",
            false => "NULL",
        };
        let select = format!(
            "SELECT name, question, hypothesis, manifest, created_at, updated_at, {estimates}
             FROM experiment NOT INDEXED WHERE id = ?1"
        );
        let row =
            |id| read_row(self.connection, &select, id).map(|columns| NamedRow { id, columns });
        row_ids(self.connection, "experiment").0.into_iter().filter_map(row).collect()
    }

    /// The jobs to check and copy.
    fn job_ids(&self) -> Vec<i64> {
        let needed = "SELECT id FROM job WHERE id IN (SELECT job FROM experiment_job)
                OR id IN (SELECT job FROM run WHERE status IN ('completed', 'failed'))
             ORDER BY id";
        let needed = || {
            let mut statement = self.connection.prepare_cached(needed)?;
            statement.query_map([], |row| row.get(0))?.collect::<rusqlite::Result<_>>()
        };
        match self.extent {
            Extent::Results(_) => needed().ok(),
            Extent::Everything(_) => None,
        }
        .unwrap_or_else(|| row_ids(self.connection, "job").0)
    }

    /// The intact jobs among these ids.
    fn jobs(&mut self, ids: &[i64]) -> Vec<JobRow> {
        let select = "SELECT key, environment_version, algorithm_version, canonical
             FROM job NOT INDEXED WHERE id = ?1";
        let mut jobs = Vec::new();
        for &id in ids {
            let Ok((key, None)) = verify::job_fault(self.connection, id) else { continue };
            let Ok(key) = u128::from_str_radix(&key, 16) else { continue };
            let Some(columns) = read_row(self.connection, select, id) else { continue };
            self.job_keys.insert(id, key);
            jobs.push(NamedRow { id, columns });
        }
        jobs
    }

    fn job_key(&self, job: i64) -> Option<String> {
        self.job_keys.get(&job).map(|key| format!("{key:032x}"))
    }

    /// Passes on which experiments hold which jobs, one page at a time.
    fn memberships<E>(
        &self,
        experiments: &[i64],
        mut give: impl FnMut(Vec<MembershipRow>) -> Result<(), E>,
    ) -> Result<(), E> {
        let columns = "SELECT experiment, job, agent, position FROM experiment_job";
        let next = format!(
            "{columns} WHERE (experiment, job, agent) > (?1, ?2, ?3)
             ORDER BY experiment, job, agent LIMIT {ROWS_PER_BATCH}"
        );
        let mut after = [Value::Integer(i64::MIN), Value::Null, Value::Null];
        while let Some(page) = read_rows::<4>(self.connection, &next, &after) {
            let Some([experiment, job, agent, _]) = page.last() else { return Ok(()) };
            after = [experiment.clone(), job.clone(), agent.clone()];
            give(page)?;
        }
        // Part of the table is unreadable; rows behind that part are found pair by pair.
        let pair = format!("{columns} WHERE experiment = ?1 AND job = ?2");
        let pairs =
            self.job_keys.keys().flat_map(|job| experiments.iter().map(move |e| [*e, *job]));
        let rows = pairs.filter_map(|pair_ids| {
            read_rows(self.connection, &pair, &pair_ids.map(Value::Integer))
        });
        give(rows.flatten().collect())
    }

    /// Runs until the batch is full or no run is left.
    fn runs(&mut self, ids: &mut impl Iterator<Item = i64>) -> Vec<CopiedRun> {
        let mut bytes = 0;
        let mut batch = Vec::new();
        while bytes < BYTES_PER_BATCH
            && let Some(id) = ids.next()
        {
            bytes += BYTES_PER_RUN;
            let Some(run) = self.run(id) else { continue };
            if let RunContent::Results(results) = &run.content {
                bytes += results.bytes();
            }
            batch.push(run);
        }
        batch
    }

    /// The run with its results, if it has ended and should be copied.
    fn run(&mut self, id: i64) -> Option<CopiedRun> {
        // Stores of earlier versions do not have the column, and no digest covers it.
        let programs = match has_column(self.connection, "run", "programs") {
            Ok(true) => "CASE WHEN json_valid(programs) THEN programs END",
            Ok(false) | Err(_) => "NULL",
        };
        let select = format!(
            "SELECT status, job, attempt, session, started_at, results_sha256, {programs}, ended_at,
                wall_seconds, failure_kind, failure_message, failure_episode, suspects
             FROM run NOT INDEXED WHERE id = ?1"
        );
        let [status, job, attempt, session, started_at, digest, programs, end @ ..] =
            read_row::<13>(self.connection, &select, id)?;
        let ended = Ended::of(&status).filter(|ended| self.extent.includes(*ended))?;
        let (Value::Integer(job), Value::Integer(session)) = (job, session) else { return None };
        let job_key = self.job_key(job);
        let content = match &job_key {
            Some(key) => self.content(id, ended, key, &digest),
            None => RunContent::Damaged("the row of its job is missing or damaged".to_owned()),
        };
        let session_row = self.session(session);
        let estimates = match (&job_key, ended) {
            (Some(key), Ended::Completed) => estimate::intact(self.connection, id, key),
            _ => Ok(Vec::new()),
        };
        Some(CopiedRun {
            ended,
            job_key,
            job,
            attempt,
            session,
            session_row,
            started_at,
            end,
            digest,
            programs,
            content,
            estimates: estimates.unwrap_or_default(),
        })
    }

    fn content(&self, run: i64, ended: Ended, job_key: &str, digest: &Value) -> RunContent {
        match ended {
            Ended::Completed if self.is_known(job_key, digest) => RunContent::KnownToTarget,
            Ended::Completed => {
                let results = ResultRows::read(self.connection, &self.metrics, run);
                let Some(results) = results else {
                    return RunContent::Damaged("its results cannot be read".to_owned());
                };
                let has = |taken: Option<[u8; 32]>| {
                    taken.is_some_and(|taken| *digest == Value::Blob(taken.into()))
                };
                let is_earlier = || {
                    digest::may_leave_out_steps(self.connection, run).unwrap_or(false)
                        && has(results.digest_in(job_key, DigestForm::WithoutSteps))
                };
                if !has(results.digest_in(job_key, DigestForm::Whole)) && !is_earlier() {
                    let fault = "its results do not match their digest";
                    return RunContent::Damaged(fault.to_owned());
                }
                match self.weights_fault(run) {
                    None => RunContent::Results(results),
                    Some(fault) => RunContent::Damaged(fault),
                }
            }
            Ended::Failed => match verify::failure_fault(self.connection, run) {
                None => RunContent::Nothing,
                Some(fault) => RunContent::Damaged(fault),
            },
            Ended::Interrupted => RunContent::Nothing,
        }
    }

    /// Whether the target has a completed run of the job with these results.
    fn is_known(&self, job_key: &str, digest: &Value) -> bool {
        let Extent::Results(target) = self.extent else { return false };
        let same = "SELECT 1 FROM job JOIN run ON run.job = job.id AND run.status = 'completed'
             WHERE job.key = ?1 AND run.results_sha256 = ?2";
        // An error that prevents reading the target occurs again when the target is written.
        let found = target.prepare_cached(same).and_then(|mut same| same.exists((job_key, digest)));
        found.unwrap_or(false)
    }

    fn weights_fault(&self, run: i64) -> Option<String> {
        match self.extent {
            Extent::Everything(check) => verify::weights_fault(self.connection, run, check)
                .unwrap_or_else(|error| Some(format!("its weights: {error}"))),
            // The weights passed the digest check, and this program may lack the algorithm that
            // uses them.
            Extent::Results(_) => None,
        }
    }

    fn session(&mut self, id: i64) -> Option<Arc<SessionRow>> {
        let read = || {
            let columns = SESSION.join(", ");
            let select =
                format!("SELECT {columns}, heartbeat_at, ended_at FROM session WHERE id = ?1");
            let row = read_row::<{ SESSION.len() + 2 }>(self.connection, &select, id)?;
            let mut row = row.into_iter();
            let identity = std::array::from_fn(|_| row.next().unwrap_or(Value::Null));
            let [heartbeat_at, ended_at] =
                std::array::from_fn(|_| row.next().unwrap_or(Value::Null));
            Some(Arc::new(SessionRow { identity, heartbeat_at, ended_at }))
        };
        self.sessions.entry(id).or_insert_with(read).clone()
    }
}
