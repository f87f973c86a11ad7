//! Examination of a store for damage to the file, its references, and the invariants of the design.
//!
//! In: a path, and a check of weights. Out: a [`Diagnosis`]. Nothing is written or repaired; see
//! [`super::salvage()`]. The caller checks weights, because the store cannot interpret them.

use std::collections::{BTreeSet, HashSet};
use std::path::Path;

use rusqlite::Connection;

use crate::job::{self, ImpliedParameter};

use super::error::StoreError;
use super::implied::{self, Known};
use super::schema::has_table;
use super::tables::RESULT_TABLES;
use super::verify::{CheckWeights, failure_fault, job_fault, leaves_out_steps, row_ids, run_fault};
use super::{earlier_manifest, estimate, file, schema};

/// The result of an examination.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Diagnosis {
    /// The faults found; empty if the store is intact.
    pub findings: Vec<Discovery>,
    /// The number of completed runs.
    pub completed: u64,
    /// The number of completed runs that verify.
    pub intact: u64,
    /// The number of these whose digests do not cover their recorded decisions: trials in the family `step_count` by
    /// release 0.1.0.
    pub uncovered: u64,
}

/// A fault of the store.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Discovery {
    /// The faulty part, such as `schema`, `estimate`, `job` or `run`.
    pub part: &'static str,
    /// The job concerned, if there is one.
    pub job_key: Option<String>,
    /// A description of the fault, as a fragment.
    pub what: String,
}

/// The maximum number of SQLite's findings that are listed; a torn page causes hundreds.
const MOST_OF_FILE: u32 = 20;

/// An invariant over several rows, and the SQL for the keys of the jobs that violate it.
struct Invariant {
    violation: &'static str,
    sql: &'static str,
}

const INVARIANTS: [Invariant; 6] = [
    Invariant {
        violation: "it has several running or completed runs",
        sql: "SELECT job.key FROM run JOIN job ON job.id = run.job
              WHERE status IN ('running', 'completed') GROUP BY run.job HAVING count(*) > 1",
    },
    Invariant {
        violation: "its learning curve extends beyond its last training episode",
        sql: "SELECT job.key FROM job
              JOIN (SELECT run.job AS job, max(episode) AS last FROM curve_point
                JOIN run ON run.id = curve_point.run GROUP BY run.job) AS curve
                ON curve.job = job.id
              WHERE last > json_extract(canonical, '$.agent.episodes')",
    },
    Invariant {
        violation: "its test episodes do not match the declared number, counted from 1",
        sql: "SELECT job.key FROM run JOIN job ON job.id = run.job
              WHERE status = 'completed' AND CASE
                    WHEN json_extract(canonical, '$.evaluation.record_episodes') = 'none' THEN 0
                    ELSE ifnull(json_extract(canonical, '$.trial.people'),
                        json_extract(canonical, '$.evaluation.test_episodes')) END
                IS NOT (SELECT iif(count(*) = ifnull(max(episode), 0), count(*), -1) FROM test_episode
                    WHERE run = run.id)",
    },
    Invariant {
        violation: "its mean return, mean length or rate of terminated episodes does not match its test episodes",
        sql: "SELECT job.key FROM run JOIN job ON job.id = run.job
              JOIN run_metric ON run_metric.run = run.id
              JOIN metric_name ON metric_name.id = run_metric.metric
              JOIN (SELECT run, avg(total_reward) AS mean_return, avg(length) AS mean_length,
                    avg(disengaged) AS disengagement_rate
                FROM test_episode GROUP BY run) AS tested ON tested.run = run.id
              WHERE name IN ('mean_return', 'mean_length', 'disengagement_rate',
                'termination_rate')
                -- Sums are taken in other orders.
                AND abs(value - CASE name WHEN 'mean_return' THEN mean_return
                    WHEN 'mean_length' THEN mean_length ELSE disengagement_rate END)
                    > 1e-9 * max(1, abs(value))
              GROUP BY job.key",
    },
    Invariant {
        violation: "invalid `started_at` or `ended_at` of a run",
        sql: "SELECT job.key FROM run JOIN job ON job.id = run.job
              WHERE status <> 'completed'
                AND (strftime('%Y-%m-%dT%H:%M:%fZ', started_at) IS NOT started_at
                  OR strftime('%Y-%m-%dT%H:%M:%fZ', ended_at) IS NOT ended_at)
              GROUP BY job.key",
    },
    Invariant {
        violation: "its number of actions does not match the steps of its test episodes",
        sql: "SELECT job.key FROM run JOIN job ON job.id = run.job
              WHERE status = 'completed' AND json_type(canonical, '$.environment.family') IS NULL
                AND json_type(canonical, '$.evaluation.record_episodes') IS NULL
                AND (SELECT sum(count) FROM action_count WHERE run = run.id)
                    IS NOT (SELECT sum(length) FROM test_episode WHERE run = run.id)",
    },
];

