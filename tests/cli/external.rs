//! Agents that are outside programs: shell scripts that follow the protocol, and scripts that violate
//! it.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::process::Command;
use std::time::Instant;

use crate::support::{Folder, assert_prompt, until};

/// Shell functions for programs: `ready`, `begin`, `step` and `play`, each with its messages.
const LIBRARY: &str = r#"
say() { printf '%s\n' "$1"; }
hear() { read -r line || exit 9; }
ready() { hear; say '{"type":"ready","protocol":1}'; }
begin() { say '{"type":"reset"}'; hear; }
step() { say '{"type":"step","actions":[1]}'; hear; }
play() {
  say '{"type":"trained"}'
  while read -r line; do
    case $line in
      *'"type":"act"'*)
        lanes=${line#*'"lanes":['}; lanes=${lanes%%]*}
        say "{\"type\":\"choices\",\"actions\":[$(echo "$lanes" | sed 's/[0-9][0-9]*/1/g')]}";;
      *'"type":"end"'*) exit 0;;
    esac
  done
  exit 8
}
"#;

/// A manifest with an outside program, `sh program.sh`, and a rule; `more` are lines of the program's table.
fn manifest(head: &str, more: &str) -> String {
    format!(
        "format = 1
name = \"sweep\"
{head}
scenarios = [\"P-H-D\"]
seeds = 1
environment.sigma = 0.6
environment.first_context = \"sampled\"
environment.delta_d = 0.3
evaluation.test_episodes = 20
[[agent]]
name = \"outside\"
algorithm = \"external\"
command = [\"sh\", \"program.sh\"]
version = \"1\"
episodes = 3
{more}
[[agent]]
name = \"rule\"
algorithm = \"rule\"
rule = \"untailored\"
"
    )
}

/// A folder with a program that consists of these lines.
fn with_program(lines: &str) -> Folder {
    let folder = Folder::with(&manifest("", ""));
    folder.write("program.sh", format!("{LIBRARY}\n{lines}\n"));
    folder
}

/// The message of the failed run; asserts that the other job completed.
#[track_caller]
fn failure(folder: &Folder) -> String {
    let ended = folder.jitai(["run", "sweep.toml"]).ended(1);
    ended.says("2 jobs run, 1 completed in all, 1 failed").prints("external (");
    let sql = "SELECT failure_message FROM run_summary WHERE failure_kind = 'external'";
    folder.store().query_row(sql, [], |row| row.get(0)).unwrap()
}

/// Whether a process runs; zombies do not count.
fn is_alive(id: &str) -> bool {
    let stat = fs::read_to_string(format!("/proc/{}/stat", id.trim())).unwrap_or_default();
    stat.rsplit(") ").next().is_some_and(|rest| !rest.is_empty() && !rest.starts_with('Z'))
}

#[test]
fn the_test_is_of_the_episodes_that_every_agent_of_the_seed_meets() {
    let text =
        manifest("", "parameters = { depth = [1, 2] }").replace("seeds = 1", "seeds = 2").replace(
            "test_episodes = 20",
            "test_episodes = 1003\nevaluation.record_decisions = \"test\"",
        );
    let people = "environment.delta_d = 0.3\npopulation.epsilon_h = { uniform = [0.01, 0.2] }";
    let text = text.replace("untailored", "tailored").replace("P-H-D", "C-H-D");
    let text = text.replace("environment.delta_d = 0.3", people);
    let folder = Folder::with(&text);
    // A message tailored to the context, which is the first entry of an observation.
    let tailored = r#"
ready
say '{"type":"trained"}'
while read -r line; do
  case $line in
    *'"type":"act"'*)
      rows=$(echo "$line" | sed 's/.*"observations":\[\[//; s/\]\].*//; s/\],\[/\n/g')
      chosen=$(echo "$rows" | sed 's/^0.*/2/; s/^1.*/3/' | tr '\n' ,)
      say "{\"type\":\"choices\",\"actions\":[${chosen%,}]}";;
  esac
done
"#;
    folder.write("program.sh", format!("{LIBRARY}\n{tailored}"));
    folder.jitai(["run", "sweep.toml"]).succeeded().says("6 jobs run, 6 completed in all");
    for (view, columns) in [
        ("evaluation_episode", "seed, episode, total_reward, length, disengaged"),
        (
            "decision",
            "seed, episode, step, context, probability, action, action_probability, reward",
        ),
    ] {
        let rows = |condition: &str| {
            let key = "SELECT job_key FROM run_summary WHERE agent";
            let from = format!("FROM {view} JOIN run_summary USING (job_key)");
            format!("SELECT {columns} {from} WHERE job_key IN ({key} {condition})")
        };
        let (rule, outside) = (rows("= 'rule'"), rows("= 'outside'"));
        let count = |sql: &str| folder.number(&format!("SELECT count(*) FROM ({sql})"));
        assert!(count(&rule) >= 2 * 1003, "{view}");
        assert_eq!(count(&outside), 2 * count(&rule), "{view}");
        assert_eq!(count(&format!("{outside} EXCEPT {rule}")), 0, "{view}");
        assert_eq!(count(&format!("{rule} EXCEPT {outside}")), 0, "{view}");
    }
    let varied = "SELECT count(DISTINCT total_reward) > 20 FROM evaluation_episode";
    assert_eq!(folder.number(varied), 1);
    folder.jitai(["doctor"]).succeeded();
    folder.jitai(["report", "sweep.toml", "--out", "report"]).succeeded();
}

#[test]
fn training_is_counted_by_us_and_recorded_as_a_learning_curve() {
    let text = manifest("", "").replace("episodes = 3", "episodes = 7").replace(
        "test_episodes = 20",
        "test_episodes = 20\nevaluation.curve_stride = 2\nevaluation.record_decisions = \"all\"",
    );
    let folder = Folder::with(&text);
    // Two lanes and six episodes, with an update after each step; a step shows an ended lane unchanged.
    let program = r#"
hear
say '{"type":"ready","protocol":1,"lanes":2}'
for pair in 1 2 3; do
  begin
  while :; do
    say '{"type":"step","actions":[1,2],"probabilities":[0.5,0.25]}'
    hear
    say '{"type":"update","loss":2.5,"epsilon":0.1}'
    case $line in *'"terminated":[false,false],"truncated":[false,false]'*) ;; *'[true,true]'*) break;; esac
    case $line in *'"terminated":[true,false],"truncated":[false,true]'*) break;; esac
    case $line in *'"terminated":[false,true],"truncated":[true,false]'*) break;; esac
  done
