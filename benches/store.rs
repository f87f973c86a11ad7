//! Writing: the jobs of an experiment.

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

use divan::Bencher;
use divan::counter::ItemsCount;
use jitai::manifest::{Agent, Environment, Evaluation, Reinforce};
use jitai::plan::Job;
use jitai::store::{Experiment, Store};

fn main() {
    divan::main();
}

fn jobs(count: u64) -> Vec<Job> {
    (1..=count)
        .map(|seed| Job {
            environment: Environment::paper(0.6),
            scenario: "P-H-D".parse().unwrap(),
            agent: Agent::Reinforce(Reinforce { episodes: 1, ..Reinforce::default() }),
            evaluation: Evaluation { test_episodes: 1, ..Evaluation::default() },
            seed,
        })
        .collect()
}

/// Registering an experiment in an empty store.
#[divan::bench(sample_count = 5, sample_size = 1, args = [10_000])]
fn registering(bencher: Bencher<'_, '_>, count: u64) {
    let jobs = jobs(count);
    let fresh = || {
        let folder = tempfile::tempdir().unwrap();
        let path: PathBuf = folder.path().join("jitai.sqlite");
        let store = Store::open(&path).unwrap();
        (folder, store)
    };
    bencher.counter(ItemsCount::new(count)).with_inputs(fresh).bench_local_values(
        |(folder, mut store)| {
            let experiment =
                Experiment { name: "bench", question: None, hypothesis: None, manifest: "" };
            let stop = AtomicBool::new(false);
            store
                .register_until(&stop, &experiment, jobs.iter().map(|job| ("reinforce", job)))
                .unwrap()
                .unwrap();
            (folder, store)
        },
    );
}
