//! A store with the first schema: every command works on it, in this release and in all later ones.
//!
//! `tests/data/stores/v1-0.1.0.sqlite` was written by jitai 0.1.0 from the two manifests beside it.

use std::fs;
use std::path::Path;

use jitai::job::implied_parameters;

use crate::support::{Folder, assert_same_rows};

const STORE: &str = "v1-0.1.0.sqlite";
const METHODS: &str = "v1-0.1.0-methods.toml";
const DIVERGING: &str = "v1-0.1.0-diverging.toml";

/// The jobs of the store in the order of their manifests: key, agent and state.
const JOBS: [(&str, &str, &str); 8] = [
    ("e16e20ffeacfd7ec885e62e7016cef16", "dqn", "completed"),
    ("4f0ec0d900e4b0ddc4319c098261a3cb", "dqn", "completed"),
    ("fd436c3060e62c11b952c5020a81ee02", "reinforce", "completed"),
    ("975db803026327630246e109ffbc0d87", "reinforce", "completed"),
    ("1d9ae99338567871e87c5a08b79288cb", "tailored", "completed"),
    ("de31b7104668f05799767a7971d9e2ab", "tailored", "completed"),
    ("6f8790aa80dbe8f0021e13bcb4b7895e", "wild", "failed"),
    ("8a5f2323e9753f56ac36012a1bd712ee", "tame", "completed"),
];

/// Mean returns of the completed runs.
const MEAN_RETURNS: &str = "\
e16e20ffeacfd7ec885e62e7016cef16,457.3379999999999
4f0ec0d900e4b0ddc4319c098261a3cb,536.9200000000001
fd436c3060e62c11b952c5020a81ee02,644.2345076600001
975db803026327630246e109ffbc0d87,457.8745
1d9ae99338567871e87c5a08b79288cb,1043.2999999999997
de31b7104668f05799767a7971d9e2ab,1003.3799999999994
8a5f2323e9753f56ac36012a1bd712ee,717.1206321972398
";

/// A folder with the store and its manifests.
fn old_store() -> Folder {
    let folder = Folder::new();
    folder.write("jitai.sqlite", stored(STORE));
    for manifest in [METHODS, DIVERGING] {
        folder.write(manifest, stored(manifest));
    }
    folder
}

fn stored(name: &str) -> Vec<u8> {
    let stores = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/stores");
    fs::read(stores.join(name)).unwrap()
}

/// Every row of a folder's store, without additions of later releases: views, and parameters that are
/// absent from the store's jobs.
fn rows_of(folder: &Folder) -> Vec<String> {
    let implied = implied_parameters();
    let is_added = |row: &String| match row.split_once(": ") {
        Some(("decision", _)) => true,
        Some(("parameter", row)) => {
            implied.iter().any(|parameter| row.contains(&format!("\"{}\"", parameter.name)))
        }
        _ => false,
    };
    // Version 12 has one column more: whether the episode was terminated.
    let has_more = "evaluation_episode: ";
    let same = |row: String| match row.strip_prefix(has_more).map(|row| row.matches(',').count()) {
        Some(5) => row.rsplit_once(", ").map_or(row.clone(), |(row, _)| format!("{row}]")),
        _ => row,
    };
    folder.dump().into_iter().filter(|row| !is_added(row)).map(same).collect()
}

