//! Merging of stores into a new store, with verification of every result.

use std::path::PathBuf;
use std::sync::LazyLock;
use std::sync::atomic::AtomicBool;

use divan::Bencher;
use divan::counter::ItemsCount;
use jitai::agent::{Agent, DuelingDqn, Reinforce};
use jitai::env::StepCount;
use jitai::job::Evaluation;
use jitai::job::Job;
use jitai::job::{Outcome, Provenance};
use jitai::store::{Claimed, Experiment, Isolation, RetryFailed, RunEnd, Sources, Store, merge};
use jitai::train::{self, Uncontrolled};
use tempfile::TempDir;

fn main() {
    divan::main();
}

/// Stores with the same number of runs each.
struct Filled {
    _folder: TempDir,
    paths: Vec<PathBuf>,
}

impl Filled {
    /// `stores` stores with `runs` runs of a job each; every run has its own seed.
    fn new(job: &Job, stores: u64, runs: u64) -> Filled {
        let folder = tempfile::tempdir().unwrap();
        let outcome = train::run(job, &Uncontrolled);
        let path = |number: u64| folder.path().join(format!("{number}.sqlite"));
        let paths: Vec<PathBuf> = (0..stores).map(path).collect();
        for (number, path) in (0..).zip(&paths) {
            let seeds = 1 + number * runs..=(number + 1) * runs;
            let jobs: Vec<Job> = seeds.map(|seed| Job { seed, ..job.clone() }).collect();
            fill(&mut Store::open(path).unwrap(), &jobs, &outcome);
        }
        Filled { _folder: folder, paths }
    }
}

/// Stores the same outcome for every job.
fn fill(store: &mut Store, jobs: &[Job], outcome: &Outcome) {
    let experiment = Experiment { name: "bench", question: None, hypothesis: None, manifest: "" };
    let named = jobs.iter().map(|job| ("agent", job));
    store.register_until(&AtomicBool::new(false), &experiment, named, None).unwrap();
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
    let (environment, scenario) = (StepCount::paper(0.6).into(), "P-H-D".parse().unwrap());
    Job { environment, scenario, agent, evaluation, trial: None, seed: 1 }
}

static TRIVIAL: LazyLock<Filled> = LazyLock::new(|| {
    let agent = Agent::of(&Reinforce { episodes: 1, ..Reinforce::default() });
    let evaluation = Evaluation { test_episodes: 1, ..Evaluation::default() };
    Filled::new(&job(agent, evaluation), 200, 500)
});

static DQN: LazyLock<Filled> = LazyLock::new(|| {
    Filled::new(&job(Agent::of(&DuelingDqn::default()), Evaluation::default()), 4, 250)
});

fn merging(bencher: Bencher<'_, '_>, sources: &Filled, runs: usize) {
    let target = || {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(&folder.path().join("jitai.sqlite")).unwrap();
        (folder, store)
    };
    bencher.counter(ItemsCount::new(runs)).with_inputs(target).bench_local_values(
        |(folder, mut store)| {
            let checked = Sources::open(sources.paths.clone()).unwrap();
            let merged = merge(&checked, &mut store, |_| {}).unwrap();
            assert_eq!(merged.completed, runs);
            (folder, store)
        },
    );
}

/// 200 stores with 100,000 runs in total, of jobs with one training and one test episode; counted in
/// runs.
#[divan::bench(sample_count = 3, sample_size = 1)]
fn merging_trivial_runs(bencher: Bencher<'_, '_>) {
    merging(bencher, &TRIVIAL, 100_000);
}

/// Four stores with 1000 runs in total, of the dueling DQN in the published settings; counted in runs.
#[divan::bench(sample_count = 3, sample_size = 1)]
fn merging_dqn_runs(bencher: Bencher<'_, '_>) {
    merging(bencher, &DQN, 1000);
}