/// What has to hold for the rows of tables that stores of earlier versions lack.
const OF_TABLES: [(&str, &[Invariant]); 5] = [
    ("recorded_decision", OF_DECISIONS),
    ("recorded_choice", OF_CHOICES),
    ("recorded_participant", OF_PARTICIPANTS),
    ("recorded_step", OF_STEPS),
    ("recorded_ending", OF_ENDINGS),
];

/// The invariants of recorded decisions, which stores of earlier versions lack.
const OF_DECISIONS: &[Invariant] = &[Invariant {
    violation: "its recorded decisions do not match its declaration: one per step",
    sql: "SELECT job.key FROM run JOIN job ON job.id = run.job
              WHERE status = 'completed' AND json_type(canonical, '$.environment.family') IS NULL
                AND json_type(canonical, '$.trial') IS NULL AND
                (SELECT total(steps) FROM recorded_decision AS recorded
                 WHERE recorded.id BETWEEN (run.id << 39) + (1 << 38)
                    AND (run.id << 39) + 549755813887)
                IS NOT CASE WHEN json_extract(canonical, '$.evaluation.record_decisions')
                        IN ('test', 'all')
                    THEN (SELECT total(length) FROM test_episode WHERE run = run.id) ELSE 0.0 END",
}];

/// The invariants of decisions in environments of other families, which stores of earlier versions lack.
const OF_STEPS: &[Invariant] = &[
    Invariant {
        violation: "its number of actions does not match the steps of its test episodes",
        sql: "SELECT job.key FROM run JOIN job ON job.id = run.job
              WHERE status = 'completed' AND json_type(canonical, '$.environment.family') IS NOT NULL
                AND json_type(canonical, '$.evaluation.record_episodes') IS NULL
                AND (SELECT sum(count) FROM action_total WHERE run = run.id)
                    IS NOT (SELECT sum(length) FROM test_episode WHERE run = run.id)",
    },
    Invariant {
        violation: "its recorded steps do not match its declaration: one per step",
        sql: "SELECT job.key FROM run JOIN job ON job.id = run.job
              WHERE status = 'completed' AND
                (SELECT count(*) FROM recorded_step WHERE recorded_step.run = run.id AND phase = 1)
                <> CASE WHEN json_extract(canonical, '$.evaluation.record_decisions') IN ('test', 'all')
                        AND coalesce(json_type(canonical, '$.environment.family'),
                            json_type(canonical, '$.trial')) IS NOT NULL
                    THEN (SELECT sum(length) FROM test_episode WHERE run = run.id) ELSE 0 END",
    },
];

