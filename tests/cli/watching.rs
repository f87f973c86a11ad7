//! `watch`, and the command that is called at the end of a run.

use std::fs;
use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::process::Stdio;
use std::time::Instant;

use jitai::schedule::RunningCurve;
use serde_json::Value;

use crate::failures::partly_diverging;
use crate::support::{Effort, Folder, Running, assert_prompt, left_out, manifest, until};

/// The files of learning curves in a folder.
fn curves(folder: &Folder, name: &str) -> Vec<PathBuf> {
    let files = fs::read_dir(folder.path(name)).into_iter().flatten().flatten();
    files
        .map(|file| file.path())
        .filter(|path| path.extension().is_some_and(|e| e == "curve"))
        .collect()
}

#[test]
fn lines_say_what_has_ended_and_why_jobs_failed() {
    let folder = Folder::with(&partly_diverging());
    folder.jitai(["run", "sweep.toml"]).ended(1);
    for arguments in [&["watch"][..], &["watch", "sweep", "--plain"]] {
        let watch = folder.jitai(arguments.iter().copied()).succeeded();
        let watch = watch.prints("sweep: 2 of 4 completed, 2 failed\n");
        watch.prints("failed: wild P-H-D sigma=0.6 seed=1: diverged (");
    }
    folder.jitai(["watch", "swep"]).ended(2).says("did you mean `sweep`?");
    folder.jitai(["watch", "--store", "none.sqlite"]).ended(3).says("none.sqlite");
}

#[test]
fn a_filter_limits_what_is_counted_and_the_time_left() {
    let folder = Folder::with(&manifest("sweep", "[0.4, 0.6]", "3", Effort::Endless));
    let filter = "agent=dqn,sigma=0.4,seed=1|3";
    let plan = ["plan", "sweep.toml", "--filter", filter, "--workers", "2", "--format", "json"];
    let planned = folder.jitai(plan).json();
    let run = folder.start(["run", "sweep.toml", "--filter", filter, "--workers", "2"]);
    let status = || folder.jitai(["status", "--format", "json"]).json()[0].clone();
    until("the store is made", || folder.jitai(["status"]).code == Some(0));
    until("both jobs run", || status()["running"] == 2);
    let found = status();
    let filtered = &found["filtered"];
    assert_eq!(filtered["filters"], serde_json::json!([filter]));
    assert_eq!((&found["jobs"], &filtered["jobs"]), (&12.into(), &2.into()));
    assert_eq!((&filtered["running"], &filtered["pending"]), (&2.into(), &0.into()));
    assert_eq!(found["seconds_left"], planned[0]["seconds_left"]);
    let selects = format!("--filter {filter} selects 2 of 12 jobs");
    folder
        .jitai(["status"])
        .succeeded()
        .prints(&format!("sweep: {selects}, of which 0 have ended"));
    let watch = folder.start(["watch", "--plain"]);
    until("the watch says what runs", || {
        let said = watch.stdout();
        said.contains("sweep: 0 of 2 completed, 2 running, about") && said.contains(&selects)
    });
    // A command without a filter will run all of them.
    let all = folder.start(["run", "sweep.toml", "--workers", "1"]);
    until("a third job runs", || status()["running"] == 3);
    assert!(status()["filtered"].is_null());
    run.kill();
    all.kill();
    watch.kill();
}

#[test]
fn curves_of_running_jobs_are_seen_and_leave_nothing_behind() {
    let folder = Folder::with(&manifest("sweep", "0.6", "1", Effort::Endless));
    let run = folder.start(["run", "sweep.toml", "--workers", "2"]);
    let checkpoints = "jitai.sqlite.checkpoints";
    until("both jobs have curves", || curves(&folder, checkpoints).len() == 2);
    let watch = folder.start(["watch", "--plain"]);
    until("the watch counts them", || {
        watch.stdout().contains("sweep: 0 of 2 completed, 2 running, about")
    });
    let files = curves(&folder, checkpoints);
    assert_eq!(files.len(), 2);
    let read_curve = |file: &PathBuf| RunningCurve::read(file).unwrap();
    let read = || files.iter().map(read_curve).collect::<Vec<_>>();
    let before = read();
    assert!(before.iter().all(|curve| curve.episode > 0 && curve.seconds > 1.0), "{before:?}");
    until("points are added to both", || {
        read().iter().zip(&before).all(|(now, before)| now.episode > before.episode)
    });
    // A killed process leaves its files; nobody takes them for running jobs.
    run.kill();
    assert_eq!(curves(&folder, checkpoints).len(), 2);
    watch.wait().succeeded().says("2 jobs left, but no process is running");
    let again = folder.start(["run", "sweep.toml", "--workers", "1"]);
    until("the files are removed", || curves(&folder, checkpoints).is_empty());
    until("jobs run", || folder.is_running_a_job());
    until("the running job has a curve again", || curves(&folder, checkpoints).len() == 1);
    again.signal("INT");
    again.wait().ended(130);
    assert_eq!(curves(&folder, checkpoints), [] as [PathBuf; 0]);
}

