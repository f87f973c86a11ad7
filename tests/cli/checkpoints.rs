//! Stopped or killed jobs resume from their checkpoints, and completed jobs leave no checkpoint.

use std::fs;
use std::path::PathBuf;
use std::process::Stdio;
use std::sync::LazyLock;
use std::thread;
use std::time::{Duration, Instant};

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use rusqlite::Connection;

use crate::support::{
    Effort, Folder, Running, assert_prompt, assert_same_rows, is_timed, manifest, until,
};

/// Two jobs of about a second each: a fast machine must not complete them before they are stopped.
fn text() -> String {
    let long = manifest("sweep", "0.6", "1", Effort::Long);
    long.replace("episodes = 4000", "episodes = 2000").replace("120000", "60000")
}

/// The results of the jobs in an undisturbed sweep.
fn undisturbed() -> &'static [String] {
    static DUMP: LazyLock<Vec<String>> = LazyLock::new(|| {
        let folder = Folder::completed(&text());
        assert_nothing_stays(&folder);
        folder.dump()
    });
    &DUMP
}

/// The files in the folder of checkpoints.
fn checkpoints(folder: &Folder) -> Vec<PathBuf> {
    let Ok(files) = fs::read_dir(folder.path("jitai.sqlite.checkpoints")) else {
        return Vec::new();
    };
    let mut paths: Vec<PathBuf> = files.map(|file| file.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|form| form == "checkpoint"));
    paths.sort_unstable();
    paths
}

#[track_caller]
fn assert_nothing_stays(folder: &Folder) {
    assert!(!folder.path("jitai.sqlite.checkpoints").exists(), "{:?}", checkpoints(folder));
}

fn running(folder: &Folder) -> i64 {
    folder.count_if_there("SELECT count(*) FROM run WHERE status = 'running'").unwrap_or(0)
}

/// Starts a sweep of two workers, and lets both train until each has written a checkpoint.
#[track_caller]
fn well_under_way(folder: &Folder) -> Running {
    let often = ["run", "sweep.toml", "--workers", "2", "--checkpoint-every", "0.1"];
    let before = contents(folder);
    let run = folder.start(often);
    until("both jobs have made a checkpoint", || {
        let now = contents(folder);
        now.len() == 2 && now.iter().all(|file| !before.contains(file))
    });
    run
}

/// The checkpoints with their contents.
fn contents(folder: &Folder) -> Vec<(PathBuf, Vec<u8>)> {
    // A checkpoint that is replaced between listing and reading is left out.
    let paths = checkpoints(folder).into_iter();
    paths.filter_map(|path| fs::read(&path).ok().map(|bytes| (path, bytes))).collect()
}

#[test]
fn a_stopped_job_resumes_where_it_was_to_the_same_rows() {
    for signal in ["TERM", "INT", "HUP"] {
        let folder = Folder::with(&text());
        let run = well_under_way(&folder);
        let before = contents(&folder);
        let asked = Instant::now();
        run.signal(signal);
        run.wait().ended(130).says("2 left; run the same command to resume");
        assert_prompt(asked);
        let after = contents(&folder);
        assert_eq!(after.len(), 2);
        assert!(after.iter().all(|file| !before.contains(file)), "as they were before the stop");
        let ended = folder.jitai(["run", "sweep.toml"]).succeeded();
        assert_eq!(ended.stderr.matches(": resumed from episode ").count(), 2, "{}", ended.stderr);
        assert!(!ended.stderr.contains("resumed from episode 0 of"), "{}", ended.stderr);
        assert_same_rows(&folder.dump(), undisturbed());
        assert_nothing_stays(&folder);
        // The second attempts record the total time of the jobs.
        let shorter = "SELECT count(*) FROM run AS late JOIN run AS early ON early.job = late.job
            WHERE late.attempt = 2 AND early.attempt = 1
                AND late.wall_seconds <= early.wall_seconds";
        assert_eq!(folder.number(shorter), 0);
    }
}

#[test]
fn a_killed_job_resumes_from_its_last_checkpoint_to_the_same_rows() {
    let mut chance = ChaCha8Rng::seed_from_u64(5);
    let folder = Folder::with(&text());
    let mut resumed = 0;
    for _ in 0..6 {
        let run = well_under_way(&folder);
        thread::sleep(Duration::from_millis(u64::from(chance.next_u32() % 60)));
        resumed += run.stderr().matches(": resumed from episode ").count();
        run.kill();
    }
    assert_eq!(resumed, 10, "both jobs, all times but the first");
    folder.jitai(["run", "sweep.toml"]).succeeded().says(": resumed from episode ");
    assert_same_rows(&folder.dump(), undisturbed());
    assert_nothing_stays(&folder);
}

