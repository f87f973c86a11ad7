//! A failed job is a row in the store, and the other jobs continue.

use std::num::NonZeroUsize;
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use jitai::job::{Job, JobKey, Outcome, Provenance};
use jitai::manifest;
use jitai::plan::{self};
use jitai::schedule::{
    self, Context, Event, EventSink, OnFailure, Options, Queued, QueuedFor, Tally,
};
use jitai::store::{Experiment, RetryFailed, SessionId, Store};
use jitai::train::{self, TrainingControl};

use crate::support::{self, Effort, Folder};

/// Two jobs whose loss overflows at the second update, and two jobs that complete.
pub fn partly_diverging() -> String {
    let layers = ["64"; 24].join(", ");
    format!(
        "format = 1
name = \"sweep\"
scenarios = [\"P-H-D\"]
seeds = 2
environment.sigma = 0.6
evaluation.test_episodes = 20
[[agent]]
name = \"wild\"
algorithm = \"dueling_dqn\"
episodes = 50
layers = [{layers}]
batch = 8
learning_rate = 1.0
[[agent]]
name = \"tame\"
algorithm = \"reinforce\"
episodes = 10
layers = [8]
"
    )
}

/// The agent, attempt and status of every run.
fn runs(folder: &Folder) -> Vec<(String, i64, String)> {
    let store = folder.store();
    let mut statement = store
        .prepare("SELECT agent, attempt, status FROM run_summary ORDER BY agent, seed, attempt")
        .unwrap();
    let rows = statement.query_map([], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?))).unwrap();
    rows.collect::<Result<_, _>>().unwrap()
}

fn run(agent: &str, attempt: i64, status: &str) -> (String, i64, String) {
    (agent.to_owned(), attempt, status.to_owned())
}

#[test]
fn a_job_that_diverges_is_a_failed_row_and_the_others_complete() {
    let folder = Folder::with(&partly_diverging());
    let ended = folder.jitai(["run", "sweep.toml"]).ended(1);
    let ended = ended
        .says("4 jobs run, 2 completed in all, 2 failed")
        .prints("wild P-H-D sigma=0.6 seed=1 and 1 more job: diverged");
    let row = |agent| ended.stdout.lines().find(|line| line.starts_with(agent)).unwrap();
    assert!(row("wild ").ends_with("0 of 2"), "{}", ended.stdout);
    assert!(row("tame ").contains("  2  "), "{}", ended.stdout);
    assert!(ended.stdout.contains("run them again with `--retry-failed`"), "{}", ended.stdout);
    let expected =
        [("tame", "completed"), ("tame", "completed"), ("wild", "failed"), ("wild", "failed")];
    assert_eq!(runs(&folder), expected.map(|(agent, status)| run(agent, 1, status)));
    let told = "SELECT count(*) FROM run WHERE failure_kind = 'diverged' \
                AND failure_message LIKE 'the loss of update % is %' AND failure_episode < 50";
    assert_eq!(folder.number(told), 2);

    let status = folder.jitai(["status"]).succeeded();
    status
        .prints("failed:")
        .prints("wild P-H-D sigma=0.6 seed=1")
        .prints("diverged")
        .prints("the loss of update");
    let counts = folder.jitai(["status", "--format", "json"]).succeeded().json();
    assert_eq!((&counts[0]["completed"], &counts[0]["failed"]), (&2.into(), &2.into()));
    assert_eq!(counts[0]["pending"], 0);
    let failures = counts[0]["failures"].as_array().unwrap();
    assert_eq!(failures.len(), 2);
    assert_eq!(
        (&failures[0]["failure_kind"], &failures[0]["attempt"]),
        (&"diverged".into(), &1.into())
    );
    let shown = "SELECT failure_message FROM run_summary WHERE job_key = ?1";
    let key = failures[0]["job_key"].as_str().unwrap();
    let message: String = folder.store().query_row(shown, [key], |row| row.get(0)).unwrap();
    assert_eq!(failures[0]["failure_message"], message);
}

