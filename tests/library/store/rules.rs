//! The file itself rejects invalid states, whichever program writes them.

use rusqlite::Connection;
use rusqlite::types::Value;

use super::sample::{Sample, completed, dqn, failed, number};

const END: &str = "ended_at = '2026-01-31T12:00:00.000Z'";
const DIGEST: &str = "results_sha256 = zeroblob(32)";
const RESULTS: &str =
    "INSERT INTO run_metric VALUES (1, 1, 2.5), (1, 2, 2.5), (1, 3, 2.5), (1, 4, 0.5);
    INSERT INTO test_episode VALUES (1, 1, 2.5, 50, 0);
    INSERT INTO trained_weights VALUES (1, x'00');";

/// A store in which run 1, of job 1, is running.
fn running() -> (Sample, Connection) {
    let job = dqn(0.4, 1);
    let mut sample = Sample::with(std::slice::from_ref(&job));
    sample.claim(&job);
    let raw = sample.raw();
    raw.execute_batch(
        "INSERT INTO metric_name VALUES (1, 'mean_return'), (2, 'sd_return'), (3, 'mean_length'),
            (4, 'disengagement_rate'), (5, 'message_rate')",
    )
    .unwrap();
    (sample, raw)
}

fn refused(raw: &Connection, sql: &str, reason: &str) {
    let error = raw.execute_batch(sql).expect_err(sql).to_string();
    assert!(error.contains(reason), "{sql}\n{error}");
}

#[test]
fn a_completed_run_has_an_end_a_wall_time_and_a_digest() {
    let (_sample, raw) = running();
    raw.execute_batch(RESULTS).unwrap();
    refused(
        &raw,
        "UPDATE run SET status = 'completed', wall_seconds = 1, results_sha256 = zeroblob(32)",
        "CHECK",
    );
    refused(&raw, &format!("UPDATE run SET status = 'completed', {END}, {DIGEST}"), "CHECK");
    refused(
        &raw,
        &format!("UPDATE run SET status = 'completed', {END}, wall_seconds = 1"),
        "CHECK",
    );
    refused(
        &raw,
        &format!("UPDATE run SET status = 'interrupted', {END}, {DIGEST}"),
        "only a completed run",
    );
    refused(
        &raw,
        &format!("UPDATE run SET status = 'completed', {END}, wall_seconds = -1, {DIGEST}"),
        "CHECK",
    );
    refused(
        &raw,
        &format!("UPDATE run SET status = 'completed', {END}, wall_seconds = 9e999, {DIGEST}"),
        "CHECK",
    );
    raw.execute_batch(&format!(
        "UPDATE run SET status = 'completed', {END}, wall_seconds = 1, {DIGEST}"
    ))
    .unwrap();
}

#[test]
fn a_completed_run_has_metrics_and_episodes() {
    let complete =
        format!("UPDATE run SET status = 'completed', {END}, wall_seconds = 1, {DIGEST}");
    for missing in ["run_metric", "test_episode"] {
        let (_sample, raw) = running();
        for insert in RESULTS.split_inclusive(';').filter(|insert| !insert.contains(missing)) {
            raw.execute_batch(insert).unwrap();
        }
        refused(&raw, &complete, "a completed run has its metrics and test episodes");
    }
}

#[test]
fn a_completed_run_has_every_metric_of_the_summary() {
    let complete =
        format!("UPDATE run SET status = 'completed', {END}, wall_seconds = 1, {DIGEST}");
    for missing in 1..=4 {
        let (_sample, raw) = running();
        // The same number of metrics, but one of them is not in the summary.
        let other = RESULTS.replace(&format!("(1, {missing}, "), "(1, 5, ");
        raw.execute_batch(&other).unwrap();
        refused(&raw, &complete, "a completed run has its metrics and test episodes");
    }
}

#[test]
fn a_running_run_has_neither_end_nor_wall_time() {
    let (_sample, raw) = running();
    refused(&raw, &format!("UPDATE run SET {END}"), "CHECK");
    refused(&raw, "UPDATE run SET wall_seconds = 1", "CHECK");
}

