//! Queries of users: they only read the store.

use std::fs;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use jitai::store::{Answer, QueryError, Reader, SqlValue};

use super::sample::{Sample, completed, dqn};

fn sample() -> Sample {
    let mut sample = Sample::with(&[dqn(0.4, 1)]);
    sample.run(&dqn(0.4, 1), &completed());
    sample
}

/// An answer as lines of text.
fn ask(reader: &Reader, sql: &str) -> Result<Vec<String>, QueryError> {
    let mut lines = Vec::new();
    reader.query(sql, |answer| {
        lines.push(match answer {
            Answer::Columns(names) => names.join("|"),
            Answer::Row(values) => {
                values.iter().map(|value| format!("{value:?}")).collect::<Vec<_>>().join("|")
            }
        });
        ControlFlow::Continue(())
    })?;
    Ok(lines)
}

#[test]
fn an_answer_has_its_columns_and_then_its_rows() {
    let sample = sample();
    let reader = Reader::open(&sample.path).unwrap();
    let answer = ask(&reader, "SELECT 1 AS a, 2.5, 'é', NULL AS d, x'00ff';").unwrap();
    assert_eq!(answer[0], "a|2.5|'é'|d|x'00ff'");
    assert_eq!(answer[1], "Integer(1)|Real(2.5)|Text(\"é\")|Null|Blob([0, 255])");
    assert_eq!(ask(&reader, "SELECT agent FROM run_summary WHERE false").unwrap(), ["agent"]);
    assert_eq!(ask(&reader, "SELECT CAST(x'ff' AS TEXT) AS t").unwrap()[1], "Blob([255])");
    for sql in [
        "WITH RECURSIVE n (i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n LIMIT 3) SELECT i FROM n",
        "VALUES (1), (2), (3)",
        "SELECT seed, status FROM run_summary UNION ALL SELECT 1, 2 UNION ALL SELECT 3, 4",
        "/* three */ SELECT value FROM json_each('[1,2,3]') -- of them",
    ] {
        assert_eq!(ask(&reader, sql).unwrap().len(), 4, "{sql}");
    }
    let twice = "SELECT 1 AS a, 2 AS b, 3 AS A, run.* FROM metric AS run JOIN metric USING (name)";
    assert_eq!(ask(&reader, twice).unwrap()[0], "a|b|A_2|job_key|name|value");
    assert_eq!(ask(&reader, "PRAGMA table_info(run_summary)").unwrap().len(), 23);
    assert!(ask(&reader, "EXPLAIN QUERY PLAN SELECT * FROM metric").unwrap().len() > 1);
}

#[test]
fn a_listener_can_break_off() {
    let sample = sample();
    let reader = Reader::open(&sample.path).unwrap();
    let mut heard = 0;
    let endless =
        "WITH RECURSIVE n (i) AS (VALUES (1) UNION ALL SELECT i + 1 FROM n) SELECT i FROM n";
    reader
        .query(endless, |answer| {
            heard += 1;
            match answer {
                Answer::Row([SqlValue::Integer(1000)]) => ControlFlow::Break(()),
                _ => ControlFlow::Continue(()),
            }
        })
        .unwrap();
    assert_eq!(heard, 1001);
}

#[test]
fn a_query_cannot_change_anything_or_reach_another_file() {
    let sample = sample();
    let folder = sample.path.parent().unwrap();
    let target = folder.join("other.sqlite");
    let target = target.to_str().unwrap();
    let before = fs::read(&sample.path).unwrap();
    let reader = Reader::open(&sample.path).unwrap();
    for sql in [
        "INSERT INTO metric_name (name) VALUES ('x')",
        "INSERT INTO metric_name (name) VALUES ('x') RETURNING id",
        "UPDATE session SET backend = 'x'",
        "DELETE FROM experiment_job",
        "DROP TABLE run",
        "DROP VIEW metric",
        "CREATE TABLE t (a)",
        "CREATE TEMP TABLE t (a)",
        "CREATE TEMP VIEW v AS SELECT 1",
        "CREATE VIRTUAL TABLE t USING fts5(a)",
        "ALTER TABLE run RENAME TO walk",
        "REINDEX",
        "ANALYZE",
        "VACUUM",
        &format!("VACUUM INTO '{target}'"),
        &format!("ATTACH '{target}' AS other"),
        "DETACH main",
        "BEGIN IMMEDIATE",
        "SAVEPOINT s",
        "COMMIT",
        "PRAGMA query_only = OFF",
        "PRAGMA query_only",
        "PRAGMA writable_schema = ON",
        "PRAGMA journal_mode = DELETE",
        "PRAGMA wal_checkpoint(TRUNCATE)",
        "PRAGMA user_version = 7",
        "SELECT load_extension('/tmp/x.so')",
        "SELECT LOAD_EXTENSION('/tmp/x.so')",
        "SELECT fts3_tokenizer('simple')",
    ] {
        let error = ask(&reader, sql).expect_err(sql);
        assert!(matches!(error, QueryError::NotAllowed), "{sql}: {error}");
    }
    for sql in [
        "SELECT readfile('/etc/passwd')",
        "SELECT writefile('x', 'y')",
        "SELECT edit('x')",
        "SELECT * FROM pragma_wal_checkpoint",
        "SELECT * FROM pragma_journal_mode('delete')",
    ] {
        ask(&reader, sql).expect_err(sql);
    }
    let names: Vec<_> = fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert!(!names.iter().any(|name| name.to_str().unwrap().contains("other")), "{names:?}");
    assert_eq!(fs::read(&sample.path).unwrap(), before);
    assert_eq!(ask(&reader, "SELECT count(*) FROM run").unwrap()[1], "Integer(1)");
}

