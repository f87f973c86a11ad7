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

/// The action that suits the likely context.
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
    let matched = steps(&folder, &["--policy", "match", "--set", "sigma=0.8"]);
    assert!(matched.iter().all(|step| step["action"] == tailored(step)));
    assert_eq!(steps(&folder, &["--set", "sigma=0.8"]), matched, "it is the default");

    let careful = steps(&folder, &["--policy", "threshold:0.9", "--set", "sigma=0.8"]);
    for step in &careful {
        let p = step["probability_0"].as_f64().unwrap();
        let expected = if p.max(1.0 - p) >= 0.9 { tailored(step) } else { 0 };
        assert_eq!(step["action"], expected, "{step}");
    }
    assert!(actions(&careful).contains(&0));
}

#[test]
fn rewards_add_up_to_the_return() {
    let folder = Folder::new();
    let mut total = 0.0;
    for step in steps(&folder, &["--policy", "match"]) {
        total += step["reward"].as_f64().unwrap();
        assert!((step["return"].as_f64().unwrap() - total).abs() < 1e-9, "{step}");
    }
    let summary = steps(&folder, &["--policy", "match", "--summary"]);
    assert!((summary[0]["mean_return"].as_f64().unwrap() - total).abs() < 1e-9, "{summary:?}");
}

#[test]
fn settings_change_the_environment() {
    let folder = Folder::new();
    let settings = ["--set", "sigma=0", "--set", "horizon=7", "--set", "mu=[1, 1]"];
    let steps = steps(&folder, &[&["--policy", "fixed:0"][..], &settings[..]].concat());
    assert_eq!(steps.len(), 7);
    assert!(steps.iter().all(|step| step["reward"] == 1.0), "{steps:?}");
    // The first step shows 0.5 whatever the truth; after it nothing is uncertain.
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
    for form in ["sigma", "=1", "sigma=0.4\nhorizon=3", "\"horizon\"=3", "mu.x=3", "a b=1"] {
        set(form).says("is not NAME=VALUE");
    }
    let rules = "the rules are fixed:<action 0-3>, random, match, threshold:<0.5-1>, run:<job key>";
    for rule in ["fixed:4", "fixed", "threshold:0.2", "threshold:nan", "best", ""] {
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

    // Sixteen keys and sixteen digits: some digit begins two, or every digit begins one.
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
    policy(digit).ended(3).says(&format!("`{digit}` begins the keys of several completed jobs"));
    policy("0123456789abcdef").ended(3).says("no job's key begins with `0123456789abcdef`");
    policy("dqn").ended(3).says("`dqn` is not a job key");
    policy("").ended(3).says("is not a job key");
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
    folder.jitai(["simulate", "--policy", &policy]).ended(3).says("has no completed run");
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
            assert_eq!((&ours["case"], &ours["step"]), (&number.into(), &t.into()));
            assert_eq!(ours["action"], theirs["action"]);
            for name in ["habituation", "disengagement", "reward"] {
                let difference = ours[name].as_f64().unwrap() - theirs[name].as_f64().unwrap();
                assert!(difference.abs() <= 1e-12, "{name}: {ours} {theirs}");
            }
        }
    }
    assert!(rows.next().is_none());
    let (_, told) = replay.stderr.split_once("and reward: ").unwrap();
    let (largest, endings) = told.trim_end().split_once("; endings that differ: ").unwrap();
    assert!(largest.parse::<f64>().unwrap() < 1e-12, "{}", replay.stderr);
    assert_eq!(endings, "0");
    assert!(replay.stderr.starts_with("6 cases, 274 steps;"), "{}", replay.stderr);
}

#[test]
fn a_difference_from_the_recording_is_told() {
    let folder = Folder::new();
    let text = include_str!("../data/golden_trajectories.json");
    let mut recorded: Value = serde_json::from_str(text).unwrap();
    recorded["cases"][2]["steps"][3]["reward"] = 1e6.into();
    recorded["cases"][0]["disengaged"] =
        (!recorded["cases"][0]["disengaged"].as_bool().unwrap()).into();
    folder.write("changed.json", recorded.to_string());
    let replay = folder.jitai(["simulate", "--replay", "changed.json"]).succeeded();
    assert!(!replay.stderr.contains("0.0e0"), "{}", replay.stderr);
    replay.says("; endings that differ: 1");
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
    change(|case| case["steps"][0]["action"] = 4.into()).says("case 1: step 0: action 4");
    change(|case| case["steps"][1]["context"] = 2.into()).says("case 1: step 1: the context");
    change(|case| case["steps"][1]["p0"] = 1.5.into()).says("case 1: step 1: the context");
    change(|case| case["horizon"] = 1.into()).says("step 1 comes after the end");
    change(|case| case["horizon"] = "long".into()).says("changed.json");
    folder.write("changed.json", "{\"cases\": [");
    folder.jitai(["simulate", "--replay", "changed.json"]).ended(2).says("changed.json: EOF");
    folder.jitai(["simulate", "--replay", "none.json"]).ended(3).says("`none.json`");
    folder.jitai(["simulate", "--replay", "."]).ended(3);
    let both = ["simulate", "--replay", GOLDEN, "--policy", "match"];
    folder.jitai(both).ended(2).says("cannot be used with");
}
