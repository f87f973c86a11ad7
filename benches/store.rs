//! Writes to a store: the jobs of an experiment, and the ends of runs. Reads of a large one: a report, and a
//! run with nothing to do.

use std::path::PathBuf;
use std::slice;
use std::sync::LazyLock;
use std::sync::atomic::AtomicBool;

use divan::Bencher;
use divan::counter::ItemsCount;
use jitai::agent::{Agent, Reinforce};
use jitai::env::StepCount;
use jitai::job::Job;
use jitai::job::{Evaluation, RecordedDecisions};
use jitai::job::{Outcome, Provenance};
use jitai::manifest::Manifest;
use jitai::plan;
use jitai::results::{Hosts, assemble, report, summarise_arms};
use jitai::schedule::{Event, Options, Selection, register, run_manifests};
use jitai::store::{
    Claim, Claimed, Experiment, Isolation, Parts, Reader, RetryFailed, RunEnd, SessionId, Store,
};
use jitai::train::{self, Uncontrolled};
use tempfile::TempDir;

fn main() {
    divan::main();
}

/// A store in a folder of its own.
struct Fresh {
    _folder: TempDir,
    store: Store,
}

impl Fresh {
    fn new() -> Fresh {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(&folder.path().join("jitai.sqlite")).unwrap();
        Fresh { _folder: folder, store }
    }

    fn with(jobs: &[Job]) -> Fresh {
        let mut fresh = Fresh::new();
        fresh.register(jobs);
        fresh
    }

    fn register(&mut self, jobs: &[Job]) {
        let experiment =
            Experiment { name: "bench", question: None, hypothesis: None, manifest: "" };
        let stop = AtomicBool::new(false);
        let named = jobs.iter().map(|job| ("reinforce", job));
        self.store.register_until(&stop, &experiment, named, None).unwrap().unwrap();
    }

    fn begin_session(&mut self) -> SessionId {
        let provenance = Provenance {
            code_version: String::new(),
            git_revision: String::new(),
            backend: String::new(),
            host: String::new(),
            processor: String::new(),
        };
        self.store.begin_session(&provenance).unwrap()
    }

    fn claim(&mut self, session: SessionId, job: &Job) -> Claim {
        let claimed =
            self.store.claim(session, &job.key(), RetryFailed::No, Isolation::Shared).unwrap();
        match claimed {
            Claimed::Claimed(claim) => claim,
            other => panic!("the job is not free: {other:?}"),
        }
    }
}

fn job(episodes: u32, evaluation: Evaluation) -> Job {
    Job {
        environment: StepCount::paper(0.6).into(),
        scenario: "P-H-D".parse().unwrap(),
        agent: Agent::of(&Reinforce { episodes, ..Reinforce::default() }),
        evaluation,
        trial: None,
        seed: 1,
    }
}

/// Jobs with one training and one test episode.
fn trivial(count: u64) -> Vec<Job> {
    let job = job(1, Evaluation { test_episodes: 1, ..Evaluation::default() });
    (1..=count).map(|seed| Job { seed, ..job.clone() }).collect()
}

/// Registering an experiment in an empty store; counted in jobs.
#[divan::bench(sample_count = 5, sample_size = 1, args = [10_000])]
fn registering(bencher: Bencher<'_, '_>, count: u64) {
    let jobs = trivial(count);
    bencher.counter(ItemsCount::new(count)).with_inputs(Fresh::new).bench_local_values(
        |mut fresh| {
            fresh.register(&jobs);
            fresh
        },
    );
}

