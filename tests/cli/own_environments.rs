//! Manifests whose environment is an outside program: run, resumed, analysed and reported like those of a built-in
//! family.

use std::time::Instant;

use crate::outside_environments::COUNTER;
use crate::support::{Folder, assert_prompt, until};

/// Every agent in the counter, in which action 1 pays 1 at each of six steps.
const MANIFEST: &str = r#"
format = 1
name = "sweep"
scenarios = ["all", ["count"]]
seeds = 2
[environment]
family = "external"
command = ["python3", "counter.py"]
version = "1"
parameters = { pay = [1, 2], note = "x" }
[evaluation]
test_episodes = 30
curve_stride = 10
record_decisions = "test"
[[agent]]
name = "dqn"
algorithm = "dueling_dqn"
episodes = 20
layers = [8]
buffer = 100
batch = 8
[[agent]]
name = "reinforce"
algorithm = "reinforce"
episodes = 200
layers = [8]
learning_rate = 0.02
[[agent]]
name = "ppo"
algorithm = "ppo"
episodes = 60
layers = [8]
lanes = 4
steps = 8
[[agent]]
name = "thompson"
algorithm = "linear_thompson"
episodes = 20
prior_sd = 10
noise_sd = 1
[[agent]]
name = "never"
algorithm = "rule"
rule = "never"
[[agent]]
name = "random"
algorithm = "rule"
rule = "random"
[[analysis]]
name = "contrast"
kind = "contrast"
by = "agent.name"
between = ["thompson", "never"]
[[analysis]]
name = "curve"
kind = "curve"
x = "environment.parameters.pay"
[[analysis]]
name = "learning"
kind = "learning_curve"
window = 10
"#;

/// The counter with the parameter `pay`, and a unit.
fn counter() -> String {
    let mut program = COUNTER.to_owned();
    for (from, to) in [
        (
            "kind == \"describe\":\n",
            "kind == \"describe\":\n        pay = message[\"parameters\"][\"pay\"]\n",
        ),
        ("reward=[0, 1]", "reward=[0, 2], unit=\"coins\""),
        (
            "rewards = message[\"actions\"]",
            "rewards = [pay * action for action in message[\"actions\"]]",
        ),
    ] {
        assert!(program.contains(from), "{from}");
        program = program.replace(from, to);
    }
    program
}

fn folder() -> Folder {
    let folder = Folder::with(MANIFEST);
    folder.write("counter.py", counter());
    folder
}