#[test]
fn every_reading_command_works_on_an_old_store_and_leaves_it_as_it_is() {
    let folder = old_store();
    folder.jitai(["check", METHODS, DIVERGING]).succeeded();

    let plan = folder.jitai(["plan", METHODS, DIVERGING, "--jobs", "--format", "json"]);
    let planned = plan.succeeded().json();
    let planned = planned.as_array().unwrap();
    assert_eq!(planned.len(), JOBS.len());
    for (job, (key, agent, state)) in planned.iter().zip(JOBS) {
        let found = ["job_key", "agent", "state"].map(|name| job[name].as_str().unwrap());
        assert_eq!(found, [key, agent, state]);
    }

    let status = folder.jitai(["status"]).succeeded();
    status.prints("methods").prints("the loss of update 2 is inf");
    let query = "SELECT job_key, mean_return FROM run_summary WHERE status = 'completed'
        ORDER BY agent, seed";
    let means = folder.jitai(["query", query, "--format", "csv"]).succeeded();
    assert_eq!(means.stdout, format!("job_key,mean_return\n{MEAN_RETURNS}"));
    let newer = folder.jitai(["query", "SELECT * FROM decision"]).ended(2);
    newer
        .says("the store is of an earlier version, without the view decision; `jitai run` adds it");
    folder.jitai(["doctor"]).succeeded().prints("is healthy: 7 completed runs");

    let exported = folder.jitai(["export", "--out", "exported"]).succeeded();
    exported.says("decision left out: an earlier version made the store");
    assert_eq!(folder.read("exported/run_summary.csv").lines().count(), 1 + JOBS.len());
    folder.jitai(["report", METHODS, DIVERGING, "--out", "report"]).succeeded();
    assert!(folder.read("report/index.html").contains("Is everything that the first schema"));

    for (key, agent, _) in JOBS.into_iter().filter(|(_, _, state)| *state == "completed") {
        let policy = format!("run:{key}");
        let simulated = folder.jitai(["simulate", "--policy", &policy]).succeeded();
        assert!(simulated.stdout.lines().count() > 1, "{agent}: {}", simulated.stdout);
    }
    folder.jitai(["optimum", METHODS]).succeeded().prints("P-H-D");

    assert!(fs::read(folder.path("jitai.sqlite")).unwrap() == stored(STORE));
}

#[test]
fn the_jobs_of_an_old_store_still_have_the_same_results() {
    let (old, fresh) = (old_store(), old_store());
    fs::remove_file(fresh.path("jitai.sqlite")).unwrap();
    fresh.jitai(["run", METHODS, DIVERGING, "--quiet"]).ended(1);
    assert_same_rows(&rows_of(&fresh), &rows_of(&old));
}

#[test]
fn an_old_store_is_salvaged_whole() {
    let folder = old_store();
    let saved = folder.jitai(["doctor", "--salvage", "new.sqlite"]).succeeded();
    saved.prints("2 experiments, 8 jobs, 7 completed runs, 1 run that failed");
    let rows = rows_of(&folder);
    fs::rename(folder.path("new.sqlite"), folder.path("jitai.sqlite")).unwrap();
    assert_same_rows(&rows_of(&folder), &rows);
    folder.jitai(["doctor"]).succeeded().prints("is healthy: 7 completed runs");
}

#[test]
fn a_run_migrates_an_old_store_after_a_copy_and_runs_only_what_is_new() {
    let folder = old_store();
    let rows = rows_of(&folder);
    folder.jitai(["run", METHODS, DIVERGING]).ended(1).says("0 jobs run, 7 completed in all");
    assert_same_rows(&rows_of(&folder), &rows);
    assert_eq!(folder.runs(), 8);
    folder.jitai(["doctor"]).succeeded().prints("is healthy: 7 completed runs");

    fs::rename(folder.path("jitai.sqlite.v1.bak"), folder.path("backup.sqlite")).unwrap();
    let backup = folder.jitai(["doctor", "--store", "backup.sqlite"]).succeeded();
    backup.prints("is healthy: 7 completed runs");

    let larger = folder.read(DIVERGING).replace("seeds = 1", "seeds = 2");
    folder.write("larger.toml", larger.replace("\"wild\"", "\"other\"").replace("= 1.0", "= 1e-4"));
    folder.jitai(["run", METHODS, "larger.toml"]).succeeded().says("3 jobs run");
}

/// The schema pages of a store do not depend on the version that made it, so a store that has lost its
/// first page can be read with the schema pages of a new store.
#[test]
fn a_migrated_store_without_its_header_is_salvaged() {
    let folder = old_store();
    let rows = rows_of(&folder);
    folder.jitai(["run", METHODS, DIVERGING]).ended(1);
    let mut bytes = fs::read(folder.path("jitai.sqlite")).unwrap();
    bytes[..4096].fill(0xa5);
    for file in ["jitai.sqlite-wal", "jitai.sqlite-shm"] {
        let _ = fs::remove_file(folder.path(file));
    }
    folder.write("jitai.sqlite", bytes);
    let saved = folder.jitai(["doctor", "--salvage", "new.sqlite"]).succeeded();
    saved.prints("7 completed runs");
    fs::rename(folder.path("new.sqlite"), folder.path("jitai.sqlite")).unwrap();
    assert_same_rows(&rows_of(&folder), &rows);
}