/// Claiming jobs of one training and one test episode one by one, and ending their runs together,
/// synced to the disk; counted in jobs.
#[divan::bench(sample_count = 20, sample_size = 1, args = [1, 100])]
fn claiming_and_ending(bencher: Bencher<'_, '_>, count: u64) {
    let jobs = trivial(count);
    let outcome = train::run(&jobs[0], &Uncontrolled);
    let begun = || {
        let mut fresh = Fresh::with(&jobs);
        let session = fresh.begin_session();
        (fresh, session)
    };
    bencher.counter(ItemsCount::new(count)).with_inputs(begun).bench_local_values(
        |(mut fresh, session)| {
            let claims: Vec<Claim> = jobs.iter().map(|job| fresh.claim(session, job)).collect();
            let end = |claim| RunEnd { claim, outcome: &outcome, wall_seconds: 1.0 };
            let ends: Vec<RunEnd<'_>> = claims.iter().map(end).collect();
            fresh.store.finish_all(&ends).unwrap();
            fresh
        },
    );
}

/// Ending a run in the published settings whose learning curve has a point for every training episode,
/// synced to the disk; counted in values of the curve.
#[divan::bench(sample_count = 10, sample_size = 1)]
fn ending_with_a_long_curve(bencher: Bencher<'_, '_>) {
    let job = job(15_000, Evaluation { curve_stride: 1, ..Evaluation::default() });
    let outcome = train::run(&job, &Uncontrolled);
    let Outcome::Completed(results) = &outcome else { panic!("{outcome:?}") };
    let claimed = || {
        let mut fresh = Fresh::with(slice::from_ref(&job));
        let session = fresh.begin_session();
        let claim = fresh.claim(session, &job);
        (fresh, claim)
    };
    bencher.counter(ItemsCount::new(results.curve.len())).with_inputs(claimed).bench_local_values(
        |(mut fresh, claim)| {
            fresh.store.finish(&claim, &outcome, 1.0).unwrap();
            fresh
        },
    );
}

/// Ending a run with the 50,000 recorded decisions of a default test, synced to the disk; counted in
/// decisions.
#[divan::bench(sample_count = 20, sample_size = 1)]
fn ending_with_decisions(bencher: Bencher<'_, '_>) {
    let evaluation =
        Evaluation { record_decisions: RecordedDecisions::Test, ..Evaluation::default() };
    let mut job = job(1, evaluation);
    // Disengagement never occurs, so every test episode has all of its steps.
    job.environment.change(|environment| environment.epsilon_d = 0.0);
    let outcome = train::run(&job, &Uncontrolled);
    let Outcome::Completed(results) = &outcome else { panic!("{outcome:?}") };
    assert_eq!(results.decisions.len(), 50_000);
    let claimed = || {
        let mut fresh = Fresh::with(slice::from_ref(&job));
        let session = fresh.begin_session();
        let claim = fresh.claim(session, &job);
        (fresh, claim)
    };
    bencher
        .counter(ItemsCount::new(results.decisions.len()))
        .with_inputs(claimed)
        .bench_local_values(|(mut fresh, claim)| {
            fresh.store.finish(&claim, &outcome, 1.0).unwrap();
            fresh
        });
}

/// A completed experiment of 100,000 jobs.
struct Large {
    manifest: Manifest,
    path: PathBuf,
    _folder: TempDir,
}

impl Large {
    /// The experiment with these keys, which must make 100,000 jobs. Its results are those of ten jobs.
    fn of(keys: &str) -> Large {
        let text = format!(
            "format = 1\nname = \"bench\"\nevaluation.test_episodes = 10\n{keys}\n[[analysis]]\nname = \"search\"\n\
             kind = \"selection\"\nreporting_seeds = [0]\n"
        );
        let manifest = jitai::manifest::parse("bench", text.as_bytes()).unwrap();
        let mut fresh = Fresh::new();
        let selection = Selection::new(slice::from_ref(&manifest), None).unwrap();
        let _ = register(&mut fresh.store, &selection, &AtomicBool::new(false), |_| {}).unwrap();
        let jobs: Vec<Job> = plan::jobs(&manifest).map(|planned| planned.job).collect();
        assert_eq!(jobs.len(), 100_000);
        let evaluation = Evaluation { test_episodes: 10, ..Evaluation::default() };
        let tried = (1..=10).map(|seed| Job { seed, ..job(1, evaluation.clone()) });
        let outcomes: Vec<Outcome> = tried.map(|job| train::run(&job, &Uncontrolled)).collect();
        let session = fresh.begin_session();
        for jobs in jobs.chunks(1000) {
            let claims: Vec<Claim> = jobs.iter().map(|job| fresh.claim(session, job)).collect();
            let ends = claims.iter().zip(outcomes.iter().cycle());
            let end = |(claim, outcome)| RunEnd { claim, outcome, wall_seconds: 1.0 };
            fresh.store.finish_all(&ends.map(end).collect::<Vec<_>>()).unwrap();
        }
        fresh.store.end_session(session).unwrap();
        let Fresh { store, _folder } = fresh;
        Large { manifest, path: store.path().to_owned(), _folder }
    }

