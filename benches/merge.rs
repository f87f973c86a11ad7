//! Merging stores into a new one, every result verified.

use std::path::PathBuf;
use std::sync::LazyLock;
use std::sync::atomic::AtomicBool;

use divan::Bencher;
use divan::counter::ItemsCount;
use jitai::agent::{Agent, DuelingDqn, Reinforce};
use jitai::env::Environment;
use jitai::manifest::Evaluation;
use jitai::plan::Job;
use jitai::record::{Outcome, Provenance};
use jitai::store::{Claimed, Experiment, Isolation, RetryFailed, RunEnd, Store, merge};
use jitai::train::{self, Uncontrolled};
use tempfile::TempDir;

fn main() {
    divan::main();
}

/// Stores with the same number of runs each.
struct Sources {
    _folder: TempDir,
    paths: Vec<PathBuf>,
}

impl Sources {
    /// So many stores with so many runs of a job each, every run with a seed of its own.
    fn new(job: &Job, stores: u64, runs: u64) -> Sources {
        let folder = tempfile::tempdir().unwrap();
        let outcome = train::run(job, &Uncontrolled);
        let path = |number: u64| folder.path().join(format!("{number}.sqlite"));
        let paths: Vec<PathBuf> = (0..stores).map(path).collect();
        for (number, path) in (0..).zip(&paths) {
            let seeds = 1 + number * runs..=(number + 1) * runs;
            let jobs: Vec<Job> = seeds.map(|seed| Job { seed, ..job.clone() }).collect();
            fill(&mut Store::open(path).unwrap(), &jobs, &outcome);
        }
        Sources { _folder: folder, paths }
    }
}

/// Stores the same outcome for all jobs.
fn fill(store: &mut Store, jobs: &[Job], outcome: &Outcome) {
    let experiment = Experiment { name: "bench", question: None, hypothesis: None, manifest: "" };
    let named = jobs.iter().map(|job| ("agent", job));
    store.register_until(&AtomicBool::new(false), &experiment, named).unwrap();
    let [code_version, git_revision, backend, host, processor] = [(); 5].map(|()| String::new());
    let provenance = Provenance { code_version, git_revision, backend, host, processor };
    let session = store.begin_session(&provenance).unwrap();
    let mut claim = |job: &Job| match store
        .claim(session, &job.key(), RetryFailed::No, Isolation::Shared)
        .unwrap()
    {
        Claimed::Claimed(claim) => claim,
        other => panic!("the job is not free: {other:?}"),
    };
    let claims: Vec<_> = jobs.iter().map(&mut claim).collect();
    for claims in claims.chunks(100) {
        let end = |claim| RunEnd { claim, outcome, wall_seconds: 1.0 };
        store.finish_all(&claims.iter().map(end).collect::<Vec<_>>()).unwrap();
    }
    store.end_session(session).unwrap();
}

fn job(agent: Agent, evaluation: Evaluation) -> Job {
    let (environment, scenario) = (Environment::paper(0.6), "P-H-D".parse().unwrap());
    Job { environment, scenario, agent, evaluation, seed: 1 }
}

static TRIVIAL: LazyLock<Sources> = LazyLock::new(|| {
    let agent = Agent::of(&Reinforce { episodes: 1, ..Reinforce::default() });
    let evaluation = Evaluation { test_episodes: 1, ..Evaluation::default() };
    Sources::new(&job(agent, evaluation), 200, 500)
});

static DQN: LazyLock<Sources> = LazyLock::new(|| {
    Sources::new(&job(Agent::of(&DuelingDqn::default()), Evaluation::default()), 4, 250)
});

fn merging(bencher: Bencher<'_, '_>, sources: &Sources, runs: usize) {
    let target = || {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(&folder.path().join("jitai.sqlite")).unwrap();
        (folder, store)
    };
    bencher.counter(ItemsCount::new(runs)).with_inputs(target).bench_local_values(
        |(folder, mut store)| {
            let merged = merge(&sources.paths, &mut store, |_| {}).unwrap();
            assert_eq!(merged.completed, runs);
            (folder, store)
        },
    );
}

/// 200 stores with 100,000 runs of one training and one test episode together; counted in runs.
#[divan::bench(sample_count = 3, sample_size = 1)]
fn merging_trivial_runs(bencher: Bencher<'_, '_>) {
    merging(bencher, &TRIVIAL, 100_000);
}

/// Four stores with 1000 runs of the dueling DQN in the published settings together; counted in runs.
#[divan::bench(sample_count = 3, sample_size = 1)]
fn merging_dqn_runs(bencher: Bencher<'_, '_>) {
    merging(bencher, &DQN, 1000);
}