#[test]
fn every_agent_trains_and_every_table_is_as_for_a_built_in_family() {
    let folder = folder();
    folder.jitai(["check", "sweep.toml"]).succeeded().prints("48 jobs");
    folder
        .jitai(["plan", "sweep.toml"])
        .succeeded()
        .says("their jobs start over instead of resuming");
    let ran = folder.jitai(["run", "sweep.toml"]).succeeded();
    ran.says("48 jobs run, 48 completed in all").prints("mean return ± sd over seeds, in coins");
    folder.jitai(["doctor"]).succeeded();
    // What each agent makes of twelve coins at most.
    let mean = |agent: &str, pay: i64| {
        folder.number(&format!(
            "SELECT CAST(round(100 * avg(mean_return)) AS INTEGER) FROM run_summary AS s JOIN parameter AS p
                ON p.job_key = s.job_key AND p.name = 'environment.parameters.pay' AND p.value = {pay}
             WHERE agent = '{agent}'"
        ))
    };
    assert_eq!([mean("never", 1), mean("never", 2)], [0, 0]);
    assert!(mean("thompson", 2) > 1100 && mean("thompson", 1) > 550, "{}", mean("thompson", 2));
    assert!(mean("reinforce", 2) > 1000, "{}", mean("reinforce", 2));
    assert!((200..400).contains(&mean("random", 1)));
    let count = |sql: &str| folder.number(&format!("SELECT count(*) FROM ({sql})"));
    // Both agents of a seed meet the same people: the chance that they see does not depend on actions.
    let state = "SELECT DISTINCT seed, episode, step, json_extract(state, '$.twice') AS twice
        FROM decision JOIN run_summary USING (job_key) WHERE phase = 'test'";
    assert_eq!(count(state), 2 * 30 * 6);
    assert_eq!(count(&format!("{state} AND json_extract(state, '$.twice') <> 2 * step")), 0);
    assert_eq!(
        count("SELECT 1 FROM decision WHERE context IS NOT NULL OR habituation IS NOT NULL"),
        0
    );
    assert_eq!(
        count("SELECT 1 FROM action_choice WHERE p_low IS NOT NULL OR context IS NOT NULL"),
        0
    );
    assert_eq!(count("SELECT DISTINCT action FROM action_choice"), 2);
    let ends = "SELECT 1 FROM evaluation_episode WHERE disengaged IS NOT NULL OR terminated <> 0";
    assert_eq!(count(ends), 0);
    assert_eq!(count("SELECT 1 FROM metric WHERE name = 'termination_rate' AND value = 0"), 48);
    assert_eq!(count("SELECT 1 FROM metric WHERE name = 'disengagement_rate'"), 0);
    assert_eq!(count("SELECT 1 FROM run_summary WHERE sigma IS NOT NULL"), 0);
    // Keys of the first family that later releases added are no parameters of these jobs.
    let own = "SELECT DISTINCT name FROM parameter WHERE name LIKE 'environment.%'";
    assert_eq!(count(own), 5);
    assert_eq!(count("SELECT DISTINCT swept FROM arm_summary WHERE agent = 'dqn'"), 2);

    folder.jitai(["report", "sweep.toml", "--out", "report"]).succeeded();
    let arms = folder.read("report/tables/sweep-arms.md");
    assert!(arms.contains("return (coins)") && arms.contains("Terminated, %"), "{arms}");
    assert!(!arms.contains("Optimum") && !arms.contains("isengage"), "{arms}");
    let figure = folder.read("report/figures/sweep-curve.svg");
    assert!(figure.contains("coins") && !figure.contains("steps walked"), "{figure}");
    folder.jitai(["report", "sweep.toml", "--out", "again"]).succeeded();
    assert_eq!(folder.read("report/index.html"), folder.read("again/index.html"));

    let filtered = folder.jitai([
        "plan",
        "sweep.toml",
        "--filter",
        "pay=2,agent=ppo|dqn",
        "--format",
        "csv",
        "--jobs",
    ]);
    assert_eq!(filtered.succeeded().stdout.lines().count(), 1 + 8);
    let set = folder.jitai([
        "plan",
        "sweep.toml",
        "--set",
        "pay=3",
        "--set",
        "environment.version=\"2\"",
    ]);
    set.succeeded().says("24 jobs to run");

    // A policy of the program's environment is exported with its names.
    let key = "SELECT job_key FROM run_summary WHERE agent = 'ppo' AND scenario = 'all' LIMIT 1";
    let key: String = folder.store().query_row(key, [], |row| row.get(0)).unwrap();
    folder.jitai(["export", "--policy", &key, "--out", "policy"]).succeeded();
    let policy = folder.read("policy/policy.json");
    for word in ["\"wait\"", "\"pay\"", "\"count\"", "\"chance\"", "\"unit\": \"m\""] {
        assert!(policy.contains(word), "{word} {policy}");
    }
    folder
        .jitai(["simulate", "--policy", &format!("run:{key}")])
        .ended(2)
        .says("`jitai simulate` shows those of step_count");
}