/// The invariants of recorded choices, which stores of earlier versions lack.
const OF_CHOICES: &[Invariant] = &[Invariant {
    violation: "it has recorded choices that belong to no recorded decision",
    sql: "SELECT DISTINCT job.key FROM run JOIN job ON job.id = run.job
          JOIN recorded_choice AS choice
              ON choice.id BETWEEN run.id << 39 AND (run.id << 39) + 549755813887
          LEFT JOIN recorded_decision AS recorded ON recorded.id = choice.id
          WHERE run.status <> 'completed' OR recorded.id IS NULL
              OR recorded.steps <> json_array_length(choice.probabilities)",
}];

/// The invariants of recorded endings, which stores of earlier versions lack.
const OF_ENDINGS: &[Invariant] = &[Invariant {
    violation: "it has recorded endings that do not match its recorded training",
    sql: "SELECT job.key FROM run JOIN job ON job.id = run.job
          JOIN (SELECT id >> 39 AS run, sum(length) AS steps FROM recorded_ending GROUP BY 1) AS ended
              ON ended.run = run.id
          WHERE run.status <> 'completed' OR steps <>
              (SELECT total(recorded.steps) FROM recorded_decision AS recorded
                  WHERE recorded.id BETWEEN run.id << 39 AND (run.id << 39) + 274877906943)
              + (SELECT count(*) FROM recorded_step AS recorded
                  WHERE recorded.run = run.id AND recorded.phase = 0)",
}];

/// The invariants of recorded participants, which stores of earlier versions lack.
const OF_PARTICIPANTS: &[Invariant] = &[Invariant {
    violation: "its recorded participants do not match its population: one per test episode",
    sql: "SELECT job.key FROM run JOIN job ON job.id = run.job
              WHERE status = 'completed' AND
                (SELECT count(DISTINCT recorded.id >> 14) FROM recorded_participant AS recorded
                 WHERE recorded.id BETWEEN (run.id << 39) + (1 << 38)
                    AND (run.id << 39) + 549755813887)
                <> CASE WHEN json_type(canonical, '$.population') IS NULL THEN 0
                    ELSE (SELECT count(*) FROM test_episode WHERE run = run.id) END",
}];

/// Examines the whole store at `path`.
///
/// **Errors**: `path` does not exist, is not a store, or is a store of a newer release.
pub fn examine(path: &Path, check_weights: CheckWeights<'_>) -> Result<Diagnosis, StoreError> {
    let connection = match file::open_reader(path) {
        Ok((connection, _)) => connection,
        Err(StoreError::Damaged { reason, .. }) => {
            let finding = Discovery { part: "file", job_key: None, what: in_a_line(&reason) };
            return Ok(Diagnosis { findings: vec![finding], ..Diagnosis::default() });
        }
        Err(error) => return Err(error),
    };
    let mut examination = Examination { connection: &connection, found: Diagnosis::default() };
    examination.file();
    examination.references();
    examination.runs_without_results();
    examination.invariants();
    examination.implied_parameters();
    examination.earlier_manifests();
    examination.estimates();
    examination.jobs();
    examination.runs(check_weights);
    Ok(examination.found)
}

/// A message on one line, because SQLite quotes SQL with line breaks.
fn in_a_line(message: &str) -> String {
    message.lines().map(str::trim).collect::<Vec<_>>().join(" ")
}

struct Examination<'a> {
    connection: &'a Connection,
    found: Diagnosis,
}