#[test]
fn the_same_failure_is_listed_once_with_the_number_of_its_jobs() {
    let text = "format = 1\nname = \"sweep\"\nscenarios = [\"P-H-D\"]\nseeds = 3\n\
        environment.sigma = 0.6\nevaluation.test_episodes = 20\n[[agent]]\nname = \"absent\"\n\
        algorithm = \"external\"\ncommand = [\"./absent\"]\nversion = \"1\"\nepisodes = 1\n";
    let folder = Folder::with(text);
    let run = folder.jitai(["run", "sweep.toml", "--workers", "1"]).ended(1);
    let again = folder.jitai(["run", "sweep.toml"]).ended(1);
    let status = folder.jitai(["status"]).succeeded();
    let reason = "install it on this machine";
    for (listed, of) in [
        (&run.stdout, "run"),
        (&run.stderr, "its progress"),
        (&again.stdout, "the next run"),
        (&status.stdout, "status"),
    ] {
        assert_eq!(listed.matches(reason).count(), 1, "{of}: {listed}");
    }
    for others in ["1 job", "2 jobs"] {
        let line = format!("failed (external) like {others} before");
        assert!(run.stderr.contains(&line), "{}", run.stderr);
    }
    assert!(run.stdout.contains("seed=1 and 2 more jobs: external ("), "{}", run.stdout);
    let row = status.stdout.lines().find(|line| line.contains(reason)).unwrap();
    assert!(row.split_whitespace().any(|word| word == "3"), "{row}");
    // Programs read every failed job.
    let counts = folder.jitai(["status", "--format", "json"]).succeeded().json();
    assert_eq!(counts[0]["failures"].as_array().unwrap().len(), 3);
}

#[test]
fn failed_jobs_stay_failed_until_a_retry_is_asked_for() {
    let folder = Folder::with(&partly_diverging());
    folder.jitai(["run", "sweep.toml"]).ended(1);
    let before = folder.everything();
    folder.jitai(["run", "sweep.toml"]).ended(1).says("0 jobs run, 2 completed in all, 2 failed");
    assert_eq!(folder.everything(), before);
    let plan = folder.jitai(["plan", "sweep.toml", "--jobs"]).succeeded();
    plan.prints("failed; runs with --retry-failed");

    folder.jitai(["run", "sweep.toml", "--retry-failed"]).ended(1).says("2 jobs run");
    let wild = [run("wild", 1, "failed"), run("wild", 2, "failed")];
    assert_eq!(runs(&folder)[2..], [wild.clone(), wild].concat());
}

#[test]
fn fail_fast_stops_at_the_first_failure_and_a_later_run_resumes() {
    let folder = Folder::with(&partly_diverging());
    let arguments = ["run", "sweep.toml", "--fail-fast", "--workers", "1"];
    folder.jitai(arguments).ended(1).says(
        "1 job run, 0 completed in all, 1 failed; halted after the first failure; 3 jobs left",
    );
    assert_eq!(runs(&folder), [run("wild", 1, "failed")]);
    folder.jitai(["run", "sweep.toml"]).ended(1).says("3 jobs run, 2 completed in all, 2 failed");
    assert_eq!(folder.runs(), 4);
}

#[test]
fn a_halt_by_fail_fast_is_an_event() {
    let folder = Folder::with(&partly_diverging());
    let arguments = ["run", "sweep.toml", "--fail-fast", "--workers", "1", "--format", "json"];
    let ended = folder.jitai(arguments).ended(1);
    let last: serde_json::Value =
        serde_json::from_str(ended.stdout.lines().last().unwrap()).unwrap();
    assert_eq!((&last["event"], &last["left"]), (&"halted".into(), &3.into()));
}

#[test]
fn a_run_lists_the_failures_of_its_own_manifests() {
    let folder = Folder::with(&partly_diverging());
    folder.jitai(["run", "sweep.toml"]).ended(1);
    let wilder = partly_diverging().replace("\"sweep\"", "\"other\"").replace("wild", "wilder");
    folder.write("other.toml", wilder.replace("seeds = 2", "seeds = [3]"));
    let ended = folder
        .jitai(["run", "other.toml"])
        .ended(1)
        .prints(" wilder P-H-D sigma=0.6 seed=3: diverged");
    assert!(!ended.stdout.contains(" wild:"), "{}", ended.stdout);
}

