//! `jitai decide`: actions of an exported bandit for a table of states, and what it learns from a log.

use sha2::{Digest, Sha256};

use crate::support::Folder;

/// A bandit that never learned in its trial, with its policy beside one that learned.
fn folder(agent: &str) -> Folder {
    let trial = |name: &str, every: u32, people: u32| {
        format!(
            "format = 1\nname = \"{name}\"\nscenarios = [\"C-H\"]\nseeds = [3]\nenvironment.sigma = 0.4\n\
             environment.horizon = 8\ntrial = {{ people = {people}, days = 8, update_every_days = {every} }}\n\
             evaluation = {{ on = \"trial\", record_decisions = \"test\" }}\n[[agent]]\nname = \"a\"\n\
             algorithm = \"linear_thompson\"\nnoise_sd = 40.0\npi_min = 0.05\n{agent}\n"
        )
    };
    let folder = Folder::completed(&trial("t", 0, 6));
    let key =
        folder.jitai(["query", "SELECT job_key FROM run_summary", "--format", "csv"]).succeeded();
    let key = key.stdout.lines().nth(1).unwrap().to_owned();
    folder.jitai(["export", "--policy", &key, "--out", "learned"]).succeeded();
    // The same agent before any data: a policy whose posterior is the prior.
    let mut about: serde_json::Value =
        serde_json::from_str(&folder.read("learned/policy.json")).unwrap();
    for matrix in about["posterior"]["precision"].as_array_mut().unwrap() {
        for (row, numbers) in matrix.as_array_mut().unwrap().iter_mut().enumerate() {
            for (column, number) in numbers.as_array_mut().unwrap().iter_mut().enumerate() {
                *number = if row == column { 0.01.into() } else { 0.0.into() };
            }
        }
    }
    for mean in about["posterior"]["mean"].as_array_mut().unwrap() {
        mean.as_array_mut().unwrap().iter_mut().for_each(|number| *number = 0.0.into());
    }
    folder.write("prior.json", about.to_string());
    let sql = "SELECT json_extract(state, '$.context') AS C, json_extract(state, '$.habituation') AS H, action, reward,
        json_extract(action_probabilities, '$[1]') AS probability_1, json_extract(action_probabilities, '$[2]') AS probability_2,
        json_extract(action_probabilities, '$[3]') AS probability_3 FROM decision ORDER BY episode, step";
    let log = folder.jitai(["query", sql, "--format", "csv"]).succeeded();
    folder.write("log.csv", log.stdout);
    folder
}

fn numbers(folder: &Folder, file: &str, pointer: &str) -> Vec<f64> {
    let about: serde_json::Value = serde_json::from_str(&folder.read(file)).unwrap();
    fn collect(value: &serde_json::Value, out: &mut Vec<f64>) {
        match value {
            serde_json::Value::Array(list) => list.iter().for_each(|one| collect(one, out)),
            other => out.extend(other.as_f64()),
        }
    }
    let mut out = Vec::new();
    collect(about.pointer(pointer).unwrap(), &mut out);
    out
}

#[test]
fn a_log_teaches_what_the_trial_has_learned() {
    for agent in ["", "action_centring = true"] {
        let folder = folder(agent);
        folder
            .jitai([
                "decide",
                "--policy",
                "prior.json",
                "--data",
                "log.csv",
                "--update",
                "new.json",
            ])
            .succeeded();
        for of in ["/posterior/precision", "/posterior/mean"] {
            let (ours, theirs) =
                (numbers(&folder, "new.json", of), numbers(&folder, "learned/policy.json", of));
            assert_eq!(ours.len(), theirs.len());
            let scale = theirs.iter().fold(0.0_f64, |most, one| most.max(one.abs()));
            for (one, other) in ours.iter().zip(&theirs) {
                assert!((one - other).abs() < 1e-9 * scale, "{agent}, {of}: {one}, {other}");
            }
        }
        let rows = folder.read("log.csv").lines().count() as f64 - 1.0;
        assert_eq!(numbers(&folder, "new.json", "/updated/0/decisions"), [rows]);
    }
}

