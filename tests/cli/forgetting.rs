//! `forget`: removes an experiment, and nothing that another experiment holds.

use std::fs;
use std::os::unix::fs::PermissionsExt;

use rusqlite::Connection;

use crate::support::{Effort, Finished, Folder, Running, assert_same_rows, manifest, until};

/// Two experiments; the second shares the jobs of one sigma with the first.
fn two() -> Folder {
    let folder = Folder::with(&manifest("sweep", "[0.4, 0.6]", "2", Effort::Trivial));
    let other = manifest("other", "[0.6, 0.8]", "2", Effort::Trivial);
    let recorded = "evaluation.record_decisions = \"all\"\npopulation.delta_d = 0.2\n[[agent]]";
    folder.write("recorded.toml", {
        let recording = manifest("recorded", "0.6", "1", Effort::Trivial);
        recording.replacen("[[agent]]", recorded, 1)
    });
    folder.write("other.toml", other);
    folder.jitai(["run", "sweep.toml", "--quiet"]).succeeded();
    folder
}

#[test]
fn forgetting_shows_what_there_is_and_needs_a_yes() {
    let folder = two();
    let before = fs::read(folder.path("jitai.sqlite")).unwrap();
    let refused = folder.jitai(["forget", "sweep"]).ended(2);
    refused.says("sweep has 8 jobs (8 completed); no other experiment holds them");
    folder.jitai(["forget", "sweep"]).ended(2).says("add --yes to remove sweep; all results stay");
    let results = folder.jitai(["forget", "sweep", "--results"]).ended(2);
    results.says("add --yes to remove sweep and the results of 8 jobs");
    folder.jitai(["forget", "swep"]).ended(2).says("has no experiment `swep`");
    assert_eq!(fs::read(folder.path("jitai.sqlite")).unwrap(), before);
}

#[test]
fn a_forgotten_experiment_comes_back_with_its_results() {
    let folder = two();
    let before = folder.dump();
    folder
        .jitai(["forget", "sweep", "--yes"])
        .succeeded()
        .prints("sweep removed")
        .prints("the results of 8 jobs of it stay");
    assert!(!folder.jitai(["status"]).succeeded().stdout.contains("sweep"));
    assert_eq!(folder.number("SELECT count(*) FROM run_summary"), 0);
    assert_eq!(folder.number("SELECT count(DISTINCT job_key) FROM metric"), 8);
    folder.jitai(["run", "sweep.toml"]).succeeded().says("nothing to run: all 8 jobs");
    assert_same_rows(&folder.dump(), &before);
}

#[test]
fn an_experiment_with_running_jobs_is_not_forgotten() {
    let folder = Folder::with(&manifest("sweep", "0.6", "1", Effort::Endless));
    let run = folder.start(["run", "sweep.toml", "--workers", "2"]);
    let running = "SELECT count(*) FROM run WHERE status = 'running'";
    until("jobs run", || folder.count_if_there(running) == Some(2));
    let refused = folder.jitai(["forget", "sweep", "--results", "--yes"]).ended(2);
    refused.says("nothing was removed").says("stop the process, or wait until it ends");
    assert_eq!(folder.number(running), 2);
    run.kill();
    // A killed process runs nothing.
    folder.jitai(["forget", "sweep", "--results", "--yes"]).succeeded().prints("with 2 jobs");
    folder.jitai(["doctor"]).succeeded().prints("is healthy");
}

#[test]
fn results_that_another_experiment_holds_stay() {
    let folder = two();
    folder.jitai(["run", "other.toml", "recorded.toml", "--quiet"]).succeeded();
    let forget = ["forget", "sweep", "--results", "--yes"];
    let forgotten = folder.jitai(forget).succeeded();
    forgotten.says("other experiments hold 4 of them, too").prints("with 4 jobs");
    folder.jitai(["doctor"]).succeeded().prints("is healthy");
    assert_eq!(folder.number("SELECT count(*) FROM run_summary WHERE experiment = 'other'"), 8);
    assert_eq!(folder.number("SELECT count(DISTINCT job_key) FROM parameter"), 8 + 2);
    // The rest equals a store that never had the experiment.
    let fresh = Folder::with(&folder.read("other.toml"));
    fresh.write("recorded.toml", folder.read("recorded.toml"));
    fresh.jitai(["run", "sweep.toml", "recorded.toml", "--quiet"]).succeeded();
    assert_same_rows(&folder.dump(), &fresh.dump());
    folder.jitai(["forget", "recorded", "--results", "--yes"]).succeeded();
    assert_eq!(folder.number("SELECT count(*) FROM recorded_decision"), 0);
    folder.jitai(["doctor"]).succeeded().prints("is healthy");
    // The triggers that protect runs are in place again.
    let raw = rusqlite::Connection::open(folder.path("jitai.sqlite")).unwrap();
    let refused = raw.execute("DELETE FROM run", []).unwrap_err();
    drop(raw);
    assert!(refused.to_string().contains("a run is never deleted"), "{refused}");
    folder.jitai(["run", "sweep.toml", "--quiet"]).succeeded();
    assert_eq!(folder.number("SELECT count(*) FROM run_summary WHERE experiment = 'sweep'"), 8);
}