#[test]
fn a_query_cannot_reach_outside_by_any_way_that_sql_has() {
    let sample = sample();
    let folder = sample.path.parent().unwrap();
    let before = fs::read(&sample.path).unwrap();
    let reader = Reader::open(&sample.path).unwrap();
    for sql in [
        // Disguised writes.
        "WITH x AS (SELECT 1) INSERT INTO metric_name (name) SELECT 'x' FROM x",
        "WITH x AS (SELECT 1) DELETE FROM experiment_job",
        "REPLACE INTO metric_name (id, name) VALUES (1, 'x')",
        "INSERT INTO sqlite_schema VALUES ('table', 'x', 'x', 0, 'x')",
        "UPDATE sqlite_schema SET sql = ''",
        "EXPLAIN DELETE FROM run; DELETE FROM run",
        "SELECT 1; ATTACH 'other.sqlite' AS other",
        "CREATE TEMP TRIGGER t AFTER INSERT ON run BEGIN SELECT 1; END",
        "CREATE TABLE copy AS SELECT * FROM run",
        "CREATE VIRTUAL TABLE temp.t USING rtree(a, b, c)",
        "CREATE INDEX i ON run (job)",
        // Other files.
        "ATTACH 'file:other.sqlite?mode=rwc' AS other",
        "ATTACH DATABASE ':memory:' AS other",
        "VACUUM main INTO 'other.sqlite'",
        "PRAGMA temp_store_directory = '/tmp'",
        "PRAGMA data_store_directory = '/tmp'",
        "SELECT * FROM fsdir('/')",
        "SELECT * FROM csv('/etc/passwd')",
        "SELECT * FROM zipfile('x.zip')",
        "SELECT * FROM fts5_source('/etc/passwd')",
        // Extensions.
        "SELECT load_extension('other')",
        "SELECT load_extension('other', 'sqlite3_extension_init') FROM run",
        "SELECT (SELECT load_extension('other'))",
        "WITH x AS (SELECT load_extension('other') AS a) SELECT a FROM x",
        // Settings, and locks on other processes.
        "PRAGMA locking_mode = EXCLUSIVE",
        "PRAGMA hard_heap_limit = 0",
        "PRAGMA trusted_schema = ON",
        "PRAGMA mmap_size = 1000000000",
        "PRAGMA schema_version = 9",
        "PRAGMA application_id = 1",
        "PRAGMA integrity_check",
        "PRAGMA table_info = 1; DROP TABLE run",
        "SELECT * FROM pragma_writable_schema",
        "SELECT * FROM pragma_database_list",
        "SELECT sqlite_compileoption_get(load_extension('other'))",
        "BEGIN EXCLUSIVE",
        "ROLLBACK",
        "RELEASE s",
    ] {
        let error = ask(&reader, sql).expect_err(sql);
        assert!(!matches!(error, QueryError::Damaged { .. }), "{sql}: {error}");
    }
    assert_eq!(fs::read(&sample.path).unwrap(), before);
    let names: Vec<_> = fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name()).collect();
    let of_store = |name: &std::ffi::OsString| name.to_str().unwrap().starts_with("jitai.sqlite");
    assert!(names.iter().all(of_store), "{names:?}");
    assert_eq!(ask(&reader, "SELECT count(*) FROM run").unwrap()[1], "Integer(1)");
}

#[test]
fn a_query_cannot_fill_the_memory() {
    let sample = sample();
    let reader = Reader::open(&sample.path).unwrap();
    for sql in [
        "SELECT length(zeroblob(1000000000))",
        "SELECT length(randomblob(1000000000))",
        "SELECT length(printf('%1000000000d', 1))",
        "SELECT length(replace(hex(zeroblob(1000000)), '0', hex(zeroblob(1000))))",
        "WITH RECURSIVE n (i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n LIMIT 1000)
         SELECT length(group_concat(hex(zeroblob(1000000)))) FROM n",
        "WITH RECURSIVE n (i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n LIMIT 1000)
         SELECT json_group_array(hex(zeroblob(1000000))) FROM n",
    ] {
        let error = ask(&reader, sql).expect_err(sql);
        assert!(matches!(error, QueryError::TooLarge), "{sql}: {error}");
    }
    assert_eq!(ask(&reader, "SELECT length(zeroblob(1000000))").unwrap()[1], "Integer(1000000)");
}

