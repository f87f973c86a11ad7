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
    // Two jobs run in the first session and become suspects. Then the one with fewer deaths runs alone: the
    // first, the second, and the first again.
    ended_while_running(&folder, 1, 2, "ABRT");
    for session in 2..=4 {
        ended_while_running(&folder, session, 1, "ABRT");
        assert_eq!(folder.number("SELECT count(*) FROM run WHERE suspects = 2"), 2);
    }
    let alone = "SELECT job, count(*) AS runs FROM run WHERE suspects = 1 GROUP BY job";
    assert_eq!(folder.number(&format!("SELECT 10 * min(runs) + max(runs) FROM ({alone})")), 11);
    assert_eq!(folder.number(CRASHED), 0);
    // Then the other job runs. A kill soon after the start does not count, however often it happens.
    for session in 5..=8 {
        ended_while_running(&folder, session, 1, "KILL");
        assert_eq!(folder.number(CRASHED), 1);
    }
    let run: Running = folder.start(["run", "sweep.toml", "--workers", "2"]);
    let ninth = format!("{RUNNING} AND session = 9");
    until("the other runs on", || folder.count_if_there(&ninth) == Some(1));
    assert_eq!(marks(&folder), 1);
    run.signal("INT");
    run.wait().ended(130);
    assert_eq!(marks(&folder), 0);
    let status = folder.jitai(["status"]).succeeded().prints("crashed");
    let status =
        status.prints("the process crashed or was killed in 3 attempts at this job, in the");
    assert!(status.stdout.contains("dqn P-H-D"), "{}", status.stdout);
    folder.jitai(["doctor"]).succeeded();
}

/// An endless job, which comes first, and two rules.
fn endless_and_rules() -> String {
    let endless = manifest("sweep", "0.6", "1", Effort::Endless);
    let (before, _) = endless.split_once("[[agent]]\nname = \"reinforce\"").unwrap();
    let rule = "[[agent]]\nname = \"never\"\nalgorithm = \"rule\"\nrule = \"never\"\n";
    format!("{before}{rule}{}", rule.replace("never", "tailored"))
}

/// Kills a run with one worker more than a second after it has started a job.
fn killed_after_a_second(folder: &Folder, session: i64, more: &[&str]) {
    let arguments = [&["run", "sweep.toml", "--workers", "1"], more].concat();
    let run = folder.start(arguments);
    until("the start of a job is outlived", || {
        folder.count_if_there(&outlived(session)) == Some(1)
    });
    run.signal("KILL");
    assert_eq!(run.wait().code, None);
}

/// A sweep that can write no checkpoint: a file lies in the place of their folder.
fn without_checkpoints(manifest: &str) -> Folder {
    let folder = Folder::with(manifest);
    folder.write("jitai.sqlite.checkpoints", "");
    folder
}

#[test]
fn a_job_that_is_killed_three_times_without_getting_further_comes_last_and_has_failed() {
    let folder = without_checkpoints(&endless_and_rules());
    const COMPLETED: &str = "SELECT count(*) FROM run WHERE status = 'completed'";
    killed_after_a_second(&folder, 1, &[]);
    assert_eq!(folder.number(COMPLETED), 0);
    // From now on, the job runs after all others.
    killed_after_a_second(&folder, 2, &[]);
    assert_eq!(folder.number(COMPLETED), 2);
    killed_after_a_second(&folder, 3, &[]);
    let ended = folder.jitai(["run", "sweep.toml"]).ended(1);
    ended.prints("crashed").prints("`--retry-failed` runs the job again");
    assert_eq!(folder.number(CRASHED), 1);
    // The job is not condemned for ever: its deaths are counted anew.
    killed_after_a_second(&folder, 5, &["--retry-failed"]);
    killed_after_a_second(&folder, 6, &["--retry-failed"]);
    assert_eq!(folder.number(CRASHED), 1);
    folder.jitai(["doctor"]).succeeded();
}