#[test]
fn results_that_no_experiment_holds_are_counted() {
    let folder = two();
    folder.write("sweep.toml", manifest("sweep", "0.6", "2", Effort::Trivial));
    folder.jitai(["run", "sweep.toml", "--quiet"]).succeeded();
    let forgotten = folder.jitai(["forget", "sweep", "--results", "--yes"]).succeeded();
    forgotten.says("note: no experiment holds 4 jobs with results").prints("with 4 jobs");
    assert_eq!(folder.number("SELECT count(DISTINCT job_key) FROM metric"), 4);
}

#[test]
fn the_latest_change_of_a_manifest_is_the_last_one_whatever_the_clock_said() {
    let folder = two();
    let text = |seeds: &str| manifest("sweep", "[0.4, 0.6]", seeds, Effort::Trivial);
    // The first run was ten days ahead.
    let ahead = "UPDATE experiment SET created_at = '2999-01-01T00:00:00.000Z',
        updated_at = '2999-01-01T00:00:00.000Z' WHERE name = 'sweep'";
    Connection::open(folder.path("jitai.sqlite")).unwrap().execute_batch(ahead).unwrap();
    for seeds in ["3", "4"] {
        folder.write("sweep.toml", text(seeds));
        folder.jitai(["run", "sweep.toml", "--quiet"]).succeeded();
    }
    let status = folder.jitai(["status"]).succeeded();
    status.prints("(the latest of 2 changes)").prints("  - seeds = 3\n  + seeds = 4\n");
    let changes = folder.jitai(["status", "--format", "json"]).succeeded().json();
    let added = |index: usize| changes[0]["manifest_changes"][index]["added"][0].clone();
    assert_eq!((added(0), added(1)), ("seeds = 3".into(), "seeds = 4".into()));
    folder.jitai(["export", "--out", "export"]).succeeded();
    let mut rows = csv::Reader::from_path(folder.path("export/manifest.csv")).unwrap();
    let rows: Vec<csv::StringRecord> = rows.records().map(Result::unwrap).collect();
    let rows: Vec<(&str, bool)> = rows
        .iter()
        .filter(|row| &row[0] == "sweep")
        .map(|row| (&row[4], row[3].contains("seeds = 4")))
        .collect();
    assert_eq!(rows, [("1", false), ("2", false), ("3", true)]);
}

#[test]
fn every_text_of_a_manifest_is_kept_and_status_shows_what_changed() {
    let folder = two();
    assert!(!folder.jitai(["status"]).succeeded().stdout.contains("changed"));
    let first = folder.read("sweep.toml");
    let second = manifest("sweep", "[0.4, 0.6]", "[1, 2, 3]", Effort::Trivial);
    folder.write("sweep.toml", &second);
    folder.jitai(["run", "sweep.toml", "--quiet"]).succeeded();
    folder.jitai(["run", "sweep.toml", "--quiet"]).succeeded();
    let status = folder.jitai(["status"]).succeeded();
    status
        .prints("the manifest of sweep changed at 20")
        .prints("  - seeds = 2\n  + seeds = [1, 2, 3]\n");
    folder.write("sweep.toml", &first);
    folder.jitai(["run", "sweep.toml", "--quiet"]).succeeded();
    let status = folder.jitai(["status", "--format", "json"]).succeeded().json();
    let changes = status[0]["manifest_changes"].as_array().unwrap();
    assert_eq!(changes.len(), 2);
    assert_eq!(changes[0]["added"], changes[1]["removed"]);
    let texts = "SELECT manifest FROM manifest WHERE experiment = 'sweep' ORDER BY number";
    let kept = folder.jitai(["query", texts, "--format", "json"]).succeeded().json();
    let kept: Vec<&str> =
        kept.as_array().unwrap().iter().map(|row| row["manifest"].as_str().unwrap()).collect();
    assert_eq!(kept, [first.as_str(), &second, &first]);
    folder.jitai(["doctor"]).succeeded().prints("is healthy");
    // Merged and salvaged stores keep the texts, too.
    folder.jitai(["merge", "jitai.sqlite", "--store", "merged.sqlite"]).succeeded();
    folder.jitai(["doctor", "--salvage", "saved.sqlite"]).succeeded();
    for store in ["merged.sqlite", "saved.sqlite"] {
        let texts = ["query", texts, "--format", "json", "--store", store];
        assert_eq!(folder.jitai(texts).succeeded().json().as_array().unwrap().len(), 3, "{store}");
        folder.jitai(["doctor", "--store", store]).succeeded().prints("is healthy");
    }
    let mut bytes = fs::read(folder.path("saved.sqlite")).unwrap();
    let at = bytes.windows(second.len()).position(|window| window == second.as_bytes()).unwrap();
    bytes[at] ^= 1;
    folder.write("saved.sqlite", bytes);
    let damaged = folder.jitai(["doctor", "--store", "saved.sqlite"]).ended(3);
    damaged.prints("an earlier manifest of sweep does not match its digest");
}

