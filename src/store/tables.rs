//! The tables of results, as data.
//!
//! In: one declaration for each table whose rows are results of a run. Out: how its rows are found, read in order,
//! copied and deleted. The digest, copies, `forget`, `doctor` and the tests go through [`RESULT_TABLES`]; how values of
//! a result become a row is in the module of that result.

use std::sync::LazyLock;

use rusqlite::Connection;
use rusqlite::types::Value;

use super::schema::has_table;

/// The lowest bit of the run in row ids that contain it.
pub(super) const RUN: u32 = 39;

/// The bits of such a row id besides the run.
const WITHIN_RUN: i64 = (1 << RUN) - 1;

/// A table whose rows are results of a run.
#[derive(Debug)]
pub(super) struct ResultTable {
    pub(super) name: &'static str,
    /// The first column, which names the run.
    run: RunColumn,
    /// The columns besides the first one; the rest of the key comes first.
    columns: &'static [&'static str],
    /// How many of these columns belong to the key.
    in_key: usize,
    /// Whether the first of these columns is the id of a metric, which differs between stores.
    pub(super) is_by_metric: bool,
    /// The migration that made the table: stores of earlier versions lack it.
    since: usize,
    pub(super) digest: InDigest,
    /// Whether another run of the job may lack the rows, because an earlier release made or copied it.
    pub(super) is_optional: bool,
}

/// How rows name their run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum RunColumn {
    /// By the column `run`.
    Run,
    /// By the upper bits of the column `id`.
    Id,
}

/// How the digest of a run covers a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum InDigest {
    /// With a mark before the rows.
    Marked,
    /// Without a mark, so that runs without rows keep the digest that they had before there was the table.
    Unmarked,
    /// Like [`InDigest::Unmarked`], but not in digests of release 0.1.0 of trials in the family `step_count`.
    UnmarkedSince,
    /// Not at all: rows can be added to a completed run.
    No,
}

const fn by_run(
    name: &'static str,
    columns: &'static [&'static str],
    in_key: usize,
    since: usize,
) -> ResultTable {
    let (run, digest) = (RunColumn::Run, InDigest::Unmarked);
    ResultTable {
        name,
        run,
        columns,
        in_key,
        since,
        digest,
        is_by_metric: false,
        is_optional: false,
    }
}