/// The program in a pseudo terminal of 80 by 24, to which keys are written.
struct Terminal {
    run: Running,
    keys: fs::File,
}

impl Terminal {
    fn start(folder: &Folder, arguments: &str) -> Terminal {
        let program = env!("CARGO_BIN_EXE_jitai");
        Terminal::start_script(folder, &format!("echo $$ > pid; exec {program} {arguments}"))
    }

    fn start_script(folder: &Folder, script: &str) -> Terminal {
        let inner = format!("stty rows 24 cols 80; {script}");
        let fifo = folder.path("keys");
        let made = std::process::Command::new("mkfifo").arg(&fifo).status().unwrap();
        assert!(made.success());
        let mut command = folder.command_of("script", ["-qefc", &inner, "/dev/null"]);
        command.env("TERM", "xterm-256color").env("SHELL", "/bin/sh").env_remove("NO_COLOR");
        // Opened for both, so that neither end waits for the other.
        let keys = fs::OpenOptions::new().read(true).write(true).open(&fifo).unwrap();
        command.stdin(Stdio::from(keys.try_clone().unwrap()));
        Terminal { run: Running::of(command), keys }
    }

    fn press(&mut self, keys: &str) {
        self.keys.write_all(keys.as_bytes()).unwrap();
    }

    /// Everything that was written, and that the terminal was restored.
    #[track_caller]
    fn left(self, code: i32) -> String {
        let ended = self.run.wait();
        assert_eq!(ended.code, Some(code), "{}", ended.stdout);
        let (entered, left) = ("\u{1b}[?1049h", "\u{1b}[?1049l");
        let at = |text: &str| ended.stdout.rfind(text).unwrap_or_else(|| panic!("{ended:?}"));
        assert!(at(entered) < at(left) && at("\u{1b}[?25l") < at("\u{1b}[?25h"));
        ended.stdout
    }
}

/// Whether `script` of util-linux can make a pseudo terminal.
fn has_terminals() -> bool {
    let script = std::process::Command::new("script").arg("--version").output();
    let has =
        script.is_ok_and(|output| String::from_utf8_lossy(&output.stdout).contains("util-linux"));
    if !has {
        left_out("the full screen of `watch`", "it needs `script` of util-linux");
    }
    if !cfg!(feature = "screen") {
        left_out("the full screen of `watch`", "it needs the feature `screen`");
        return false;
    }
    has
}

#[test]
fn the_screen_shows_arms_and_curves_and_restores_the_terminal() {
    if !has_terminals() {
        return;
    }
    let folder = Folder::with(&partly_diverging());
    folder.jitai(["run", "sweep.toml"]).ended(1);
    let mut screen = Terminal::start(&folder, "watch");
    until("the screen is drawn", || screen.run.stdout().contains("quit"));
    screen.press("j");
    until("the curve is drawn", || screen.run.stdout().contains("mean_return"));
    screen.press("mm");
    until("another metric is drawn", || screen.run.stdout().contains("disengage"));
    screen.press("f");
    until("the failures are drawn", || screen.run.stdout().contains("like"));
    screen.press("q");
    let text = screen.left(0);
    for word in ["sweep", "wild", "tame", "2/2", "diverged"] {
        assert!(text.contains(word), "{word} is not in {text}");
    }
}

#[test]
fn a_signal_ends_the_screen_and_restores_the_terminal() {
    if !has_terminals() {
        return;
    }
    let folder = Folder::completed(&manifest("sweep", "0.6", "1", Effort::Trivial));
    let screen = Terminal::start(&folder, "watch");
    until("the screen is drawn", || screen.run.stdout().contains("quit"));
    let kill = format!("kill -TERM {}", folder.read("pid"));
    assert!(std::process::Command::new("sh").args(["-c", &kill]).status().unwrap().success());
    screen.left(130);
}