#[test]
fn failures_are_events() {
    let folder = Folder::with(&partly_diverging());
    let ended = folder.jitai(["run", "sweep.toml", "--format", "json"]).ended(1);
    let events: Vec<serde_json::Value> =
        ended.stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let count = |name: &str| events.iter().filter(|event| event["event"] == name).count();
    assert_eq!((count("started"), count("completed"), count("failed")), (4, 2, 2));
    let failed = events.iter().find(|event| event["event"] == "failed").unwrap();
    assert_eq!((&failed["kind"], &failed["job"]["agent"]), (&"diverged".into(), &"wild".into()));
    let last = events.last().unwrap();
    assert_eq!((&last["event"], &last["failed"]), (&"done".into(), &2.into()));
    assert!(ended.stderr.is_empty(), "{}", ended.stderr);
}

/// A manifest with an endless job and a short job, and a time limit in seconds.
fn partly_endless(seconds: u32) -> String {
    let endless = support::manifest("sweep", "0.6", "1", Effort::Endless);
    let head = format!("name = \"sweep\"\ntime_limit_seconds = {seconds}");
    endless.replace("name = \"sweep\"", &head).replace("10000000", "10")
}

#[test]
fn a_job_over_its_time_limit_is_a_failed_row_and_the_others_complete() {
    let folder = Folder::with(&partly_endless(1));
    let ended = folder.jitai(["run", "sweep.toml"]).ended(1);
    ended.says("2 jobs run, 1 completed in all, 1 failed").prints("over_time");
    assert_eq!(runs(&folder), [run("dqn", 1, "failed"), run("reinforce", 1, "completed")]);
    let told = "SELECT count(*) FROM run WHERE failure_kind = 'over_time' AND wall_seconds >= 1
        AND failure_episode > 0
        AND failure_message LIKE 'the job exceeded its time limit of 1 s; raise %'";
    assert_eq!(folder.number(told), 1);
    assert!(!folder.path("jitai.sqlite.checkpoints").exists());
    folder.jitai(["status"]).succeeded().prints("over_time");

    folder.jitai(["run", "sweep.toml", "--retry-failed"]).ended(1).says("1 job run");
    let failed = [run("dqn", 1, "failed"), run("dqn", 2, "failed")];
    assert_eq!(runs(&folder)[..2], failed);
    folder.jitai(["doctor"]).succeeded();
}

#[test]
fn a_time_limit_counts_what_was_worked_before_a_stop_and_makes_no_other_job() {
    let folder = Folder::with(&partly_endless(1000));
    let stopped = folder.start(["run", "sweep.toml"]);
    let worked = "SELECT count(*) FROM run WHERE status = 'completed' OR status = 'running'
        AND 86400 * (julianday('now') - julianday(started_at)) > 1.5";
    support::until("one job is done and the endless job has worked for more than a second", || {
        folder.count_if_there(worked) == Some(2)
    });
    stopped.signal("TERM");
    stopped.wait().ended(130);
    // Its time before the stop exceeds this limit.
    folder.write("sweep.toml", partly_endless(1));
    folder.jitai(["run", "sweep.toml"]).ended(1).says(": resumed from episode ");
    // More than it took since it was resumed.
    let counted = "SELECT count(*) FROM run WHERE attempt = 2 AND failure_kind = 'over_time'
        AND wall_seconds > 86400 * (julianday(ended_at) - julianday(started_at)) + 0.5";
    assert_eq!(folder.number(counted), 1);
    // The job without the limit is the same job, which has failed.
    folder.write("sweep.toml", partly_endless(1).replace("time_limit_seconds = 1\n", ""));
    folder.jitai(["run", "sweep.toml"]).ended(1).says("0 jobs run");
}

/// Records the outcome of each ended job.
#[derive(Default)]
struct Listener(Vec<(u64, Outcome)>);