#[test]
fn decisions_are_drawn_at_their_places() {
    let folder = folder("");
    folder.write("states.csv", "H,C\n0.1,0\n0.3,1\n0.2,1\n");
    let decide = ["decide", "--policy", "learned/policy.json", "--data", "states.csv"];
    let all = folder.jitai(decide).succeeded().stdout;
    let lines: Vec<&str> = all.lines().collect();
    assert_eq!(
        lines[0],
        "H,C,row,probability_0,probability_1,probability_2,probability_3,action,place"
    );
    for (row, line) in lines[1..].iter().enumerate() {
        let fields = numbers_of(line);
        assert!((fields[3..7].iter().sum::<f64>() - 1.0).abs() < 1e-12);
        assert!(fields[3..7].iter().all(|p| *p >= 0.05 - 1e-12));
        assert_eq!((fields[2], fields[8]), (row as f64 + 1.0, row as f64));
    }
    // Another call draws at the next place what one call would have drawn.
    folder.write("states.csv", "C,H\n1,0.2\n");
    let last = folder.jitai(decide.into_iter().chain(["--place", "2"])).succeeded().stdout;
    assert_eq!(numbers_of(last.lines().nth(1).unwrap())[3..], numbers_of(lines[3])[3..]);
    // So does a policy that says where the next decisions begin.
    let mut about: serde_json::Value =
        serde_json::from_str(&folder.read("learned/policy.json")).unwrap();
    about["place"] = 2.into();
    folder.write("moved.json", about.to_string());
    let moved = ["decide", "--policy", "moved.json", "--data", "states.csv"];
    assert_eq!(folder.jitai(moved).succeeded().stdout, last);
    let first = moved.into_iter().chain(["--place", "0"]);
    assert!(folder.jitai(first).succeeded().stdout.ends_with(",0\n"));
    about["place"] = (-1).into();
    folder.write("moved.json", about.to_string());
    folder.jitai(moved).ended(2).says("its `place` is -1, expected a whole number from 0");
}

fn numbers_of(line: &str) -> Vec<f64> {
    line.split(',').map(|field| field.parse().unwrap()).collect()
}

fn update<'a>(policy: &'a str, log: &'a str, new: &'a str) -> [&'a str; 7] {
    ["decide", "--policy", policy, "--data", log, "--update", new]
}