#[test]
fn a_failed_run_has_kind_message_and_episode() {
    let (_sample, raw) = running();
    let fail = |kind: &str, message: &str, episode: &str| {
        format!(
            "UPDATE run SET status = 'failed', {END}, wall_seconds = 1, failure_kind = {kind},
                failure_message = {message}, failure_episode = {episode}, {DIGEST}"
        )
    };
    refused(&raw, &fail("NULL", "'nan'", "1"), "CHECK");
    refused(&raw, &fail("'diverged'", "NULL", "1"), "CHECK");
    refused(&raw, &fail("'diverged'", "'nan'", "NULL"), "CHECK");
    refused(&raw, &fail("'diverged'", "'nan'", "-1"), "CHECK");
    refused(&raw, &fail("'bored'", "'nan'", "1"), "FOREIGN KEY");
    let without_digest = fail("'diverged'", "'nan'", "1").replace(&format!(", {DIGEST}"), "");
    refused(&raw, &without_digest, "CHECK");
    raw.execute_batch(&fail("'diverged'", "'nan'", "1")).unwrap();
}

#[test]
fn only_a_failed_run_has_a_failure() {
    let (_sample, raw) = running();
    for column in ["failure_kind = 'panicked'", "failure_message = 'x'", "failure_episode = 3"] {
        refused(&raw, &format!("UPDATE run SET {column}"), "CHECK");
        refused(&raw, &format!("UPDATE run SET status = 'interrupted', {END}, {column}"), "CHECK");
    }
}

#[test]
fn the_kinds_of_failure_are_those_of_the_program() {
    let (_sample, raw) = running();
    let mut statement = raw.prepare("SELECT name FROM failure_kind ORDER BY name").unwrap();
    let names: Vec<String> =
        statement.query_map([], |row| row.get(0)).unwrap().collect::<Result<_, _>>().unwrap();
    let mut known: Vec<&str> = jitai::job::FailureKind::WORDS.to_vec();
    known.sort_unstable();
    assert_eq!(names, known);
}

#[test]
fn a_run_has_one_of_four_statuses() {
    let (_sample, raw) = running();
    refused(&raw, &format!("UPDATE run SET status = 'done', {END}, wall_seconds = 1"), "CHECK");
}

#[test]
fn a_job_has_one_running_or_completed_run() {
    let job = dqn(0.4, 1);
    let mut sample = Sample::with(std::slice::from_ref(&job));
    let raw = sample.raw();
    let again = "INSERT INTO run (job, attempt, session, status, started_at)
        VALUES (1, 9, 1, 'running', '2026-01-31T12:00:00.000Z')";
    let claim = sample.claim(&job);
    refused(&raw, again, "a job has one running or completed run");
    sample.store.finish(&claim, &completed(), 1.0).unwrap();
    refused(&raw, again, "a job has one running or completed run");
}

#[test]
fn attempts_at_a_job_have_different_numbers() {
    let job = dqn(0.4, 1);
    let mut sample = Sample::with(std::slice::from_ref(&job));
    sample.run(&job, &failed());
    let insert = |attempt: i64| {
        format!(
            "INSERT INTO run (job, attempt, session, status, started_at)
             VALUES (1, {attempt}, 1, 'running', '2026-01-31T12:00:00.000Z')"
        )
    };
    refused(&sample.raw(), &insert(1), "a run begins once");
    refused(&sample.raw(), &insert(0), "CHECK");
    sample.raw().execute_batch(&insert(2)).unwrap();
}

#[test]
fn a_run_begins_running() {
    let (_sample, raw) = running();
    refused(
        &raw,
        &format!(
            "UPDATE run SET status = 'interrupted', {END};
             INSERT INTO run (job, attempt, session, status, started_at, ended_at, wall_seconds)
             VALUES (1, 2, 1, 'completed', '2026-01-31T12:00:00.000Z',
                '2026-01-31T12:00:00.000Z', 1)"
        ),
        "a run begins running",
    );
}