#[test]
fn a_damaged_checkpoint_is_reported_and_its_job_starts_over() {
    for format in ["text", "json"] {
        let folder = Folder::with(&text());
        let run = well_under_way(&folder);
        run.signal("TERM");
        run.wait().ended(130);
        let damaged = checkpoints(&folder).remove(0);
        let mut bytes = fs::read(&damaged).unwrap();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 4;
        fs::write(&damaged, bytes).unwrap();
        let ended = folder.jitai(["run", "sweep.toml", "--format", format]).succeeded();
        let ended = ended.says(" rejected: damaged");
        if format == "json" {
            let events: Vec<serde_json::Value> =
                ended.stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
            let event = |name: &str| {
                events
                    .iter()
                    .find(|event| event["event"] == name)
                    .unwrap_or_else(|| panic!("{name}"))
            };
            let refused = event("checkpoint_refused");
            let file = refused["file"].as_str().unwrap();
            assert!(damaged.ends_with(PathBuf::from(file).file_name().unwrap()), "{file}");
            assert_eq!(refused["reason"], "damaged");
            let resumed = event("resumed");
            assert!(resumed["episode"].as_i64() > Some(0), "{resumed}");
            assert_ne!(resumed["job"]["job_key"], refused["job"]["job_key"]);
        }
        assert_same_rows(&folder.dump(), undisturbed());
        assert_nothing_stays(&folder);
    }
}

#[test]
fn checkpoints_that_cannot_be_written_are_reported_once_and_jobs_continue() {
    let folder = Folder::with(&text());
    folder.write("jitai.sqlite.checkpoints", "a file where the folder would be");
    let often = ["run", "sweep.toml", "--quiet", "--checkpoint-every", "0.05"];
    let ended = folder.jitai(often).succeeded();
    let told = ended.stderr.matches("failed to write the checkpoint").count();
    assert_eq!(told, 2, "{}", ended.stderr);
    assert_same_rows(&folder.dump(), undisturbed());
    assert_eq!(folder.read("jitai.sqlite.checkpoints"), "a file where the folder would be");
}

#[test]
fn checkpoints_of_jobs_that_are_done_are_removed_when_a_sweep_begins() {
    let folder = Folder::with(&text());
    let run = well_under_way(&folder);
    run.signal("TERM");
    run.wait().ended(130);
    let kept = contents(&folder);
    folder.jitai(["run", "sweep.toml"]).succeeded();
    assert_nothing_stays(&folder);
    fs::create_dir(folder.path("jitai.sqlite.checkpoints")).unwrap();
    for (path, bytes) in kept {
        fs::write(path.with_extension("unfinished"), &bytes[..10]).unwrap();
        fs::write(path, bytes).unwrap();
    }
    folder.jitai(["run", "sweep.toml"]).succeeded().says("nothing to run");
    assert_nothing_stays(&folder);
}

#[test]
fn a_stop_writes_checkpoints_while_another_program_holds_the_store() {
    let folder = Folder::with(&manifest("sweep", "0.6", "1", Effort::Endless));
    let run = folder.start(["run", "sweep.toml", "--workers", "2"]);
    until("both jobs run", || running(&folder) == 2);
    let stranger = Connection::open(folder.path("jitai.sqlite")).unwrap();
    stranger.execute_batch("BEGIN IMMEDIATE").unwrap();
    if is_timed() {
        // This is long enough for a heartbeat, which then waits for the store.
        thread::sleep(Duration::from_secs(6));
    }
    let asked = Instant::now();
    run.signal("TERM");
    run.wait().ended(130);
    assert_prompt(asked);
    // No checkpoint was due before the stop.
    assert_eq!(checkpoints(&folder).len(), 2);
    stranger.execute_batch("COMMIT").unwrap();
    let again = folder.start(["run", "sweep.toml"]);
    until("the jobs go on", || again.stderr().matches(": resumed from episode ").count() == 2);
}

#[test]
fn a_terminal_that_is_closed_stops_a_sweep_as_ctrl_c_does() {
    let folder = Folder::with(&manifest("sweep", "0.6", "1", Effort::Endless));
    let mut command = folder.command(["run", "sweep.toml", "--workers", "2"]);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    until("both jobs run", || running(&folder) == 2);
    // A terminal that goes away closes the output and sends a signal.
    drop((child.stdout.take(), child.stderr.take()));
    let kill = format!("kill -HUP {}", child.id());
    assert!(folder.command_of("sh", ["-c", &kill]).status().unwrap().success());
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert_eq!(checkpoints(&folder).len(), 2);
}

#[test]
fn a_run_whose_claim_was_lost_leaves_no_checkpoint_and_harms_none() {
    let folder = Folder::with(&text());
    let often = ["run", "sweep.toml", "--workers", "2", "--checkpoint-every", "0.05"];
    let run = folder.start(often);
    until("there are checkpoints", || checkpoints(&folder).len() == 2);
    run.signal("STOP");
    // As if the process were dead, its runs are marked as interrupted.
    let interrupt = "UPDATE run SET status = 'interrupted',
        ended_at = '2026-01-31T12:00:00.000Z' WHERE status = 'running'";
    Connection::open(folder.path("jitai.sqlite")).unwrap().execute(interrupt, []).unwrap();
    let second = folder.start(often);
    until("the second goes on", || second.stderr().matches(": resumed from episode ").count() == 2);
    run.signal("CONT");
    second.wait().succeeded();
    run.wait().succeeded().says("taken over by another process");
    assert_eq!(folder.number("SELECT count(*) FROM run WHERE status = 'completed'"), 2);
    assert_same_rows(&folder.dump(), undisturbed());
    assert_nothing_stays(&folder);
}
