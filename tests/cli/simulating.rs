//! `simulate`: rules, trained policies and recorded trajectories, step by step.

use serde_json::Value;

use crate::support::{Effort, Finished, Folder, manifest};

const GOLDEN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/golden_trajectories.json");

/// The steps that `simulate` prints.
#[track_caller]
fn steps(folder: &Folder, arguments: &[&str]) -> Vec<Value> {
    let all = ["simulate", "--format", "json"].iter().chain(arguments).copied();
    folder.jitai(all).succeeded().json().as_array().unwrap().clone()
}

fn actions(steps: &[Value]) -> Vec<i64> {
    steps.iter().map(|step| step["action"].as_i64().unwrap()).collect()
}

/// The action tailored to the likelier context.
fn tailored(step: &Value) -> i64 {
    2 + step["likely"].as_i64().unwrap()
}

#[test]
fn a_fixed_rule_always_takes_its_action() {
    let folder = Folder::new();
    for action in 0..4 {
        let steps = steps(&folder, &["--policy", &format!("fixed:{action}"), "--episodes", "3"]);
        assert!(actions(&steps).iter().all(|taken| *taken == action));
        let ends = steps.iter().filter(|step| step["ending"] != "running").count();
        assert_eq!(ends, 3, "each episode ends once");
    }
}

#[test]
fn a_random_rule_takes_every_action_and_follows_its_seed() {
    let folder = Folder::new();
    let rolled = |seed: &str| {
        actions(&steps(&folder, &["--policy", "random", "--episodes", "20", "--seed", seed]))
    };
    let one = rolled("1");
    assert!((0..4).all(|action| one.contains(&action)), "{one:?}");
    assert_eq!(rolled("1"), one);
    assert_ne!(rolled("2"), one);
}

#[test]
fn matching_rules_follow_the_likely_context() {
    let folder = Folder::new();
    let matched = steps(&folder, &["--policy", "tailored", "--set", "sigma=0.8"]);
    assert!(matched.iter().all(|step| step["action"] == tailored(step)));
    assert_eq!(steps(&folder, &["--set", "sigma=0.8"]), matched, "it is the default");
    assert_eq!(steps(&folder, &["--set", "environment.sigma=0.8"]), matched);

    let careful = steps(&folder, &["--policy", "threshold:0.9", "--set", "sigma=0.8"]);
    for step in &careful {
        let p = step["probability_0"].as_f64().unwrap();
        let expected = if p.max(1.0 - p) >= 0.9 { tailored(step) } else { 0 };
        assert_eq!(step["action"], expected, "{step}");
    }
    assert!(actions(&careful).contains(&0));

    // Without noise, only the fixed first context is not certain: its shown probability is 0.5.
    let certain = steps(&folder, &["--policy", "threshold:0.9", "--set", "sigma=0"]);
    assert_eq!(certain[0]["action"], 0);
    assert!(certain[1..].iter().all(|step| step["action"] == tailored(step)));
    let sampled =
        ["--policy", "threshold:0.9", "--set", "sigma=0", "--set", "first_context=sampled"];
    assert!(steps(&folder, &sampled).iter().all(|step| step["action"] == tailored(step)));
}

