//! Writing the target: inserts missing rows and keeps existing ones.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use rusqlite::types::Value;
use rusqlite::{Connection, OptionalExtension};

use crate::store::conflict;
use crate::store::earlier_manifest;
use crate::store::estimate;
use crate::store::transaction::NOW;

use super::results::{MetricNames, ResultRows};
use super::rows::{
    ConflictRow, CopiedRun, EarlierManifests, Ended, ExperimentRow, JobRow, MembershipRow,
    NamedRow, RunContent, SESSION, SessionRow,
};
use super::sql::{Written, find, write};

/// The result of copying a run of the source.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::store) enum RunCopy {
    /// The run was copied.
    Copied,
    /// The target has this run or, for a run without results, a completed run of the job.
    AlreadyThere,
    /// The target has a completed run of the same job with different results, and keeps it.
    Conflict(Box<Origins>),
    /// A process is running the job in the target. Copy again when that run has ended.
    InProgress,
    /// The run does not verify, and was omitted; with the reason.
    Damaged(String),
}

/// Two runs of a job with different results.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::store) struct Origins {
    /// The origin of the source's run.
    pub(in crate::store) theirs: Origin,
    /// The origin of the target's run.
    pub(in crate::store) ours: Origin,
}

/// The digest of a run's results, and the machine and code that made them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Origin {
    /// The digest of the results, in hexadecimal.
    pub results_sha256: String,
    /// The name of the machine.
    pub host: String,
    /// The processor of the machine.
    pub processor: String,
    /// The version of jitai.
    pub code_version: String,
    /// The git revision of its source.
    pub git_revision: String,
}

/// The result of copying experiments.
#[derive(Debug, Default)]
pub(in crate::store) struct ExperimentsCopied {
    /// The number of experiments inserted.
    pub(in crate::store) inserted: usize,
    /// The names of experiments with a different manifest in the target, which keeps its own.
    pub(in crate::store) differing: Vec<String>,
}

/// The target of a copy: maps row ids of the current source to row ids of the target.
#[derive(Default)]
pub(in crate::store) struct Target {
    /// The path of the source.
    source: String,
    experiments: HashMap<i64, i64>,
    jobs: HashMap<i64, i64>,
    sessions: HashMap<i64, i64>,
    metrics: HashMap<i64, i64>,
    /// The number of estimates added to runs that the target had.
    pub(super) estimates: usize,
}

/// A table whose rows are identified by a unique text in every store.
struct NamedTable {
    find: &'static str,
    insert: &'static str,
}

const EXPERIMENT: NamedTable = NamedTable {
    find: "SELECT id FROM experiment WHERE name = ?1",
    insert: "INSERT INTO experiment
            (name, question, hypothesis, manifest, created_at, updated_at, estimates)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)",
};

const JOB: NamedTable = NamedTable {
    find: "SELECT id FROM job WHERE key = ?1",
    insert: "INSERT INTO job (key, environment_version, algorithm_version, canonical)
         VALUES (?1, ?2, ?3, ?4)",
};

/// Inserts the rows that the target lacks; returns their number. `ids` receives the target's id of each row.
fn insert_missing<const COLUMNS: usize>(
    target: &Connection,
    table: &NamedTable,
    rows: &[NamedRow<COLUMNS>],
    ids: &mut HashMap<i64, i64>,
) -> rusqlite::Result<usize> {
    let mut inserted = 0;
    for NamedRow { id, columns } in rows {
        let own = match find(target, table.find, &columns[..1])? {
            Some(own) => own,
            None => match write(target, table.insert, columns)? {
                Written::Yes => {
                    inserted += 1;
                    target.last_insert_rowid()
                }
                Written::Refused => continue,
            },
        };
        ids.insert(*id, own);
    }
    Ok(inserted)
}

/// Whether the target's run `own` has the results of the source's run under another digest: only one of the two has
/// recorded choices, endings or steps, or the digest of only one covers its steps.
fn has_the_same_results(target: &Connection, own: i64, run: &CopiedRun) -> bool {
    let RunContent::Results(theirs) = &run.content else { return false };
    let names = Arc::new(MetricNames::read(target));
    let ours = ResultRows::read(target, &names, own);
    ours.is_some_and(|ours| ours.are_the_same_but_for_records(theirs))
}