impl EventSink for Listener {
    fn on_event(&mut self, event: Event<'_>) {
        match event {
            Event::Ended { queued, outcome, .. } => {
                self.0.push((queued.job.seed, outcome.clone()));
            }
            Event::Started { .. } | Event::Tick { .. } => {}
            Event::Lost { .. }
            | Event::Checkpoint { .. }
            | Event::Skipped { .. }
            | Event::FewerWorkers { .. } => {
                panic!("nothing of the kind: {event:?}");
            }
        }
    }
}

/// A store with a session of this process, and the registered and queued jobs of a manifest.
pub fn queued(folder: &Folder, text: &str) -> (Store, SessionId, Vec<Queued>) {
    let manifest = manifest::parse("sweep.toml", text.as_bytes()).unwrap();
    let mut store = Store::open(&folder.path("jitai.sqlite")).unwrap();
    let experiment = Experiment { name: "sweep", question: None, hypothesis: None, manifest: text };
    let jobs = plan::jobs(&manifest).map(|planned| (planned.agent, planned.job));
    store.register(&experiment, jobs).unwrap();
    let queue = plan::jobs(&manifest).map(|planned| Queued {
        key: planned.job.key(),
        agent: planned.agent.to_string(),
        job: planned.job,
        time_limit: None,
        estimates: Vec::new(),
        purpose: QueuedFor::Run,
        folder: ".".into(),
    });
    let session = store.begin_session(&provenance()).unwrap();
    (store, session, queue.collect())
}

pub fn provenance() -> Provenance {
    Provenance {
        code_version: "0.1.0".into(),
        git_revision: "unknown".into(),
        backend: "ndarray".into(),
        host: "here".into(),
        processor: "any".into(),
    }
}

/// Options with two workers and without retries.
pub const OPTIONS: Options = Options {
    workers: NonZeroUsize::new(2).unwrap(),
    retry_failed: RetryFailed::No,
    on_failure: OnFailure::Continue,
    checkpoint_every: Duration::from_secs(20),
};

/// Runs a sweep of two seeds and both agents in this process.
fn sweep(folder: &Folder, train: schedule::Train<'_>) -> (Tally, Listener) {
    let text = support::manifest("sweep", "0.6", "2", Effort::Trivial);
    let (mut store, session, queue) = queued(folder, &text);
    let context = Context { options: OPTIONS, train, stop: &AtomicBool::new(false), curves: None };
    let mut listener = Listener::default();
    let tally = schedule::run(&mut store, session, queue, context, &mut listener).unwrap();
    store.end_session(session).unwrap();
    (tally, listener)
}

#[test]
fn a_panic_in_a_job_is_a_failed_row_with_its_text_and_place() {
    let folder = Folder::new();
    let train = |job: &Job, control: &dyn TrainingControl| {
        assert!(job.algorithm() != "reinforce" || job.seed != 2, "no luck with seed {}", job.seed);
        train::run(job, control)
    };
    let (tally, listener) = sweep(&folder, &train);
    assert_eq!(tally, Tally { completed: 3, failed: 1, ..Tally::default() });
    let failed: Vec<_> = listener
        .0
        .iter()
        .filter_map(|(seed, outcome)| match outcome {
            Outcome::Failed(failure) => Some((*seed, failure.message.clone())),
            Outcome::Completed(_) | Outcome::Interrupted => None,
        })
        .collect();
    assert_eq!(failed.len(), 1);
    let (seed, message) = &failed[0];
    assert_eq!(*seed, 2);
    assert!(message.starts_with("no luck with seed 2 (tests/cli/failures.rs:"), "{message}");
    let row = "SELECT count(*) FROM run WHERE status = 'failed' AND failure_kind = 'panicked' \
               AND failure_message LIKE 'no luck with seed 2 (tests/cli/failures.rs:%)'";
    assert_eq!(folder.number(row), 1);
    assert_eq!(folder.number("SELECT count(*) FROM run WHERE status = 'completed'"), 3);
    folder.jitai(["status"]).succeeded().prints("panicked").prints("no luck with seed 2");
}