    fn reader(&self) -> Reader {
        Reader::open(&self.path).unwrap()
    }
}

/// 40 arms of 2500 seeds.
static SEEDS: LazyLock<Large> = LazyLock::new(|| {
    Large::of(
        "scenarios = [\"P-H-D\", \"L-H-D\", \"P-T\", \"L-T\"]\nseeds = 2500\nenvironment.sigma = 0.6\n[[agent]]\n\
         name = \"a\"\nalgorithm = \"reinforce\"\nepisodes = 1\n\
         learning_rate = { from = 0.0001, to = 0.001, step = 0.0001 }",
    )
});

/// 100,000 arms of one seed.
static ARMS: LazyLock<Large> = LazyLock::new(|| {
    Large::of(
        "scenarios = [\"P-H-D\", \"P-T\"]\nseeds = 1\nenvironment.sigma = 0.6\n[[agent]]\nname = \"a\"\n\
         algorithm = \"reinforce\"\nepisodes = 1\ngamma = { from = 0.5, to = 1, count = 200 }\n\
         learning_rate = { from = 0.0001, to = 0.025, count = 250 }",
    )
});

const LARGE: [(&str, &LazyLock<Large>); 2] = [("40 arms", &SEEDS), ("100,000 arms", &ARMS)];

fn large(name: &str) -> &'static Large {
    let (_, large) = LARGE.into_iter().find(|(known, _)| *known == name).unwrap();
    large
}

/// A report on 100,000 completed runs, without writing its files; counted in runs.
#[divan::bench(sample_count = 1, sample_size = 1, args = LARGE.map(|(name, _)| name))]
fn reporting(bencher: Bencher<'_, '_>, name: &str) {
    let large = large(name);
    bencher.counter(ItemsCount::new(100_000_usize)).bench_local(|| {
        let manifests = slice::from_ref(&large.manifest);
        let experiments = assemble(&large.reader(), manifests, |_, _, _| {}).unwrap();
        report(&experiments, "bench", Hosts::Unnamed)
    });
}

/// A run of an experiment with 100,000 completed runs, and the summary of its arms; counted in runs.
#[divan::bench(sample_count = 3, sample_size = 1, args = LARGE.map(|(name, _)| name))]
fn running_nothing(bencher: Bencher<'_, '_>, name: &str) {
    let large = large(name);
    bencher.counter(ItemsCount::new(100_000_usize)).bench_local(|| {
        let mut store = Store::open(&large.path).unwrap();
        let (stop, options) = (AtomicBool::new(false), Options::default());
        let selection = Selection::new(slice::from_ref(&large.manifest), None).unwrap();
        let mut ignore = |_: Event<'_>| {};
        let ended = run_manifests(&mut store, &selection, options, &stop, &mut ignore).unwrap();
        assert_eq!(ended.unwrap().end.completed(), 100_000);
        let data = large
            .reader()
            .data_set(&large.manifest.name, plan::jobs(&large.manifest), Parts::default())
            .unwrap();
        summarise_arms(&data.jobs)
    });
}