impl Target {
    /// The target of a copy from the store at `source`.
    pub(super) fn new(source: &Path) -> Self {
        Target { source: source.display().to_string(), ..Target::default() }
    }

    /// Copies the experiments whose names the target lacks.
    pub(in crate::store) fn experiments(
        &mut self,
        target: &Connection,
        rows: &[ExperimentRow],
    ) -> rusqlite::Result<ExperimentsCopied> {
        let inserted = insert_missing(target, &EXPERIMENT, rows, &mut self.experiments)?;
        let differs = "SELECT id FROM experiment WHERE name = ?1 AND manifest <> ?2";
        let mut differing = Vec::new();
        for NamedRow { columns: [name, _, _, manifest, ..], .. } in rows {
            if find(target, differs, &[name.clone(), manifest.clone()])?.is_some()
                && let Value::Text(name) = name
            {
                differing.push(name.clone());
            }
        }
        Ok(ExperimentsCopied { inserted, differing })
    }

    /// Copies the earlier manifests that the target's experiments lack.
    pub(in crate::store) fn earlier_manifests(
        &self,
        target: &Connection,
        earlier: &[EarlierManifests],
    ) -> rusqlite::Result<()> {
        for EarlierManifests { experiment, texts } in earlier {
            if let Some(own) = self.experiments.get(experiment) {
                earlier_manifest::copy(target, *own, texts)?;
            }
        }
        Ok(())
    }

    /// Copies the jobs whose keys the target lacks; returns their number.
    pub(in crate::store) fn jobs(
        &mut self,
        target: &Connection,
        rows: &[JobRow],
    ) -> rusqlite::Result<usize> {
        insert_missing(target, &JOB, rows, &mut self.jobs)
    }

    /// Adds jobs to the target's experiments where they are missing.
    pub(in crate::store) fn hold(
        &self,
        target: &Connection,
        memberships: &[MembershipRow],
    ) -> rusqlite::Result<()> {
        let insert = "INSERT INTO experiment_job (experiment, job, agent, position)
             VALUES (?1, ?2, ?3, ?4) ON CONFLICT (experiment, job, agent) DO NOTHING";
        for [experiment, job, agent, position] in memberships {
            let experiment = translate(&self.experiments, experiment);
            let job = translate(&self.jobs, job);
            if let (Some(experiment), Some(job)) = (experiment, job) {
                write(target, insert, &[experiment, job, agent.clone(), position.clone()])?;
            }
        }
        Ok(())
    }