#[test]
fn every_step_has_the_probability_of_its_action() {
    let folder = Folder::new();
    let probabilities = |arguments: &[&str]| -> Vec<f64> {
        let steps = steps(&folder, arguments);
        steps.iter().map(|step| step["action_probability"].as_f64().unwrap()).collect()
    };
    assert!(probabilities(&["--policy", "random"]).iter().all(|p| *p == 0.25));
    for rule in ["never", "untailored", "tailored", "threshold:0.8", "optimal", "fixed:3"] {
        assert!(probabilities(&["--policy", rule]).iter().all(|p| *p == 1.0), "{rule}");
    }
    let replayed = steps(&folder, &["--replay", GOLDEN]);
    assert!(replayed.iter().all(|step| step["action_probability"].is_null()));

    let folder = Folder::completed(&manifest("sweep", "0.6", "1", Effort::Trivial));
    let keys = "SELECT agent, job_key FROM run_summary ORDER BY scenario, agent LIMIT 2";
    let store = folder.store();
    let mut statement = store.prepare(keys).unwrap();
    let keys: Vec<(String, String)> = statement
        .query_map([], |row| Ok((row.get(0)?, row.get(1)?)))
        .unwrap()
        .collect::<Result<_, _>>()
        .unwrap();
    for (agent, key) in keys {
        let policy = format!("run:{key}");
        let explored = steps(&folder, &["--policy", &policy, "--episodes", "20"]);
        let probability = |step: &Value| step["action_probability"].as_f64().unwrap();
        assert!(explored.iter().map(probability).all(|p| p > 0.0 && p < 1.0), "{agent}");
        let greedy = steps(&folder, &["--policy", &policy, "--greedy"]);
        assert!(greedy.iter().map(probability).all(|p| p == 1.0), "{agent}");
    }
}

#[test]
fn a_step_without_a_message_shows_what_was_chosen_and_why_it_was_not_sent() {
    let folder = Folder::new();
    let set = ["--set", "availability=0.5", "--set", "message_budget=1", "--set", "horizon=12"];
    let random = [&["--policy", "random", "--episodes", "20"][..], &set].concat();
    let (mut unavailable, mut over_budget) = (0, 0);
    let mut is_spent = false;
    for step in steps(&folder, &random) {
        let whole = |name: &str| step[name].as_i64().unwrap();
        is_spent &= whole("step") > 0;
        let can_send = whole("available") == 1 && !is_spent;
        assert_eq!(whole("can_send"), i64::from(can_send), "{step}");
        let (taken, probability) = if can_send { (whole("chosen_action"), 0.25) } else { (0, 1.0) };
        assert_eq!(whole("action"), taken, "{step}");
        assert_eq!(step["action_probability"], probability, "{step}");
        if !can_send && whole("chosen_action") != 0 {
            unavailable += usize::from(whole("available") == 0);
            over_budget += usize::from(is_spent);
        }
        is_spent |= taken != 0;
    }
    assert!(unavailable > 10 && over_budget > 10, "{unavailable} {over_budget}");
}

#[test]
fn the_step_after_the_horizon_is_no_part_of_the_test() {
    let text = "format = 1\nname = \"m\"\nscenarios = [\"P-H-D\"]\nseeds = 1\n[environment]\nsigma = 2.0\n\
        horizon = 3\nunpaid_last_step = true\nepsilon_d = 0.31\ndelta_d = 0.0\n[evaluation]\n\
        test_episodes = 200\nrecord_decisions = \"test\"\n[[agent]]\nname = \"a\"\nalgorithm = \"rule\"\n\
        rule = \"tailored\"\n";
    let folder = Folder::with(text);
    folder.jitai(["run", "sweep.toml", "--quiet"]).succeeded();
    let whole = |sql: &str| -> i64 { folder.store().query_row(sql, [], |row| row.get(0)).unwrap() };
    assert_eq!(whole("SELECT min(length) = 3 AND max(length) = 3 FROM evaluation_episode"), 1);
    assert_eq!(whole("SELECT count(*) FROM decision"), 600);
    assert_eq!(whole("SELECT sum(count) FROM action_choice"), 600);
    // Two wrongly tailored messages raise the risk to 0.72, and a third, in the step after the horizon, to 1.03.
    assert_eq!(whole("SELECT sum(disengaged) FROM evaluation_episode"), 0);
    folder.jitai(["doctor"]).succeeded();
    let set = ["sigma=2", "horizon=3", "unpaid_last_step=true", "epsilon_d=0.31", "delta_d=0"];
    let set = || set.iter().flat_map(|set| ["--set", set]);
    let all: Vec<&str> = ["--episodes", "200"].into_iter().chain(set()).collect();
    assert!(steps(&folder, &all).iter().any(|step| step["ending"] == "disengaged"));
    let all = ["simulate", "--episodes", "200", "--summary", "--format", "json"];
    let summary = folder.jitai(all.into_iter().chain(set())).succeeded().json();
    assert_eq!(summary[0]["mean_length"], 3.0);
    assert_eq!(summary[0]["disengagement_rate"], 0.0);
}