#[test]
fn jobs_that_are_trained_again_for_estimates_come_last_and_beside_no_run() {
    let folder = Folder::new();
    let text = support::manifest("sweep", "0.6", "4", Effort::Trivial);
    let (mut store, session, mut queue) = queued(&folder, &text);
    let stop = AtomicBool::new(false);
    let context = Context { options: OPTIONS, train: &train::run, stop: &stop, curves: None };
    let completed = queue[..4].to_vec();
    let mut listener = Listener::default();
    schedule::run(&mut store, session, completed, context, &mut listener).unwrap();
    queue[..4].iter_mut().for_each(|queued| queued.purpose = QueuedFor::Estimates);
    assert!(queue.iter().all(Queued::trains));
    let again: Vec<JobKey> = queue[..4].iter().map(|queued| queued.key).collect();
    let (running, begun) = (Mutex::new(Vec::new()), Mutex::new(Vec::new()));
    let train = |job: &Job, control: &dyn TrainingControl| {
        let is_again = again.contains(&job.key());
        let mut beside = running.lock().unwrap();
        begun.lock().unwrap().push((is_again, beside.iter().all(|other| *other == is_again)));
        beside.push(is_again);
        drop(beside);
        let outcome = train::run(job, control);
        let mut beside = running.lock().unwrap();
        let index = beside.iter().position(|other| *other == is_again).unwrap();
        beside.swap_remove(index);
        outcome
    };
    let context = Context { train: &train, ..context };
    let tally = schedule::run(&mut store, session, queue, context, &mut listener).unwrap();
    assert_eq!((tally.completed, tally.estimated.trained), (4, 4));
    let order = begun.into_inner().unwrap();
    assert_eq!(order, [[(false, true); 4], [(true, true); 4]].concat());
    store.end_session(session).unwrap();
}

#[test]
fn a_panic_without_a_text_and_one_after_another_are_rows_too() {
    let folder = Folder::new();
    let (tally, _) = sweep(&folder, &|_: &Job, _: &dyn TrainingControl| std::panic::panic_any(17));
    assert_eq!(tally, Tally { failed: 4, ..Tally::default() });
    let rows = "SELECT count(*) FROM run WHERE failure_kind = 'panicked' \
                AND failure_message LIKE 'a panic without a message (%'";
    assert_eq!(folder.number(rows), 4);
}

/// An environment whose rewards are as large as its parameter.
const LARGE: &str = r#"
import json, sys
for line in sys.stdin:
    m = json.loads(line)
    if m["type"] == "describe":
        size = m["parameters"]["size"]
        said = {"type": "description", "protocol": 1, "features": [{"name": "x"}], "actions": ["a", "b"], "horizon": 1}
    elif m["type"] == "reset":
        said = {"type": "began", "observations": [[0.0] for _ in m["lanes"]]}
    elif m["type"] == "step":
        said = {"type": "stepped", "observations": [[0.0] for _ in m["lanes"]], "rewards": [size * a for a in m["actions"]],
                "truncated": [True for _ in m["lanes"]]}
    else:
        continue
    print(json.dumps(said), flush=True)
"#;

#[test]
fn a_job_whose_results_overflow_fails_with_the_name_of_the_number() {
    let folder = Folder::with(
        r#"format = 1
name = "sweep"
scenarios = ["all"]
seeds = 1
[environment]
family = "external"
command = ["python3", "large.py"]
version = "1"
parameters = { size = [1e300, 1.0] }
[evaluation]
test_episodes = 10
[[agent]]
name = "random"
algorithm = "rule"
rule = "random"
"#,
    );
    folder.write("large.py", LARGE);
    folder.jitai(["run", "sweep.toml", "--workers", "1", "--quiet"]).ended(1);
    let statuses = "SELECT group_concat(status) FROM (SELECT status FROM run_summary ORDER BY 1)";
    let statuses: String = folder.store().query_row(statuses, [], |row| row.get(0)).unwrap();
    assert_eq!(statuses, "completed,failed");
    let failure = "SELECT count(*) FROM run_summary WHERE failure_kind = 'diverged'
        AND failure_message LIKE 'sd_return is %'";
    assert_eq!(folder.number(failure), 1);
    folder.jitai(["doctor"]).succeeded();
}