#[test]
fn equal_jobs_give_equal_results_and_a_merged_store_has_them_all() {
    let (one, other) = (folder(), folder());
    let some = ["run", "sweep.toml", "--filter", "agent=ppo|thompson,scenario=all"];
    one.jitai(some).succeeded();
    other.jitai(some).succeeded();
    assert_eq!(one.dump(), other.dump());
    let into = other.path("jitai.sqlite");
    let merged = ["merge", into.to_str().unwrap(), "--store", "both.sqlite"];
    one.jitai(merged).succeeded();
    one.jitai(["doctor", "--store", "both.sqlite"])
        .succeeded()
        .prints("8 completed runs, all intact");
    one.jitai(["forget", "sweep", "--results", "--yes"]).succeeded();
}

#[test]
fn a_stopped_job_starts_over_and_ends_as_if_undisturbed() {
    let undisturbed = folder();
    let filter = ["run", "sweep.toml", "--filter", "agent=reinforce,scenario=all,pay=1,seed=1"];
    undisturbed.jitai(filter).succeeded();
    let stopped = Folder::with(MANIFEST);
    // The first start waits in mid-training, and never again.
    let slow = counter().replace(
        "    elif kind == \"step\":\n",
        "    elif kind == \"step\":\n        import os\n        if not os.path.exists('waited'):\n            \
         open('waited', 'w').close()\n            time.sleep(60)\n",
    );
    stopped.write("counter.py", slow);
    let running = stopped.start(filter);
    until("the program waits", || stopped.path("waited").exists());
    let asked = Instant::now();
    running.signal("INT");
    running.wait().ended(130);
    assert_prompt(asked);
    stopped.jitai(filter).succeeded();
    let without_ends = |folder: &Folder| folder.dump();
    assert_eq!(without_ends(&stopped), without_ends(&undisturbed));
}

#[test]
fn the_agent_may_be_a_program_as_well() {
    let folder = Folder::with(
        &MANIFEST.split("[[agent]]").next().unwrap().replace("[1, 2]", "2").replace(
            "seeds = 2",
            "seeds = 2\n[[agent]]\nname = \"payer\"\nalgorithm = \"external\"\ncommand = [\"python3\", \
             \"payer.py\"]\nversion = \"1\"\nepisodes = 3\n",
        ),
    );
    folder.write("counter.py", counter());
    folder.write(
        "payer.py",
        r#"
import json, sys
def say(**answer):
    print(json.dumps(answer), flush=True)
for line in sys.stdin:
    message = json.loads(line)
    if message["type"] == "job":
        assert message["actions"] == 2 and message["observation"][0]["name"] == "count", message
        assert message["horizon"] == message["longest_episode"] == 6, message
        left = message["episodes"]
        say(type="ready", protocol=1)
        say(type="reset")
    elif message["type"] == "began":
        say(type="step", actions=[1])
    elif message["type"] == "stepped":
        if not message["truncated"][0]:
            say(type="step", actions=[1])
        else:
            left -= 1
            say(type="reset") if left else say(type="trained")
    elif message["type"] == "act":
        say(type="choices", actions=[1] * len(message["lanes"]))
    elif message["type"] == "end":
        break
"#,
    );
    folder.jitai(["run", "sweep.toml"]).succeeded().says("4 jobs run, 4 completed in all");
    assert_eq!(folder.number("SELECT count(*) FROM run_summary WHERE mean_return = 12"), 4);
    let curve = "SELECT count(*) FROM learning_curve WHERE metric = 'mean_return' AND value = 12";
    assert_eq!(folder.number(curve), 4);
}

