//! Exit codes, rejected input and help.

use std::fs;

use rusqlite::Connection;

use crate::support::{Effort, Folder, manifest};

const STORE_READERS: [&[&str]; 4] =
    [&["status"], &["query", "SELECT 1"], &["export", "--out", "out"], &["plan", "sweep.toml"]];

fn folder() -> Folder {
    Folder::with(&manifest("sweep", "0.6", "1", Effort::Trivial))
}

#[test]
fn bad_usage_ends_with_two_and_says_what_would_be_right() {
    let folder = folder();
    folder.jitai([]).ended(2).says("Usage: jitai <COMMAND>");
    folder.jitai(["statu"]).ended(2).says("'status'");
    folder.jitai(["run"]).ended(2).says("<MANIFEST>");
    folder.jitai(["run", "sweep.toml", "--workerz", "2"]).ended(2).says("--workers");
    for workers in ["0", "1025", "-1", "many", "1e99"] {
        for verb in ["run", "plan"] {
            let refused = folder.jitai([verb, "sweep.toml", &format!("--workers={workers}")]);
            refused.ended(2).says("--workers").says("expected a whole number from 1 to 1024");
        }
    }
    folder.jitai(["query", "SELECT 1", "--format", "cvs"]).ended(2).says("csv");
    folder.jitai(["export"]).ended(2).says("--out");
    folder.jitai(["plan", "sweep.toml", "--resolved", "--jobs"]).ended(2);
    folder.jitai(["run", "none.toml"]).ended(2).says("none.toml: no such file");
    folder.jitai(["run", "."]).ended(2).says(".: is a directory, not a manifest");
    assert!(!folder.path("jitai.sqlite").exists());
}

#[test]
fn there_is_nothing_to_read_before_a_run() {
    let folder = folder();
    for reader in &STORE_READERS[..3] {
        let ended = folder.jitai(reader.iter().copied()).ended(3);
        assert_eq!(ended.stdout, "");
        ended.says("there is no store at").says("create it with `jitai run`");
    }
    assert!(!folder.path("jitai.sqlite").exists() && !folder.path("out").exists());
}

#[test]
fn an_empty_file_is_named_as_one_and_a_run_makes_a_store_of_it() {
    let folder = folder();
    folder.write("jitai.sqlite", "");
    for reader in &STORE_READERS[..3] {
        let ended = folder.jitai(reader.iter().copied()).ended(3);
        ended.says("is an empty file; `jitai run` turns it into a store");
    }
    folder.jitai(["plan", "sweep.toml"]).succeeded().says("2 jobs to run");
    folder.jitai(["run", "sweep.toml"]).succeeded();
    folder.jitai(["status"]).succeeded();
}

/// Asserts that every command rejects the file at the store's path and leaves it unchanged.
#[track_caller]
fn refused(folder: &Folder, message: &str) {
    let before = fs::read(folder.path("jitai.sqlite")).ok();
    for arguments in STORE_READERS.iter().chain(&[&["run", "sweep.toml"][..]]) {
        let ended = folder.jitai(arguments.iter().copied()).ended(3).says(message);
        assert!(ended.stderr.contains("jitai.sqlite"), "{}", ended.stderr);
    }
    assert_eq!(fs::read(folder.path("jitai.sqlite")).ok(), before);
}

#[test]
fn a_file_of_another_program_is_refused_and_left_untouched() {
    let folder = folder();
    let foreign = Connection::open(folder.path("jitai.sqlite")).unwrap();
    foreign.execute_batch("CREATE TABLE note (text TEXT)").unwrap();
    drop(foreign);
    refused(&folder, "is a SQLite file of another program");
}

#[test]
fn a_store_of_a_newer_release_is_refused_and_left_untouched() {
    let folder = folder();
    folder.jitai(["run", "sweep.toml"]).succeeded();
    let newer = Connection::open(folder.path("jitai.sqlite")).unwrap();
    newer.execute_batch("PRAGMA user_version = 999").unwrap();
    drop(newer);
    refused(&folder, "has schema version 999");
}

#[test]
fn what_is_no_store_is_refused_and_left_untouched() {
    let text = folder();
    text.write("jitai.sqlite", "date,steps\n2024-01-01,4000\n");
    refused(&text, "is not a SQLite file");
    let directory = folder();
    fs::create_dir(directory.path("jitai.sqlite")).unwrap();
    refused(&directory, "is a folder, not a store");
}