/// Runs a command beside a stub of Slurm, which holds the task of a submission while the file `held` exists.
fn beside_slurm(folder: &Folder, arguments: &str) -> Finished {
    let program = env!("CARGO_BIN_EXE_jitai");
    let script = format!("PATH=$PWD/bin:$PATH exec {program} {arguments}");
    Running::of(folder.command_of("sh", ["-c", &script])).wait()
}

#[test]
fn an_experiment_of_an_open_submission_is_neither_forgotten_nor_replaced() {
    let folder = Folder::with(&manifest("sweep", "0.6", "1", Effort::Trivial));
    fs::create_dir(folder.path("bin")).unwrap();
    let held = folder.path("held");
    let squeue = format!(
        "[ -e '{}' ] && for a; do case $a in --name=*) echo \"${{a#--name=}}|17|0|RUNNING\" ;; esac; done; exit 0",
        held.display()
    );
    for (name, body) in [
        ("sbatch", "echo 17"),
        ("scontrol", "echo MaxArraySize = 1001"),
        ("scancel", "exit 0"),
        ("squeue", &squeue),
    ] {
        let path = folder.path("bin").join(name);
        fs::write(&path, format!("#!/bin/sh\n{body}\n")).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    }
    fs::write(&held, "").unwrap();
    beside_slurm(&folder, "submit sweep.toml").succeeded();
    let submission = fs::read_dir(folder.path("jitai.sqlite.submissions")).unwrap().flatten();
    let submission = submission.map(|entry| entry.path()).find(|path| path.is_dir()).unwrap();
    let experiments = "SELECT count(DISTINCT experiment) FROM run_summary";

    let tasks = "has tasks with jobs of it; cancel them with `jitai cancel ";
    for forget in ["forget sweep --yes", "forget sweep --results --yes"] {
        beside_slurm(&folder, forget).ended(2).says("nothing was removed").says(tasks);
    }
    folder.write("other.toml", manifest("sweep", "0.8", "1", Effort::Trivial));
    for verb in ["run", "submit"] {
        let replace = format!("{verb} other.toml --replace");
        beside_slurm(&folder, &replace).ended(2).says("nothing was removed").says(tasks);
    }
    // Without Slurm, nobody knows whether a task is left.
    folder.jitai(["forget", "sweep", "--yes"]).ended(2).says("its cluster does not answer");

    let chunk =
        ["--chunk", "0", "--attempt", "17.0", "--scratch", folder.path("").to_str().unwrap()]
            .join(" ");
    beside_slurm(&folder, &format!("task {} {chunk}", submission.display())).succeeded();
    fs::remove_file(&held).unwrap();
    let unmerged = beside_slurm(&folder, "forget sweep --results --yes").ended(2);
    unmerged.says("has results of it that are not merged; merge them with `jitai status --merge");
    beside_slurm(&folder, "status --merge").succeeded();
    assert_eq!(folder.number(experiments), 1);

    // What was merged before it was forgotten stays away.
    beside_slurm(&folder, "forget sweep --results --yes").succeeded();
    beside_slurm(&folder, "status --merge").succeeded();
    assert_eq!(folder.number(experiments), 0);
    assert_eq!(folder.number("SELECT count(*) FROM run"), 0);
}
