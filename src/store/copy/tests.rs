//! Copying between stores that the store module has written.

use std::path::{Path, PathBuf};

use rusqlite::{Connection, params};

use crate::job::metric::{EPSILON, metrics_of};
use crate::job::{
    CurvePoint, Decision, Failure, FailureKind, Job, MetricPlace, Outcome, Phase, Results,
    TestEpisode,
};

use crate::store::digest;
use crate::store::sample::{begin_session, claim, job, results};
use crate::store::{Experiment, SessionId, Store};

use super::{Copied, Ended, Origins, RunCopy, copy};

/// A store with its own session, in a temporary folder.
struct Sample {
    _folder: tempfile::TempDir,
    path: PathBuf,
    store: Store,
    session: SessionId,
}

impl Sample {
    fn new() -> Sample {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("jitai.sqlite");
        let mut store = Store::open(&path).unwrap();
        let session = begin_session(&mut store);
        Sample { _folder: folder, path, store, session }
    }

    fn run(&mut self, job: &Job, outcome: &Outcome) {
        let claim = claim(&mut self.store, self.session, job);
        self.store.finish(&claim, outcome, 1.5).unwrap();
    }

    fn number(&self, sql: &str) -> i64 {
        self.store.connection.query_row(sql, [], |row| row.get(0)).unwrap()
    }

    fn text(&self, sql: &str) -> String {
        self.store.connection.query_row(sql, [], |row| row.get(0)).unwrap()
    }

    /// Copies the runs of another store; returns the numbers copied and the result for each run.
    fn copy(&mut self, from: &Path) -> (Copied, Vec<(Ended, RunCopy)>) {
        let from = Connection::open(from).unwrap();
        let mut heard = Vec::new();
        let copied = copy(&from, &mut self.store, &|_, _| Ok(()), |run, became| {
            heard.push((run.ended, became));
        });
        (copied.unwrap(), heard)
    }

    /// Copies the runs of another store; returns the result for each run as a word.
    fn became(&mut self, from: &Path) -> Vec<&'static str> {
        let word = |(_, became)| match became {
            RunCopy::Copied => "copied",
            RunCopy::AlreadyThere => "already there",
            RunCopy::Conflict(_) => "conflict",
            RunCopy::InProgress => "in progress",
            RunCopy::Damaged(_) => "damaged",
        };
        self.copy(from).1.into_iter().map(word).collect()
    }

    /// All rows that do not depend on the ids and times of one store.
    fn rows(&self) -> Vec<String> {
        let sql = "SELECT concat_ws('|', experiment, job_key, agent, status, attempt, mean_return,
                wall_seconds, started_at, ended_at, code_version, failure_kind, failure_message)
                FROM run_summary
            UNION ALL SELECT concat_ws('|', job_key, name, value) FROM metric
            UNION ALL SELECT concat_ws('|', job_key, episode, metric, value) FROM learning_curve
            UNION ALL SELECT concat_ws('|', job_key, episode, total_reward, length, disengaged)
                FROM evaluation_episode
            UNION ALL SELECT concat_ws('|', job_key, p_low, context, action, count)
                FROM action_choice
            UNION ALL SELECT concat_ws('|', job_key, phase, episode, step, context, probability,
                    habituation, available, action, action_probability, reward, can_send,
                    chosen_action, action_probabilities, terminated, truncated)
                FROM decision
            UNION ALL SELECT concat_ws('|', hex(safetensors), hex(results_sha256))
                FROM run LEFT JOIN trained_weights ON run.id = run
            ORDER BY 1";
        let mut statement = self.store.connection.prepare(sql).unwrap();
        let rows = statement.query_map([], |row| row.get(0)).unwrap();
        rows.collect::<rusqlite::Result<_>>().unwrap()
    }
}

fn seed(seed: u64) -> Job {
    Job { seed, ..job() }
}

fn completed() -> Outcome {
    let point = |episode, metric| CurvePoint { episode, metric, value: 0.5 };
    let curve = metrics_of(MetricPlace::Curve).map(|metric| point(10, metric)).collect();
    Outcome::Completed(Results { curve, decisions: decisions(), ..results() })
}