#[test]
fn a_job_that_gets_further_between_kills_has_not_failed() {
    let folder = Folder::with(&endless_and_rules());
    for session in 1..=4 {
        killed_after_a_second(&folder, session, &["--checkpoint-every", "0.05"]);
    }
    let run = folder.start(["run", "sweep.toml", "--workers", "1"]);
    until("the job runs on", || run.stderr().contains("resumed from episode"));
    run.signal("INT");
    run.wait().ended(130);
    assert_eq!(folder.number(CRASHED), 0);
    assert_eq!(folder.number("SELECT count(suspects) FROM run"), 0);
}

#[test]
fn after_a_kill_a_job_writes_checkpoints_sooner_and_gets_further() {
    let folder = Folder::with(&endless_and_rules());
    // The first attempt is killed before the interval of 20 seconds is over.
    killed_after_a_second(&folder, 1, &[]);
    let checkpoint = |attempt: u32| {
        let files = fs::read_dir(folder.path("jitai.sqlite.checkpoints"));
        let mut names = files.into_iter().flatten().map(|file| file.unwrap().file_name());
        names.any(|name| name.to_str().unwrap().ends_with(&format!(".{attempt}.checkpoint")))
    };
    assert!(!checkpoint(1));
    for attempt in 2..=5 {
        let run = folder.start(["run", "sweep.toml", "--workers", "1"]);
        until("a checkpoint is written", || checkpoint(attempt));
        if attempt > 2 {
            assert!(run.stderr().contains("resumed from episode"), "{}", run.stderr());
        }
        run.signal("KILL");
        assert_eq!(run.wait().code, None);
    }
    let run = folder.start(["run", "sweep.toml", "--workers", "1"]);
    until("the job runs on", || run.stderr().contains("resumed from episode"));
    run.signal("INT");
    run.wait().ended(130);
    // Only the first attempt got nowhere.
    assert_eq!(folder.number("SELECT count(suspects) FROM run"), 1);
}

/// SQL: the running jobs of a session that have outlived their start.
fn outlived(session: i64) -> String {
    format!(
        "SELECT count(*) FROM run JOIN session ON session.id = run.session
         WHERE status = 'running' AND session = {session}
            AND 86400 * (julianday(heartbeat_at) - julianday(run.started_at)) >= 1"
    )
}

#[test]
fn jobs_that_run_side_by_side_are_suspects_after_the_second_kill() {
    let folder = without_checkpoints(&manifest("sweep", "0.6", "1", Effort::Endless));
    let start = || folder.start(["run", "sweep.toml", "--workers", "2"]);
    for (session, suspects, side_by_side) in [(1, 0, 2), (4, 2, 1)] {
        let run = start();
        until("both outlive their start", || folder.count_if_there(&outlived(session)) == Some(2));
        run.signal("KILL");
        run.wait();
        // The next run takes over the jobs and starts them.
        let next = start();
        let running = format!("{RUNNING} AND session = {}", session + 1);
        until("the next run runs", || folder.count_if_there(&running) == Some(side_by_side));
        next.signal("INT");
        next.wait().ended(130);
        assert_eq!(folder.number("SELECT count(suspects) FROM run"), suspects);
        // A kill soon after the start makes no suspect, but the next kill is the second in a row.
        if suspects == 0 {
            ended_while_running(&folder, 3, 2, "KILL");
        }
    }
}

#[test]
fn a_process_that_ends_after_a_second_signal_counts_against_no_job() {
    let folder = Folder::with(&endless_and_rules());
    let run = folder.start(["run", "sweep.toml", "--workers", "1"]);
    until("the job outlives its start", || folder.count_if_there(&outlived(1)) == Some(1));
    for signal in ["STOP", "INT", "TERM", "CONT"] {
        run.signal(signal);
    }
    run.wait().ended(130);
    assert_eq!(folder.number(RUNNING), 1);
    let next = folder.start(["run", "sweep.toml", "--workers", "1"]);
    let second = format!("{RUNNING} AND session = 2");
    until("the next run runs", || folder.count_if_there(&second) == Some(1));
    next.signal("INT");
    next.wait().ended(130);
    assert_eq!(folder.number("SELECT count(suspects) FROM run"), 0);
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
