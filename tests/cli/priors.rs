//! Bandits that start from the posterior of an earlier job.

use std::collections::BTreeMap;
use std::fs;

use crate::support::Folder;

const PEOPLE: &str = include_str!("../../experiments/oralytics/synthetic_v2.csv");

/// A pilot of people one after the other, with a bandit and an agent that has no posterior.
const PILOT: &str = r#"format = 1
name = "pilot"
scenarios = ["C-H-D"]
seeds = 1
environment = { sigma = 0.4, horizon = 10 }
evaluation = { test_episodes = 20, record_decisions = "all" }
[[agent]]
name = "thompson"
algorithm = "linear_thompson"
episodes = 20
noise_sd = 400
prior_sd = 100
[[agent]]
name = "dqn"
algorithm = "dueling_dqn"
episodes = 3
"#;

/// A trial with features that are 0 or 1, with an agent for everybody and an agent for each person.
const TRIAL: &str = r#"format = 1
name = "trial"
scenarios = [["time_of_day", "app"]]
seeds = 1
[trial]
people = 6
days = 8
decisions_per_day = 2
update = { every_days = 2 }
pooling = ["full", "none"]
[environment]
family = "declared"
model = "oralytics_v2"
people = "people.csv"
days = 8
[evaluation]
on = "trial"
record_decisions = "test"
[[agent]]
name = "thompson"
algorithm = "linear_thompson"
action_centring = true
allocation = "logistic"
logistic_slope = 0.05
noise_sd = 60
"#;

/// A manifest with another name, and this prior of its bandit.
fn next(of: &str, prior: &str) -> String {
    let named = of.replacen("name = \"", "name = \"next-", 1).replace("prior_sd = 100\n", "");
    let bandit = "algorithm = \"linear_thompson\"\n";
    let text = named.replacen(bandit, &format!("{bandit}prior_from = {prior:?}\n"), 1);
    text.split("[[agent]]\nname = \"dqn\"").next().unwrap().to_owned()
}

fn key(folder: &Folder, which: &str) -> String {
    let sql = format!(
        "SELECT DISTINCT job_key FROM run_summary JOIN parameter USING (job_key) WHERE {which}"
    );
    folder.store().query_row(&sql, [], |row| row.get(0)).unwrap()
}

/// The probabilities of all actions by state, in decisions that meet a condition; equal states have equal
/// probabilities.
fn by_state(folder: &Folder, state: &str, which: &str) -> BTreeMap<String, Vec<f64>> {
    let sql = format!(
        "SELECT {state}, min(action_probabilities), max(action_probabilities) FROM decision \
         JOIN run_summary USING (job_key) WHERE {which} GROUP BY 1"
    );
    let store = folder.store();
    let mut rows = store.prepare(&sql).unwrap();
    let rows = rows.query_map([], |row| {
        let [state, least, most]: [String; 3] = [row.get(0)?, row.get(1)?, row.get(2)?];
        assert_eq!(least, most, "{state}");
        Ok((state, serde_json::from_str(&least).unwrap()))
    });
    rows.unwrap().collect::<Result<_, _>>().unwrap()
}

/// Asserts that states in both have equal probabilities, and that there are some.
#[track_caller]
fn assert_close(ours: &BTreeMap<String, Vec<f64>>, theirs: &BTreeMap<String, Vec<f64>>) {
    let both = ours.iter().filter_map(|(state, row)| Some((row, theirs.get(state)?)));
    assert!(both.clone().next().is_some(), "{ours:?} {theirs:?}");
    for (row, other) in both {
        assert!(row.iter().zip(other).all(|(p, q)| (p - q).abs() < 1e-9), "{row:?} {other:?}");
    }
}

#[test]
fn the_race_of_a_manifest_that_names_a_run_and_a_file_is_listed_from_any_folder() {
    let folder = Folder::with(PILOT);
    folder.jitai(["run", "sweep.toml"]).succeeded();
    let pilot = key(&folder, "agent = 'thompson'");
    let race = next(PILOT, &format!("run:{pilot}"))
        .replace("seeds = 1\n", "")
        .replace("noise_sd = 400", "noise_sd = { uniform = [300, 500] }")
        .replace(
            "[[agent]]",
            "[search]\nsamples = 2\nrungs = [1, 2]\nkeep = 0.5\nfresh = 1\n[[agent]]",
        )
        .replace("evaluation", "population = { rows = \"people.csv\" }\nevaluation");
    fs::create_dir(folder.path("studies")).unwrap();
    folder.write("studies/race.toml", race);
    folder.write("studies/people.csv", "delta_d,epsilon_d\n0.05,0.6\n0.15,0.2\n");
    folder.jitai(["run", "studies/race.toml"]).succeeded();
    let mut elsewhere = folder.command(["status", "--format", "json"]);
    elsewhere.env("JITAI_STORE", folder.path("jitai.sqlite")).current_dir(folder.path("studies"));
    let elsewhere = elsewhere.output().unwrap().stdout;
    let here = folder.jitai(["status", "--format", "json"]).succeeded();
    assert_eq!(here.stdout, String::from_utf8(elsewhere).unwrap());
    let races = &here.json()[1]["races"];
    assert_eq!((&races[0]["rungs"], &races[0]["arms"]), (&2.into(), &2.into()), "{races}");
}

