//! The list of the tables of results.

/// Every table whose rows are results of a run, with the condition for the rows of run `?1`. The ids of some contain
/// the run in their upper bits. Stores of earlier versions lack some of them.
pub(super) const RESULT_TABLES: [(&str, &str); 14] = [
    ("run_metric", BY_RUN),
    ("curve_point", BY_RUN),
    ("test_episode", BY_RUN),
    ("action_count", BY_RUN),
    ("trained_weights", BY_RUN),
    ("recorded_decision", BY_ID),
    ("recorded_participant", BY_ID),
    ("recorded_choice", BY_ID),
    ("recorded_ending", BY_ID),
    ("action_total", BY_RUN),
    ("recorded_step", BY_RUN),
    ("recorded_description", BY_RUN),
    ("recorded_posterior", BY_RUN),
    ("recorded_estimate", BY_RUN),
];

const BY_RUN: &str = "run = ?1";
const BY_ID: &str = "id BETWEEN ?1 << 39 AND (?1 << 39) + 549755813887";

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
    use crate::store::digest::{self, Form};
    use crate::store::export::VIEWS;
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
        let of = |phase| Decision {
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
        vec![of(Phase::Train), of(Phase::Test)]
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
            posteriors: vec![RecordedPosterior {
                update: 1,
                step: 3,
                action: 1,
                mean: vec![0.5],
                covariance: vec![1.0],
            }],
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
        RESULT_TABLES.iter().map(|(table, _)| (*table, count(&connection, table))).collect()
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
        let mut listed: Vec<&str> = RESULT_TABLES.iter().map(|(table, _)| *table).collect();
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
        for (table, _) in RESULT_TABLES {
            let without = changed(&path, "without.sqlite", &format!("DELETE FROM {table}"));
            // A row of an estimate has a digest of its own; a run may have none.
            assert!(is_wrong(&without) || table == "recorded_estimate", "{table}");
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
    fn doctor_finds_rows_of_an_unfinished_run_in_every_table_of_results() {
        let folder = tempfile::tempdir().unwrap();
        let path = full(folder.path());
        for (table, _) in RESULT_TABLES {
            let others = RESULT_TABLES.iter().filter(|(other, _)| *other != table);
            let delete = others.map(|(other, _)| format!("DELETE FROM {other};"));
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
        for (table, _) in RESULT_TABLES {
            // Weights are exported as policies, and descriptions belong to them.
            let is_of_policies = ["trained_weights", "recorded_description"].contains(&table);
            assert!(is_of_policies || texts.iter().any(|text| text.contains(table)), "{table}");
        }
    }

    /// Makes the digest of the trial the digest of release 0.1.0, which did not cover its steps.
    fn uncover(path: &Path) {
        let raw = Connection::open(path).unwrap();
        let run: i64 =
            raw.query_row("SELECT DISTINCT run FROM recorded_step", [], |row| row.get(0)).unwrap();
        let earlier = digest::of_run_in(&raw, run, Form::WithoutSteps).unwrap();
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