#[test]
fn a_store_in_a_folder_that_is_missing_is_refused() {
    let folder = folder();
    let run = folder.jitai(["run", "sweep.toml", "--store", "no/where.sqlite"]).ended(3);
    run.says("there is no folder").says("create it first");
    assert!(!folder.path("no").exists());
}

#[test]
fn files_to_where_no_folder_can_be_are_refused() {
    let folder = folder();
    folder.jitai(["run", "sweep.toml"]).succeeded();
    for command in ["export", "report sweep.toml"] {
        let to = |out| folder.jitai(command.split(' ').chain(["--out", out]));
        to("sweep.toml/results").ended(3).says(
            "error: failed to write to the folder `sweep.toml/results` (name another with --out): ",
        );
        to("sweep.toml").ended(2).says("--out: `sweep.toml` is a file; name a folder");
    }
}

#[test]
fn a_run_prints_every_event_as_a_line_of_json() {
    let folder = folder();
    let run = folder.jitai(["run", "sweep.toml", "--format", "json"]).succeeded();
    let events: Vec<serde_json::Value> =
        run.stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert!(events.iter().all(|event| event.is_object() && event["event"].is_string()));
    let names: Vec<_> = events.iter().map(|event| event["event"].as_str().unwrap()).collect();
    assert_eq!(names.iter().filter(|name| **name == "started").count(), 2);
    assert_eq!(names.iter().filter(|name| **name == "completed").count(), 2);
    let completed = events.iter().find(|event| event["event"] == "completed").unwrap();
    let key = completed["job"]["job_key"].as_str().unwrap();
    let stored: f64 = folder
        .store()
        .query_row("SELECT mean_return FROM run_summary WHERE job_key = ?1", [key], |r| r.get(0))
        .unwrap();
    assert_eq!(completed["mean_return"], stored);
    let done = serde_json::json!(
        { "event": "done", "ran": 2, "completed": 2, "failed": 0, "left": 0 });
    assert_eq!(events.last(), Some(&done));
    assert_eq!(run.stderr, "");
}

#[test]
fn programs_hear_that_a_worker_s_job_has_ended_before_its_next_starts() {
    let folder = Folder::with(&manifest("sweep", "0.6", "10", Effort::Trivial));
    for workers in ["1", "2"] {
        let store = format!("{workers}.sqlite");
        let arguments =
            ["run", "sweep.toml", "--workers", workers, "--format", "json", "--store", &store];
        let run = folder.jitai(arguments).succeeded();
        let events = run.stdout.lines().map(|line| serde_json::from_str(line).unwrap());
        let events: Vec<serde_json::Value> = events.collect();
        for worker in 0..workers.parse().unwrap() {
            let ours: Vec<_> = events.iter().filter(|event| event["worker"] == worker).collect();
            for pair in ours.chunks(2) {
                let [start, end] = pair else { panic!("{pair:?}") };
                assert_eq!(
                    (&start["event"], &end["event"]),
                    (&"started".into(), &"completed".into())
                );
                assert_eq!(start["job"], end["job"]);
            }
        }
        assert_eq!(events.len(), 41);
    }
    let help = folder.jitai(["run", "--help"]).succeeded().stdout;
    for event in [
        "started",
        "completed",
        "failed",
        "interrupted",
        "lost",
        "skipped",
        "halted",
        "resumed",
        "checkpoint_refused",
        "checkpoint_not_kept",
    ] {
        assert!(help.contains(event), "{event}");
    }
}

/// Runs the program with `stack` megabytes per thread stack and `all` megabytes in total.
#[cfg(target_os = "linux")]
fn with_memory(folder: &Folder, stack: u64, all: u64, arguments: &str) -> std::process::Output {
    let limited = format!("ulimit -v {} && exec \"$0\" {arguments}", all << 10);
    let mut shell = folder.command_of("sh", ["-c", &limited, env!("CARGO_BIN_EXE_jitai")]);
    shell.env("RUST_MIN_STACK", (stack << 20).to_string()).output().unwrap()
}

