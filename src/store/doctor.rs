//! Whether a store is as it was written: the file, its references, and what the design says of it.
//!
//! In: a path, and a way to see whether weights load. Out: a [`Diagnosis`]. Nothing is written. It
//! does not know what weights are, and repairs nothing; see [`super::salvage`].

use std::path::Path;

use rusqlite::{Connection, OptionalExtension};

use crate::key::CanonicalError;
use crate::plan::{Job, JobError, JobKey, Versions};

use super::{StoreError, digest, file, schema};

/// Says why weights cannot be loaded for a job, if they cannot.
pub type Loads<'a> = &'a dyn Fn(&Job, &[u8]) -> Result<(), String>;

/// What was found out about a store.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Diagnosis {
    /// What is wrong; nothing for a healthy store.
    pub findings: Vec<Finding>,
    /// Completed runs that were found.
    pub completed: u64,
    /// Of these, those whose results are the ones that were stored.
    pub intact: u64,
}

/// One thing that is wrong.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// What it is about: `file`, `schema`, `reference`, `job` or `run`.
    pub part: &'static str,
    /// The job concerned, if it is about one.
    pub job_key: Option<String>,
    /// What is wrong, as a fragment.
    pub what: String,
}

/// Findings of SQLite that are listed at most; a torn page has hundreds.
const MOST_OF_FILE: u32 = 20;

/// A rule that no single row can break: SQL for the jobs that break it.
struct Rule {
    broken: &'static str,
    sql: &'static str,
}

const RULES: [Rule; 7] = [
    Rule {
        broken: "it has several running or completed runs",
        sql: "SELECT job.key FROM run JOIN job ON job.id = run.job
              WHERE status IN ('running', 'completed') GROUP BY run.job HAVING count(*) > 1",
    },
    Rule {
        broken: "a run that is not completed has results",
        sql: "SELECT job.key FROM run JOIN job ON job.id = run.job
              WHERE status <> 'completed' AND (
                EXISTS (SELECT 1 FROM run_metric WHERE run = run.id)
                OR EXISTS (SELECT 1 FROM curve_point WHERE run = run.id)
                OR EXISTS (SELECT 1 FROM test_episode WHERE run = run.id)
                OR EXISTS (SELECT 1 FROM action_count WHERE run = run.id)
                OR EXISTS (SELECT 1 FROM trained_weights WHERE run = run.id))",
    },
    Rule {
        broken: "its learning curve goes on after its last training episode",
        sql: "SELECT job.key FROM job
              JOIN (SELECT run.job AS job, max(episode) AS last FROM curve_point
                JOIN run ON run.id = curve_point.run GROUP BY run.job) AS curve
                ON curve.job = job.id
              WHERE last > json_extract(canonical, '$.agent.episodes')",
    },
    Rule {
        broken: "its test episodes are not as many as it declares, numbered from 1",
        sql: "SELECT job.key FROM run JOIN job ON job.id = run.job
              WHERE status = 'completed' AND json_extract(canonical, '$.evaluation.test_episodes')
                IS NOT (SELECT iif(count(*) = max(episode), count(*), -1) FROM test_episode
                    WHERE run = run.id)",
    },
    Rule {
        broken: "its mean return, mean length or disengagement rate is not that of its test episodes",
        sql: "SELECT job.key FROM run JOIN job ON job.id = run.job
              JOIN run_metric ON run_metric.run = run.id
              JOIN metric_name ON metric_name.id = run_metric.metric
              JOIN (SELECT run, avg(total_reward) AS mean_return, avg(length) AS mean_length,
                    avg(disengaged) AS disengagement_rate
                FROM test_episode GROUP BY run) AS tested ON tested.run = run.id
              WHERE name IN ('mean_return', 'mean_length', 'disengagement_rate')
                -- Sums are taken in other orders.
                AND abs(value - CASE name WHEN 'mean_return' THEN mean_return
                    WHEN 'mean_length' THEN mean_length ELSE disengagement_rate END)
                    > 1e-9 * max(1, abs(value))
              GROUP BY job.key",
    },
    Rule {
        broken: "a run of it began or ended at no point in time",
        sql: "SELECT job.key FROM run JOIN job ON job.id = run.job
              WHERE status <> 'completed'
                AND (strftime('%Y-%m-%dT%H:%M:%fZ', started_at) IS NOT started_at
                  OR strftime('%Y-%m-%dT%H:%M:%fZ', ended_at) IS NOT ended_at)
              GROUP BY job.key",
    },
    Rule {
        broken: "its actions are not as many as the steps of its test episodes",
        sql: "SELECT job.key FROM run JOIN job ON job.id = run.job
              WHERE status = 'completed'
                AND (SELECT sum(count) FROM action_count WHERE run = run.id)
                    IS NOT (SELECT sum(length) FROM test_episode WHERE run = run.id)",
    },
];