done
play
"#;
    folder.write("program.sh", format!("{LIBRARY}\n{program}"));
    folder.jitai(["run", "sweep.toml"]).succeeded();
    let curve = |condition: &str| {
        folder.number(&format!("SELECT count(*) FROM learning_curve WHERE {condition}"))
    };
    assert_eq!(curve("metric = 'mean_return'"), 3);
    assert_eq!(curve("metric = 'mean_return' AND episode IN (2, 4, 6)"), 3);
    assert_eq!(curve("metric = 'mean_loss' AND value = 2.5"), 3);
    // The rate is unknown until the first update, which follows the first step.
    assert_eq!(curve("metric = 'epsilon' AND value = 0.1"), 3);
    let trained = "SELECT count(DISTINCT episode) FROM decision WHERE phase = 'train'";
    assert_eq!(folder.number(trained), 6);
    let steps = "SELECT sum(action_probability = 0.5 AND action = 1) > 9
        AND sum(action_probability = 0.25 AND action = 2) > 9
        AND sum(action NOT IN (1, 2)) = 0 FROM decision WHERE phase = 'train'";
    assert_eq!(folder.number(steps), 1);
    let returns =
        "SELECT abs((SELECT sum(value) * 2 FROM learning_curve WHERE metric = 'mean_return')
        - (SELECT sum(reward) FROM decision WHERE phase = 'train')) < 1e-6";
    assert_eq!(folder.number(returns), 1);
}