#[test]
fn a_query_is_one_statement() {
    let sample = sample();
    let reader = Reader::open(&sample.path).unwrap();
    assert!(matches!(ask(&reader, "SELECT 1; SELECT 2"), Err(QueryError::Several)));
    for sql in ["", "  ", ";", "-- only words"] {
        assert!(matches!(ask(&reader, sql), Err(QueryError::Empty)), "{sql:?}");
    }
    assert_eq!(ask(&reader, "SELECT 1; -- and no more").unwrap().len(), 2);
    assert!(ask(&reader, "SELECT '\0'").is_err());
}

#[test]
fn faulty_sql_is_shown_with_its_place() {
    let sample = sample();
    let reader = Reader::open(&sample.path).unwrap();
    let error = ask(&reader, "SELECT agent,\n  mean_retrun\nFROM run_summary").unwrap_err();
    let error = error.to_string();
    let place = "no such column: mean_retrun at line 2, column 3\n    mean_retrun\n    ^\n";
    assert!(error.starts_with(place), "{error}");
    let help = "\nthe view run_summary has experiment, job_key, agent, ";
    assert!(error.contains(help) && error.lines().count() == 4, "{error}");
    let error = ask(&reader, "SELECT 1 WHERE x").unwrap_err().to_string();
    assert!(error.starts_with("no such column: x at") && error.ends_with('^'), "{error}");
    let error = ask(&reader, "SELECT * FORM metric").unwrap_err();
    assert!(error.to_string().starts_with("near \"FORM\": syntax error at line 1, column 10\n"));
    // SQLite reports no position for an unfinished statement.
    let error = ask(&reader, "SELECT * FROM").unwrap_err();
    assert!(error.to_string().contains("incomplete input"), "{error}");
    let error = ask(&reader, "SELECT * FROM runs").unwrap_err();
    assert_eq!(
        error.to_string(),
        "no such table: runs; the views are run_summary, parameter, metric, learning_curve, \
         evaluation_episode, action_choice, arm_summary, decision, participant, manifest, conflict, estimate, every_estimate, posterior, person_posterior"
    );
}

#[test]
fn a_query_can_take_roots() {
    let sample = sample();
    let reader = Reader::open(&sample.path).unwrap();
    let answer = ask(&reader, "SELECT sqrt(2), sqrt(9), sqrt(-1), sqrt(NULL), sqrt('x')").unwrap();
    assert_eq!(answer[1], "Real(1.4142135623730951)|Real(3.0)|Null|Null|Null");
}

#[test]
fn a_query_can_take_standard_deviations() {
    let sample = sample();
    let reader = Reader::open(&sample.path).unwrap();
    let deviation = |values: &str| {
        let sql = format!("SELECT stddev(x) FROM (SELECT 0 AS x WHERE 0 {values})");
        ask(&reader, &sql).unwrap().remove(1)
    };
    assert_eq!(deviation("UNION ALL VALUES (2), (4.0), (9)"), format!("Real({:?})", 13f64.sqrt()));
    assert_eq!(deviation("UNION ALL VALUES (1e9 + 1), (1e9 + 2), (1e9 + 3)"), "Real(1.0)");
    assert_eq!(deviation("UNION ALL VALUES (3), (NULL), (3), ('x')"), "Real(0.0)");
    assert_eq!(deviation("UNION ALL VALUES (3)"), "Null");
    assert_eq!(deviation(""), "Null");
    let by_group = "SELECT stddev(x) FROM (VALUES (1)), (SELECT 1 AS g, 5 AS x UNION ALL \
                    VALUES (1, 7), (2, 1), (2, 1)) GROUP BY g ORDER BY g";
    assert_eq!(
        ask(&reader, by_group).unwrap()[1..],
        [format!("Real({:?})", 2f64.sqrt()), "Real(0.0)".into()]
    );
}

#[test]
fn a_query_can_be_interrupted_from_another_thread() {
    let sample = sample();
    let reader = Reader::open(&sample.path).unwrap();
    let interrupter = reader.interrupter();
    let endless =
        "WITH RECURSIVE n (i) AS (VALUES (1) UNION ALL SELECT i + 1 FROM n) SELECT count(*) FROM n";
    let ended = AtomicBool::new(false);
    thread::scope(|scope| {
        // An interrupt before the query begins has no effect.
        scope.spawn(|| {
            while !ended.load(Ordering::Relaxed) {
                thread::sleep(Duration::from_millis(20));
                interrupter.interrupt();
            }
        });
        let answer = ask(&reader, endless);
        ended.store(true, Ordering::Relaxed);
        let error = answer.unwrap_err();
        assert!(matches!(error, QueryError::Interrupted), "{error}");
    });
    assert_eq!(ask(&reader, "SELECT 1").unwrap().len(), 2);
}