#[test]
fn a_run_that_has_ended_never_changes() {
    for outcome in [completed(), failed(), jitai::job::Outcome::Interrupted] {
        let job = dqn(0.4, 1);
        let mut sample = Sample::with(std::slice::from_ref(&job));
        sample.run(&job, &outcome);
        let raw = sample.raw();
        for change in
            ["status = 'running', ended_at = NULL", "wall_seconds = 3", "failure_episode = 1"]
        {
            refused(&raw, &format!("UPDATE run SET {change}"), "an ended run never changes");
        }
        refused(&raw, "DELETE FROM run", "a run is never deleted");
    }
}

#[test]
fn a_run_stays_the_same_attempt_by_the_same_session() {
    let (_sample, raw) = running();
    for change in ["attempt = 7", "job = 1", "session = 1", "started_at = ended_at", "id = 9"] {
        refused(&raw, &format!("UPDATE run SET {change}"), "a run stays the same attempt");
    }
    refused(&raw, "DELETE FROM run", "a run is never deleted");
}

#[test]
fn only_a_run_in_progress_takes_results() {
    let inserts = [
        "INSERT INTO run_metric VALUES (1, 1, 2.5)",
        "INSERT INTO curve_point VALUES (1, 1, 20, 2.5)",
        "INSERT INTO test_episode VALUES (1, 99, 2.5, 50, 0)",
        "INSERT INTO action_count VALUES (1, 0, 0, 0, 1)",
        "INSERT INTO trained_weights VALUES (1, x'00')",
    ];
    for outcome in [completed(), failed(), jitai::job::Outcome::Interrupted] {
        let job = dqn(0.4, 1);
        let mut sample = Sample::with(std::slice::from_ref(&job));
        sample.run(&job, &outcome);
        for insert in inserts {
            refused(&sample.raw(), insert, "results belong to a run in progress");
        }
    }
    // Results without a run are rejected as well.
    let empty = Sample::new();
    for insert in inserts {
        refused(&empty.raw(), insert, "results belong to a run in progress");
    }
}

#[test]
fn a_run_that_does_not_complete_leaves_no_results() {
    for insert in RESULTS.split_inclusive(';').filter(|insert| insert.contains("INSERT")) {
        let (_sample, raw) = running();
        raw.execute_batch(insert).unwrap();
        refused(
            &raw,
            &format!("UPDATE run SET status = 'interrupted', {END}"),
            "only a completed run has results",
        );
    }
}

#[test]
fn results_never_change() {
    let job = dqn(0.4, 1);
    let mut sample = Sample::with(std::slice::from_ref(&job));
    sample.run(&job, &completed());
    let raw = sample.raw();
    for (table, column) in [
        ("run_metric", "value"),
        ("curve_point", "value"),
        ("test_episode", "total_reward"),
        ("action_count", "count"),
        ("trained_weights", "run"),
    ] {
        refused(&raw, &format!("UPDATE {table} SET {column} = 1"), "results never change");
        refused(&raw, &format!("DELETE FROM {table}"), "results are never deleted");
    }
}

#[test]
fn results_are_finite_and_in_range() {
    let (_sample, raw) = running();
    for insert in [
        "INSERT INTO run_metric VALUES (1, 1, 9e999)",
        "INSERT INTO curve_point VALUES (1, 1, 10, -9e999)",
        "INSERT INTO curve_point VALUES (1, 1, 0, 1)",
        "INSERT INTO test_episode VALUES (1, 1, 9e999, 50, 0)",
        "INSERT INTO test_episode VALUES (1, 0, 1, 50, 0)",
        "INSERT INTO test_episode VALUES (1, 1, 1, 0, 0)",
        "INSERT INTO test_episode VALUES (1, 1, 1, 50, 2)",
        "INSERT INTO action_count VALUES (1, 10, 0, 0, 1)",
        "INSERT INTO action_count VALUES (1, 0, 2, 0, 1)",
        "INSERT INTO action_count VALUES (1, 0, 0, 4, 1)",
        "INSERT INTO action_total VALUES (1, 256, 1)",
        "INSERT INTO action_count VALUES (1, 0, 0, 0, 0)",
        "INSERT INTO trained_weights VALUES (1, x'')",
    ] {
        refused(&raw, insert, "CHECK");
    }
    refused(&raw, "INSERT INTO run_metric VALUES (1, 1, NULL)", "NOT NULL");
    refused(&raw, "INSERT INTO run_metric VALUES (1, 1, 'many')", "cannot store TEXT");
}