#[test]
fn a_rule_knows_what_its_scenario_shows() {
    let folder = Folder::new();
    let certain = steps(&folder, &["--policy", "tailored", "--scenario", "C", "--set", "sigma=2"]);
    assert!(
        certain.iter().all(|step| {
            step["action"].as_i64().unwrap() == step["context"].as_i64().unwrap() + 2
        })
    );
    let blind = ["--policy", "optimal", "--scenario", "P-T"];
    refused(&folder, &blind)
        .says("no optimum is computed for P-T")
        .says("P-T-H-D is an upper bound");
    refused(&folder, &["--policy", "run:00", "--scenario", "P"])
        .says("--scenario applies to rules only");
}

#[test]
fn rewards_add_up_to_the_return() {
    let folder = Folder::new();
    let mut total = 0.0;
    for step in steps(&folder, &["--policy", "tailored"]) {
        total += step["reward"].as_f64().unwrap();
        assert!((step["return"].as_f64().unwrap() - total).abs() < 1e-9, "{step}");
    }
    let summary = steps(&folder, &["--policy", "tailored", "--summary"]);
    assert!((summary[0]["mean_return"].as_f64().unwrap() - total).abs() < 1e-9, "{summary:?}");
}

#[test]
fn settings_change_the_environment() {
    let folder = Folder::new();
    let settings = ["--set", "sigma=0", "--set", "horizon=7", "--set", "mu=[1, 1]"];
    let steps = steps(&folder, &[&["--policy", "fixed:0"][..], &settings[..]].concat());
    assert_eq!(steps.len(), 7);
    assert!(steps.iter().all(|step| step["reward"] == 1.0), "{steps:?}");
    // The first step shows a probability of 0.5, whatever the context; without noise, later steps show
    // 0 or 1.
    assert!(
        steps[1..].iter().all(|step| [0.0, 1.0].contains(&step["probability_0"].as_f64().unwrap()))
    );
}

fn refused(folder: &Folder, arguments: &[&str]) -> Finished {
    let all = ["simulate"].iter().chain(arguments).copied();
    let refused = folder.jitai(all).ended(2);
    assert_eq!(refused.stdout, "");
    refused
}

#[test]
fn faulty_settings_and_rules_are_refused_with_what_is_valid() {
    let folder = Folder::new();
    let set = |setting| refused(&folder, &["--set", setting]);
    set("siggma=1").says("unknown key `siggma`").says("did you mean `sigma`?");
    set("sigma=-1").says("expected a number from 0 to 1000000, found -1");
    set("epsilon_d=1.5").says("expected a number from 0 to 1");
    set("first_context=fixd").says("did you mean");
    set("sigma=nan").says("`sigma`: expected a number");
    set("sigma=[0.4, 0.6]").says("expected one value, not a sweep");
    set("horizon={ from = 1, to = 3, step = 1 }").says("expected one value, not a sweep");
    for form in ["sigma", "=1", "\"horizon\"=3", "mu.x=3", "a b=1"] {
        set(form).says("expected NAME=VALUE");
    }
    set("sigma=0.4\nhorizon=3").says("expected a value on one line");
    for rule in ["random", "fixed:2"] {
        refused(&folder, &["--greedy", "--policy", rule])
            .says("--greedy applies to trained policies only");
    }
    let rules = "the rules are never, untailored, tailored, threshold:<0.5-1>, random, optimal, \
                 fixed:<action 0-3>, run:<job key>";
    for threshold in ["0.3", "1.01", "nan", ""] {
        let policy = format!("threshold:{threshold}");
        let refused = folder.jitai(["simulate", "--policy", &policy]).ended(2);
        refused.says("the threshold must lie in [0.5, 1]");
    }
    for rule in ["fixed:4", "fixed", "best", ""] {
        refused(&folder, &["--policy", rule]).says(rules);
    }
    refused(&folder, &["--episodes", "0"]);
}