#[test]
#[cfg(target_os = "linux")]
fn a_closed_terminal_ends_the_screen() {
    if !has_terminals() {
        return;
    }
    let folder = Folder::completed(&manifest("sweep", "0.6", "1", Effort::Trivial));
    let screen = Terminal::start(&folder, "watch");
    until("the screen is drawn", || screen.run.stdout().contains("quit"));
    let state = format!("/proc/{}/stat", folder.read("pid").trim());
    assert!(fs::read_to_string(&state).is_ok());
    screen.run.kill();
    // A process that nobody has waited for yet is a zombie.
    until("it ends", || fs::read_to_string(&state).map_or(true, |text| text.contains(") Z ")));
}

/// The summary that the command of `--on-end` got; the command is called once.
#[track_caller]
#[test]
#[cfg(target_os = "linux")]
fn a_terminal_that_is_gone_is_no_crash() {
    if !has_terminals() {
        return;
    }
    let folder = Folder::completed(&manifest("sweep", "0.6", "1", Effort::Trivial));
    let program = env!("CARGO_BIN_EXE_jitai");
    let script = format!("trap : HUP; {program} watch; echo $? > code");
    let screen = Terminal::start_script(&folder, &script);
    until("the screen is drawn", || screen.run.stdout().contains("quit"));
    screen.run.kill();
    until("it ends", || {
        fs::read_to_string(folder.path("code")).is_ok_and(|text| text.ends_with('\n'))
    });
    assert_eq!(folder.read("code").trim(), "130");
}

const ASK: &str = "cat > /dev/null\nread -r answer < /dev/tty\necho \"$answer\" > answer\n";

#[test]
fn a_command_at_the_end_may_ask_on_the_terminal() {
    if !has_terminals() {
        return;
    }
    let folder = Folder::with(&manifest("sweep", "0.6", "1", Effort::Trivial));
    folder.write("ask.sh", ASK);
    let mut terminal = Terminal::start(&folder, "run sweep.toml -q --on-end 'sh ask.sh'");
    terminal.press("yes\n");
    terminal.run.wait().ended(0);
    assert_eq!(folder.read("answer"), "yes\n");
}

#[test]
fn an_agent_that_uses_the_terminal_fails_at_once() {
    if !has_terminals() {
        return;
    }
    let sweep = "format = 1\nname = \"sweep\"\nscenarios = [\"P-H-D\"]\nseeds = 1\nenvironment.sigma = 0.6\n\
                 evaluation.test_episodes = 2\n[[agent]]\nname = \"asks\"\nalgorithm = \"external\"\n\
                 command = [\"sh\", \"ask.sh\"]\nversion = \"1\"\nepisodes = 1\n";
    let folder = Folder::with(sweep);
    folder.write("ask.sh", "read -r answer < /dev/tty\n");
    let terminal = Terminal::start(&folder, "run sweep.toml -q");
    terminal.run.wait().ended(1);
    let used =
        "SELECT count(*) FROM run WHERE failure_message LIKE '%`sh ask.sh` used the terminal%'";
    assert_eq!(folder.number(used), 1);
}

fn summary(folder: &Folder) -> Value {
    until("the command was called", || {
        fs::read_to_string(folder.path("end")).is_ok_and(|text| text.ends_with('\n'))
    });
    let text = folder.read("end");
    assert_eq!(text.lines().count(), 1, "{text}");
    fs::remove_file(folder.path("end")).unwrap();
    serde_json::from_str(&text).unwrap()
}

const ON_END: &str = "cat >> end";