/// Decisions of two phases, more than one row of the table can hold.
fn decisions() -> Vec<Decision> {
    let make_decisions = |phase| {
        (0..13).map(move |step| Decision {
            phase,
            episode: 1,
            step,
            state: [1.0, 0.25, 1.0, 0.1 * f64::from(step % 3), 0.1].into(),
            available: true,
            can_send: true,
            chosen: 3,
            action: 3,
            probabilities: [0.125, 0.25, 0.125, 0.5].into(),
            reward: f64::from(step),
            cost: 0.0,
            terminated: false,
            truncated: step == 12,
        })
    };
    make_decisions(Phase::Train).chain(make_decisions(Phase::Test)).collect()
}

/// Results of the same job that differ in one reward.
fn otherwise_completed() -> Outcome {
    let episodes = vec![TestEpisode { total_reward: 51.0, length: 2, terminated: true }];
    Outcome::Completed(Results { episodes, ..results() })
}

fn failed() -> Outcome {
    let message = "the loss is not a number".to_owned();
    Outcome::Failed(Failure { kind: FailureKind::Diverged, message, episode: 3 })
}

/// A store with two completed jobs, one of which was interrupted first, and a failed job.
fn source() -> Sample {
    let mut source = Sample::new();
    source.run(&seed(1), &completed());
    source.run(&seed(2), &Outcome::Interrupted);
    source.run(&seed(2), &completed());
    source.run(&seed(3), &failed());
    source.store.end_session(source.session).unwrap();
    source
}

#[test]
fn a_copy_has_every_row_and_a_second_one_inserts_nothing() {
    let source = source();
    let mut target = Sample::new();
    let (copied, runs) = target.copy(&source.path);
    assert_eq!(copied, Copied { experiments: 3, jobs: 3, ..Copied::default() });
    let ended = [Ended::Completed, Ended::Interrupted, Ended::Completed, Ended::Failed];
    assert_eq!(runs, ended.map(|ended| (ended, RunCopy::Copied)));
    assert_eq!(target.rows(), source.rows());

    let changes = target.store.connection.total_changes();
    let (copied, runs) = target.copy(&source.path);
    assert_eq!(copied, Copied::default());
    assert!(runs.iter().all(|(_, became)| *became == RunCopy::AlreadyThere), "{runs:?}");
    assert_eq!(target.store.connection.total_changes(), changes);
}

#[test]
fn a_conflict_is_reported_and_the_run_of_the_target_is_kept() {
    let source = source();
    let mut target = Sample::new();
    target.run(&seed(1), &otherwise_completed());
    let before = target.text("SELECT hex(results_sha256) FROM run");
    let (_, runs) = target.copy(&source.path);
    let (_, RunCopy::Conflict(origins)) = &runs[0] else { panic!("{runs:?}") };
    let Origins { theirs, ours } = &**origins;
    assert!(runs[1..].iter().all(|(_, became)| *became == RunCopy::Copied), "{runs:?}");
    assert_eq!(ours.results_sha256.to_uppercase(), before);
    let digest = source.text("SELECT hex(results_sha256) FROM run");
    assert_eq!(theirs.results_sha256.to_uppercase(), digest);
    assert_eq!((&*theirs.host, &*theirs.processor, &*theirs.code_version), ("4", "5", "1"));
    assert_eq!(target.text("SELECT hex(results_sha256) FROM run WHERE id = 1"), before);
    assert_eq!(target.number("SELECT total_reward = 51 FROM test_episode WHERE run = 1"), 1);
}

/// Makes a store whose decisions were recorded by an earlier release, without the choices.
fn forget_choices(store: &Sample) {
    let raw = &store.store.connection;
    raw.execute_batch(
        "DROP TRIGGER recorded_choice_stays; DROP TRIGGER IF EXISTS run_ends_once; DELETE FROM recorded_choice",
    )
    .unwrap();
    renew_digests(store);
}