#[test]
fn a_program_that_plays_episodes_itself_reports_them() {
    let program = r#"
ready
say '{"type":"episodes","returns":[100.5,200.5],"lengths":[50,20],"terminated":[false,true]}'
say '{"type":"episodes","returns":[300],"lengths":[50],"terminated":[false]}'
play
"#;
    let folder = with_program(program);
    folder.jitai(["run", "sweep.toml"]).succeeded();
    let curve = "SELECT count(*) FROM learning_curve WHERE episode = 3
        AND (metric = 'mean_return' AND abs(value - 601.0 / 3) < 1e-9
        OR metric = 'mean_length' AND value = 40 OR metric = 'disengagement_rate' AND value > 0.3)";
    assert_eq!(folder.number(curve), 3);
    let weights = "SELECT count(*) FROM trained_weights";
    assert_eq!(folder.number(weights), 0);
    let key = "SELECT substr(job_key, 1, 8) FROM run_summary WHERE agent = 'outside'";
    let key: String = folder.store().query_row(key, [], |row| row.get(0)).unwrap();
    let policy = format!("run:{key}");
    folder.jitai(["simulate", "--policy", &policy]).ended(2).says("outside program");
}

#[test]
fn every_fault_of_a_program_is_a_failure_with_its_reason() {
    let reset = r#"say '{"type":"reset","lanes":"#;
    let in_lanes = |lanes: &str| format!("ready; {reset}{lanes}}}'; hear");
    let acting = |answer: &str| {
        let begin = "ready; say '{\"type\":\"trained\"}'; hear; hear";
        format!("{begin}; say '{answer}'; hear")
    };
    for (program, expected) in [
        ("echo Hello from Python", "found the line `Hello from Python`"),
        (
            "ready; echo loss 0.5",
            "standard output is reserved for messages; write to standard error",
        ),
        ("ready; echo '{\"type\":\"stepp\"}'", "unknown variant `stepp`"),
        ("hear; say '{\"type\":\"ready\",\"protocol\":2}'; hear", "expected protocol 1, found 2"),
        (
            "hear; say '{\"type\":\"ready\",\"protocol\":1,\"lanes\":0}'; hear",
            "`lanes`: expected a number from 1 to 4096, found 0",
        ),
        ("hear; begin", "expected \"ready\", found \"reset\""),
        ("ready; step", "expected \"reset\" before \"step\": no episode is running"),
        ("ready; begin; begin", "expected at least one lane whose episode has ended, found none"),
        (&in_lanes("[1]"), "expected a lane from 0 to 0, found 1"),
        (&in_lanes("[0,0]"), "expected every lane once, found lane 0 twice"),
        (&format!("ready; begin; {reset}[0]}}'; hear"), "found lane 0 in mid-episode"),
        (
            "hear; say '{\"type\":\"ready\",\"protocol\":1,\"lanes\":4}'; begin",
            "expected at most 3 episodes of training, the job's budget; found 4 more after 0",
        ),
        (
            "ready; for n in 1 2 3 4; do begin; while :; do step; case $line in *true*) break;; esac; done; done",
            "expected at most 3 episodes of training, the job's budget; found 1 more after 3",
        ),
        (
            "ready; begin; say '{\"type\":\"step\",\"actions\":[4]}'; hear",
            "expected an action from 0 to 3 for lane 0, found 4",
        ),
        (
            "ready; begin; say '{\"type\":\"step\",\"actions\":[null]}'; hear",
            "expected an action from 0 to 3 for lane 0, found null",
        ),
        (
            "ready; begin; say '{\"type\":\"step\",\"actions\":[1,1]}'; hear",
            "expected 1 action, one for every lane, found 2",
        ),
        (
            "ready; begin; say '{\"type\":\"step\",\"actions\":[1],\"probabilities\":[0]}'; hear",
            "expected a probability above 0 and at most 1 for lane 0, found 0",
        ),
        (
            "ready; say '{\"type\":\"episodes\",\"returns\":[1,2,3,4],\"lengths\":[1,1,1,1],\
             \"terminated\":[true,true,true,true]}'; hear",
            "the job's budget; found 4 more after 0",
        ),
        (
            "ready; say '{\"type\":\"episodes\",\"returns\":[1],\"lengths\":[51],\
             \"terminated\":[true]}'; hear",
            "`lengths`: expected 1 to 50 steps, found 51",
        ),
        (
            "ready; say '{\"type\":\"episodes\",\"returns\":[1],\"lengths\":[],\"terminated\":[]}'; hear",
            "expected as many `lengths` and `terminated` as `returns`, which are 1; found 0 and 0",
        ),
        (&acting(r#"{"type":"choices"}"#), "found neither"),
        (&acting(r#"{"type":"choices","actions":[1]}"#), "expected 20 actions, one for each lane"),
        (&acting(r#"{"type":"trained"}"#), "expected \"choices\", found \"trained\""),
        (
            "ready; begin; step; echo oops >&2; exit 3",
            "exited with code 3 in training, after 0 episodes",
        ),
        ("ready; begin; step; echo oops >&2; exit 3", "standard error ends with: oops"),
        (
            "ready; kill -s KILL $$",
            "was ended by signal 9 (SIGKILL, as systems send it when memory is short) in training",
        ),
        ("ready; kill -s TERM $$", "was ended by signal 15 in training"),
        ("exit 0", "exited with code 0 before training, where \"ready\" was expected"),
        (&acting("x").replace("; say 'x'; hear", "; exit 5"), "exited with code 5 in the test"),
        ("ready; exec >&-; sleep 1000", "closed its standard output in training"),
        (
            "hear; head -c 3000000 /dev/zero | tr '\\0' x; hear",
            "found a line of more than 1048576 bytes that begins with `xxx",
        ),
        (
            "hear; yes flood | head -c 30000000 >&2; echo the last line >&2; exit 4",
            "flood | the last line",
        ),
    ] {
        let folder = with_program(program);
        let message = failure(&folder);
        assert!(message.contains(expected), "{program}\n{message}");
        assert!(message.contains("sh program.sh"), "{message}");
        assert!(message.len() < 4000, "{program}\n{message}");
    }
}

#[test]
fn a_program_that_cannot_be_started_is_named_and_the_other_jobs_complete() {
    let folder = with_program("");
    let words = |words: &str| {
        let text = manifest("", "").replace("[\"sh\", \"program.sh\"]", words);
        folder.write("sweep.toml", text);
        let ended = folder.jitai(["run", "sweep.toml"]).ended(1);
        drop(ended);
        let sql = "SELECT failure_message FROM run_summary WHERE failure_kind = 'external'
            ORDER BY started_at DESC, attempt DESC LIMIT 1";
        let message: String = folder.store().query_row(sql, [], |row| row.get(0)).unwrap();
        message
    };
    let missing = words("[\"no-such-program\", \"a b\"]");
    assert!(missing.starts_with("cannot start `no-such-program 'a b'` in "), "{missing}");
    assert!(missing.contains("install it on this machine, or correct `command`"), "{missing}");
    folder.write("plain.txt", "text");
    let plain = words("[\"./plain.txt\"]");
    assert!(plain.contains("make the file executable"), "{plain}");
    let completed =
        "SELECT count(*) FROM run_summary WHERE agent = 'rule' AND status = 'completed'";
    assert_eq!(folder.number(completed), 1);
}

#[test]
fn a_program_starts_in_the_folder_of_its_manifest_with_our_environment() {
    let folder = Folder::new();
    fs::create_dir(folder.path("inner")).unwrap();
    let text = manifest("", "").replace("[\"sh\", \"program.sh\"]", "[\"./program\", \"a  'b\"]");
    folder.write("inner/sweep.toml", text);
    let check = "[ \"$1\" = \"a  'b\" ] || exit 6\n[ \"$PASSED\" = through ] || exit 7\n\
                 [ -e sweep.toml ] || exit 5\n";
    folder.write("inner/program", format!("#!/bin/sh\n{LIBRARY}\n{check}ready\nplay\n"));
    let executable = fs::Permissions::from_mode(0o755);
    fs::set_permissions(folder.path("inner/program"), executable).unwrap();
    let mut command = folder.command(["run", "inner/sweep.toml"]);
    let output = command.env("PASSED", "through").output().unwrap();
    assert!(output.status.success(), "{output:?}");
}

#[test]
fn shards_of_a_programs_jobs_make_the_store_of_one_machine() {
    let folder = with_program("ready\nplay");
    folder.write("sweep.toml", manifest("", "").replace("seeds = 1", "seeds = 4"));
    for shard in ["1/3", "2/3", "3/3"] {
        let store = format!("parts/{}.sqlite", &shard[..1]);
        fs::create_dir_all(folder.path("parts")).unwrap();
        folder.jitai(["run", "sweep.toml", "--shard", shard, "--store", &store]).succeeded();
    }
    folder.jitai(["merge", "parts", "--store", "merged.sqlite"]).succeeded();
    folder.jitai(["run", "sweep.toml"]).succeeded().says("8 jobs run, 8 completed in all");
    let rows = |store: &str| {
        let sql = "SELECT job_key, agent, seed, mean_return, episode, total_reward
            FROM run_summary JOIN evaluation_episode USING (job_key) ORDER BY 1, 5";
        folder.jitai(["query", sql, "--store", store]).succeeded().stdout
    };
    assert_eq!(rows("merged.sqlite"), rows("jitai.sqlite"));
    assert_eq!(rows("merged.sqlite").lines().filter(|line| line.contains("outside")).count(), 80);
}

#[test]
fn a_silent_program_fails_at_the_time_limit() {
    let folder = Folder::with(&manifest("time_limit_seconds = 1", ""));
    folder.write("program.sh", format!("{LIBRARY}\nready\nbegin\necho $$ >id\nsleep 1000\n"));
    let ended = folder.jitai(["run", "sweep.toml"]).ended(1);
    ended.prints("over_time").prints("flush its standard output");
    assert!(!is_alive(&folder.read("id")));
}

/// A program that starts children, ignores signals and never ends.
const STUBBORN: &str = "trap '' TERM HUP INT PIPE
sleep 1000 & echo $! >child
sh -c 'trap \"\" TERM; sleep 1000 & echo $! >grandchild; wait' &
ready
begin
echo $$ >id
while :; do sleep 1; done
";

fn all_of_it(folder: &Folder) -> Vec<String> {
    let ids = ["id", "child", "grandchild"].map(|name| folder.path(name));
    until("the program runs", || ids.iter().all(|id| fs::read(id).is_ok_and(|id| !id.is_empty())));
    let ids: Vec<String> = ids.iter().map(|id| fs::read_to_string(id).unwrap()).collect();
    assert!(ids.iter().all(|id| is_alive(id)), "{ids:?}");
    ids
}

#[test]
fn an_interrupt_ends_a_program_with_its_children_within_two_seconds() {
    let folder = with_program(STUBBORN);
    let run = folder.start(["run", "sweep.toml"]);
    let ids = all_of_it(&folder);
    let asked = Instant::now();
    run.signal("INT");
    run.wait().ended(130).says("run the same command to resume");
    assert_prompt(asked);
    assert!(!ids.iter().any(|id| is_alive(id)), "{ids:?}");
    let ended = "SELECT count(*) FROM run_summary WHERE agent = 'outside'
        AND status IN ('completed', 'failed')";
    assert_eq!(folder.number(ended), 0);

    folder.write("program.sh", format!("{LIBRARY}\nready\nplay\n"));
    folder.jitai(["run", "sweep.toml"]).succeeded().says("2 completed in all");
}

#[test]
fn a_signal_that_ends_a_program_and_stops_jitai_is_no_failure_of_the_job() {
    for signal in ["USR1", "TERM"] {
        let folder = with_program("echo $$ >id.new; mv id.new id\nready\nbegin\nsleep 1000\n");
        let run = folder.start(["run", "sweep.toml"]);
        until("the program runs", || folder.path("id").exists());
        // As a batch system does, which signals all processes of a job.
        let id = folder.read("id");
        let kill = format!("kill -{signal} {} {}", id.trim(), run.id());
        assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
        run.wait().ended(130);
        let ended = "SELECT count(*) FROM run WHERE status = 'failed'";
        assert_eq!(folder.number(ended), 0, "{signal}");
    }
}

#[test]
fn a_program_and_its_children_do_not_outlive_a_kill_of_ours() {
    let folder = with_program(STUBBORN);
    let run = folder.start(["run", "sweep.toml"]);
    let ids = all_of_it(&folder);
    run.kill();
    until("the program is gone", || !ids.iter().any(|id| is_alive(id)));
}

#[test]
fn children_that_a_program_leaves_behind_are_ended_with_its_job() {
    let folder = with_program("sleep 1000 & echo $! >child\nready\nplay");
    folder.jitai(["run", "sweep.toml"]).succeeded();
    assert!(!is_alive(&folder.read("child")));
    // This program ends by itself, while a child keeps its output open.
    let folder = with_program("sleep 1000 & echo $! >child\nready; exit 7");
    assert!(failure(&folder).contains("exited with code 7"));
    assert!(!is_alive(&folder.read("child")));
}

#[test]
fn workers_run_programs_at_the_same_time() {
    let text = manifest("", "").replace("seeds = 1", "seeds = 2");
    let folder = Folder::with(&text);
    // Each program waits for the mark of the other.
    let meet = "hear\nseed=${line#*'\"seed\":'}; seed=${seed%%,*}; echo >mark$seed\n\
                n=0; until [ -e mark1 ] && [ -e mark2 ]; do sleep 0.1; n=$((n + 1)); \
                [ $n -lt 300 ] || exit 6; done\n\
                say '{\"type\":\"ready\",\"protocol\":1}'\nplay\n";
    folder.write("program.sh", format!("{LIBRARY}\n{meet}"));
    folder.jitai(["run", "sweep.toml", "--workers", "2"]).succeeded();
}

#[test]
fn a_short_name_of_several_parameters_is_refused_with_their_dotted_names() {
    let more = "parameters = { sigma = [0.1, 0.6], seed = 2 }";
    let folder = Folder::with(&manifest("", more));
    let plan = |more: [&str; 2]| {
        let [option, value] = more;
        folder.jitai(["plan", "sweep.toml", "--format", "json", option, value])
    };
    let several = "`sigma` is ambiguous; use one of `environment.sigma`, `agent.parameters.sigma`";
    plan(["--filter", "sigma=0.6"]).ended(2).says(several);
    plan(["--set", "sigma=1"]).ended(2).says(several);
    // A whole name has one meaning.
    plan(["--filter", "seed=2"]).ended(2).says("no job has seed=2, did you mean 1?; its values: 1");
    for (filter, jobs) in [
        ("environment.sigma=0.6", 3),
        ("agent.parameters.sigma=0.6", 1),
        ("parameters.sigma=0.6", 1),
        ("seed=1", 3),
        ("agent.parameters.seed=2", 2),
    ] {
        let found = plan(["--filter", filter]).succeeded().json();
        assert_eq!(found[0]["jobs"], jobs, "{filter}: {found}");
    }
    for set in ["environment.sigma=1", "agent.parameters.sigma=1"] {
        plan(["--set", set]).succeeded();
    }
    let jobs = folder.jitai(["plan", "sweep.toml", "--jobs"]).succeeded();
    jobs.prints("agent.parameters.sigma=0.1");
}

#[test]
fn parameters_are_swept_filtered_set_and_shown_like_keys() {
    let more =
        "parameters = { learning_rate = [3e-4, 1e-3], depth = 3, name = \"a b\", deep = true }";
    let folder = Folder::with(&manifest("", more));
    folder.write(
        "program.sh",
        format!(
            "{LIBRARY}\nhear\ncase $line in *'\"parameters\":{{\"deep\":true,\"depth\":3,\
             \"learning_rate\":0.001,\"name\":\"a b\"}}'*) ;; *) exit 6;; esac\n\
             say '{{\"type\":\"ready\",\"protocol\":1}}'\nplay\n"
        ),
    );
    let plan = folder.jitai(["plan", "sweep.toml"]).succeeded();
    plan.says(
        "outside programs: outside; their job keys cover command, version, parameters and budget, \
         but jitai cannot guarantee that equal jobs give equal results",
    );
    for filter in [
        "agent.parameters.learning_rate=1e-3",
        "parameters.learning_rate=0.001,agent=outside",
        "learning_rate=0.001,depth=3,name=a b,deep=true",
    ] {
        let plan = ["plan", "sweep.toml", "--filter", filter, "--format", "json"];
        let found = folder.jitai(plan).succeeded().json();
        assert_eq!(found[0]["jobs"], 1, "{filter}: {found}");
    }
    let unmet = folder.jitai(["plan", "sweep.toml", "--filter", "depth=4"]).ended(2);
    unmet.says("no job has depth=4, did you mean 3?; its values: 3");
    let one = ["run", "sweep.toml", "--filter", "learning_rate=0.001"];
    folder.jitai(one).succeeded().says("learning_rate=0.001");
    let value = "SELECT count(DISTINCT name || value) FROM parameter WHERE (name, value) IN (VALUES
        ('agent.parameters.depth', 3), ('agent.parameters.deep', 1),
        ('agent.parameters.name', 'a b'), ('agent.parameters.learning_rate', 0.001),
        ('agent.version', '1'), ('agent.command', '[\"sh\",\"program.sh\"]'))";
    assert_eq!(folder.number(value), 6);
    for set in ["agent.outside.parameters.depth=4", "agent.parameters.depth=4", "depth=4"] {
        let filter = "parameters.depth=4";
        let plan = ["plan", "sweep.toml", "--set", set, "--filter", filter, "--format", "json"];
        assert_eq!(folder.jitai(plan).succeeded().json()[0]["pending"], 2, "{set}");
    }
    // The resolved manifest declares the same jobs.
    let resolved = folder.jitai(["plan", "sweep.toml", "--resolved"]).succeeded().stdout;
    folder.write("resolved.toml", resolved);
    let keys = |file: &str| {
        let jobs = folder.jitai(["plan", file, "--jobs", "--format", "json"]).succeeded().json();
        let keys = jobs.as_array().unwrap().iter().map(|job| job["job_key"].to_string());
        keys.collect::<Vec<_>>()
    };
    assert_eq!(keys("sweep.toml"), keys("resolved.toml"));
}

#[test]
fn command_version_parameters_and_budget_are_the_identity_of_a_job() {
    let folder = Folder::with(&manifest("", "parameters = { depth = 1 }"));
    let text = folder.read("sweep.toml");
    let mut keys = Vec::new();
    for (from, to) in [
        ("", ""),
        ("program.sh\"]", "program.sh\", \"x\"]"),
        ("version = \"1\"", "version = \"2\""),
        ("depth = 1", "depth = 2"),
        ("depth = 1", "depth = 1.0"),
        ("depth = 1", "depth = \"1\""),
        ("depth = 1", "depth = -1"),
        ("depth = 1", "deep = 1"),
        ("episodes = 3", "episodes = 4"),
    ] {
        folder.write("other.toml", text.replacen(from, to, 1));
        let plan = ["plan", "other.toml", "--jobs", "--format", "json"];
        keys.push(folder.jitai(plan).succeeded().json()[0]["job_key"].to_string());
    }
    let distinct: std::collections::BTreeSet<&String> = keys.iter().collect();
    assert_eq!(distinct.len(), keys.len(), "{keys:?}");
    // Stores keep this key for ever.
    assert_eq!(keys[0], "\"32b5bdf159276c2548367518f81d9723\"");
}

#[test]
fn faults_of_a_declaration_are_found_by_check() {
    let folder = Folder::new();
    for (more, expected) in [
        ("command = []", "`command`: expected a list of 1 to 1000 texts"),
        ("command = [\"\"]", "`command`: expected a list of 1 to 1000 texts"),
        ("command = \"sh x\"", "as in [\"python\", \"train.py\"], found \"sh x\""),
        ("version = \"\"", "`version`: expected a text of 1 to 100 characters"),
        ("version = 1", "`version`: expected a text of 1 to 100 characters"),
        ("version = ", "a value is missing"),
        (
            "parameters = 3",
            "`parameters`: expected a table, as in { learning_rate = [3e-4, 1e-3] }",
        ),
        ("parameters = { \"a-b\" = 1 }", "`a-b` is not a name of a parameter"),
        ("parameters = { a = [[1]] }", "`parameters.a`: expected true, false, a number, or a text"),
        ("parameters = { a = nan }", "`parameters.a`: expected true, false, a number, or a text"),
        ("parameters = { a = 1979-05-27 }", "found a date or time"),
        ("parameters = { a = [1, 1] }", "`parameters.a`: 1 is listed twice"),
        ("parameters = { a = { from = 1, to = 3 } }", "a range of `parameters.a` needs `step`"),
        ("episodes = 0", "`episodes`: expected a whole number from 1"),
        ("comand = 1", "unknown key `comand` in an [[agent]] with algorithm = \"external\""),
    ] {
        let key = more.split(' ').next().unwrap();
        let kept = manifest("", "");
        let kept = kept.lines().filter(|line| !line.starts_with(&format!("{key} =")));
        let text = kept.collect::<Vec<_>>().join("\n");
        let text = text.replacen(
            "algorithm = \"external\"",
            &format!("algorithm = \"external\"\n{more}"),
            1,
        );
        folder.write("m.toml", text);
        let checked = folder.jitai(["check", "m.toml"]).ended(2);
        let said = format!("{}{}", checked.stdout, checked.stderr);
        assert!(said.contains(expected), "{more}\n{said}");
    }
    for missing in ["command", "version"] {
        let text = manifest("", "");
        let kept = text.lines().filter(|line| !line.starts_with(missing));
        folder.write("m.toml", kept.collect::<Vec<_>>().join("\n"));
        let checked = folder.jitai(["check", "m.toml"]).ended(2);
        checked.says(&format!("missing key `{missing}` in [[agent]]"));
    }
    let ranged = "parameters = { a = { from = 1, to = 3, step = 1 }, b = { from = 0.1, to = 0.2, count = 2 } }";
    folder.write("m.toml", manifest("", ranged));
    folder.jitai(["check", "m.toml"]).succeeded().prints("7 jobs");
}

#[test]
fn an_unpaid_last_step_makes_the_longest_episode_one_step_longer() {
    let lengths = |longest: u32, text: &str| {
        let program = format!(
            r#"
hear
case $line in *'"longest_episode":{longest},'*) ;; *) exit 7;; esac
say '{{"type":"ready","protocol":1}}'
say '{{"type":"episodes","returns":[1.0],"lengths":[{longest}],"terminated":[false]}}'
[ -e longer ] && say '{{"type":"episodes","returns":[1.0],"lengths":[{}],"terminated":[false]}}'
play"#,
            longest + 1
        );
        let folder = Folder::with(text);
        folder.write("program.sh", format!("{LIBRARY}\n{program}\n"));
        folder.jitai(["run", "sweep.toml"]).succeeded();
        folder.write("longer", "");
        folder.jitai(["run", "sweep.toml", "--set", "version=\"2\""]).ended(1);
        let sql = "SELECT failure_message FROM run_summary WHERE failure_kind = 'external'";
        let message: String = folder.store().query_row(sql, [], |row| row.get(0)).unwrap();
        let expected = format!("`lengths`: expected 1 to {longest} steps, found {}", longest + 1);
        assert!(message.contains(&expected), "{message}");
    };
    let text = manifest("environment.horizon = 7", "");
    lengths(7, &text);
    lengths(8, &text.replace("horizon = 7", "horizon = 7\nenvironment.unpaid_last_step = true"));
}

#[test]
fn the_bandit_in_awk_learns_what_tailored_messages_are_worth() {
    let folder = Folder::new();
    fs::create_dir(folder.path("experiments")).unwrap();
    for file in ["outside.toml", "bandit.sh", "bandit.awk"] {
        let shipped = format!("{}/experiments/external/{file}", env!("CARGO_MANIFEST_DIR"));
        fs::copy(shipped, folder.path("experiments").join(file)).unwrap();
    }
    let filter = "agent=awk_bandit|tailored,seed=1|2";
    let run = ["run", "experiments/outside.toml", "--filter", filter, "--set", "scenario=C-H-D"];
    folder.jitai(run).succeeded().says("6 jobs run, 6 completed in all");
    // The program sees the context and learns to send the matching message, as the rule does.
    let alike = "SELECT count(*) FROM run_summary AS a JOIN run_summary AS t USING (seed)
        WHERE a.agent = 'awk_bandit' AND t.agent = 'tailored' AND a.mean_return = t.mean_return";
    assert_eq!(folder.number(alike), 4);
    let points =
        "SELECT count(*) FROM learning_curve WHERE metric = 'mean_return' AND episode = 100";
    assert_eq!(folder.number(points), 4);
    // The same seed and the same program give the same choices.
    let first = folder.dump();
    fs::remove_file(folder.path("jitai.sqlite")).unwrap();
    folder.jitai(run).succeeded();
    crate::support::assert_same_rows(&first, &folder.dump());
}