#[test]
fn faults_of_programs_are_failures_of_their_jobs() {
    let ends =
        "if lanes[message[\"lanes\"][0]][0] == 3: sys.exit('no such dose')\n        rewards = ";
    for (from, to, expected) in [
        ("rewards = ", ends, "no such dose"),
        (
            "rewards = ",
            "rewards = [7 for _ in ends] if 0 else [9 for _ in message[\"lanes\"]] or ",
            "from 0 to 2",
        ),
        ("\"chance\"", "\"change\"", ""),
    ] {
        let folder = Folder::with(&MANIFEST.replace("[\"count\"]", "[\"chance\"]"));
        let program = counter();
        assert!(program.contains(from), "{from}");
        folder.write("counter.py", program.replace(from, to));
        let filter = "agent=dqn,scenario=chance,pay=2";
        folder.jitai(["run", "sweep.toml", "--filter", filter]).ended(1).prints("external (");
        let message: String = folder
            .store()
            .query_row("SELECT failure_message FROM run_summary LIMIT 1", [], |row| row.get(0))
            .unwrap();
        let expected =
            if expected.is_empty() { "its features are count, change" } else { expected };
        assert!(message.contains(expected), "{message}");
        folder.write("counter.py", counter());
        let again = ["run", "sweep.toml", "--filter", filter, "--retry-failed"];
        folder.jitai(again).succeeded();
    }
}

#[test]
fn terminated_episodes_are_counted() {
    let folder = Folder::with(MANIFEST);
    let program = counter()
        .replace("[0, random.Random(seed)]", "[0, random.Random(seed), seed % 2]")
        .replace(
            "truncated=ends,",
            "truncated=ends, terminated=[lanes[lane][2] == 1 and lanes[lane][0] == 3 for lane in \
             message[\"lanes\"]],",
        );
    folder.write("counter.py", program);
    folder.jitai(["run", "sweep.toml", "--filter", "agent=random|dqn,pay=2"]).succeeded();
    let rates =
        "SELECT count(*) FROM metric WHERE name = 'termination_rate' AND value BETWEEN 0.1 AND 0.9";
    assert_eq!(folder.number(rates), 8);
    let ends = "SELECT count(*) FROM evaluation_episode WHERE terminated <> (length = 3)";
    assert_eq!(folder.number(ends), 0);
    let alike = "SELECT count(*) FROM metric AS rate JOIN (SELECT job_key, avg(terminated) AS share \
                 FROM evaluation_episode GROUP BY 1) USING (job_key) \
                 WHERE name = 'termination_rate' AND abs(value - share) < 1e-12";
    assert_eq!(folder.number(alike), 8);
}

#[test]
fn what_an_agent_must_suit_is_known_once_the_program_runs() {
    let biased = MANIFEST.replace("noise_sd = 1", "noise_sd = 1\naction_bias = [0, 1, 0, 0]");
    let ending = counter().replace(
        "kind == \"begin\":\n",
        "kind == \"begin\":\n        message[\"phase\"] == \"test\" and sys.exit(\"no test\")\n",
    );
    assert_ne!(ending, counter());
    for (manifest, program, agent, expected) in [
        (biased.as_str(), counter(), "thompson", "it needs one number per action"),
        (MANIFEST, ending, "ppo", "no test"),
    ] {
        let folder = Folder::with(manifest);
        folder.write("counter.py", program);
        let filter = format!("agent={agent},scenario=all,pay=2,seed=1");
        let run = folder.jitai(["run", "sweep.toml", "--filter", &filter]).ended(1);
        run.prints("external (").prints(expected);
        assert_eq!(
            folder.number("SELECT count(*) FROM run_summary WHERE mean_return IS NOT NULL"),
            0
        );
    }
}

#[test]
fn a_trial_names_the_broken_clause() {
    let folder = folder();
    let tried = folder.jitai(["check", "sweep.toml", "--try"]).succeeded();
    tried.prints("environment with note = \"x\", pay = 1: keeps the contract; 2 features, 2 actions, horizon 6;");
    let json = folder.jitai(["check", "sweep.toml", "--try", "--format", "json"]).succeeded();
    let json: serde_json::Value = serde_json::from_str(&json.stdout).unwrap();
    assert_eq!(json["trials"].as_array().unwrap().len(), 2);
    assert!(json["trials"][0]["speeds"][1][1].as_f64().unwrap() > 0.0);
    // The seed is ignored.
    folder.write("counter.py", counter().replace("random.Random(seed)", "random.Random()"));
    folder
        .jitai(["check", "sweep.toml", "--try"])
        .ended(2)
        .says("the same stream gives the same episodes");
    folder.write("counter.py", counter().replace("nothing=\"wait\"", "nothing=\"pay\""));
    let misplaced = folder.jitai(["check", "sweep.toml", "--try"]).ended(2);
    misplaced.says("`nothing`: expected the first action, `wait`, found `pay`");
    folder.write("counter.py", counter().replace("\"chance\"", "\"change\""));
    folder.write("sweep.toml", MANIFEST.replace("[\"count\"]", "[\"chance\"]"));
    folder.jitai(["check", "sweep.toml", "--try"]).ended(2).says("has no feature `chance`");
}