const fn by_id(name: &'static str, columns: &'static [&'static str], since: usize) -> ResultTable {
    ResultTable { run: RunColumn::Id, ..by_run(name, columns, 0, since) }
}

impl ResultTable {
    const fn marked(self) -> Self {
        ResultTable { digest: InDigest::Marked, ..self }
    }

    const fn by_metric(self) -> Self {
        ResultTable { is_by_metric: true, ..self.marked() }
    }

    const fn optional(self) -> Self {
        ResultTable { is_optional: true, ..self }
    }

    const fn digest(self, digest: InDigest) -> Self {
        ResultTable { digest, ..self }
    }
}

/// Ten steps of a recorded decision: the columns of their numbers.
macro_rules! packed {
    ($($step:literal)*) => {
        &["steps", "bits", $(
            concat!("probability_", $step),
            concat!("habituation_", $step),
            concat!("disengagement_", $step),
            concat!("action_probability_", $step),
            concat!("reward_", $step),
        )*]
    };
}

/// All tables of results, in the order of the digest.
pub(super) static RESULT_TABLES: [ResultTable; 15] = [
    by_run("run_metric", &["metric", "value"], 1, 1).by_metric(),
    by_run("curve_point", &["metric", "episode", "value"], 2, 1).by_metric(),
    by_run("test_episode", &["episode", "total_reward", "length", "disengaged"], 1, 1).marked(),
    by_run("action_count", &["bin", "context", "action", "count"], 3, 1).marked(),
    by_run("trained_weights", &["safetensors"], 0, 1).marked(),
    by_id("recorded_decision", packed!(0 1 2 3 4 5 6 7 8 9), 4),
    by_id("recorded_participant", &["value"], 6),
    by_id("recorded_choice", &["bits", "probabilities"], 9).optional(),
    by_id("recorded_ending", &["length", "ending"], 15).optional(),
    by_run("action_total", &["action", "count"], 1, 12).digest(InDigest::UnmarkedSince),
    by_run(
        "recorded_step",
        &[
            "phase",
            "episode",
            "step",
            "available",
            "can_send",
            "chosen_action",
            "action",
            "action_probability",
            "action_probabilities",
            "reward",
            "state",
        ],
        3,
        12,
    )
    .digest(InDigest::UnmarkedSince)
    .optional(),
    by_run("recorded_description", &["description"], 0, 12).digest(InDigest::UnmarkedSince),
    by_run("recorded_posterior", &["number", "action", "step", "mean", "covariance"], 2, 16),
    by_run(
        "recorded_person",
        &["number", "person", "action", "step", "mean", "covariance", "deviation"],
        3,
        19,
    ),
    by_run(
        "recorded_estimate",
        &[
            "declaration",
            "number",
            "term",
            "estimate",
            "standard_error",
            "degrees_of_freedom",
            "low",
            "high",
            "p_value",
            "decisions",
            "residual_sd",
            "truth",
            "failure",
            "sha256",
            "treatment_variance",
            "effective_sample_size",
        ],
        2,
        14,
    )
    .digest(InDigest::No),
];

/// The statements of a table.
pub(super) struct Statements {
    /// The values of the rows of run `?1` in order: those of [`ResultTable::width`].
    pub(super) select: String,
    /// The rows of metric `?2` of run `?1` in order, with the name of the metric; empty for other tables.
    pub(super) of_metric: String,
    /// Inserts one row.
    pub(super) insert_one: String,
    /// Inserts [`ROWS`] rows.
    pub(super) insert_many: String,
}

/// The number of rows that one statement inserts. More rows are hardly faster: the overhead of a statement equals the
/// cost of three rows.
pub(super) const ROWS: usize = 32;

/// The statements of all tables.
static STATEMENTS: LazyLock<Vec<Statements>> =
    LazyLock::new(|| RESULT_TABLES.iter().map(Statements::of).collect());

impl Statements {
    fn of(table: &ResultTable) -> Statements {
        let ResultTable { name, run, columns, in_key, .. } = table;
        let (first, read, order) = match run {
            RunColumn::Run => ("run", None, columns[..*in_key].join(", ")),
            RunColumn::Id => ("id", Some(format!("id & {WITHIN_RUN}")), "id".to_owned()),
        };
        let read: Vec<&str> = read.as_deref().into_iter().chain(columns.iter().copied()).collect();
        let order = if order.is_empty() { order } else { format!(" ORDER BY {order}") };
        let row = format!("({})", vec!["?"; 1 + columns.len()].join(", "));
        let names = columns.join(", ");
        let insert = |rows: usize| {
            let rows = vec![row.as_str(); rows].join(", ");
            format!("INSERT INTO {name} ({first}, {names}) VALUES {rows}")
        };
        let read = read.join(", ");
        Statements {
            select: format!("SELECT {read} FROM {name} WHERE {}{order}", table.rows()),
            of_metric: if table.is_by_metric { table.of_metric() } else { String::new() },
            insert_one: insert(1),
            insert_many: insert(ROWS),
        }
    }
}

/// The table of recorded decisions whose steps are packed.
pub(super) fn packed_decisions() -> &'static ResultTable {
    RESULT_TABLES.iter().find(|table| table.name == "recorded_decision").expect("it is listed")
}

/// The tables whose rows a digest covers, and which a copy carries with it, each with its statements.
pub(super) fn digested() -> impl Iterator<Item = (&'static ResultTable, &'static Statements)> {
    let all = RESULT_TABLES.iter().zip(&*STATEMENTS);
    all.filter(|(table, _)| table.digest != InDigest::No)
}

impl ResultTable {
    /// The condition for the rows of run `?1`.
    pub(super) fn rows(&self) -> String {
        match self.run {
            RunColumn::Run => "run = ?1".to_owned(),
            RunColumn::Id => format!("id BETWEEN ?1 << {RUN} AND (?1 << {RUN}) + {WITHIN_RUN}"),
        }
    }