/// Looks through the whole store at `path`.
///
/// **Errors**: there is no store that could be looked at: nothing is there, or it is something
/// else, or of another release.
pub fn examine(path: &Path, loads: Loads<'_>) -> Result<Diagnosis, StoreError> {
    let connection = match file::open_reader(path) {
        Ok((connection, _)) => connection,
        Err(StoreError::Damaged { reason, .. }) => {
            let finding = Finding { part: "file", job_key: None, what: in_a_line(&reason) };
            return Ok(Diagnosis { findings: vec![finding], ..Diagnosis::default() });
        }
        Err(error) => return Err(error),
    };
    let mut examination = Examination { connection: &connection, found: Diagnosis::default() };
    examination.file();
    examination.references();
    examination.rules();
    examination.jobs();
    examination.runs(loads);
    Ok(examination.found)
}

/// A message without its line breaks: SQLite quotes SQL.
fn in_a_line(message: &str) -> String {
    message.lines().map(str::trim).collect::<Vec<_>>().join(" ")
}

struct Examination<'a> {
    connection: &'a Connection,
    found: Diagnosis,
}

impl Examination<'_> {
    fn find(&mut self, part: &'static str, job_key: Option<String>, what: impl Into<String>) {
        let finding = Finding { part, job_key, what: in_a_line(&what.into()) };
        // Several questions can meet the same damage; where that is not of a job, it is one finding.
        if finding.job_key.is_some() || !self.found.findings.contains(&finding) {
            self.found.findings.push(finding);
        }
    }

    /// The first column of an answer, as text; what cannot be read is a finding.
    fn texts(&mut self, part: &'static str, sql: &str) -> Vec<String> {
        let mut texts = Vec::new();
        let read = self.connection.prepare(sql).and_then(|mut statement| {
            let mut rows = statement.query([])?;
            while let Some(row) = rows.next()? {
                texts.push(row.get(0)?);
            }
            Ok(())
        });
        if let Err(error) = read {
            self.find(part, None, error.to_string());
        }
        texts
    }

    fn file(&mut self) {
        let check = format!("PRAGMA integrity_check({MOST_OF_FILE})");
        // An answer can have several lines, the first of which names the database.
        for answer in self.texts("file", &check) {
            let is_fault = |line: &&str| *line != "ok" && !line.starts_with("*** ");
            answer.lines().filter(is_fault).for_each(|line| self.find("file", None, line));
        }
        match schema::faults(self.connection) {
            Ok(faults) => faults.into_iter().for_each(|fault| self.find("schema", None, fault)),
            Err(error) => self.find("schema", None, error.to_string()),
        }
    }

    fn references(&mut self) {
        let dangling = "SELECT concat('rows of ', \"table\", ' refer to rows of ', parent,
                ' that are not there: ', count(*))
             FROM pragma_foreign_key_check GROUP BY \"table\", parent";
        for line in self.texts("reference", dangling) {
            self.find("reference", None, line);
        }
    }

    fn rules(&mut self) {
        for Rule { broken, sql } in &RULES {
            for key in self.texts("job", sql) {
                self.find("job", Some(key), *broken);
            }
        }
    }

    fn jobs(&mut self) {
        let (jobs, whole) = row_ids(self.connection, "job");
        if !whole {
            self.find("job", None, "some jobs cannot be read");
        }
        for job in jobs {
            match job_fault(self.connection, job) {
                Ok((_, None)) => {}
                Ok((key, Some(fault))) => self.find("job", Some(key), fault),
                Err(error) => self.find("job", None, format!("row {job}: {error}")),
            }
        }
    }

    fn runs(&mut self, loads: Loads<'_>) {
        let (runs, whole) = row_ids(self.connection, "run");
        if !whole {
            self.find("run", None, "some runs cannot be read");
        }
        for run in runs {
            let named = "SELECT status, job.key FROM run
                 LEFT JOIN job ON job.id = run.job WHERE run.id = ?1";
            let named = self.connection.prepare_cached(named).and_then(|mut statement| {
                statement.query_row([run], |row| Ok((row.get::<_, String>(0)?, row.get(1)?)))
            });
            let key = match named {
                Ok((status, key)) if status == "completed" => key,
                Ok((status, key)) => {
                    let fault = (status == "failed").then(|| failure_fault(self.connection, run));
                    if let Some(fault) = fault.flatten() {
                        self.find("run", key, fault);
                    }
                    continue;
                }
                Err(_) => None,
            };
            self.found.completed += 1;
            match run_fault(self.connection, run, loads) {
                None => self.found.intact += 1,
                Some(fault) => self.find("run", key, fault),
            }
        }
    }
}