/// Stores the digests of the results as they are.
fn renew_digests(store: &Sample) {
    let raw = &store.store.connection;
    let mut completed = raw.prepare("SELECT id FROM run WHERE status = 'completed'").unwrap();
    let runs = completed.query_map([], |row| row.get(0)).unwrap();
    for run in runs.collect::<rusqlite::Result<Vec<i64>>>().unwrap() {
        let digest = digest::of_run(raw, run).unwrap();
        raw.execute("UPDATE run SET results_sha256 = ?2 WHERE id = ?1", params![run, digest])
            .unwrap();
    }
}

#[test]
fn the_same_results_without_a_record_of_choices_are_no_conflict() {
    let (with, mut without, mut target, mut other) =
        (source(), Sample::new(), Sample::new(), Sample::new());
    without.copy(&with.path);
    target.copy(&with.path);
    let Outcome::Completed(results) = otherwise_completed() else { unreachable!() };
    other.run(&seed(1), &Outcome::Completed(Results { decisions: decisions(), ..results }));
    forget_choices(&without);
    forget_choices(&other);
    assert_eq!(target.became(&without.path), ["already there"; 4]);
    assert_eq!(target.became(&other.path), ["conflict"]);
    assert_eq!(target.rows(), with.rows());
    assert_eq!(without.became(&with.path), ["already there"; 4]);
}

/// Makes the runs of a store those of a version that did not record how training episodes ended.
fn forget_endings(store: &Sample) {
    let raw = &store.store.connection;
    raw.execute_batch(
        "DROP TRIGGER recorded_ending_stays; DROP TRIGGER run_ends_once; DELETE FROM recorded_ending",
    )
    .unwrap();
    renew_digests(store);
}

#[test]
fn the_same_results_without_a_record_of_endings_are_no_conflict() {
    let (with, mut without, mut target) = (source(), Sample::new(), Sample::new());
    without.copy(&with.path);
    target.copy(&with.path);
    let endings =
        "SELECT concat_ws(' ', sum(terminated), sum(truncated), count(terminated), count(*))
        FROM decision WHERE phase = 'train'";
    assert_eq!(target.text(endings), "0 2 26 26");
    forget_endings(&without);
    assert_eq!(without.text(endings), "0 26");
    assert_eq!(target.became(&without.path), ["already there"; 4]);
    assert_eq!(without.became(&with.path), ["already there"; 4]);
    // A run with neither was made by a still earlier version.
    forget_choices(&without);
    assert_eq!(target.became(&without.path), ["already there"; 4]);
    assert_eq!(target.rows(), with.rows());
}

#[test]
fn a_damaged_run_is_left_out_and_is_no_conflict() {
    let source = source();
    let raw = Connection::open(&source.path).unwrap();
    raw.execute_batch(
        "DROP TRIGGER run_metric_is_fixed;
         UPDATE run_metric SET value = 2.0 WHERE run = 1 AND metric = 1",
    )
    .unwrap();
    let expected = ["damaged", "copied", "copied", "copied"];
    let mut target = Sample::new();
    assert_eq!(target.became(&source.path), expected);
    for table in ["run_metric", "curve_point", "test_episode", "trained_weights"] {
        assert_eq!(target.number(&format!("SELECT count(DISTINCT run) FROM {table}")), 1);
    }
    let sessions = target.number("SELECT count(*) FROM session");
    let again = ["damaged", "already there", "already there", "already there"];
    assert_eq!(target.became(&source.path), again);
    assert_eq!(target.number("SELECT count(*) FROM session"), sessions);
    let mut with_other_results = Sample::new();
    with_other_results.run(&seed(1), &otherwise_completed());
    assert_eq!(with_other_results.became(&source.path), expected);
}

#[test]
fn a_run_whose_weights_are_found_wrong_is_left_out() {
    let source = source();
    let from = Connection::open(&source.path).unwrap();
    let mut target = Sample::new();
    let check = |job: &Job, weights: Option<&[u8]>| match (job.seed, weights) {
        (1, Some(_)) => Err("too few".to_owned()),
        (_, Some(_)) => Ok(()),
        (_, None) => Err("none".to_owned()),
    };
    let mut became = Vec::new();
    copy(&from, &mut target.store, &check, |_, run| became.push(run)).unwrap();
    let damaged = RunCopy::Damaged("its weights do not load: too few".to_owned());
    assert_eq!(became, [damaged, RunCopy::Copied, RunCopy::Copied, RunCopy::Copied]);
}