#[cfg(target_os = "linux")]
#[test]
fn a_sweep_continues_with_as_many_workers_as_there_can_be() {
    let folder = Folder::with(&manifest("sweep", "0.6", "20", Effort::Trivial));
    let output = with_memory(&folder, 512, 3500, "run sweep.toml --workers 40");
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(0), "{said}");
    let (started, _) =
        said.split_once(" of 40 workers started: the system refused more threads").expect(&said);
    let started = started.rsplit(' ').next().unwrap().parse::<u32>().unwrap();
    assert!((1..=6).contains(&started), "{said}");
    assert!(said.contains("40 jobs run, 40 completed in all, 0 failed"), "{said}");
}

#[cfg(target_os = "linux")]
#[test]
fn a_sweep_without_a_single_worker_is_an_error() {
    let folder = Folder::with(&manifest("sweep", "0.6", "1", Effort::Trivial));
    // The memory suffices for the threads that receive signals and time a stop, but for no other
    // thread.
    let output = with_memory(&folder, 1024, 2700, "run sweep.toml --workers 2");
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(3), "{said}");
    assert!(said.starts_with("error: failed to start a worker: "), "{said}");
    assert_eq!(folder.runs(), 0);
    assert_eq!(folder.number("SELECT count(*) FROM session WHERE ended_at IS NULL"), 0);
}

#[test]
fn a_quiet_run_prints_nothing() {
    let folder = folder();
    let run = folder.jitai(["run", "sweep.toml", "-q"]).succeeded();
    assert_eq!((run.stdout.as_str(), run.stderr.as_str()), ("", ""));
    let again = folder.jitai(["run", "sweep.toml"]).succeeded();
    again.prints("mean return ± sd over seeds");
}

#[test]
fn a_misspelt_verb_names_the_nearest_one() {
    let folder = Folder::new();
    for (misspelt, verb) in [("reprot", "report"), ("chekc", "check"), ("stauts", "status")] {
        let said = folder.jitai([misspelt, "sweep.toml"]).ended(2).stderr;
        assert!(said.contains(&format!("a similar subcommand exists: '{verb}'")), "{said}");
    }
    let said = folder.jitai(["plan", "--wokers", "2", "sweep.toml"]).ended(2);
    said.says("'--workers'");
}

#[test]
fn an_experiment_that_is_not_there_has_a_nearest_name() {
    let folder = folder();
    folder.jitai(["run", "sweep.toml", "-q"]).succeeded();
    let meant = "has no experiment `sweeep`, did you mean `sweep`?; it has sweep";
    folder.jitai(["forget", "sweeep", "--yes"]).ended(2).says(meant);
    folder.jitai(["export", "--experiment", "sweeep", "--out", "out"]).ended(2).says(meant);
    folder.write("other.toml", manifest("sweeep", "0.9", "[7]", Effort::Trivial));
    folder.jitai(["report", "other.toml", "--out", "report"]).succeeded().says(meant);
}

#[test]
fn every_verb_explains_its_options() {
    let folder = Folder::new();
    let everywhere = folder.jitai(["--help"]).succeeded().stdout;
    let options: [(&str, &[&str]); 8] = [
        ("check", &["<MANIFEST>", "--format"]),
        ("plan", &["<MANIFEST>", "--jobs", "--resolved", "--filter", "--workers", "--format"]),
        (
            "run",
            &[
                "<MANIFEST>",
                "--workers",
                "--filter",
                "--retry-failed",
                "--fail-fast",
                "--quiet",
                "--format",
            ],
        ),
        ("status", &["--submissions", "--format"]),
        ("query", &["<SQL>", "--format", "csv", "json", "table"]),
        ("export", &["--out", "--format"]),
        (
            "simulate",
            &[
                "--policy",
                "fixed:",
                "random",
                "tailored",
                "optimal",
                "threshold:",
                "run:",
                "--set",
                "--episodes",
                "--seed",
                "--greedy",
                "--summary",
                "--replay",
                "--format",
            ],
        ),
        ("schema", &["--help"]),
    ];
    for (verb, options) in options {
        assert!(everywhere.contains(&format!("\n  {verb} ")), "{verb}");
        let help = folder.jitai([verb, "--help"]).succeeded().stdout;
        for option in options {
            assert!(help.contains(option), "`{verb} --help` does not say {option}");
        }
        let has_store = verb != "schema";
        assert_eq!(help.contains("--store"), has_store, "{verb}");
    }
    folder.jitai(["--version"]).succeeded().prints(env!("CARGO_PKG_VERSION"));
}