/// What is wrong with the results of a completed run, if anything is.
pub(super) fn run_fault(connection: &Connection, run: i64, loads: Loads<'_>) -> Option<String> {
    fault_of(connection, run, loads).unwrap_or_else(|error| Some(format!("its results: {error}")))
}

/// What is wrong with what a failed run tells of its failure, if anything is.
pub(super) fn failure_fault(connection: &Connection, run: i64) -> Option<String> {
    let is_as_stored = || -> rusqlite::Result<bool> {
        let (kind, message, episode, stored): (String, String, i64, Option<[u8; 32]>) = connection
            .prepare_cached(
                "SELECT failure_kind, failure_message, failure_episode, results_sha256
                 FROM run WHERE id = ?1",
            )?
            .query_row([run], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?)))?;
        Ok(stored == Some(digest::of_failure(connection, run, (&kind, &message, episode))?))
    };
    match is_as_stored() {
        Ok(true) => None,
        Ok(false) => Some("its failure is not the one that was stored".to_owned()),
        Err(error) => Some(format!("its failure: {error}")),
    }
}

fn fault_of(
    connection: &Connection,
    run: i64,
    loads: Loads<'_>,
) -> rusqlite::Result<Option<String>> {
    let (job, stored, has_instants): (i64, Option<[u8; 32]>, bool) = connection
        .prepare_cached(
            "SELECT job, results_sha256,
                strftime('%Y-%m-%dT%H:%M:%fZ', started_at) IS started_at
                AND strftime('%Y-%m-%dT%H:%M:%fZ', ended_at) IS ended_at
             FROM run WHERE id = ?1",
        )?
        .query_row([run], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)))?;
    if !has_instants {
        return Ok(Some("it began or ended at no point in time".to_owned()));
    }
    if stored != Some(digest::of_run(connection, run)?) {
        return Ok(Some("its results are not those that were stored".to_owned()));
    }
    if let (_, Some(fault)) = job_fault(connection, job)? {
        return Ok(Some(fault));
    }
    let trained: Option<(String, Vec<u8>)> = connection
        .prepare_cached(
            "SELECT canonical, safetensors FROM trained_weights
             JOIN run ON run.id = trained_weights.run JOIN job ON job.id = run.job
             WHERE run.id = ?1",
        )?
        .query_row([run], |row| Ok((row.get(0)?, row.get(1)?)))
        .optional()?;
    // A rule has none; those of another agent are in the digest.
    let Some((canonical, weights)) = trained else { return Ok(None) };
    // The jobs of another release may mean nothing to this one.
    let Ok(job) = Job::from_canonical(&canonical) else { return Ok(None) };
    Ok(loads(&job, &weights).err().map(|reason| format!("its weights do not load: {reason}")))
}