#[test]
fn a_trained_policy_is_found_by_the_beginning_of_its_job_key() {
    let folder = Folder::completed(&manifest("sweep", "0.6", "8", Effort::Trivial));
    let key: String =
        folder.store().query_row("SELECT min(job_key) FROM metric", [], |row| row.get(0)).unwrap();
    let whole = steps(&folder, &["--policy", &format!("run:{key}"), "--episodes", "5"]);
    let beginning = format!("run:{}", &key[..12]);
    assert_eq!(steps(&folder, &["--policy", &beginning, "--episodes", "5"]), whole);
    steps(&folder, &["--policy", &beginning, "--greedy", "--set", "sigma=2"]);

    // Of sixteen keys, two have the same first digit unless each of the sixteen digits occurs once.
    let by_digit = "SELECT substr(job_key, 1, 1), count(DISTINCT job_key) FROM metric GROUP BY 1";
    let store = folder.store();
    let mut statement = store.prepare(by_digit).unwrap();
    let begun: Vec<(String, i64)> = statement
        .query_map([], |row| Ok((row.get(0)?, row.get(1)?)))
        .unwrap()
        .collect::<Result<_, _>>()
        .unwrap();
    let (digit, _) = begun.iter().find(|(_, keys)| *keys > 1).expect("two keys begin alike");
    let policy = |text: &str| folder.jitai(["simulate", "--policy", &format!("run:{text}")]);
    policy(digit).ended(2).says(&format!("`{digit}` is a prefix of several completed jobs' keys"));
    policy("0123456789abcdef").ended(2).says("no job key begins with `0123456789abcdef`");
    policy("dqn").ended(2).says("`dqn` is not a job key");
    policy("").ended(2).says("is not a job key");
}

