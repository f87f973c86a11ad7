//! The events of a sweep when other processes work on the same jobs.

use std::sync::atomic::{AtomicBool, Ordering};

use jitai::job::Job;
use jitai::schedule::{self, Context, Event, EventSink, Found, Options, Tally};
use jitai::store::{Claimed, Isolation, RetryFailed, Store};
use jitai::train::{self, TrainingControl, Uncontrolled};
use rusqlite::Connection;

use crate::failures::{OPTIONS, provenance, queued};
use crate::support::{Effort, Folder, manifest};

/// Records the names of the events with the seeds of their jobs, and sets a flag at a skip.
struct Listener<'a> {
    heard: Vec<(&'static str, u64)>,
    stop_at_skip: &'a AtomicBool,
}

impl EventSink for Listener<'_> {
    fn on_event(&mut self, event: Event<'_>) {
        let (name, queued) = match event {
            Event::Started { queued, .. } => ("started", queued),
            Event::Ended { queued, .. } => ("ended", queued),
            Event::Lost { queued, .. } => ("lost", queued),
            Event::Skipped { queued, found } => {
                self.stop_at_skip.store(true, Ordering::Relaxed);
                match found {
                    Found::Completed => ("completed elsewhere", queued),
                    Found::Failed => ("failed elsewhere", queued),
                }
            }
            Event::FewerWorkers { .. } | Event::Checkpoint { .. } | Event::Tick { .. } => return,
        };
        self.heard.push((name, queued.job.seed));
    }
}

/// A manifest with one agent, so that a seed identifies a job.
fn text(seeds: &str) -> String {
    let both = manifest("sweep", "0.6", seeds, Effort::Trivial);
    let (before, _) = both.split_once("[[agent]]\nname = \"reinforce\"").unwrap();
    before.to_owned()
}

fn one_worker() -> Options {
    Options { workers: std::num::NonZeroUsize::MIN, ..OPTIONS }
}

#[test]
fn a_run_that_was_taken_over_is_reported_and_its_job_runs_again() {
    let folder = Folder::new();
    let (mut store, session, queue) = queued(&folder, &text("1"));
    let taken = AtomicBool::new(false);
    let train = |job: &Job, control: &dyn TrainingControl| {
        if !taken.swap(true, Ordering::Relaxed) {
            let other = Connection::open(folder.path("jitai.sqlite")).unwrap();
            let interrupt = "UPDATE run SET status = 'interrupted',
                ended_at = '2026-01-31T12:00:00.000Z' WHERE status = 'running'";
            assert_eq!(other.execute(interrupt, []).unwrap(), 1);
        }
        train::run(job, control)
    };
    let stop = AtomicBool::new(false);
    let context = Context { options: one_worker(), train: &train, stop: &stop, curves: None };
    let mut listener = Listener { heard: Vec::new(), stop_at_skip: &AtomicBool::new(false) };
    let tally = schedule::run(&mut store, session, queue, context, &mut listener).unwrap();
    assert_eq!(tally, Tally { completed: 1, ..Tally::default() });
    assert_eq!(listener.heard, [("started", 1), ("lost", 1), ("started", 1), ("ended", 1)]);
    assert_eq!(folder.number("SELECT attempt FROM run WHERE status = 'completed'"), 2);
}

#[test]
fn a_job_that_ended_elsewhere_is_reported_with_its_outcome() {
    let folder = Folder::new();
    let (mut store, session, queue) = queued(&folder, &text("3"));
    let others = queue[1..].to_vec();
    let train = |job: &Job, control: &dyn TrainingControl| {
        // While seed 1 is trained here, another process runs the other seeds.
        let mut other = Store::open(&folder.path("jitai.sqlite")).unwrap();
        let theirs = other.begin_session(&provenance()).unwrap();
        for queued in &others {
            let claimed =
                other.claim(theirs, &queued.key, RetryFailed::No, Isolation::Shared).unwrap();
            let Claimed::Claimed(claim) = claimed else { panic!("{claimed:?}") };
            let outcome = match queued.job.seed {
                2 => train::run(&queued.job, &Uncontrolled),
                _ => jitai::job::Outcome::Failed(jitai::job::Failure {
                    kind: jitai::job::FailureKind::Diverged,
                    message: "the loss is not a number".into(),
                    episode: 1,
                }),
            };
            other.finish(&claim, &outcome, 1.0).unwrap();
        }
        train::run(job, control)
    };
    let stop = AtomicBool::new(false);
    let context = Context { options: one_worker(), train: &train, stop: &stop, curves: None };
    let mut listener = Listener { heard: Vec::new(), stop_at_skip: &AtomicBool::new(false) };
    let tally = schedule::run(&mut store, session, queue, context, &mut listener).unwrap();
    let expected =
        Tally { completed: 1, already_completed: 1, already_failed: 1, ..Tally::default() };
    assert_eq!(tally, expected);
    listener.heard.sort_unstable();
    let expected =
        [("completed elsewhere", 2), ("ended", 1), ("failed elsewhere", 3), ("started", 1)];
    assert_eq!(listener.heard, expected);
}

#[test]
fn a_stop_is_heard_among_thousands_of_jobs_that_others_have_done() {
    let folder = Folder::new();
    let (mut store, session, queue) = queued(&folder, &text("2500"));
    let done = "INSERT INTO run (job, attempt, session, status, started_at)
            SELECT id, 1, 1, 'running', '2026-01-31T12:00:00.000Z' FROM job;
        UPDATE run SET status = 'failed', wall_seconds = 1, failure_kind = 'diverged',
            ended_at = '2026-01-31T12:00:00.000Z', failure_message = '-', failure_episode = 1,
            results_sha256 = zeroblob(32)";
    Connection::open(folder.path("jitai.sqlite")).unwrap().execute_batch(done).unwrap();
    let stop = AtomicBool::new(false);
    let context = Context { options: OPTIONS, train: &train::run, stop: &stop, curves: None };
    let mut listener = Listener { heard: Vec::new(), stop_at_skip: &stop };
    let tally = schedule::run(&mut store, session, queue, context, &mut listener).unwrap();
    assert!((1..=1000).contains(&tally.already_failed), "{tally:?}");
    assert_eq!(listener.heard.len(), tally.already_failed);
}

#[test]
fn jobs_that_another_process_did_are_events() {
    let folder = Folder::with(&text("4"));
    let arguments = ["run", "sweep.toml", "--workers", "1", "--format", "json"];
    let sweeps = [folder.start(arguments), folder.start(arguments)];
    let mut skipped = 0;
    let mut completed = 0;
    for sweep in sweeps {
        let events: Vec<serde_json::Value> = sweep
            .wait()
            .succeeded()
            .stdout
            .lines()
            .map(|line| serde_json::from_str(line).unwrap())
            .collect();
        let done = events.last().unwrap();
        assert_eq!((&done["event"], &done["completed"]), (&"done".into(), &4.into()));
        completed += events.iter().filter(|event| event["event"] == "completed").count();
        let told = events.iter().filter(|event| event["event"] == "skipped");
        skipped += told.inspect(|event| assert_eq!(event["found"], "completed")).count();
    }
    assert_eq!(completed, 4);
    assert!(skipped <= 4, "{skipped}");
}