#[test]
fn an_unavailable_person_gets_action_0_at_a_place_of_the_stream() {
    let folder = folder("");
    let decide = ["decide", "--policy", "learned/policy.json", "--data", "states.csv"];
    let states = |flags: [u8; 3]| {
        let [first, second, third] = flags;
        folder.write(
            "states.csv",
            format!("C,H,available\n1,0.1,{first}\n0,0.3,{second}\n1,0.2,{third}\n"),
        );
        let out = folder.jitai(decide).succeeded().stdout;
        out.lines().skip(1).map(|line| numbers_of(line)[3..].to_vec()).collect::<Vec<_>>()
    };
    let (all, some) = (states([1, 1, 1]), states([1, 0, 1]));
    assert_eq!((&all[0], &all[2]), (&some[0], &some[2]));
    assert_eq!(some[1], [2.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
    folder.write("states.csv", "C,H,available\n1,0.1,1\n0,0.3,2\n");
    folder.jitai(decide).ended(2).says("states.csv: line 3: `available` is 2, expected");
    folder.write("states.csv", "C,H,available\n1,0.1,\n");
    folder.jitai(decide).ended(2).says("states.csv: line 2: column `available` is empty");
}

#[test]
fn rows_that_a_replay_leaves_out_teach_nothing() {
    let folder = folder("action_centring = true");
    let header = "C,H,action,reward,probability_1,probability_2,probability_3";
    folder.write("plain.csv", format!("{header}\n1,0.5,1,60,0.25,0.25,0.25\n"));
    folder.jitai(update("prior.json", "plain.csv", "plain.json")).succeeded();
    let rows = [
        "1,0.5,1,60,0.25,0.25,0.25,1,1",
        // Without availability, an action is 0, whose probabilities are not read.
        "1,0.5,0,90,7,,,0,1",
        "0,0.5,,,,,,0,0",
        "0,0.5,2,90,0.25,0.25,0.25,1,0",
        "0,0.5,2,NA,0.25,0.25,0.25,1,1",
        "0,0.5,,90,0.25,0.25,0.25,1,1",
        "0,0.5,2,90,,0.25,0.25,1,1",
    ];
    let flags = format!("{header},available,reached\n");
    folder.write("log.csv", format!("{flags}{}\n", rows.join("\n")));
    folder.jitai(update("prior.json", "log.csv", "new.json")).succeeded().says(
        "note: log.csv: 1 of 7 rows teach the policy; 2 with `available` 0; 1 with `reached` 0; 1 without `action`; \
         1 without `reward`; 1 without a probability",
    );
    for of in ["/posterior/precision", "/posterior/mean"] {
        assert_eq!(numbers(&folder, "new.json", of), numbers(&folder, "plain.json", of));
    }
    assert_eq!(numbers(&folder, "new.json", "/updated/0/decisions"), [1.0]);
    for (row, says) in [
        ("1,0.5,1,60,0.25,0.25,0.25,0,1", "line 2: action 1 where `available` is 0"),
        ("1,0.5,1,60,0.25,0.25,0.25,1,0.5", "line 2: `reached` is 0.5, expected"),
        ("1,,0,60,0.25,0.25,0.25,0,1", "line 2: column `H` is empty"),
    ] {
        folder.write("log.csv", format!("{flags}{row}\n"));
        folder.jitai(update("prior.json", "log.csv", "bad.json")).ended(2).says(says);
        assert!(!folder.path("bad.json").exists());
    }
    folder.write("log.csv", "C,H,action,probability_1,probability_2,probability_3\n");
    let refused = folder.jitai(update("prior.json", "log.csv", "bad.json")).ended(2);
    refused.says("there is no column `reward`");
}

#[test]
fn numbers_outside_of_their_range_are_noted() {
    let folder = folder("");
    folder.write("states.csv", "C,H\n1,0.5\n1,7\n0,8\n");
    let decide = ["decide", "--policy", "learned/policy.json", "--data", "states.csv"];
    let noted = folder.jitai(decide).succeeded();
    assert_eq!(noted.stdout.lines().count(), 4);
    assert_eq!(
        noted.stderr,
        "note: states.csv: line 3: `H` is 7, outside of its range 0 to 1; rows like this: 2\n"
    );
}

#[test]
fn an_update_says_where_the_next_decisions_begin() {
    let folder = folder("");
    let log = |name: &str, rows: &[&str]| {
        folder.write(name, format!("C,H,action,reward,place\n{}\n", rows.join("\n")));
    };
    // Without the column, every row has had a place.
    folder.jitai(update("prior.json", "log.csv", "a.json")).succeeded();
    let rows = folder.read("log.csv").lines().count() as f64 - 1.0;
    assert_eq!(numbers(&folder, "a.json", "/place"), [rows]);
    // With it, decisions begin after the last place, and never before those of the policy.
    log("b.csv", &["1,0.5,0,1,1007", "1,0.5,0,1,1009", "1,0.5,0,1,"]);
    folder.jitai(update("a.json", "b.csv", "b.json")).succeeded();
    assert_eq!(numbers(&folder, "b.json", "/place"), [1010.0]);
    log("c.csv", &["1,0.5,0,1,3"]);
    folder.jitai(update("b.json", "c.csv", "c.json")).succeeded();
    assert_eq!(numbers(&folder, "c.json", "/place"), [1010.0]);
    folder.write("states.csv", "C,H\n1,0.5\n");
    folder
        .jitai(["decide", "--policy", "c.json", "--data", "states.csv"])
        .succeeded()
        .prints(",1010\n");
    log("d.csv", &["1,0.5,0,1,3", "1,0.5,0,1,1.5"]);
    let refused = folder.jitai(update("c.json", "d.csv", "d.json")).ended(2);
    refused.says("d.csv: line 3: `place` is 1.5, expected a whole number from 0");
}

#[test]
fn a_table_without_rows_has_no_decisions_and_teaches_nothing() {
    let folder = folder("");
    folder.write("states.csv", "day,C,H\n");
    let decide = ["decide", "--policy", "learned/policy.json", "--data", "states.csv"];
    let header =
        "day,C,H,row,probability_0,probability_1,probability_2,probability_3,action,place\n";
    assert_eq!(folder.jitai(decide).succeeded().stdout, header);
    folder.write("states.csv", "day,C\n");
    folder.jitai(decide).ended(2).says("there is no column `H`");
    folder.write("log.csv", "C,H,action,reward\n");
    let none = folder.jitai(update("learned/policy.json", "log.csv", "new.json")).succeeded();
    none.says("note: log.csv: 0 of 0 rows teach the policy");
    assert_eq!(folder.read("new.json"), folder.read("learned/policy.json"));
    // Another day without rows is no fault.
    folder.jitai(update("new.json", "log.csv", "next.json")).succeeded();
}

#[test]
fn decisions_keep_the_columns_of_the_states_and_become_a_log() {
    let folder = folder("action_centring = true");
    folder.write(
        "states.csv",
        "person,C,action,H,\"day, hour\"\n\"Lee, Ann\",1,x,0.5,2024-05-01\n=Jörg,0,y,0.25,\n",
    );
    let decide = ["decide", "--policy", "learned/policy.json", "--data", "states.csv"];
    let out = folder.jitai(decide).succeeded().stdout;
    let lines: Vec<&str> = out.lines().collect();
    // The action of the decisions stands in the place of another.
    let header = "person,C,H,\"day, hour\",row,probability_0,probability_1,probability_2,probability_3,action,place";
    assert_eq!(lines[0], header);
    assert!(lines[1].starts_with("\"Lee, Ann\",1,0.5,2024-05-01,1,"), "{out}");
    assert!(lines[2].starts_with("=Jörg,0,0.25,,2,"), "{out}");
    // With a column of rewards, the decisions are a log.
    let log = format!("{},reward\n{},60\n{},80\n", lines[0], lines[1], lines[2]);
    folder.write("log.csv", log);
    folder.jitai(update("learned/policy.json", "log.csv", "new.json")).succeeded();
    assert_eq!(numbers(&folder, "new.json", "/place"), [2.0]);
    assert_eq!(numbers(&folder, "new.json", "/updated/0/decisions"), [2.0]);
}

#[test]
fn an_update_writes_a_new_file_alone() {
    let folder = folder("");
    let before = folder.read("prior.json");
    let refused = folder.jitai(update("prior.json", "log.csv", "prior.json")).ended(2);
    refused.says("--update: `prior.json` already exists; name a new file");
    assert_eq!(folder.read("prior.json"), before);
}

#[test]
fn faults_of_a_table_and_of_a_policy_are_sentences() {
    let folder = folder("");
    folder.write("states.csv", "C,H\n1,\nx,0.5\n");
    let decide = ["decide", "--policy", "learned/policy.json", "--data", "states.csv"];
    folder.jitai(decide).ended(2).says("line 3: column `C` has `x`, expected a number");
    folder.write("states.csv", "C,H\n1,\n0,0.5\n");
    folder.jitai(decide).ended(2).says("line 2: column `H` is empty");
    folder.write("states.csv", "C,Ha\n1,2\n");
    folder.jitai(decide).ended(2).says("there is no column `H`; did you mean `Ha`?");
    folder.write("states.csv", "C,H\n,0.5\n");
    let first = folder.jitai(decide).ended(2).says("line 2: column `C` is empty");
    assert!(!first.stderr.contains("person"), "{}", first.stderr);
    folder.write("states.csv", "C,H\n1,-1e200\n");
    folder.jitai(decide).ended(2).says("line 2: `H` is -1e200, above 1e30 in size");
    folder.write("log.csv", "C,H,action,reward\n1,0.5,7,1\n");
    folder
        .jitai(["decide", "--policy", "prior.json", "--data", "log.csv", "--update", "new.json"])
        .ended(2)
        .says("line 2: `action` is 7, expected a whole number from 0 to 3");
    folder.write("prior.json", "{}");
    folder
        .jitai(["decide", "--policy", "prior.json", "--data", "log.csv"])
        .ended(2)
        .says("`prior.json`: its `job` cannot be read");
    folder
        .jitai(["decide", "--policy", "log.csv", "--data", "log.csv"])
        .ended(2)
        .says("`log.csv`: this is no policy.json of `jitai export --policy`");
}

#[test]
fn a_log_needs_probabilities_with_which_its_actions_were_taken() {
    let folder = folder("action_centring = true");
    let update = ["decide", "--policy", "prior.json", "--data", "log.csv", "--update", "new.json"];
    for (row, says) in [
        ("1,7,0,0", "`probability_1` is 7, expected a number from 0 to 1"),
        ("1,0.5,-0.1,0", "`probability_2` is -0.1, expected a number from 0 to 1"),
        ("1,0.5,0.5,0.25", "the probabilities of the messages add to 1.25, above 1"),
        ("3,0.5,0.25,0", "action 3 was taken with the probability 0"),
        ("0,0.5,0.25,0.25", "action 0 was taken with the probability 0"),
    ] {
        let header = "C,H,action,reward,probability_1,probability_2,probability_3";
        let (action, chances) = row.split_once(',').unwrap();
        let rows = format!("{header}\n1,0.5,0,1,0.25,0.25,0.25\n1,0.5,{action},1,{chances}\n");
        folder.write("log.csv", rows);
        folder.jitai(update).ended(2).says(&format!("log.csv: line 3: {says}"));
        assert!(!folder.path("new.json").exists());
    }
}

#[test]
fn a_log_is_learned_from_once_and_files_are_named_by_their_bytes() {
    let folder = folder("");
    // Written by hand: the number of actions, and the covariance.
    let mut about: serde_json::Value = serde_json::from_str(&folder.read("prior.json")).unwrap();
    about["actions"] = 4.into();
    about["posterior"]["covariance"] = about["posterior"]["precision"].take();
    about["posterior"].as_object_mut().unwrap().remove("precision");
    folder.write("policy.json", format!("{about:#}"));
    let earlier = Sha256::digest(folder.read("policy.json"));
    let earlier: String = earlier.iter().map(|byte| format!("{byte:02x}")).collect();
    folder.jitai(update("policy.json", "log.csv", "once.json")).succeeded();
    assert!(!folder.path("once.partial").exists() && !folder.path("once.json.partial").exists());
    let learned: serde_json::Value = serde_json::from_str(&folder.read("once.json")).unwrap();
    assert_eq!(learned["updated"][0]["policy_sha256"], serde_json::json!(earlier));
    let again = update("once.json", "log.csv", "again.json");
    folder.jitai(again).ended(2).says("`log.csv`: this log is already in the policy");
    assert!(!folder.path("again.json").exists());
    // Another log is added to the list, and the first one is still known.
    let log = folder.read("log.csv");
    folder
        .write("log.csv", log.lines().take(4).map(|line| format!("{line}\n")).collect::<String>());
    folder.jitai(update("once.json", "log.csv", "twice.json")).succeeded();
    assert_eq!(numbers(&folder, "twice.json", "/updated/1/decisions"), [3.0]);
    folder.write("log.csv", &log);
    let again = update("twice.json", "log.csv", "again.json");
    folder.jitai(again).ended(2).says("this log is already in the policy");
}

#[test]
fn columns_that_decisions_have_are_no_features_and_learned_places_are_noted() {
    let folder = folder("");
    folder.write("states.csv", "C,H,Avail\n1,0.5,0\n");
    let decide = ["decide", "--policy", "learned/policy.json", "--data", "states.csv"];
    let noted = folder.jitai(decide).succeeded();
    assert_eq!(
        noted.stderr,
        "note: states.csv: column `Avail` is not read; a column `available` would be\n"
    );
    let mut about: serde_json::Value =
        serde_json::from_str(&folder.read("learned/policy.json")).unwrap();
    about["place"] = 5.into();
    folder.write("moved.json", about.to_string());
    folder.write("log.csv", "C,H,action,reward,place\n1,0.5,0,1,4\n1,0.5,0,1,5\n");
    let noted = folder.jitai(update("moved.json", "log.csv", "new.json")).succeeded();
    assert!(
        noted
            .stderr
            .contains("rows with a place before 5, where the policy's next decisions begin: 1;"),
        "{}",
        noted.stderr
    );
    about["updated"] = serde_json::json!({ "decisions": 1 });
    folder.write("moved.json", about.to_string());
    folder
        .jitai(update("moved.json", "log.csv", "newer.json"))
        .ended(2)
        .says("its `updated` is no list of logs");
    let renamed =
        folder.read("learned/policy.json").replace("\"name\": \"H\"", "\"name\": \"place\"");
    folder.write("renamed.json", renamed);
    let refused =
        folder.jitai(["decide", "--policy", "renamed.json", "--data", "states.csv"]).ended(2);
    refused.says("its feature `place` has the name of a column");
}