#[test]
fn bandits_and_agents_with_a_history_are_rolled_from_the_store() {
    let text = "format = 1
name = \"sweep\"
scenarios = [\"C-H-D\"]
seeds = 1
environment.sigma = 0.6
evaluation = { test_episodes = 20, first_episodes = [2, 10] }
[[agent]]
name = \"bandit\"
algorithm = \"linear_thompson\"
episodes = 30
prior_sd = 100
[[agent]]
name = \"remembering\"
algorithm = \"reinforce\"
episodes = 10
layers = [8]
history = 3
[[agent]]
name = \"never\"
algorithm = \"rule\"
rule = \"never\"
";
    let folder = Folder::completed(text);
    let key = |agent: &str| -> String {
        let sql =
            "SELECT min(job_key) FROM parameter WHERE name = 'agent.algorithm' AND value = ?1";
        folder.store().query_row(sql, [agent], |row| row.get(0)).unwrap()
    };
    let bandit = format!("run:{}", key("linear_thompson"));
    assert!(steps(&folder, &["--policy", &bandit, "--episodes", "3"]).len() > 10);
    steps(&folder, &["--policy", &bandit, "--greedy"]);
    let remembering = format!("run:{}", key("reinforce"));
    steps(&folder, &["--policy", &remembering, "--set", "sigma=1"]);
    let first = "SELECT count(*) FROM metric WHERE name LIKE 'mean_return_first_%'";
    assert_eq!(folder.number(first), 6);
    // Without messages, no participant disengages: 50 steps of 0.1.
    let never = "SELECT count(*) FROM metric JOIN parameter USING (job_key)
                 WHERE parameter.name = 'agent.algorithm' AND parameter.value = 'rule'
                 AND metric.name = 'mean_return_first_10' AND abs(metric.value - 5) < 1e-9";
    assert_eq!(folder.number(never), 1);
}

#[test]
fn what_a_trained_policy_observes_cannot_be_set_anew() {
    let text = manifest("sweep", "0.6", "1", Effort::Trivial);
    let one_hot = text.replace("0.6\n", "0.6\nenvironment.time_one_hot = true\n");
    for (text, refused, allowed) in [
        (
            &text,
            &["time_one_hot=true", "observed_probability=1"][..],
            &["time_one_hot=false", "horizon=20", "time_indicator=exact", "epsilon_d=0.2"][..],
        ),
        (
            &one_hot,
            &["time_one_hot=false", "horizon=20", "time_indicator=exact"],
            &["horizon=50", "sigma=1", "time_indicator_period=3"],
        ),
    ] {
        let folder = Folder::completed(text);
        let key: String = folder
            .store()
            .query_row("SELECT min(job_key) FROM metric", [], |row| row.get(0))
            .unwrap();
        let policy = format!("run:{key}");
        let simulate = |setting: &str| {
            folder.jitai(["simulate", "--policy", &policy, "--set", "rho_1=9", "--set", setting])
        };
        for setting in refused {
            let told = format!(
                "--set {setting}: this would change the observations on which the policy of job {key}"
            );
            simulate(setting).ended(2).says(&told);
        }
        for setting in allowed {
            simulate(setting).succeeded();
        }
    }
}

#[test]
fn a_policy_that_is_not_trained_yet_is_refused() {
    let folder = Folder::with(&manifest("sweep", "0.6", "2", Effort::Trivial));
    folder.jitai(["simulate", "--policy", "run:00"]).ended(3).says("there is no store at");
    folder.jitai(["run", "sweep.toml", "--filter", "seed=1"]).succeeded();
    let plan = ["plan", "sweep.toml", "--jobs", "--format", "json", "--filter", "seed=2"];
    let plan = folder.jitai(plan).succeeded().json();
    let key = plan[0]["job_key"].as_str().unwrap();
    let policy = format!("run:{key}");
    folder.jitai(["simulate", "--policy", &policy]).ended(2).says("has no completed run");
}

#[test]
fn recorded_trajectories_are_repeated_step_by_step() {
    let folder = Folder::new();
    let replay = folder.jitai(["simulate", "--replay", GOLDEN, "--format", "json"]).succeeded();
    let steps = replay.json();
    let steps = steps.as_array().unwrap();
    let recorded: Value =
        serde_json::from_str(include_str!("../data/golden_trajectories.json")).unwrap();
    let mut rows = steps.iter();
    for (number, case) in recorded["cases"].as_array().unwrap().iter().enumerate() {
        for (t, theirs) in case["steps"].as_array().unwrap().iter().enumerate() {
            let ours = rows.next().expect("a row a step");
            assert_eq!((&ours["episode"], &ours["step"]), (&(number + 1).into(), &t.into()));
            assert_eq!(ours["action"], theirs["action"]);
            assert_eq!(ours["likely"], theirs["inferred"]);
            for name in ["habituation", "disengagement", "reward"] {
                let difference = ours[name].as_f64().unwrap() - theirs[name].as_f64().unwrap();
                assert!(difference.abs() <= 1e-12, "{name}: {ours} {theirs}");
            }
        }
    }
    assert!(rows.next().is_none());
    let (counted, largest) = replay.stderr.trim_end().rsplit_once(' ').unwrap();
    let expected = "6 episodes, 274 steps; 0 recorded values differ; largest numerical difference:";
    assert_eq!(counted, expected);
    assert!(largest.parse::<f64>().unwrap() < 1e-12, "{}", replay.stderr);
}

#[test]
fn official_trajectories_are_repeated_with_the_preset_that_they_extend() {
    const OFFICIAL: &str =
        concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/step_count/golden.json");
    let folder = Folder::new();
    let replay = folder.jitai(["simulate", "--replay", OFFICIAL, "--format", "json"]).succeeded();
    replay.says("9 episodes, 383 steps; 0 recorded values differ; largest numerical difference: 0");
    let unknown = r#"{"cases": [{"extends": "step_count_jitay", "sigma": 1, "parameters": {}, "horizon": 1,
        "steps": []}]}"#;
    folder.write("unknown.json", unknown);
    refused(&folder, &["--replay", "unknown.json"])
        .says("episode 1, `extends`: expected \"paper\" or")
        .says("did you mean `step_count_jitai`?");
}