#[test]
fn instants_have_one_form() {
    let (_sample, raw) = running();
    for instant in
        ["2026-01-31 12:00:00", "2026-01-31T12:00:00Z", "2026-02-30T12:00:00.000Z", "soon"]
    {
        refused(&raw, &format!("UPDATE session SET heartbeat_at = '{instant}'"), "CHECK");
        refused(&raw, &format!("UPDATE session SET ended_at = '{instant}'"), "CHECK");
        refused(&raw, &format!("UPDATE experiment SET created_at = '{instant}'"), "CHECK");
        refused(
            &raw,
            &format!("UPDATE run SET status = 'interrupted', ended_at = '{instant}'"),
            "CHECK",
        );
    }
}

#[test]
fn a_job_is_its_content_and_never_changes() {
    let (_sample, raw) = running();
    refused(&raw, "UPDATE job SET canonical = '{}'", "a job never changes");
    let insert = |key: &str, canonical: &str| {
        format!(
            "INSERT INTO job (key, environment_version, algorithm_version, canonical)
             VALUES ('{key}', 1, 1, '{canonical}')"
        )
    };
    refused(&raw, &insert("0123456789abcdef", "{}"), "CHECK");
    refused(&raw, &insert("0123456789ABCDEF0123456789ABCDEF", "{}"), "CHECK");
    refused(&raw, &insert("0123456789abcdef0123456789abcdef", "{"), "CHECK");
    raw.execute_batch(&insert("0123456789abcdef0123456789abcdef", "{}")).unwrap();
    refused(&raw, &insert("0123456789abcdef0123456789abcdef", "{}"), "a job is made once");
    refused(&raw, "DELETE FROM job WHERE id > 1", "a job is never deleted");
}

#[test]
fn replacing_deletes_nothing() {
    let jobs = [dqn(0.4, 1), dqn(0.4, 2)];
    let mut sample = Sample::with(&jobs);
    sample.run(&jobs[0], &completed());
    sample.run(&jobs[1], &failed());
    let raw = sample.raw();
    let at = "'2026-01-31T12:00:00.000Z'";
    let run = |id: &str, job: i64, attempt: i64| {
        format!(
            "INSERT OR REPLACE INTO run (id, job, attempt, session, status, started_at)
             VALUES ({id}, {job}, {attempt}, 1, 'running', {at})"
        )
    };
    let job_row = |id: &str, key: &str| {
        format!(
            "INSERT OR REPLACE INTO job (id, key, environment_version, algorithm_version, canonical)
             VALUES ({id}, {key}, 1, 1, '{{}}')"
        )
    };
    let process = "process_id, code_version, git_revision, backend, processor, started_at,
        heartbeat_at) VALUES (1, 'lab', 7, '0', '0', '0', '0'";
    for (sql, reason) in [
        (run("1", 2, 9), "a run begins once"),
        (run("NULL", 2, 1), "a run begins once"),
        (run("NULL", 1, 9), "a job has one running or completed run"),
        (job_row("1", "'0123456789abcdef0123456789abcdef'"), "a job is made once"),
        (job_row("NULL", "(SELECT max(key) FROM job)"), "a job is made once"),
        (
            format!("INSERT OR REPLACE INTO session (id, host, {process}, {at}, {at})"),
            "a session begins once",
        ),
        ("INSERT OR REPLACE INTO metric_name VALUES (1, 'x')".into(), "is given once"),
        ("INSERT OR REPLACE INTO metric_name VALUES (99, 'sd_return')".into(), "is given once"),
        ("INSERT OR REPLACE INTO trained_weights VALUES (1, x'00')".into(), "results belong"),
    ] {
        refused(&raw, &sql, reason);
    }
    let kept = "SELECT count(*) FROM run JOIN run_metric ON run = run.id JOIN job ON job.id = job";
    assert_eq!(number(&raw, kept), 6);
    assert_eq!(number(&raw, "SELECT count(*) FROM run"), 2);
}