#[test]
fn a_trial_names_a_misspelt_state_of_an_estimate() {
    let folder = folder();
    let estimate = |moderator: &str| {
        let agents = "agents = \"random\"";
        let declared =
            format!("[[estimate]]\nname = \"e\"\nmoderators = [\"{moderator}\"]\n{agents}\n");
        folder.write("sweep.toml", format!("{MANIFEST}\n{declared}"));
    };
    estimate("twise");
    folder.jitai(["check", "sweep.toml"]).succeeded();
    let refused = folder.jitai(["check", "sweep.toml", "--try"]).ended(2);
    refused.says("the recorded state has no `twise`; it has twice");
    let json = folder.jitai(["check", "sweep.toml", "--try", "--format", "json"]).ended(2);
    assert!(json.stdout.contains("has no `twise`"), "{}", json.stdout);
    estimate("twice");
    folder.jitai(["check", "sweep.toml", "--try"]).succeeded();
}

#[test]
fn a_program_that_changed_under_its_version_is_named() {
    let folder = folder();
    folder.write("note.toml", "");
    let seeds = |seeds: &str, version: &str| {
        let text = MANIFEST.replace("seeds = 2", &format!("seeds = {seeds}"));
        let text = text.replace(
            "[\"python3\", \"counter.py\"]",
            "[\"python3\", \"counter.py\", \"note.toml\"]",
        );
        folder.write(
            "sweep.toml",
            text.replace("version = \"1\"", &format!("version = \"{version}\"")),
        );
    };
    let run = || {
        folder
            .jitai(["run", "sweep.toml", "--filter", "agent=never|random,pay=1", "--replace"])
            .succeeded()
    };
    seeds("1", "1");
    run();
    let said = "has changed since";
    assert!(!run().stderr.contains(said));
    // Jobs that run with the new file are no longer different.
    folder.write("counter.py", format!("{}\n# other\n", counter()));
    seeds("2", "1");
    run().says(
        "counter.py has changed since 4 completed jobs ran with it, under the same `version`",
    );
    let again = run();
    let again = again.says("counter.py has changed since 4 completed jobs");
    assert!(!again.stderr.contains("note.toml has"), "{}", again.stderr);
    let mixed = "jobs with 2 contents of counter.py stand side by side";
    let status = folder.jitai(["status"]).succeeded();
    assert!(status.stdout.contains(mixed), "{}", status.stdout);
    let status = folder.jitai(["status", "--format", "json"]).succeeded();
    assert!(status.stdout.contains(mixed), "{}", status.stdout);
    folder.jitai(["report", "sweep.toml", "--out", "report"]).succeeded().says(mixed);
    // Copies know the files, too, and results do not depend on them.
    let copy = Folder::new();
    for name in ["sweep.toml", "counter.py", "note.toml"] {
        copy.write(name, folder.read(name));
    }
    let from = folder.path("jitai.sqlite").display().to_string();
    copy.jitai(["merge", &from]).succeeded();
    let run_copy = ["run", "sweep.toml", "--filter", "agent=never|random,pay=1"];
    copy.jitai(run_copy).succeeded().says("counter.py has changed since 4 completed jobs");
    copy.jitai(["doctor"]).succeeded();
    folder.jitai(["doctor", "--salvage", "saved.sqlite"]).succeeded();
    let saved =
        ["run", "sweep.toml", "--filter", "agent=never|random,pay=1", "--store", "saved.sqlite"];
    folder.jitai(saved).succeeded().says("counter.py has changed since 4 completed jobs");
    seeds("2", "2");
    assert!(!run().stderr.contains(said));
    assert!(!folder.jitai(["status"]).succeeded().stdout.contains("side by side"));
}

