//! A sweep stops on request, and resumes when it is run again.

use std::fs;
use std::io::Write;
use std::process::{Child, ChildStderr, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use rusqlite::Connection;

use crate::support::{
    Effort, Finished, Folder, Running, assert_prompt, assert_same_rows, manifest, until,
};

fn a_signal_stops_long_jobs_at_once(signal: &str) {
    let folder = Folder::with(&manifest("sweep", "0.6", "1", Effort::Endless));
    let run = folder.start(["run", "sweep.toml", "--workers", "2"]);
    until("both jobs run", || {
        folder.is_running_a_job()
            && folder.number("SELECT count(*) FROM run WHERE status = 'running'") == 2
    });
    let asked = Instant::now();
    run.signal(signal);
    let ended = run.wait().ended(130);
    assert_prompt(asked);
    ended.says("stopped: 0 jobs completed, 2 left; run the same command to resume");
    let interrupted = "SELECT count(*) FROM run_summary WHERE status = 'interrupted' \
                       AND wall_seconds IS NOT NULL AND ended_at IS NOT NULL";
    assert_eq!(folder.number(interrupted), 2);
    assert_eq!(folder.runs(), 2);
    assert_eq!(folder.number("SELECT count(*) FROM session WHERE ended_at IS NULL"), 0);
}

/// What the command of `--on-end` has written so far.
fn called(folder: &Folder) -> String {
    fs::read_to_string(folder.path("called")).unwrap_or_default()
}

#[test]
fn an_interrupt_from_the_keyboard_stops_long_jobs_within_two_seconds() {
    a_signal_stops_long_jobs_at_once("INT");
}

#[test]
fn a_request_to_terminate_stops_long_jobs_within_two_seconds() {
    a_signal_stops_long_jobs_at_once("TERM");
}

#[test]
fn a_hang_up_and_the_warnings_of_batch_systems_stop_long_jobs_within_two_seconds() {
    for signal in ["HUP", "USR1", "USR2", "XCPU"] {
        a_signal_stops_long_jobs_at_once(signal);
    }
}

/// Many short jobs, whose lines are more than a pipe holds.
fn talkative() -> String {
    let name = "n".repeat(60);
    format!(
        "format = 1\nname = \"sweep\"\nscenarios = [\"P-H-D\"]\nseeds = 900\nenvironment.sigma = 0.6\n\
         evaluation.test_episodes = 2\n\
         [[agent]]\nname = \"{name}\"\nalgorithm = \"rule\"\nrule = \"never\"\n"
    )
}

/// Starts a run that nobody reads: its standard error is a pipe that nobody empties.
fn start_unread(folder: &Folder, more: &[&str]) -> (Child, ChildStderr) {
    let arguments = [&["run", "sweep.toml", "--workers", "2", "--on-end", "cat > called"], more];
    let mut command = folder.command_of(env!("CARGO_BIN_EXE_jitai"), arguments.concat());
    let mut run = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let unread = run.stderr.take().unwrap();
    (run, unread)
}

#[test]
fn a_reader_that_stalls_stops_neither_the_jobs_nor_the_end() {
    let completed = "SELECT count(*) FROM run WHERE status = 'completed'";
    let folder = Folder::with(&talkative());
    let (mut run, _unread) = start_unread(&folder, &[]);
    assert_eq!(run.wait().unwrap().code(), Some(0));
    assert_eq!(folder.number(completed), 900);
    assert!(folder.read("called").contains("\"done\""));

    let folder = Folder::with(&talkative());
    let endless = manifest("endless", "0.4", "1", Effort::Endless);
    folder.write("endless.toml", endless);
    let (mut run, _unread) = start_unread(&folder, &["endless.toml"]);
    until("all others are completed", || folder.count_if_there(completed) == Some(900));
    let asked = Instant::now();
    let kill = format!("kill -TERM {}", run.id());
    assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
    assert_eq!(run.wait().unwrap().code(), Some(130));
    assert_prompt(asked);
    until("the command was called", || folder.path("called").exists());
    until("it has read", || called(&folder).contains("\"stopped\""));
    assert_eq!(folder.number("SELECT count(*) FROM session WHERE ended_at IS NULL"), 0);
}

/// Starts the program with these signals ignored, as `nohup` and shells do.
fn start_ignoring(folder: &Folder, signals: &str, arguments: &str) -> Running {
    let program = env!("CARGO_BIN_EXE_jitai");
    let script = format!("trap '' {signals}; exec {program} {arguments}");
    Running::of(folder.command_of("sh", ["-c", &script]))
}

/// Sends signals, which the program must not heed, and then SIGTERM, which ends it with exit code 130.
#[track_caller]
fn heeds_only_the_last(mut run: Running, signals: &[&str]) -> Finished {
    for signal in signals {
        run.signal(signal);
        thread::sleep(Duration::from_millis(200));
        assert!(!run.has_ended(), "{signal}: {}", run.stderr());
    }
    run.signal("TERM");
    run.wait().ended(130)
}

#[test]
#[cfg(target_os = "linux")]
fn signals_that_are_ignored_at_the_start_stay_ignored() {
    let folder = Folder::with(&manifest("sweep", "0.6", "1", Effort::Endless));
    let run = start_ignoring(&folder, "HUP INT", "run sweep.toml --workers 1");
    until("a job runs", || folder.is_running_a_job());
    let ended = heeds_only_the_last(run, &["HUP", "INT", "HUP", "INT"]);
    ended.says("stopped: 0 jobs completed, 2 left");

    let folder = Folder::completed(&manifest("sweep", "0.6", "1", Effort::Trivial));
    let query = "query --format csv \"WITH RECURSIVE n (i) AS (VALUES (1) UNION ALL SELECT i + 1 \
                 FROM n) SELECT i FROM n\"";
    let run = start_ignoring(&folder, "HUP", query);
    until("it answers", || run.stdout().contains("\n1000\n"));
    heeds_only_the_last(run, &["HUP"]);
}

/// Adds a cluster on which every task waits forever.
#[cfg(target_os = "linux")]
fn add_idle_cluster(folder: &Folder) {
    std::fs::create_dir(folder.path("bin")).unwrap();
    for (name, body) in [
        ("sbatch", "echo 17"),
        ("scontrol", "echo MaxArraySize = 1001"),
        (
            "squeue",
            "for a; do case $a in --name=*) echo \"${a#--name=}|17|0|PENDING\" ;; esac; done",
        ),
    ] {
        let path = folder.path("bin").join(name);
        std::fs::write(&path, format!("#!/bin/sh\n{body}\n")).unwrap();
        let mode = std::os::unix::fs::PermissionsExt::from_mode(0o755);
        std::fs::set_permissions(&path, mode).unwrap();
    }
}

#[test]
#[cfg(target_os = "linux")]
fn a_reader_that_stalls_does_not_keep_a_wait_for_a_cluster() {
    let folder = Folder::with(&manifest("sweep", "0.6", "1", Effort::Trivial));
    add_idle_cluster(&folder);
    // A pipe that is full from the beginning, and that nobody reads.
    let (_unread, mut full) = std::io::pipe().unwrap();
    full.write_all(&[b'\n'; 1 << 16]).unwrap();
    let path = format!("{}:{}", folder.path("bin").display(), std::env::var("PATH").unwrap());
    let submit = ["submit", "sweep.toml", "--wait", "--on-end", "cat > called"];
    let mut command = folder.command_of(env!("CARGO_BIN_EXE_jitai"), submit);
    let mut wait = command.env("PATH", path).stdout(Stdio::null()).stderr(full).spawn().unwrap();
    let submissions = folder.path("jitai.sqlite.submissions");
    until("it has submitted", || submissions.exists());
    thread::sleep(Duration::from_secs(3));
    let asked = Instant::now();
    let kill = format!("kill -TERM {}", wait.id());
    assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
    assert_eq!(wait.wait().unwrap().code(), Some(130));
    assert_prompt(asked);
    until("the command has read", || called(&folder).contains("\"stopped\""));
}

#[test]
#[cfg(target_os = "linux")]
fn a_wait_for_a_cluster_ignores_and_heeds_the_same_signals() {
    let folder = Folder::with(&manifest("sweep", "0.6", "1", Effort::Trivial));
    add_idle_cluster(&folder);
    let program = env!("CARGO_BIN_EXE_jitai");
    let waiting = |ignored: &str| {
        let script = format!(
            "{ignored} PATH=$PWD/bin:$PATH; export PATH; exec {program} submit sweep.toml --wait"
        );
        // Unless the script says otherwise, the program heeds signals that this process ignores.
        let heeding = ["--default-signal=HUP,INT", "sh", "-c", &script];
        let run = Running::of(folder.command_of("/usr/bin/env", heeding));
        until("it waits", || run.stderr().contains("waiting"));
        run
    };
    let ended = heeds_only_the_last(waiting("trap '' HUP INT;"), &["HUP", "INT"]);
    ended.says("stopped waiting; the tasks continue on the cluster");
    for signal in ["HUP", "USR1", "XCPU"] {
        let run = waiting("");
        run.signal(signal);
        run.wait().ended(130).says("stopped waiting");
    }
}

#[test]
#[cfg(target_os = "linux")]
fn repeated_warnings_do_not_end_the_program_before_its_jobs_are_saved() {
    let folder = Folder::with(&manifest("sweep", "0.6", "1", Effort::Endless));
    let run = folder.start(["run", "sweep.toml", "--workers", "1"]);
    until("a job runs", || folder.is_running_a_job());
    // All signals are pending before the program can act on the first.
    run.signal("STOP");
    for signal in ["XCPU", "USR1", "USR2", "TERM"] {
        run.signal(signal);
    }
    run.signal("CONT");
    run.wait().ended(130).says("stopped: 0 jobs completed, 2 left");
    assert_eq!(folder.number("SELECT count(*) FROM run WHERE status = 'running'"), 0);
}

/// Interrupts a sweep, which must end in time, and returns its output.
#[track_caller]
fn stopped_in_time(run: Running) -> Finished {
    let asked = Instant::now();
    run.signal("INT");
    let ended = run.wait().ended(130);
    assert_prompt(asked);
    ended
}

#[test]
fn a_registration_of_very_many_jobs_is_stopped_in_time() {
    let folder = Folder::with(&manifest("sweep", "0.6", "200000", Effort::Trivial));
    let run = folder.start(["run", "sweep.toml"]);
    let registered = || folder.count_if_there("SELECT count(*) FROM experiment_job");
    until("jobs are being registered", || registered() > Some(0));
    stopped_in_time(run).says("run the same command to resume");
    let registered = registered().unwrap();
    assert!((1..400_000).contains(&registered), "{registered}");
    assert_eq!(folder.runs(), 0);
}

#[test]
fn a_sweep_that_waits_for_another_writer_is_stopped_in_time() {
    let folder = Folder::completed(&manifest("sweep", "0.6", "1", Effort::Trivial));
    folder.write("sweep.toml", manifest("sweep", "0.6", "2", Effort::Trivial));
    let stranger = Connection::open(folder.path("jitai.sqlite")).unwrap();
    stranger.execute_batch("BEGIN IMMEDIATE").unwrap();
    let mut run = folder.start(["run", "sweep.toml"]);
    thread::sleep(Duration::from_millis(300));
    assert!(!run.has_ended());
    stopped_in_time(run).says("run the same command to resume");
    stranger.execute_batch("COMMIT").unwrap();
    folder.jitai(["run", "sweep.toml"]).succeeded().says("2 jobs run, 4 completed in all");
}

#[test]
fn a_training_of_a_huge_network_is_stopped_in_time() {
    // One update takes longer than a stop may take.
    let huge = "format = 1
name = \"sweep\"
scenarios = [\"P-H-D\"]
seeds = 1
environment.sigma = 0.6
[[agent]]
name = \"huge\"
algorithm = \"reinforce\"
episodes = 1000
trajectories_per_update = 500
layers = [2048, 2048]
";
    let folder = Folder::with(huge);
    let run = folder.start(["run", "sweep.toml"]);
    until("the job runs", || folder.is_running_a_job());
    thread::sleep(Duration::from_millis(300));
    stopped_in_time(run).says("run the same command to resume");
    let completed = "SELECT count(*) FROM run WHERE status = 'completed'";
    assert_eq!(folder.number(completed), 0);
}

#[test]
fn the_next_run_resumes_to_the_same_rows() {
    let text = manifest("sweep", "0.6", "3", Effort::Short);
    let stopped = Folder::with(&text);
    let run = stopped.start(["run", "sweep.toml", "--workers", "1"]);
    // In the middle of the sweep, one job is completed, one is running, and one has not started.
    until("a job has ended", || {
        stopped.is_running_a_job()
            && stopped.number("SELECT count(*) FROM run WHERE status = 'completed'") > 0
    });
    run.signal("INT");
    run.wait().ended(130);
    let runs = stopped.runs();
    let completed = stopped.number("SELECT count(*) FROM run WHERE status = 'completed'");
    assert!((1..6).contains(&completed), "{completed}");
    let plan = stopped.jitai(["plan", "sweep.toml", "--format", "json"]).succeeded().json();
    assert_eq!(plan[0]["completed"], completed);
    assert_eq!(
        plan[0]["pending"].as_i64().unwrap() + plan[0]["interrupted"].as_i64().unwrap(),
        6 - completed
    );

    stopped.jitai(["run", "sweep.toml"]).succeeded().says("6 completed in all");
    assert_eq!(stopped.runs(), runs + 6 - completed);
    assert_same_rows(&stopped.dump(), &Folder::completed(&text).dump());
}

#[test]
fn a_stop_is_an_event() {
    let folder = Folder::with(&manifest("sweep", "0.6", "1", Effort::Endless));
    let run = folder.start(["run", "sweep.toml", "--format", "json"]);
    until("a job runs", || folder.is_running_a_job());
    run.signal("INT");
    let ended = run.wait().ended(130);
    let last: serde_json::Value =
        serde_json::from_str(ended.stdout.lines().last().unwrap()).unwrap();
    assert_eq!((&last["event"], &last["left"]), (&"stopped".into(), &2.into()));
    assert!(ended.stdout.contains("\"event\":\"interrupted\""), "{}", ended.stdout);
}

#[cfg(target_os = "linux")]
#[test]
fn a_second_signal_ends_the_program_without_further_ado() {
    let folder = Folder::with(&manifest("sweep", "0.6", "1", Effort::Endless));
    let run = folder.start(["run", "sweep.toml", "--workers", "1"]);
    until("a job runs", || folder.is_running_a_job());
    // Both signals are pending while the program is stopped, and arrive before it can act on the first.
    run.signal("STOP");
    let state = format!("/proc/{}/stat", run.id());
    until("it is stopped", || std::fs::read_to_string(&state).unwrap().contains(") T "));
    run.signal("INT");
    run.signal("TERM");
    run.signal("CONT");
    let ended = run.wait().ended(130);
    assert!(!ended.stderr.contains("stopped:"), "{}", ended.stderr);
    // The process could not close its run; the next sweep does.
    assert_eq!(folder.number("SELECT count(*) FROM run WHERE status = 'running'"), 1);
    folder.write("sweep.toml", manifest("sweep", "0.6", "1", Effort::Trivial));
    folder.jitai(["run", "sweep.toml", "--replace"]).succeeded();
    assert_eq!(folder.number("SELECT count(*) FROM run WHERE status = 'running'"), 0);
}

#[test]
fn a_query_without_end_can_be_interrupted() {
    let folder = Folder::completed(&manifest("sweep", "0.6", "1", Effort::Trivial));
    let endless = "WITH RECURSIVE n (i) AS (VALUES (1) UNION ALL SELECT i + 1 FROM n) \
                   SELECT i FROM n";
    let query = folder.start(["query", "--format", "csv", endless]);
    until("it answers", || query.stdout().contains("\n1000\n"));
    query.signal("INT");
    query.wait().ended(130);
}