impl Examination<'_> {
    fn find(&mut self, part: &'static str, job_key: Option<String>, what: impl Into<String>) {
        let finding = Discovery { part, job_key, what: in_a_line(&what.into()) };
        // Several checks can find the same damage. Damage that concerns no particular job is reported once.
        if finding.job_key.is_some() || !self.found.findings.contains(&finding) {
            self.found.findings.push(finding);
        }
    }

    /// The first column of a query's result, as text; an unreadable row becomes a finding.
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
        let dangling = "SELECT concat('rows of ', \"table\", ' refer to missing rows of ', parent,
                ': ', count(*))
             FROM pragma_foreign_key_check GROUP BY \"table\", parent";
        for line in self.texts("reference", dangling) {
            self.find("reference", None, line);
        }
    }

    fn runs_without_results(&mut self) {
        let mut jobs = BTreeSet::new();
        for table in &RESULT_TABLES {
            if !table.is_in(self.connection).unwrap_or(false) {
                continue;
            }
            let (name, rows) = (table.name, table.rows());
            let sql = format!(
                "SELECT job.key FROM (SELECT run.id AS number, run.job, run.status FROM run) AS ended
                 JOIN job ON job.id = ended.job
                 WHERE status <> 'completed' AND EXISTS (SELECT 1 FROM {name} WHERE {})",
                rows.replace("?1", "ended.number")
            );
            jobs.extend(self.texts("job", &sql));
        }
        for key in jobs {
            self.find("job", Some(key), "a run that is not completed has results");
        }
    }

    fn invariants(&mut self) {
        let of_tables = OF_TABLES.iter().filter(|(table, _)| {
            // Stores of earlier versions lack some of the tables.
            has_table(self.connection, table).unwrap_or(false)
        });
        let all: Vec<&Invariant> =
            INVARIANTS.iter().chain(of_tables.flat_map(|(_, of)| *of)).collect();
        for Invariant { violation, sql } in all {
            for key in self.texts("job", sql) {
                self.find("job", Some(key), *violation);
            }
        }
    }

    /// Checks the values of parameters that canonical forms omit, which the view `parameter` shows for every
    /// job.
    fn implied_parameters(&mut self) {
        let table = "SELECT name FROM sqlite_schema WHERE name = 'implied_parameter'";
        if self.texts("schema", table).is_empty() {
            return;
        }
        let declared = job::implied_parameters();
        for parameter in &declared {
            let what = match implied::known(self.connection, parameter) {
                Ok(Known::Other(stored)) => {
                    let name = &parameter.name;
                    format!(
                        "jobs without {name} mean {stored}, but this release declares another value"
                    )
                }
                Ok(Known::Not | Known::Same) => continue,
                Err(error) => format!("{}: {error}", parameter.name),
            };
            self.find("parameter", None, what);
        }
        let named = |parameter: ImpliedParameter| {
            format!("{} {}", parameter.name, parameter.algorithm.unwrap_or_default())
        };
        let known: HashSet<String> = declared.into_iter().map(named).collect();
        let stored = "SELECT concat(name, ' ', algorithm) FROM implied_parameter";
        for parameter in self.texts("parameter", stored) {
            if !known.contains(&parameter) {
                let what = "is unknown: damaged, or added by a newer release";
                self.find("parameter", None, format!("{} {what}", parameter.trim_end()));
            }
        }
    }

    fn estimates(&mut self) {
        match estimate::unread_declarations(self.connection) {
            Ok(unread) => unread.into_iter().for_each(|what| self.find("estimate", None, what)),
            Err(error) => self.find("estimate", None, format!("declarations: {error}")),
        }
    }

    fn earlier_manifests(&mut self) {
        match earlier_manifest::damaged(self.connection) {
            Ok(names) => names.into_iter().for_each(|name| {
                let what = format!("an earlier manifest of {name} does not match its digest");
                self.find("experiment", None, what);
            }),
            Err(error) => self.find("experiment", None, format!("earlier manifests: {error}")),
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

    fn runs(&mut self, check_weights: CheckWeights<'_>) {
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
            let of_key = key.as_deref().unwrap_or_default();
            if estimate::is_damaged(self.connection, run, of_key).unwrap_or(true) {
                let what = "its estimates do not match their digests";
                self.find("run", key.clone(), what);
            }
            self.found.completed += 1;
            match run_fault(self.connection, run, check_weights) {
                None => {
                    self.found.intact += 1;
                    let is_uncovered = leaves_out_steps(self.connection, run).unwrap_or(false);
                    self.found.uncovered += u64::from(is_uncovered);
                }
                Some(fault) => self.find("run", key, fault),
            }
        }
    }
}