#[test]
fn a_trial_names_agents_and_scenarios_that_do_not_suit_the_program() {
    let biased = MANIFEST.replace("noise_sd = 1", "noise_sd = 1\naction_bias = [0, 1, 0, 0]");
    let folder = folder();
    folder.write("sweep.toml", &biased);
    let expected =
        "`action_bias` does not suit an environment with 2 actions: it needs one number per action";
    folder.jitai(["check", "sweep.toml", "--try"]).ended(2).says(expected);
    folder.write("sweep.toml", biased.replace("[0, 1, 0, 0]", "[0, 1]"));
    folder.jitai(["check", "sweep.toml", "--try"]).succeeded();
    // A scenario that exclusions remove is not tried.
    let other = MANIFEST.replace("[\"count\"]", "[\"change\"]");
    assert_ne!(other, MANIFEST);
    folder.write("sweep.toml", &other);
    folder.jitai(["check", "sweep.toml", "--try"]).ended(2).says("has no feature `change`");
    folder.write("sweep.toml", format!("{other}\n[[exclude]]\nscenario = \"change\"\n"));
    folder.jitai(["check", "sweep.toml", "--try"]).succeeded();
}

#[test]
fn what_the_family_lacks_is_refused_with_a_sentence() {
    let folder = Folder::with(MANIFEST);
    let analysis =
        |kind: &str| format!("{MANIFEST}\n[[analysis]]\nname = \"more\"\nkind = \"{kind}\"\n");
    for (text, expected) in [
        (analysis("action_choice"), "\"external\", which lacks inferred contexts"),
        (analysis("inference_error"), "\"external\", which lacks inferred contexts"),
        (
            analysis("recovery")
                + "with = { agent.name = \"ppo\" }\nwithout = { agent.name = \"dqn\" }\n",
            "\"external\", which lacks an optimum",
        ),
        (
            MANIFEST.replace("rule = \"never\"", "rule = \"tailored\""),
            "needs an environment of the family step_count",
        ),
        (
            MANIFEST.replace("format = 1", "format = 1\nextends = \"paper\""),
            "is of the family step_count",
        ),
        (MANIFEST.replace("\"external\"", "\"exernal\""), "1 fault in sweep.toml"),
        (MANIFEST.replace("version = \"1\"", ""), "missing key `version` in [environment]"),
        (
            MANIFEST.replace("version = \"1\"", "version = \"1\"\nsigma = 0.4"),
            "`sigma` is a key of the family step_count",
        ),
        (MANIFEST.replace("pay = ", "p-y = "), "`p-y` is not a name of a parameter"),
        (
            MANIFEST.replace("[\"count\"]", "[\"count\", \"count\"]"),
            "feature `count` is listed twice",
        ),
        (
            MANIFEST.replace("[evaluation]", "[population]\ndelta_d = 0.1\n[evaluation]"),
            "`population` does not apply to the family external: a program may draw its own people",
        ),
        (
            MANIFEST.replace("family = \"external\"", "family = \"step_count\""),
            "unknown key `command` in [environment]",
        ),
    ] {
        folder.write("sweep.toml", &text);
        folder.jitai(["check", "sweep.toml"]).ended(2).says(expected);
    }
    folder.write("sweep.toml", MANIFEST);
    folder.jitai(["optimum", "sweep.toml"]).ended(2).says("no optimum is computed in environments");
}
