//! Arbitrary input causes no panic, takes at most one second of processor time, and needs at most a
//! gigabyte of memory.
//!
//! Each target of `fuzz/` runs on its seeds, and on mutations of the seeds for a few seconds; `make
//! test-bad-input` takes a minute per target.

mod dictionary;
mod mutator;
mod targets;

use std::collections::HashSet;
use std::env;
use std::fs;
use std::panic;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use jitai::plan;
use mutator::Mutator;
use targets::{TARGETS, Target};

/// Maximum processor time of an input, as promised to users.
const MOST_TIME: Duration = Duration::from_secs(1);
/// Maximum processor time of an input in the fast tests, on a machine that may be slow or have other work.
const MOST_TIME_IN_FAST_TESTS: Duration = Duration::from_secs(20);
/// Maximum of the peak memory of the process.
const MOST_KILOBYTES: u64 = 1 << 20;
/// The variable that sets the seconds of mutation per target.
const SECONDS: &str = "JITAI_BAD_INPUT_SECONDS";
const SECONDS_IN_FAST_TESTS: u64 = 2;

fn fuzz() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz")
}

/// The stored files of a target's corpus, and the seeds that only this program can write.
fn seeds(name: &str) -> Vec<Vec<u8>> {
    let mut files: Vec<PathBuf> = fs::read_dir(fuzz().join("seeds").join(name))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    files.sort();
    let mut seeds: Vec<Vec<u8>> = files.iter().map(|path| fs::read(path).unwrap()).collect();
    match name {
        "checkpoint" => {
            for (place, planned) in (0..).zip(plan::jobs(&targets::declared())) {
                let file = targets::sound_checkpoint(&planned.job);
                seeds.push([&[2 * place + 1], targets::state(&file)].concat());
                seeds.push([&[2 * place], &file[..]].concat());
            }
        }
        "store" => seeds.push([&[0], targets::template()].concat()),
        _ => {}
    }
    seeds
}

/// Processor time of this thread; wall-clock time where the system does not report processor time.
fn processor_time(begun: Instant) -> Duration {
    let told = fs::read_to_string("/proc/thread-self/schedstat").ok();
    let nanoseconds = told.and_then(|told| told.split(' ').next()?.parse().ok());
    nanoseconds.map_or_else(|| begun.elapsed(), Duration::from_nanos)
}

/// Peak memory of the process in kilobytes; 0 where the system does not report it.
fn most_memory() -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.and_then(|line| line.trim().trim_end_matches(" kB").parse().ok()).unwrap_or(0)
}

fn most_time() -> Duration {
    env::var_os(SECONDS).map_or(MOST_TIME_IN_FAST_TESTS, |_| MOST_TIME)
}

/// Tries one input, and saves it in a file if it breaks a promise.
#[track_caller]
fn try_one(name: &str, target: Target, bytes: &[u8]) {
    let begun = Instant::now();
    let before = processor_time(begun);
    let outcome = panic::catch_unwind(|| target(bytes));
    let taken = processor_time(begun).saturating_sub(before);
    let broken = match outcome {
        Err(_) => "panics".to_owned(),
        Ok(()) if taken > most_time() => format!("takes {taken:?}"),
        Ok(()) if most_memory() > MOST_KILOBYTES => format!("needs {} kB", most_memory()),
        Ok(()) => return,
    };
    let kept = env::temp_dir().join(format!("jitai-bad-input-{name}"));
    fs::write(&kept, bytes).unwrap();
    panic!("{name} {broken} on the {} bytes that are in {}", bytes.len(), kept.display());
}

fn hold(name: &str) {
    let (_, target) = TARGETS.into_iter().find(|(known, _)| *known == name).unwrap();
    let seeds = seeds(name);
    for seed in &seeds {
        try_one(name, target, seed);
    }
    let seconds = env::var(SECONDS).map_or(SECONDS_IN_FAST_TESTS, |s| s.parse().unwrap());
    let words = dictionary::words(&fuzz().join("dictionaries").join(format!("{name}.dict")));
    let mut mutator = Mutator::new(&seeds, &words);
    let (begun, mut tried) = (Instant::now(), 0_u64);
    while begun.elapsed() < Duration::from_secs(seconds) {
        try_one(name, target, &mutator.next());
        tried += 1;
    }
    println!("{name}: {} seeds, {tried} mutations of them", seeds.len());
}

#[test]
fn manifests_of_any_bytes_are_refused_or_planned() {
    hold("manifest");
}

#[test]
fn models_of_any_bytes_are_refused_or_simulated() {
    hold("model");
}

#[test]
fn queries_of_any_text_leave_the_store_as_it_is() {
    hold("query");
}

#[test]
fn filters_of_any_text_choose_jobs_or_say_why_not() {
    hold("filter");
}

#[test]
fn trajectories_of_any_bytes_are_replayed_or_refused() {
    hold("replay");
}

#[test]
fn checkpoints_of_any_bytes_are_resumed_or_refused() {
    hold("checkpoint");
}

#[test]
fn stores_of_any_bytes_are_read_and_examined_or_refused() {
    hold("store");
}

#[test]
fn every_target_is_fuzzed_and_tried() {
    let names: HashSet<String> = TARGETS.iter().map(|(name, _)| (*name).to_owned()).collect();
    let of_files = |folder: &str| -> HashSet<String> {
        let entries = fs::read_dir(fuzz().join(folder)).unwrap();
        let stem = |path: PathBuf| path.file_stem().unwrap().to_str().unwrap().to_owned();
        entries.map(|entry| stem(entry.unwrap().path())).collect()
    };
    assert_eq!(of_files("fuzz_targets"), names);
    assert_eq!(of_files("seeds"), names);
    assert_eq!(of_files("dictionaries"), names);
}