    fn of_metric(&self) -> String {
        let ResultTable { name, columns, in_key, .. } = self;
        let order = columns[1..*in_key].join(", ");
        let order = if order.is_empty() { order } else { format!(" ORDER BY {order}") };
        format!(
            "SELECT metric_name.name, {} FROM {name} JOIN metric_name ON metric_name.id = metric
             WHERE run = ?1 AND metric = ?2{order}",
            columns[1..].join(", ")
        )
    }

    /// Whether the file has rows of a run in the table.
    pub(super) fn has_rows(&self, connection: &Connection, run: i64) -> rusqlite::Result<bool> {
        if !self.is_in(connection)? {
            return Ok(false);
        }
        let sql = format!("SELECT 1 FROM {} WHERE {}", self.name, self.rows());
        connection.prepare_cached(&sql)?.exists([run])
    }

    /// Whether the file has the table.
    pub(super) fn is_in(&self, connection: &Connection) -> rusqlite::Result<bool> {
        Ok(self.since == 1 || has_table(connection, self.name)?)
    }

    /// The number of values that are read of a row: all but the run.
    pub(super) fn width(&self) -> usize {
        self.columns.len() + usize::from(self.run == RunColumn::Id)
    }

    /// The first column of a row of run `own`, given the first value that was read of the row, and how many of the
    /// values that were read it stands for.
    pub(super) fn first_of(&self, own: i64, read: &Value) -> (Value, usize) {
        match (self.run, read) {
            (RunColumn::Run, _) => (own.into(), 0),
            (RunColumn::Id, Value::Integer(id)) => (Value::Integer(id | own << RUN), 1),
            // The table rejects such a row.
            (RunColumn::Id, _) => (Value::Null, 1),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::{Path, PathBuf};
    use std::sync::Arc;

    use rusqlite::{Connection, params};

    use super::*;
    use crate::job::metric::EPSILON;
    use crate::job::{
        ActionCount, CurvePoint, Decision, Estimate, EstimateDeclaration, Estimates, Outcome,
        ParticipantValue, Phase, RecordedPosterior, Results,
    };
    use crate::store::copy::copy;
    use crate::store::digest::{self, DigestForm};
    use crate::store::export::VIEWS;
    use crate::store::migrate::MIGRATIONS;
    use crate::store::sample::{begin_session, claim, job, results, trial};
    use crate::store::{Forgotten, Store, examine};

    /// The tables that are no results of a run.
    const OTHERS: [&str; 12] = [
        "experiment",
        "job",
        "experiment_job",
        "session",
        "failure_kind",
        "run",
        "metric_name",
        "implied_parameter",
        "earlier_manifest",
        "recorded_conflict",
        "recorded_command",
        "estimate_declaration",
    ];

    fn decisions(state: &[f64]) -> Vec<Decision> {
        let make_decision = |phase| Decision {
            phase,
            episode: 1,
            step: 0,
            state: state.into(),
            available: true,
            can_send: true,
            chosen: 1,
            action: 1,
            probabilities: [0.25, 0.75].into(),
            reward: 1.5,
            cost: 0.0,
            terminated: false,
            truncated: true,
        };
        vec![make_decision(Phase::Train), make_decision(Phase::Test)]
    }

    /// Results with rows in every table but those of decisions.
    fn everything() -> Results {
        let estimate = r#"{"control":[],"estimator":"wcls","moderators":[],"name":"effect","numerator":0.5,
            "outcome":"reward","treatment":"any message"}"#;
        let declaration = Arc::new(EstimateDeclaration::from_canonical(estimate).unwrap());
        let failed = Estimate { term: "1".to_owned(), effect: Err("no decisions".to_owned()) };
        Results {
            curve: vec![CurvePoint { episode: 10, metric: EPSILON, value: 0.5 }],
            actions: vec![
                ActionCount { stratum: Some(3), action: 1, count: 2 },
                ActionCount { stratum: None, action: 1, count: 2 },
            ],
            description: Some(r#"{"a":1}"#.to_owned()),
            participants: vec![ParticipantValue {
                phase: Phase::Test,
                episode: 1,
                parameter: 2,
                value: 0.5,
            }],
            posteriors: vec![
                RecordedPosterior {
                    update: 1,
                    step: 3,
                    person: 0,
                    action: 1,
                    mean: vec![0.5],
                    covariance: vec![1.0],
                    deviation: Vec::new(),
                },
                RecordedPosterior {
                    update: 1,
                    step: 3,
                    person: 2,
                    action: 1,
                    mean: vec![0.25],
                    covariance: vec![0.5],
                    deviation: Vec::new(),
                },
            ],
            estimates: vec![Estimates { declaration, terms: vec![failed] }],
            ..results()
        }
    }

    /// A store of runs that have rows in every table of results: one with states of any names, and one of the family
    /// with packed decisions.
    fn full(folder: &Path) -> PathBuf {
        let path = folder.join("jitai.sqlite");
        let mut store = Store::open(&path).unwrap();
        let session = begin_session(&mut store);
        let names = results().state_names;
        let packed = Results {
            actions: vec![ActionCount { stratum: Some(3), action: 1, count: 2 }],
            description: None,
            decisions: decisions(&[1.0, 0.25, 1.0, 0.1, 0.1]),
            state_names: names,
            ..everything()
        };
        let steps = Results {
            decisions: decisions(&[1.5]),
            state_names: vec!["x".to_owned()],
            ..everything()
        };
        for (job, results) in [(job(), packed), (trial(), steps)] {
            let claim = claim(&mut store, session, &job);
            store.finish(&claim, &Outcome::Completed(results), 1.0).unwrap();
        }
        store.end_session(session).unwrap();
        path
    }

    fn count(connection: &Connection, table: &str) -> i64 {
        let sql = format!("SELECT count(*) FROM {table}");
        connection.query_row(&sql, [], |row| row.get(0)).unwrap()
    }

    fn counts(path: &Path) -> Vec<(&'static str, i64)> {
        let connection = Connection::open(path).unwrap();
        RESULT_TABLES.iter().map(|table| (table.name, count(&connection, table.name))).collect()
    }

    fn faults(path: &Path) -> Vec<String> {
        let diagnosis = examine(path, &|_, _| Ok(())).unwrap();
        diagnosis.findings.into_iter().map(|finding| finding.what).collect()
    }

    const WRONG: [&str; 2] =
        ["its results do not match their digest", "its estimates do not match their digests"];

    /// A copy of a store without the triggers, after a change.
    fn changed(path: &Path, name: &str, sql: &str) -> PathBuf {
        let copy = path.with_file_name(name);
        fs::copy(path, &copy).unwrap();
        let raw = Connection::open(&copy).unwrap();
        let triggers: Vec<(String, String)> = raw
            .prepare("SELECT name, sql FROM sqlite_schema WHERE type = 'trigger'")
            .unwrap()
            .query_map([], |row| Ok((row.get(0)?, row.get(1)?)))
            .unwrap()
            .collect::<rusqlite::Result<_>>()
            .unwrap();
        for (name, _) in &triggers {
            raw.execute_batch(&format!("DROP TRIGGER {name}")).unwrap();
        }
        let relaxed = "PRAGMA ignore_check_constraints = ON; PRAGMA foreign_keys = OFF";
        raw.execute_batch(&format!("{relaxed}; {sql}")).unwrap();
        triggers.iter().for_each(|(_, sql)| raw.execute_batch(sql).unwrap());
        copy
    }

    #[test]
    fn every_table_of_a_store_is_a_table_of_results_or_another_one() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(&folder.path().join("jitai.sqlite")).unwrap();
        let sql = "SELECT name FROM sqlite_schema WHERE type = 'table' AND name NOT GLOB 'sqlite_*'
            ORDER BY name";
        let mut found = store.connection.prepare(sql).unwrap();
        let found = found.query_map([], |row| row.get(0)).unwrap();
        let found: Vec<String> = found.collect::<rusqlite::Result<_>>().unwrap();
        let mut listed: Vec<&str> = RESULT_TABLES.iter().map(|table| table.name).collect();
        listed.extend(OTHERS);
        listed.sort_unstable();
        assert_eq!(found, listed);
    }

    #[test]
    fn every_column_of_every_table_of_results_is_covered_by_a_digest() {
        let folder = tempfile::tempdir().unwrap();
        let path = full(folder.path());
        assert!(counts(&path).iter().all(|(_, count)| *count > 0), "{:?}", counts(&path));
        let is_wrong = |path: &Path| faults(path).iter().any(|fault| WRONG.contains(&&**fault));
        assert!(!is_wrong(&path), "{:?}", faults(&path));
        let connection = Connection::open(&path).unwrap();
        for ResultTable { name: table, .. } in &RESULT_TABLES {
            let without = changed(&path, "without.sqlite", &format!("DELETE FROM {table}"));
            // A row of an estimate has a digest of its own; a run may have none.
            assert!(is_wrong(&without) || *table == "recorded_estimate", "{table}");
            let sql = format!("SELECT name FROM pragma_table_info('{table}')");
            let mut columns = connection.prepare(&sql).unwrap();
            let columns = columns.query_map([], |row| row.get(0)).unwrap();
            for column in columns.collect::<rusqlite::Result<Vec<String>>>().unwrap() {
                let of_packed = ["run", "declaration"].contains(&&*column)
                    || column.ends_with(|last: char| ('1'..='9').contains(&last));
                if of_packed {
                    continue;
                }
                let other = format!(
                    "UPDATE {table} SET {column} = CASE typeof({column}) WHEN 'text' THEN {column} || ' '
                        WHEN 'blob' THEN zeroblob(32) WHEN 'null' THEN NULL WHEN 'integer' THEN {column} + 1000000 ELSE {column} + 1 END"
                );
                let has_value = format!("SELECT count({column}) FROM {table}");
                let values: i64 = connection.query_row(&has_value, [], |row| row.get(0)).unwrap();
                let other = changed(&path, "other.sqlite", &other);
                assert!(is_wrong(&other) || values == 0, "{table}.{column}");
            }
        }
    }

    #[test]
    fn every_table_of_results_is_copied_and_forgotten() {
        let folder = tempfile::tempdir().unwrap();
        let path = full(folder.path());
        let other = folder.path().join("other.sqlite");
        let mut target = Store::open(&other).unwrap();
        copy(&Connection::open(&path).unwrap(), &mut target, &|_, _| Ok(()), |_, _| {}).unwrap();
        assert_eq!(counts(&other), counts(&path));
        let is_wrong = faults(&other).iter().any(|fault| WRONG.contains(&&**fault));
        assert!(!is_wrong, "{:?}", faults(&other));
        for seed in [job().seed, trial().seed] {
            let forgotten = target.forget(&format!("sweep {seed}"), true).unwrap();
            assert!(matches!(forgotten, Forgotten::Removed(_)), "{forgotten:?}");
        }
        assert!(counts(&other).iter().all(|(_, count)| *count == 0), "{:?}", counts(&other));
        assert_eq!(count(&target.connection, "run"), 0);
    }

    #[test]
    fn the_declarations_are_those_of_the_migrations() {
        let connection = Connection::open_in_memory().unwrap();
        for (index, migration) in MIGRATIONS.iter().enumerate() {
            connection.execute_batch(migration.sql).unwrap();
            for table in &RESULT_TABLES {
                let is_here = has_table(&connection, table.name).unwrap();
                assert_eq!(is_here, table.since <= index + 1, "{}: {}", migration.name, table.name);
            }
        }
        for table in &RESULT_TABLES {
            let sql = "SELECT name, pk FROM pragma_table_info(?1) ORDER BY cid";
            let mut columns = connection.prepare(sql).unwrap();
            let of_file: Vec<(String, usize)> = columns
                .query_map([table.name], |row| Ok((row.get(0)?, row.get(1)?)))
                .unwrap()
                .collect::<rusqlite::Result<_>>()
                .unwrap();
            let first = if table.run == RunColumn::Id { "id" } else { "run" };
            let listed = [first].into_iter().chain(table.columns.iter().copied());
            let in_key = 1 + table.in_key;
            let listed = listed
                .enumerate()
                .map(|(index, name)| (name.to_owned(), if index < in_key { index + 1 } else { 0 }));
            assert_eq!(of_file, listed.collect::<Vec<_>>(), "{}", table.name);
        }
    }

    #[test]
    fn doctor_finds_rows_of_an_unfinished_run_in_every_table_of_results() {
        let folder = tempfile::tempdir().unwrap();
        let path = full(folder.path());
        for ResultTable { name: table, .. } in &RESULT_TABLES {
            let others =
                RESULT_TABLES.iter().map(|table| table.name).filter(|other| other != table);
            let delete = others.map(|other| format!("DELETE FROM {other};"));
            let end = "UPDATE run SET status = 'interrupted', results_sha256 = NULL;";
            let sql = delete.collect::<String>() + end;
            let found = faults(&changed(&path, "unfinished.sqlite", &sql));
            let expected = "a run that is not completed has results";
            assert!(found.iter().any(|fault| fault == expected), "{table}: {found:?}");
        }
    }

    #[test]
    fn every_table_of_results_is_exported() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(&folder.path().join("jitai.sqlite")).unwrap();
        let sql = "SELECT group_concat(sql) FROM sqlite_schema WHERE type = 'view' AND name = ?1";
        let mut of_view = store.connection.prepare(sql).unwrap();
        let texts: Vec<String> =
            VIEWS.iter().map(|view| of_view.query_row([view], |row| row.get(0)).unwrap()).collect();
        for ResultTable { name: table, .. } in &RESULT_TABLES {
            // Weights are exported as policies, and descriptions belong to them.
            let is_of_policies = ["trained_weights", "recorded_description"].contains(table);
            assert!(is_of_policies || texts.iter().any(|text| text.contains(table)), "{table}");
        }
    }