#[test]
fn a_job_begins_where_an_earlier_job_ended_and_is_known_by_the_posterior() {
    let folder = Folder::with(PILOT);
    folder.jitai(["run", "sweep.toml"]).succeeded();
    let pilot = key(&folder, "agent = 'thompson'");
    folder.jitai(["export", "--policy", &pilot, "--out", "pilot"]).succeeded();
    folder.write("run.toml", next(PILOT, &format!("run:{}", &pilot[..6])));
    folder.write("file.toml", next(PILOT, "pilot/policy.json"));
    folder.jitai(["check", "run.toml"]).succeeded();
    folder.jitai(["run", "run.toml"]).succeeded();
    assert_eq!(folder.runs(), 3);
    // The file, and the text in a manifest that is written out, are the same job.
    folder.jitai(["run", "file.toml"]).succeeded();
    let resolved = folder.jitai(["plan", "--resolved", "run.toml"]).succeeded().stdout;
    folder.write("resolved.toml", resolved);
    folder.jitai(["run", "resolved.toml"]).succeeded();
    // What a policy says of its own use is no part of its posterior.
    let mut about: serde_json::Value =
        serde_json::from_str(&folder.read("pilot/policy.json")).unwrap();
    (about["place"], about["updated"]) = (7.into(), serde_json::json!([{ "decisions": 3 }]));
    folder.write("pilot/policy.json", about.to_string());
    folder.jitai(["run", "file.toml"]).succeeded();
    let set = format!("agent.prior_from=run:{pilot}");
    folder.write("none.toml", next(PILOT, "none"));
    folder.jitai(["run", "none.toml", "--set", &set]).succeeded();
    assert_eq!(folder.runs(), 3);
    // Everybody begins in the same state.
    let start = |which: &str| {
        let which = format!("{which} AND phase = 'test' AND step = 0 AND agent = 'thompson'");
        by_state(&folder, "CAST(context AS TEXT)", &which)
    };
    let ended = start("experiment = 'pilot'");
    let which = "experiment = 'next-pilot' AND phase = 'train' AND episode = 1 AND step = 0";
    let begun = by_state(&folder, "CAST(context AS TEXT)", which);
    assert_close(&begun, &ended);
    assert!(begun.values().flatten().all(|p| (1e-6..0.99).contains(p)), "{begun:?}");
    assert_ne!(start("experiment = 'next-pilot'"), ended);
}

#[test]
fn a_trial_begins_with_the_posterior_of_a_pooled_trial() {
    let folder = Folder::new();
    folder.write("people.csv", PEOPLE);
    folder.write("trial.toml", TRIAL);
    folder.jitai(["run", "trial.toml"]).succeeded();
    let pooled = |which: &str| format!("name = 'trial.pooling' AND value = '{which}'");
    let (full, none) = (key(&folder, &pooled("full")), key(&folder, &pooled("none")));
    folder.write("next.toml", next(TRIAL, &format!("run:{full}")));
    folder.jitai(["run", "next.toml"]).succeeded();
    let state = "printf('%d%d', step % 2, json_extract(state, '$.app_before'))";
    // The same people for two more days: the update on day 8 has the data of the whole shorter trial.
    let longer = TRIAL.replace("days = 8", "days = 10").replacen("trial", "longer", 1);
    folder.write("longer.toml", longer);
    folder.jitai(["run", "longer.toml"]).succeeded();
    let longer = key(&folder, &format!("experiment = 'longer' AND {}", pooled("full")));
    let ended = format!("job_key = '{longer}' AND json_extract(state, '$.policy') = 4");
    let ended = by_state(&folder, state, &ended);
    for pooling in ["full", "none"] {
        let next = key(&folder, &format!("experiment = 'next-trial' AND {}", pooled(pooling)));
        let begun = format!("job_key = '{next}' AND json_extract(state, '$.policy') = 0");
        let begun = by_state(&folder, state, &begun);
        assert_close(&begun, &ended);
        // The prior of an agent that knows nothing gives one half.
        assert!(begun.values().any(|row| (row[1] - 0.5).abs() > 1e-2), "{begun:?}");
    }
    let says = "no stored policy: in its trial, each person has an agent (`pooling = \"none\"`)";
    folder.jitai(["export", "--policy", &none, "--out", "pilot"]).ended(2).says(says);
    folder.write("next.toml", next(TRIAL, &format!("run:{none}")));
    folder.jitai(["check", "next.toml"]).ended(2).says(says);
}