#[test]
fn a_command_is_called_once_however_a_run_ends() {
    let folder = Folder::with(&partly_diverging());
    let told = |summary: &Value| {
        ["event", "exit_code", "completed", "failed", "left"].map(|key| summary[key].to_string())
    };
    folder.jitai(["run", "sweep.toml", "--on-end", ON_END]).ended(1);
    let end = summary(&folder);
    assert_eq!(told(&end), ["\"done\"", "1", "2", "2", "0"]);
    assert_eq!(
        (&end["failures"][0]["kind"], &end["failures"][0]["jobs"]),
        (&"diverged".into(), &2.into())
    );
    assert_eq!((&end["command"], &end["experiments"][0]), (&"run".into(), &"sweep".into()));
    // Standard output is for data.
    let again = ["run", "sweep.toml", "--format", "json", "--on-end", "cat >> end; echo called"];
    let again = folder.jitai(again).ended(1).says("called");
    assert!(!again.stdout.contains("called"));
    assert_eq!(told(&summary(&folder)), ["\"done\"", "1", "2", "2", "0"]);
    folder.jitai(["run", "none.toml", "--on-end", ON_END]).ended(2);
    let end = summary(&folder);
    assert_eq!(told(&end), ["\"error\"", "2", "null", "null", "null"]);
    assert!(end["message"].as_str().unwrap().contains("none.toml"));
    // The command changes nothing about the run.
    let bad = folder.jitai(["run", "sweep.toml", "--on-end", "exit 7"]).ended(1);
    bad.says("the command of --on-end ended with exit status: 7");
    folder.jitai(["submit", "sweep.toml", "--on-end", ON_END]).ended(2).says("--wait");
}

#[test]
fn a_command_is_called_after_a_signal() {
    let folder = Folder::with(&manifest("sweep", "0.6", "1", Effort::Endless));
    // A slow command does not delay the end.
    let slow = "cat >> end; sleep 30";
    let run = folder.start(["run", "sweep.toml", "--on-end", slow]);
    until("a job runs", || folder.is_running_a_job());
    let asked = Instant::now();
    run.signal("INT");
    run.wait().ended(130);
    assert_prompt(asked);
    let end = summary(&folder);
    assert_eq!(
        (&end["event"], &end["exit_code"], &end["left"]),
        (&"stopped".into(), &130.into(), &2.into())
    );
}

#[test]
fn a_submission_is_watched_through_its_folder() {
    let folder = Folder::with(&manifest("sweep", "0.6", "1", Effort::Endless));
    fs::create_dir(folder.path("bin")).unwrap();
    for (name, body) in [
        ("sbatch", "echo 17"),
        ("scontrol", "echo MaxArraySize = 1001"),
        (
            "squeue",
            "for a; do case $a in --name=*) echo \"${a#--name=}|17|0|RUNNING\" ;; esac; done",
        ),
    ] {
        let path = folder.path("bin").join(name);
        fs::write(&path, format!("#!/bin/sh\n{body}\n")).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    }
    let program = env!("CARGO_BIN_EXE_jitai");
    let with_cluster = |arguments: &str| {
        let script = format!("PATH=$PWD/bin:$PATH exec {program} {arguments}");
        Running::of(folder.command_of("sh", ["-c", &script]))
    };
    with_cluster("submit sweep.toml").wait().succeeded();
    let submission = fs::read_dir(folder.path("jitai.sqlite.submissions")).unwrap().flatten();
    let submission = submission.map(|entry| entry.path()).find(|path| path.is_dir()).unwrap();
    let name = submission.file_name().unwrap().to_str().unwrap().to_owned();
    let task = folder.start([
        "task",
        submission.to_str().unwrap(),
        "--chunk",
        "0",
        "--attempt",
        "17.0",
        "--scratch",
        folder.path("").to_str().unwrap(),
    ]);
    let lies_in = format!("jitai.sqlite.submissions/{name}/curves");
    until("the task has curves", || !curves(&folder, &lies_in).is_empty());
    let watch = with_cluster("watch --plain");
    until("the watch sees the task", || {
        let text = watch.stdout();
        text.contains(&format!("{name}: 0 chunks waiting, 1 running"))
            && text.contains("1 running, 1 pending")
    });
    watch.signal("TERM");
    watch.wait().ended(130);
    let wait = with_cluster("submit sweep.toml --wait --on-end 'cat >> end'");
    until("it waits", || wait.stderr().contains("running"));
    let asked = Instant::now();
    wait.signal("TERM");
    wait.wait().ended(130);
    assert_prompt(asked);
    let end = summary(&folder);
    assert_eq!((&end["command"], &end["event"]), (&"submit".into(), &"stopped".into()));
    assert_eq!((&end["left"], &end["completed"]), (&2.into(), &0.into()));
    task.signal("TERM");
    task.wait();
    assert_eq!(curves(&folder, &lies_in), [] as [PathBuf; 0]);
}