#[test]
fn attempts_of_two_stores_are_numbered_on() {
    let mut source = Sample::new();
    source.run(&seed(1), &Outcome::Interrupted);
    source.run(&seed(1), &completed());
    let mut target = Sample::new();
    // The target has metrics in another order than the source.
    let first = CurvePoint { episode: 10, metric: EPSILON, value: 0.5 };
    target.run(&seed(7), &Outcome::Completed(Results { curve: vec![first], ..results() }));
    target.run(&seed(1), &Outcome::Interrupted);
    assert_eq!(target.became(&source.path), ["copied"; 2]);
    let attempts = "SELECT group_concat(attempt || ' ' || status, ', ' ORDER BY attempt) FROM run
        WHERE job = (SELECT job FROM run WHERE attempt = 3)";
    assert_eq!(target.text(attempts), "1 interrupted, 2 interrupted, 3 completed");
    assert_eq!(target.became(&source.path), ["already there"; 2]);
}

#[test]
fn a_job_that_runs_in_the_target_is_left_to_it() {
    let source = source();
    let mut target = Sample::new();
    let claim = claim(&mut target.store, target.session, &seed(1));
    assert_eq!(target.became(&source.path)[0], "in progress");
    target.store.finish(&claim, &Outcome::Interrupted, 1.0).unwrap();
    assert_eq!(target.became(&source.path)[0], "copied");
}

#[test]
fn a_run_in_progress_is_not_copied() {
    let mut source = source();
    let session = begin_session(&mut source.store);
    claim(&mut source.store, session, &seed(4));
    let mut target = Sample::new();
    let (copied, runs) = target.copy(&source.path);
    assert_eq!((copied.jobs, runs.len()), (4, 4));
}

#[test]
fn an_experiment_keeps_its_manifest_and_gains_jobs() {
    let experiment =
        |manifest| Experiment { name: "sweep", question: None, hypothesis: None, manifest };
    let mut source = Sample::new();
    source.store.register(&experiment("theirs"), [("dqn", seed(1)), ("dqn", seed(2))]).unwrap();
    let mut target = Sample::new();
    target.store.register(&experiment("ours"), [("dqn", seed(1))]).unwrap();
    let (copied, _) = target.copy(&source.path);
    assert_eq!((copied.experiments, copied.jobs), (0, 1));
    assert_eq!(target.text("SELECT manifest FROM experiment"), "ours");
    assert_eq!(target.number("SELECT count(*) FROM experiment_job"), 2);
}

#[test]
fn a_session_comes_with_its_runs_and_has_ended_as_in_the_source() {
    let source = source();
    let mut target = Sample::new();
    target.copy(&source.path);
    let session = "SELECT concat_ws('|', host, process_id, code_version, git_revision, backend,
        processor, started_at, heartbeat_at, ended_at) FROM session
        WHERE id = (SELECT max(session) FROM run)";
    assert_eq!(target.text(session), source.text(session));
    assert_eq!(target.number("SELECT count(*) FROM session WHERE ended_at IS NOT NULL"), 1);
}

#[test]
fn many_results_are_copied_in_several_transactions() {
    let mut source = Sample::new();
    for number in 1..=5 {
        let weights = Some(vec![number as u8; 3 << 20]);
        source.run(&seed(number), &Outcome::Completed(Results { weights, ..results() }));
    }
    let mut target = Sample::new();
    let raw = Connection::open(&target.path).unwrap();
    let from = Connection::open(&source.path).unwrap();
    let mut seen: Vec<i64> = Vec::new();
    copy(&from, &mut target.store, &|_, _| Ok(()), |_, _| {
        seen.push(raw.query_row("SELECT count(*) FROM run", [], |row| row.get(0)).unwrap());
    })
    .unwrap();
    // Three runs of 3 MiB fill a batch.
    assert_eq!(seen, [3, 3, 3, 5, 5]);
}
