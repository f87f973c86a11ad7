//! Processes that crash: the job that crashes them is found and recorded, the jobs beside it complete,
//! and a killed process counts against no job.

use std::fs;

use crate::support::{Effort, Folder, Running, manifest, until};

const RUNNING: &str = "SELECT count(*) FROM run WHERE status = 'running'";
const CRASHED: &str = "SELECT count(*) FROM run WHERE failure_kind = 'crashed'";

/// Starts a sweep of two workers, waits until `jobs` jobs run in its session, and sends `signal`.
fn ended_while_running(folder: &Folder, sessions: i64, jobs: i64, signal: &str) {
    let run = folder.start(["run", "sweep.toml", "--workers", "2"]);
    let running = format!("{RUNNING} AND session = {sessions}");
    until("jobs run", || folder.count_if_there(&running) == Some(jobs));
    run.signal(signal);
    assert_eq!(run.wait().code, None);
}

fn marks(folder: &Folder) -> usize {
    let names = fs::read_dir(folder.path("")).unwrap().map(|entry| entry.unwrap().file_name());
    names.filter(|name| name.to_str().unwrap().contains("-session-")).count()
}

#[test]
fn a_job_that_brings_its_process_down_three_times_has_failed_and_its_neighbour_has_not() {
    let folder = Folder::with(&manifest("sweep", "0.6", "1", Effort::Endless));
    // Two jobs run in the first session and become suspects. The first suspect runs alone in the next
    // two sessions.
    ended_while_running(&folder, 1, 2, "ABRT");
    ended_while_running(&folder, 2, 1, "ABRT");
    assert_eq!(folder.number("SELECT count(*) FROM run WHERE suspects = 2"), 2);
    ended_while_running(&folder, 3, 1, "ABRT");
    assert_eq!(folder.number(CRASHED), 0);
    // Then the other job runs. A kill does not count as a crash, however often it happens.
    for session in 4..=7 {
        ended_while_running(&folder, session, 1, "KILL");
        assert_eq!(folder.number(CRASHED), 1);
    }
    let run: Running = folder.start(["run", "sweep.toml", "--workers", "2"]);
    let eighth = format!("{RUNNING} AND session = 8");
    until("the other runs on", || folder.count_if_there(&eighth) == Some(1));
    assert_eq!(marks(&folder), 1);
    run.signal("INT");
    run.wait().ended(130);
    assert_eq!(marks(&folder), 0);
    assert_eq!(folder.number("SELECT count(DISTINCT job) FROM run WHERE suspects = 1"), 1);
    let status = folder.jitai(["status"]).succeeded().prints("crashed");
    let status =
        status.prints("the process crashed in 3 attempts at this job, in the last one without");
    assert!(status.stdout.contains("dqn P-H-D"), "{}", status.stdout);
    folder.jitai(["doctor"]).succeeded();
}

#[test]
fn suspects_that_did_nothing_wrong_complete() {
    let folder = Folder::with(&manifest("sweep", "0.6", "2", Effort::Short));
    ended_while_running(&folder, 1, 2, "ABRT");
    folder.jitai(["run", "sweep.toml", "--workers", "2"]).succeeded();
    assert_eq!(folder.number("SELECT count(*) FROM run WHERE status = 'completed'"), 4);
    assert_eq!(folder.number("SELECT count(*) FROM run WHERE suspects = 2"), 2);
}

#[test]
fn the_mark_of_a_process_that_was_killed_while_idle_goes_with_the_next_run() {
    let folder = Folder::with(&manifest("sweep", "0.6", "1", Effort::Endless));
    let busy = folder.start(["run", "sweep.toml", "--workers", "2"]);
    until("both jobs run", || folder.count_if_there(RUNNING) == Some(2));
    let idle = folder.start(["run", "sweep.toml", "--workers", "2"]);
    until("the other one waits", || marks(&folder) == 2);
    idle.kill();
    folder.write("jitai.sqlite-session-77", "!");
    folder.write("jitai.sqlite-session-", "of somebody else");

    let third = folder.start(["run", "sweep.toml", "--workers", "2"]);
    until("it begins", || folder.path("jitai.sqlite-session-3").exists());
    let left = ["", "1", "3"].map(|session| format!("jitai.sqlite-session-{session}"));
    assert!(left.iter().all(|name| folder.path(name).exists()));
    assert_eq!(marks(&folder), left.len());
    for run in [third, busy] {
        run.signal("INT");
        run.wait().ended(130);
    }
    assert_eq!(marks(&folder), 1);
}