    /// Makes the digest of the trial the digest of release 0.1.0, which did not cover its steps.
    fn uncover(path: &Path) {
        let raw = Connection::open(path).unwrap();
        let run: i64 =
            raw.query_row("SELECT DISTINCT run FROM recorded_step", [], |row| row.get(0)).unwrap();
        let earlier = digest::of_run_in(&raw, run, DigestForm::WithoutSteps).unwrap();
        raw.execute_batch("DROP TRIGGER run_ends_once").unwrap();
        raw.execute("UPDATE run SET results_sha256 = ?2 WHERE id = ?1", params![run, earlier])
            .unwrap();
    }

    #[test]
    fn a_trial_of_the_first_release_verifies_is_named_and_is_copied_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = full(folder.path());
        let earlier = folder.path().join("earlier.sqlite");
        fs::copy(&path, &earlier).unwrap();
        uncover(&earlier);
        let found = examine(&earlier, &|_, _| Ok(())).unwrap();
        assert_eq!((found.completed, found.intact, found.uncovered), (2, 2, 1));
        assert_eq!(examine(&path, &|_, _| Ok(())).unwrap().uncovered, 0);
        let merged = |from: &Path, to: &Path| {
            let from = Connection::open(from).unwrap();
            let mut target = Store::open(to).unwrap();
            let mut became = Vec::new();
            copy(&from, &mut target, &|_, _| Ok(()), |_, run| became.push(format!("{run:?}")))
                .unwrap();
            became
        };
        let target = folder.path().join("target.sqlite");
        assert_eq!(merged(&earlier, &target), ["Copied"; 2]);
        assert_eq!(counts(&target), counts(&earlier));
        assert_eq!(examine(&target, &|_, _| Ok(())).unwrap().uncovered, 1);
        // The same results under another digest are no conflict.
        assert_eq!(merged(&path, &target), ["AlreadyThere"; 2]);
        assert_eq!(merged(&target, &path), ["AlreadyThere"; 2]);
        // Nor are results of which an earlier release lost the steps when it copied them.
        let lost = changed(&earlier, "lost.sqlite", "DELETE FROM recorded_step");
        assert_eq!(merged(&lost, &path), ["AlreadyThere"; 2]);
        // Other changes of the run are found.
        let sql = "UPDATE recorded_posterior SET step = step + 1";
        let other = changed(&earlier, "other.sqlite", sql);
        assert_eq!(examine(&other, &|_, _| Ok(())).unwrap().intact, 0);
    }
}