#[test]
fn a_job_that_stores_metrics_alone_has_no_policy_and_says_why() {
    let recorded = "record_decisions = \"all\"";
    let folder = Folder::completed(&PILOT.replace(recorded, "record_episodes = \"none\""));
    let says = "has no stored policy: it stores metrics alone (`record_episodes = \"none\"`)";
    for agent in ["thompson", "dqn"] {
        let key = key(&folder, &format!("agent = '{agent}'"));
        folder.jitai(["export", "--policy", &key, "--out", "policy"]).ended(2).says(says);
        folder.jitai(["simulate", "--policy", &format!("run:{key}")]).ended(2).says(says);
    }
    let pilot = key(&folder, "agent = 'thompson'");
    folder.write("next.toml", next(PILOT, &format!("run:{pilot}")));
    folder.jitai(["check", "next.toml"]).ended(2).says("next.toml").says(says);
    folder.jitai(["doctor"]).succeeded();
    // Without its weights, a job that has some is damaged, as `jitai doctor` finds.
    let folder = Folder::completed(PILOT);
    let dqn = key(&folder, "agent = 'dqn'");
    let raw = rusqlite::Connection::open(folder.path("jitai.sqlite")).unwrap();
    let trigger = "SELECT sql FROM sqlite_schema WHERE name = 'trained_weights_stay'";
    let trigger: String = raw.query_row(trigger, [], |row| row.get(0)).unwrap();
    let delete = "DROP TRIGGER trained_weights_stay; DELETE FROM trained_weights";
    raw.execute_batch(&format!("{delete}; {trigger}")).unwrap();
    drop(raw);
    let says = "lacks its weights: the store is damaged";
    folder.jitai(["export", "--policy", &dqn, "--out", "policy"]).ended(2).says(says);
    folder.jitai(["simulate", "--policy", &format!("run:{dqn}")]).ended(2).says(says);
    let found = folder.jitai(["doctor"]).ended(3).stdout;
    assert!(found.contains("do not match their digest"), "{found}");
}

#[test]
fn a_prior_that_an_agent_cannot_have_is_refused_with_its_place() {
    let folder = Folder::completed(PILOT);
    let pilot = format!("run:{}", key(&folder, "agent = 'thompson'"));
    let dqn = key(&folder, "agent = 'dqn'");
    folder.jitai(["export", "--policy", &dqn, "--out", "network"]).succeeded();
    let refused = |text: &str, arguments: &[&str], expected: &str| {
        folder.write("next.toml", text);
        let check = ["check", "next.toml"].iter().chain(arguments).copied();
        folder.jitai(check).ended(2).says("next.toml").says(expected);
    };
    for (prior, expected) in [
        (pilot.replace("run:", "run:zz"), "is not a job key"),
        ("run:00000000".to_owned(), "no job key begins with `00000000`"),
        (format!("run:{dqn}"), "has no posterior: its agent has the algorithm `dueling_dqn`"),
        ("network/policy.json".to_owned(), "it has no `posterior`"),
        ("other.json".to_owned(), "`other.json` cannot be read"),
    ] {
        refused(&next(PILOT, &prior), &[], expected);
    }
    let whole = next(PILOT, &pilot);
    refused(&whole, &["--store", "other.sqlite"], "there is no store at");
    refused(
        &whole.replace("C-H-D", "C-H"),
        &[],
        "does not suit an environment with the features C, H and 4 actions: it is of the features C, H, D and 4 actions",
    );
    for (set, expected) in [
        ("prior_sd=30", "`prior_from` is the whole prior, and `prior_sd` is given, too"),
        ("baseline_means=[1, 2, 3, 4]", "`baseline_means` is given, too"),
        (
            "features=interactions",
            "the posterior of `prior_from` has features = \"linear\", and this agent has features = \"interactions\"",
        ),
        (
            "action_centring=true",
            "the posterior of `prior_from` has action_centring = false, and this agent has action_centring = true",
        ),
    ] {
        let set = format!("agent.{set}");
        refused(&whole, &["--set", "agent.pi_min=0.05", "--set", &set], expected);
    }
}