#[test]
fn noise_is_set_with_its_size_and_forced_in_a_replay() {
    let folder = Folder::new();
    let noise = ["state_noise=beta", "kappa_h=10", "kappa_d=20", "step_noise=gamma", "sigma_s=10"];
    let settings: Vec<&str> = noise.iter().flat_map(|setting| ["--set", setting]).collect();
    let rolled = steps(&folder, &[&["--policy", "random", "--seed", "3"][..], &settings].concat());
    let quiet = steps(&folder, &["--policy", "random", "--seed", "3"]);
    assert_eq!(rolled[2]["context"], quiet[2]["context"], "contexts have a stream of their own");
    assert_ne!(rolled[1]["habituation"], quiet[1]["habituation"]);

    // The rolled steps, except the last one, as a recording.
    let (last, before) = rolled.split_last().unwrap();
    let recorded = |step: &Value| {
        let mut step = step.clone();
        step["p0"] = step["probability_0"].clone();
        step
    };
    let case = |parameters: Value| {
        serde_json::json!({
            "sigma": 0.6,
            "horizon": 50,
            "parameters": parameters,
            "steps": before.iter().map(recorded).collect::<Vec<_>>(),
            "final": { "habituation": last["habituation"], "disengagement": last["disengagement"] },
            "disengaged": false,
        })
    };
    let parameters = serde_json::json!({
        "state_noise": "beta", "kappa_h": 10, "kappa_d": 20, "step_noise": "gamma", "sigma_s": 10,
    });
    let mut file = serde_json::json!({ "cases": [case(parameters)] });
    folder.write("noisy.json", file.to_string());
    let replayed = folder.jitai(["simulate", "--replay", "noisy.json"]).succeeded();
    replayed.says("; 0 recorded values differ;");
    file["cases"][0]["final"] = Value::Null;
    folder.write("open.json", file.to_string());
    refused(&folder, &["--replay", "open.json"]).says("required in the next step, or in `final`");
    folder.write(
        "quiet.json",
        serde_json::json!({ "cases": [case(Value::Object(Default::default()))] }).to_string(),
    );
    folder.jitai(["simulate", "--replay", "quiet.json"]).ended(1);

    refused(&folder, &["--set", "kappa_h=10"])
        .says("`kappa_h` = 10.0 requires `state_noise` = \"beta\"");
    refused(&folder, &["--set", "sigma=1", "--set", "step_noise=gamma"])
        .says("--set step_noise=gamma: `step_noise` = \"gamma\" needs `sigma_s` above 0");
    let noisy = ["--policy", "optimal", "--set", "state_noise=uniform"];
    refused(&folder, &noisy).says("no optimum can be computed with `state_noise` = \"uniform\"");
}

#[test]
fn messages_are_sent_where_they_can_be_and_within_their_budget() {
    let folder = Folder::new();
    let sent = |settings: &[&str]| {
        let steps = steps(&folder, &[&["--policy", "untailored"][..], settings].concat());
        for step in &steps {
            assert!(step["available"] == 1 || step["action"] == 0, "{step}");
        }
        (actions(&steps).into_iter().filter(|action| *action > 0).count(), steps.len())
    };
    assert_eq!(sent(&["--set", "availability=0"]), (0, 50));
    assert_eq!(sent(&["--set", "message_budget=7"]), (7, 50));
    let (some, _) = sent(&["--set", "availability=0.5"]);
    assert!((10..40).contains(&some), "{some}");
    // The return counts the steps walked, so a cost changes nothing in the output.
    let priced = steps(&folder, &["--set", "message_cost=30"]);
    assert_eq!(priced, steps(&folder, &[]));
}

#[test]
fn replayed_and_rolled_episodes_have_the_same_columns_and_count_from_one() {
    let folder = Folder::new();
    let header = |arguments: &[&str]| {
        let all = ["simulate", "--format", "csv"].iter().chain(arguments).copied();
        let stdout = folder.jitai(all).succeeded().stdout;
        let mut lines = stdout.lines().map(str::to_owned);
        (lines.next().unwrap(), lines.next().unwrap())
    };
    let (rolled, first) = header(&[]);
    let (replayed, first_replayed) = header(&["--replay", GOLDEN]);
    assert_eq!(rolled, replayed);
    assert!(rolled.starts_with("episode,step,context,probability_0,likely,"), "{rolled}");
    assert!(first.starts_with("1,0,") && first_replayed.starts_with("1,0,"), "{first}");
}

