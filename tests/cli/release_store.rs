//! The store of a release: every command works on it, in this release and in all later ones.
//!
//! `tests/data/stores/release-0.1.0.sqlite` was written by jitai 0.1.0 from the two manifests beside it; it is never
//! written again. `old_stores.rs` has the store of the first schema.

use std::fs;
use std::path::Path;

use jitai::store::VIEWS;

use crate::support::{CIRCUMSTANCES, Folder, assert_same_rows, columns, rows, views};

const STORE: &str = "release-0.1.0.sqlite";
const MANIFEST: &str = "release-0.1.0.toml";
const TRIAL: &str = "release-0.1.0-trial.toml";

/// Five agents with two seeds, and a trial.
const JOBS: i64 = 11;

fn stored(name: &str) -> Vec<u8> {
    let stores = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/stores");
    fs::read(stores.join(name)).unwrap()
}

/// A folder with the manifests of the store.
fn manifests() -> Folder {
    let folder = Folder::new();
    for manifest in [MANIFEST, TRIAL] {
        folder.write(manifest, stored(manifest));
    }
    folder
}

/// A folder with the store and its manifests.
fn release() -> Folder {
    let folder = manifests();
    folder.write("jitai.sqlite", stored(STORE));
    folder
}

/// The rows of a folder's store, in the columns and parameters that the store of the release has: a later release may
/// add columns, views and keys.
fn rows_of(folder: &Folder) -> Vec<String> {
    let (store, of_release) = (folder.store(), release());
    let of_release = of_release.store();
    let known = rows(&of_release, "SELECT DISTINCT name FROM parameter");
    let left_out = ["arm_summary", "manifest", "conflict"];
    let mut found = Vec::new();
    for view in views(&of_release).into_iter().filter(|view| !left_out.contains(&view.as_str())) {
        let mut columns = columns(&of_release, &view);
        columns.retain(|column| !CIRCUMSTANCES.contains(&column.as_str()));
        let of_view = rows(&store, &format!("SELECT {} FROM {view}", columns.join(", ")));
        let is_known = |row: &String| {
            view != "parameter"
                || known.iter().any(|name| row.contains(name.trim_matches(['[', ']'])))
        };
        found.extend(of_view.into_iter().filter(is_known).map(|row| format!("{view}: {row}")));
    }
    found.sort();
    found
}

#[test]
fn every_reading_command_works_on_the_store_of_a_release_and_leaves_it_as_it_is() {
    let folder = release();
    folder.jitai(["check", MANIFEST, TRIAL]).succeeded();
    folder.jitai(["plan", MANIFEST, TRIAL]).succeeded().says("nothing to run");
    folder.jitai(["status"]).succeeded().prints("release").prints("trial");
    folder.jitai(["watch", "release", "--plain"]).succeeded().prints("release");
    folder.jitai(["log"]).succeeded().prints("jitai run");
    folder.jitai(["doctor"]).succeeded().prints("is healthy: 11 completed runs, all intact");
    folder.jitai(["export", "--out", "exported"]).succeeded();
    folder.jitai(["report", MANIFEST, TRIAL, "--out", "report"]).succeeded();
    assert!(folder.read("report/index.html").contains("Is everything that release 0.1.0 holds"));
    // Nothing was in conflict, and the release has neither a view of every estimate nor partial pooling.
    let empty = ["conflict", "every_estimate", "person_posterior"];
    for view in VIEWS.into_iter().filter(|view| !empty.contains(view)) {
        assert!(folder.number(&format!("SELECT count(*) FROM {view}")) > 0, "{view}");
        assert!(folder.read(&format!("exported/{view}.csv")).lines().count() > 1, "{view}");
    }
    let keys = "SELECT job_key FROM run_summary WHERE experiment = 'release'";
    let keys = folder.jitai(["query", keys, "--format", "csv"]).succeeded().stdout;
    for key in keys.lines().skip(1) {
        let policy = format!("run:{key}");
        folder.jitai(["simulate", "--policy", &policy, "--episodes", "2"]).succeeded();
    }
    folder.jitai(["merge", "jitai.sqlite", "--store", "merged.sqlite"]).succeeded();
    assert!(fs::read(folder.path("jitai.sqlite")).unwrap() == stored(STORE));
}

#[test]
fn the_jobs_of_a_release_still_have_the_same_bits() {
    let (old, fresh) = (release(), manifests());
    fresh.jitai(["run", MANIFEST, TRIAL, "--quiet"]).succeeded();
    assert_same_rows(&rows_of(&fresh), &rows_of(&old));
}

#[test]
fn a_run_on_the_store_of_a_release_runs_only_what_is_new() {
    let folder = release();
    let rows = rows_of(&folder);
    folder
        .jitai(["run", MANIFEST, TRIAL])
        .succeeded()
        .says("nothing to run: all 11 jobs are completed");
    assert_same_rows(&rows_of(&folder), &rows);
    assert_eq!(folder.runs(), JOBS);
    folder.write("larger.toml", folder.read(MANIFEST).replace("seeds = 2", "seeds = 3"));
    folder.jitai(["run", "larger.toml"]).succeeded().says("5 jobs run");
    folder.jitai(["forget", "trial", "--yes"]).succeeded();
    let saved = folder.jitai(["doctor", "--salvage", "new.sqlite"]).succeeded();
    saved.prints("16 completed runs");
}