#[test]
fn results_are_written_once() {
    let jobs = [dqn(0.4, 1), dqn(0.4, 2)];
    let mut sample = Sample::with(&jobs);
    sample.run(&jobs[0], &completed());
    sample.claim(&jobs[1]);
    let raw = sample.raw();
    for (table, key, value, replaced, other) in [
        ("run_metric", "1", "2.5", "3.5", "value = 0.5"),
        ("curve_point", "1, 10", "2.5", "3.5", "value = 0.5"),
        ("test_episode", "1", "9.5, 3, 0", "8.5, 3, 0", "length = 4"),
        ("action_count", "9, 0, 2", "5", "7", "count = 6"),
        ("trained_weights", "", "x'00'", "x'02'", "safetensors = x'01'"),
    ] {
        let row_of = |run: i64| {
            let columns: Vec<String> = [run.to_string().as_str(), key, value]
                .into_iter()
                .filter(|part| !part.is_empty())
                .map(str::to_owned)
                .collect();
            format!("INTO {table} VALUES ({})", columns.join(", "))
        };
        let rows = |run: i64| -> Vec<Vec<Value>> {
            let mut rows =
                raw.prepare(&format!("SELECT * FROM {table} WHERE run = {run}")).unwrap();
            let columns = rows.column_count();
            rows.query_map([], |row| (0..columns).map(|column| row.get(column)).collect())
                .unwrap()
                .map(Result::unwrap)
                .collect()
        };
        let of_the_ended = rows(1);
        assert!(!of_the_ended.is_empty(), "{table}");
        let instead =
            |run: i64| format!("INSERT {} ON CONFLICT DO UPDATE SET {other}", row_of(run));
        for verb in ["INSERT", "INSERT OR REPLACE", "INSERT OR IGNORE"] {
            let insert = format!("{verb} {}", row_of(1));
            refused(&raw, &insert, "results belong to a run in progress");
        }
        refused(&raw, &instead(1), "results belong to a run in progress");
        // A run in progress may replace only its own results.
        raw.execute_batch(&format!("INSERT {}", row_of(2))).unwrap();
        let before = rows(2);
        refused(&raw, &format!("INSERT {}", row_of(2)), "UNIQUE constraint failed");
        refused(&raw, &instead(2), "results never change");
        let replace = format!("INSERT OR REPLACE {}", row_of(2)).replace(value, replaced);
        raw.execute_batch(&replace).unwrap();
        assert_eq!(rows(2).len(), before.len(), "{table}");
        assert_ne!(rows(2), before, "{table}");
        assert_eq!(rows(1), of_the_ended, "{table}");
    }
}

#[test]
fn the_name_of_a_metric_never_changes() {
    let (_sample, raw) = running();
    refused(&raw, "UPDATE metric_name SET name = 'x' WHERE id = 1", "never changes");
    refused(&raw, "DELETE FROM metric_name", "never deleted");
    refused(&raw, "INSERT INTO metric_name VALUES (-1, 'x')", "CHECK");
}

#[test]
fn a_session_stays_the_same_process_and_ends_once() {
    let (_sample, raw) = running();
    for column in [
        "id",
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
    ] {
        let change = format!("UPDATE session SET {column} = {column}");
        refused(&raw, &change, "a session stays the same process");
    }
    refused(&raw, "DELETE FROM session", "a session is never deleted");
    raw.execute_batch("UPDATE session SET heartbeat_at = '2026-01-31T12:00:00.000Z'").unwrap();
    raw.execute_batch(&format!("UPDATE session SET {END}")).unwrap();
    for change in [END, "ended_at = NULL", "heartbeat_at = '2026-01-31T12:00:00.000Z'"] {
        refused(&raw, &format!("UPDATE session SET {change}"), "an ended session never changes");
    }
}

#[test]
fn no_run_begins_in_a_session_that_has_ended_or_never_was() {
    let mut sample = Sample::with(&[dqn(0.4, 1)]);
    sample.store.end_session(sample.session).unwrap();
    for session in [1, 77] {
        let begin = format!(
            "INSERT INTO run (job, attempt, session, status, started_at)
             VALUES (1, 1, {session}, 'running', '2026-01-31T12:00:00.000Z')"
        );
        refused(&sample.raw(), &begin, "a run begins in a session that has not ended");
    }
}