    /// Copies a run, unless the target has it or another run in its place.
    pub(in crate::store) fn run(
        &mut self,
        target: &Connection,
        run: &CopiedRun,
    ) -> rusqlite::Result<RunCopy> {
        if let RunContent::Damaged(reason) = &run.content {
            return Ok(RunCopy::Damaged(reason.clone()));
        }
        let Some(&job) = self.jobs.get(&run.job) else {
            return Ok(RunCopy::Damaged("the row of its job is missing or damaged".to_owned()));
        };
        let current: Option<(i64, bool, Value)> = target
            .prepare_cached(
                "SELECT id, status = 'completed', results_sha256 FROM run
                 WHERE job = ?1 AND status IN ('running', 'completed')",
            )?
            .query_row([job], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)))
            .optional()?;
        match (run.ended, current) {
            (_, Some((_, false, _))) => Ok(RunCopy::InProgress),
            (Ended::Completed, Some((own, true, digest)))
                if digest == run.digest || has_the_same_results(target, own, run) =>
            {
                self.estimates += estimate::insert_copied(target, own, &run.estimates)?;
                Ok(RunCopy::AlreadyThere)
            }
            (Ended::Completed, Some((own, true, _))) => {
                let (theirs, ours) = (run.origin(), origin_of(target, own)?);
                self.record_conflict(target, job, &run.digest, &theirs)?;
                Ok(RunCopy::Conflict(Box::new(Origins { theirs, ours })))
            }
            (Ended::Failed | Ended::Interrupted, Some((_, true, _))) => Ok(RunCopy::AlreadyThere),
            (Ended::Failed | Ended::Interrupted, None) if has_attempt(target, job, run)? => {
                Ok(RunCopy::AlreadyThere)
            }
            (Ended::Completed | Ended::Failed | Ended::Interrupted, None) => {
                Ok(match self.insert(target, job, run)? {
                    Written::Yes => RunCopy::Copied,
                    Written::Refused => {
                        RunCopy::Damaged("it violates a constraint of the store".to_owned())
                    }
                })
            }
        }
    }

    /// Records results that are not copied, unless they are recorded already.
    fn record_conflict(
        &self,
        target: &Connection,
        job: i64,
        digest: &Value,
        theirs: &Origin,
    ) -> rusqlite::Result<()> {
        let insert = format!(
            "INSERT INTO recorded_conflict (job, {}) VALUES (?1, ?2, {NOW}, ?3, ?4, ?5, ?6, ?7)",
            conflict::COLUMNS
        );
        let Origin { host, processor, code_version, git_revision, .. } = theirs.clone();
        let texts = [self.source.clone(), host, processor, code_version, git_revision];
        let mut values = vec![job.into(), digest.clone()];
        values.extend(texts.map(Value::Text));
        write(target, &insert, &values).map(drop)
    }

    /// Copies the conflicts of the source, unless they are recorded already.
    pub(super) fn conflicts(
        &self,
        target: &Connection,
        conflicts: &[ConflictRow],
    ) -> rusqlite::Result<()> {
        let insert = format!(
            "INSERT INTO recorded_conflict (job, {}) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8)",
            conflict::COLUMNS
        );
        for row in conflicts {
            if let Some(job) = translate(&self.jobs, &row[0]) {
                let mut values = row.clone();
                values[0] = job;
                write(target, &insert, &values)?;
            }
        }
        Ok(())
    }

    /// Inserts a run with its results, or nothing at all.
    fn insert(
        &mut self,
        target: &Connection,
        job: i64,
        run: &CopiedRun,
    ) -> rusqlite::Result<Written> {
        target.prepare_cached("SAVEPOINT run")?.execute([])?;
        let session = self.session(target, run)?;
        let written = self.insert_whole(target, job, session, run)?;
        if let Written::Refused = written {
            target.prepare_cached("ROLLBACK TO run")?.execute([])?;
            // The rolled-back rows may include metrics and sessions, so their ids are looked up again.
            self.metrics.clear();
            self.sessions.clear();
        }
        target.prepare_cached("RELEASE run")?.execute([])?;
        Ok(written)
    }

    fn insert_whole(
        &mut self,
        target: &Connection,
        job: i64,
        session: i64,
        run: &CopiedRun,
    ) -> rusqlite::Result<Written> {
        // Another attempt at the job may use the same number in the target.
        let begin = "INSERT INTO run (job, attempt, session, status, started_at, programs)
             SELECT ?1, CASE WHEN EXISTS (SELECT 1 FROM run WHERE job = ?1 AND attempt = ?2)
                THEN (SELECT max(attempt) + 1 FROM run WHERE job = ?1) ELSE ?2 END,
                ?3, 'running', ?4, ?5";
        let begun = [
            job.into(),
            run.attempt.clone(),
            session.into(),
            run.started_at.clone(),
            run.programs.clone(),
        ];
        if let Written::Refused = write(target, begin, &begun)? {
            return Ok(Written::Refused);
        }
        let own = target.last_insert_rowid();
        if let RunContent::Results(results) = &run.content
            && let Written::Refused = results.insert(target, own, &mut self.metrics)?
        {
            return Ok(Written::Refused);
        }
        let finish = "UPDATE run SET status = ?2, ended_at = ?3, wall_seconds = ?4,
                failure_kind = ?5, failure_message = ?6, failure_episode = ?7, suspects = ?8,
                results_sha256 = ?9
             WHERE id = ?1";
        let mut ended = vec![own.into(), Value::Text(run.ended.status().to_owned())];
        ended.extend_from_slice(&run.end);
        ended.push(run.digest.clone());
        let finished = write(target, finish, &ended)?;
        if let Written::Yes = finished {
            estimate::insert_copied(target, own, &run.estimates)?;
        }
        Ok(finished)
    }

    /// The target's id of a run's session, which is copied if the target lacks it. The copy has not ended,
    /// because the schema requires this of a session that receives runs; [`Target::end_sessions`] ends it.
    ///
    /// A session that cannot be read is replaced by one with an unknown process, because every run needs a
    /// session.
    fn session(&mut self, target: &Connection, run: &CopiedRun) -> rusqlite::Result<i64> {
        if let Some(&own) = self.sessions.get(&run.session) {
            return Ok(own);
        }
        let copied = match &run.session_row {
            Some(row) => copy_session(target, row)?,
            None => None,
        };
        let own = match copied {
            Some(own) => own,
            None => unknown_session(target)?,
        };
        self.sessions.insert(run.session, own);
        Ok(own)
    }

    /// Ends the target's sessions that have ended in the source.
    pub(in crate::store) fn end_sessions(
        &self,
        target: &Connection,
        sessions: &[Arc<SessionRow>],
    ) -> rusqlite::Result<()> {
        for session in sessions.iter().filter(|session| session.ended_at != Value::Null) {
            if let Some(own) = same_session(target, session)? {
                let end = "UPDATE session SET ended_at = ?2 WHERE id = ?1";
                write(target, end, &[own.into(), session.ended_at.clone()])?;
            }
        }
        Ok(())
    }
}