/// The key of a job, and what is wrong with its row, if anything is.
pub(super) fn job_fault(
    connection: &Connection,
    job: i64,
) -> rusqlite::Result<(String, Option<String>)> {
    let (key, environment, algorithm, canonical): (String, u32, u32, String) = connection
        .prepare_cached(
            "SELECT key, environment_version, algorithm_version, canonical FROM job NOT INDEXED
             WHERE id = ?1",
        )?
        .query_row([job], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?)))?;
    let JobKey(hash) = Versions { environment, algorithm }.key_of(&canonical);
    let rewritten =
        serde_json::from_str::<serde_json::Value>(&canonical).map(|value| value.to_string());
    let fault = match rewritten {
        Err(error) => Some(format!("its parameters are not JSON: {error}")),
        Ok(rewritten) if rewritten != canonical => {
            Some("its parameters are not written in the one way that a key is taken from".into())
        }
        Ok(_) if JobKey(hash).to_string() != key => {
            Some("its key is not that of its parameters".to_owned())
        }
        Ok(_) => match Job::from_canonical(&canonical) {
            Err(JobError::Keys { error: error @ CanonicalError::Redundant(_), .. }) => {
                Some(format!("its parameters have another spelling: {error}"))
            }
            // The jobs of another release may mean nothing to this one.
            Ok(_) | Err(_) => None,
        },
    };
    Ok((key, fault))
}

/// The ids of the rows of a table that can be read, in their order, and whether these are all.
///
/// A page that cannot be read ends a scan; what lies behind it is found from the other end, and
/// what lies between two such pages one by one.
pub(super) fn row_ids(connection: &Connection, table: &str) -> (Vec<i64>, bool) {
    let (mut ids, end) = scan(connection, table, "ASC");
    if end.is_ok() {
        return (ids, true);
    }
    let (mut behind, _) = scan(connection, table, "DESC");
    behind.reverse();
    let (first, last) = (ids.last().map_or(1, |id| id + 1), behind.first().copied());
    let one = format!("SELECT id FROM {table} NOT INDEXED WHERE id = ?1");
    if let (Some(last), Ok(mut one)) = (last, connection.prepare(&one)) {
        let mut missed = 0;
        for id in first..last {
            match one.query_row([id], |row| row.get(0)).optional() {
                Ok(Some(id)) => {
                    ids.push(id);
                    missed = 0;
                }
                _ => missed += 1,
            }
            if missed > MOST_MISSED {
                break;
            }
        }
    }
    ids.extend(behind.into_iter().filter(|id| *id >= first));
    (ids, false)
}

/// So many ids one after the other without a row, and what lies behind them is given up: more than a
/// branch of a table's tree holds, and a tenth of a second. A damaged id can be any number.
const MOST_MISSED: usize = 100_000;

/// The ids of a table's rows, up to the first that cannot be read, if there is one.
fn scan(connection: &Connection, table: &str, order: &str) -> (Vec<i64>, rusqlite::Result<()>) {
    let mut ids = Vec::new();
    let sql = format!("SELECT id FROM {table} NOT INDEXED ORDER BY id {order}");
    let end = connection.prepare(&sql).and_then(|mut statement| {
        let mut rows = statement.query([])?;
        while let Some(row) = rows.next()? {
            ids.push(row.get(0)?);
        }
        Ok(())
    });
    (ids, end)
}