#[test]
fn differences_from_the_recording_are_listed_with_their_places() {
    let folder = Folder::new();
    let text = include_str!("../data/golden_trajectories.json");
    let recorded: Value = serde_json::from_str(text).unwrap();
    let changed = |change: &dyn Fn(&mut Value)| {
        let mut recorded = recorded.clone();
        change(&mut recorded["cases"]);
        folder.write("changed.json", recorded.to_string());
        folder.jitai(["simulate", "--replay", "changed.json"])
    };
    let opposite = |value: &Value| Value::from(!value.as_bool().unwrap());
    changed(&|cases| cases[2]["steps"][3]["reward"] = 1e6.into())
        .ended(1)
        .says("episode 3, step 3: reward is ")
        .says(", recorded 1000000\n")
        .says("; 1 recorded value differs;");
    changed(&|cases| cases[0]["disengaged"] = opposite(&cases[0]["disengaged"]))
        .ended(1)
        .says("episode 1, after its last step: disengaged is false, recorded true\n");
    changed(&|cases| cases[0]["steps"][1]["inferred"] = 0.into())
        .ended(1)
        .says("episode 1, step 1: likely is 1, recorded 0\n");
    changed(&|cases| cases[5]["final"]["habituation"] = 7.into())
        .ended(1)
        .says("episode 6, after its last step: habituation is ");
    let all = |cases: &mut Value| {
        for step in cases[1]["steps"].as_array_mut().unwrap() {
            step["disengagement"] = (-1).into();
        }
    };
    changed(&all).ended(1).says("episode 2, step 9: ").says("\nand ");
    // Rounding a recording to ten digits makes no difference.
    let rounded = |cases: &mut Value| {
        let reward = &mut cases[0]["steps"][1]["reward"];
        *reward = (reward.as_f64().unwrap() * (1.0 + 1e-10)).into();
    };
    changed(&rounded).succeeded();
    // Values that are missing in the recording are not compared.
    let silent = |cases: &mut Value| {
        for case in cases.as_array_mut().unwrap() {
            case.as_object_mut().unwrap().remove("final");
            case["steps"][0].as_object_mut().unwrap().remove("inferred");
        }
    };
    changed(&silent).succeeded();
}

#[test]
fn faulty_trajectories_are_refused() {
    let folder = Folder::new();
    let text = include_str!("../data/golden_trajectories.json");
    let change = |change: fn(&mut Value)| {
        let mut recorded: Value = serde_json::from_str(text).unwrap();
        change(&mut recorded["cases"][1]);
        folder.write("changed.json", recorded.to_string());
        folder.jitai(["simulate", "--replay", "changed.json"]).ended(2)
    };
    change(|case| case["steps"][0]["action"] = 4.into())
        .says("episode 2, step 0: expected an action from 0 to 3, found 4");
    change(|case| case["steps"][1]["context"] = 2.into())
        .says("episode 2, step 1: expected `context` 0 or 1");
    change(|case| case["steps"][1]["p0"] = 1.5.into())
        .says("episode 2, step 1: expected `context` 0 or 1");
    change(|case| case["horizon"] = 1.into()).says("step 1 comes after the end");
    change(|case| case["horizon"] = "long".into()).says("changed.json");
    folder.write("changed.json", "{\"cases\": [");
    folder
        .jitai(["simulate", "--replay", "changed.json"])
        .ended(2)
        .says("changed.json: EOF")
        .says("; expected JSON like {\"cases\": [");
    folder.jitai(["simulate", "--replay", "none.json"]).ended(2).says("`none.json`");
    folder.jitai(["simulate", "--replay", "."]).ended(2).says("`.`");
    let both = ["simulate", "--replay", GOLDEN, "--policy", "tailored"];
    folder.jitai(both).ended(2).says("cannot be used with");
}