impl CopiedRun {
    fn origin(&self) -> Origin {
        let column = |name: &str| {
            let index = SESSION.iter().position(|column| *column == name);
            let row = self.session_row.as_ref().zip(index);
            match row.map(|(row, index)| &row.identity[index]) {
                Some(Value::Text(text)) => text.clone(),
                _ => "unknown".to_owned(),
            }
        };
        Origin {
            results_sha256: match &self.digest {
                Value::Blob(bytes) => bytes.iter().map(|byte| format!("{byte:02x}")).collect(),
                _ => String::new(),
            },
            host: column("host"),
            processor: column("processor"),
            code_version: column("code_version"),
            git_revision: column("git_revision"),
        }
    }
}

fn origin_of(target: &Connection, run: i64) -> rusqlite::Result<Origin> {
    target
        .prepare_cached(
            "SELECT lower(hex(results_sha256)), host, processor, code_version, git_revision
             FROM run JOIN session ON session.id = run.session WHERE run.id = ?1",
        )?
        .query_row([run], |row| {
            Ok(Origin {
                results_sha256: row.get(0)?,
                host: row.get(1)?,
                processor: row.get(2)?,
                code_version: row.get(3)?,
                git_revision: row.get(4)?,
            })
        })
}

/// Whether the target has this attempt at a job, under any number.
fn has_attempt(target: &Connection, job: i64, run: &CopiedRun) -> rusqlite::Result<bool> {
    let same = "SELECT id FROM run
         WHERE job = ?1 AND status = ?2 AND started_at = ?3 AND ended_at = ?4";
    let status = Value::Text(run.ended.status().to_owned());
    let ids = [job.into(), status, run.started_at.clone(), run.end[0].clone()];
    Ok(find(target, same, &ids)?.is_some())
}

/// The target's session that equals this one and has not ended.
fn same_session(target: &Connection, row: &SessionRow) -> rusqlite::Result<Option<i64>> {
    let same = SESSION.map(|column| format!("{column} IS ?")).join(" AND ");
    let sql = format!("SELECT id FROM session WHERE ended_at IS NULL AND {same}");
    find(target, &sql, &row.identity)
}

fn copy_session(target: &Connection, row: &SessionRow) -> rusqlite::Result<Option<i64>> {
    if let Some(own) = same_session(target, row)? {
        return Ok(Some(own));
    }
    let marks = vec!["?"; SESSION.len() + 1].join(", ");
    let columns = SESSION.join(", ");
    let insert = format!("INSERT INTO session ({columns}, heartbeat_at) VALUES ({marks})");
    let mut values = row.identity.to_vec();
    values.push(row.heartbeat_at.clone());
    Ok(match write(target, &insert, &values)? {
        Written::Yes => Some(target.last_insert_rowid()),
        Written::Refused => None,
    })
}

/// A session of the target with an unknown process, inserted if there is none.
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

/// The target's id for an id of the source.
fn translate(ids: &HashMap<i64, i64>, id: &Value) -> Option<Value> {
    match id {
        Value::Integer(id) => ids.get(id).map(|own| Value::Integer(*own)),
        _ => None,
    }
}
