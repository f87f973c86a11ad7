//! Names that people write, or that are meant to do harm, go through every surface whole.

use std::fs;

use crate::support::{Folder, Running};

const EXPERIMENT: &str = "<script>alert(\"1\")</script>, ${HOME} %s";
const AGENTS: [&str; 4] =
    ["=cmd('|/C calc')!A0", "a\"b,c; d'e", "עברית 学 ❤\u{fe0f}", "\\u{202e}`[x"];

fn odd() -> String {
    let agents = AGENTS.iter().zip(10..).map(|(name, episodes)| {
        format!(
            "[[agent]]\nname = {}\nalgorithm = \"reinforce\"\nepisodes = {episodes}\nlayers = [8]\n",
            serde_json::json!(name)
        )
    });
    format!(
        "format = 1\nname = {}\nscenarios = [\"P-H-D\"]\nseeds = 1\nenvironment.sigma = 0.6\n\
         evaluation.test_episodes = 5\n{}",
        serde_json::json!(EXPERIMENT),
        agents.collect::<String>()
    )
}

/// Asserts that a text cannot move the cursor, turn a line around or break it.
#[track_caller]
fn assert_plain(text: &str) {
    let directed = |c| matches!(c, '\u{61c}' | '\u{200e}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    let harmful = |c: &char| (c.is_control() && *c != '\n') || directed(*c);
    assert_eq!(text.chars().find(harmful), None, "{text}");
}

#[track_caller]
fn on_the_terminal(run: Running) -> String {
    let finished = run.wait().succeeded();
    assert_plain(&finished.stdout);
    assert_plain(&finished.stderr);
    finished.stdout + &finished.stderr
}

#[test]
fn names_are_shown_without_what_a_terminal_would_obey() {
    let folder = Folder::with(&odd());
    let run = on_the_terminal(folder.start(["run", "sweep.toml"]));
    assert!(run.contains("%s") && run.contains("עברית 学 ❤"), "{run}");
    let status = on_the_terminal(folder.start(["status"]));
    assert_eq!(status.lines().count(), 2, "{status}");
    let plan = on_the_terminal(folder.start(["plan", "sweep.toml", "--jobs"]));
    assert_eq!(plan.lines().count(), 1 + AGENTS.len(), "{plan}");
    let query = "SELECT experiment, agent FROM run_summary";
    let query = on_the_terminal(folder.start(["query", query]));
    assert_eq!(query.lines().count(), 1 + AGENTS.len(), "{query}");
    assert!(query.contains("=cmd('|/C calc')!A0"), "{query}");
    on_the_terminal(folder.start(["plan", "sweep.toml"]));
    let nowhere = ["plan", "sweep.toml", "--filter", "agent=\u{202e}nobody\u{1b}[31m"];
    let refused = folder.jitai(nowhere).ended(2);
    assert_plain(&refused.stderr);
    refused.says("no job has agent=\\u{202e}nobody\\u{1b}[31m; its values: =cmd(");
}

#[test]
fn programs_read_names_back_as_they_were_written() {
    let folder = Folder::completed(&odd());
    let query = "SELECT experiment, agent FROM run_summary ORDER BY agent";
    let mut agents = AGENTS;
    agents.sort_unstable();
    let expected: Vec<_> = agents.iter().map(|agent| vec![EXPERIMENT, agent]).collect();

    let csv = folder.jitai(["query", "--format", "csv", query]).succeeded().stdout;
    let records = csv::Reader::from_reader(csv.as_bytes()).into_records();
    let records: Vec<_> = records.map(Result::unwrap).collect();
    assert_eq!(records, expected);

    let json = folder.jitai(["query", "--format", "json", query]).succeeded().json();
    for (row, names) in json.as_array().unwrap().iter().zip(&expected) {
        assert_eq!(
            [&row["experiment"], &row["agent"]].map(|name| name.as_str().unwrap()),
            names[..]
        );
    }
    assert_eq!(json.as_array().unwrap().len(), expected.len());

    folder.jitai(["export", "--out", "out"]).succeeded();
    let mut exported = csv::Reader::from_path(folder.path("out/run_summary.csv")).unwrap();
    let mut names: Vec<_> =
        exported.records().map(|record| record.unwrap()[2].to_owned()).collect();
    names.sort();
    assert_eq!(names, agents);

    let resolved = folder.jitai(["plan", "sweep.toml", "--resolved"]).succeeded();
    folder.write("resolved.toml", resolved.stdout);
    folder.jitai(["run", "resolved.toml"]).succeeded().says("nothing to run: all 4 jobs");
}

#[test]
fn an_agent_is_found_by_its_odd_name() {
    let folder = Folder::completed(&odd());
    let filter = format!("agent={}", AGENTS[2]);
    let plan = ["plan", "sweep.toml", "--filter", &filter, "--format", "json"];
    assert_eq!(folder.jitai(plan).succeeded().json()[0]["jobs"], 1);
}

#[test]
fn characters_that_nobody_sees_are_refused_in_names() {
    for (escape, code) in [
        ("\\u0007", "U+0007, a control character"),
        ("\\u001b[31m", "U+001B, a control character"),
        ("\\n", "U+000A, a control character"),
        ("\\t", "U+0009, a control character"),
        ("\\u0000", "U+0000, a control character"),
        ("\\u009b", "U+009B, a control character"),
        ("\\u202edrawkcab", "U+202E, a mark of text direction"),
        ("\u{2066}left", "U+2066, a mark of text direction"),
        ("lines\u{2028}two", "U+2028, a separator of lines"),
        ("z\u{200b}ero", "U+200B, a character without width"),
        ("\u{e0041}", "U+E0041, a character without width"),
    ] {
        for of_what in ["<script>", "=cmd("] {
            let folder = Folder::with(&odd().replace(of_what, escape));
            let check = folder.jitai(["check", "sweep.toml"]).ended(2);
            assert_plain(&check.stderr);
            check.says(&format!("`name`: a name cannot have {code}"));
        }
    }
}

#[test]
fn stores_and_manifests_may_have_odd_paths() {
    let folder = Folder::new();
    let name = "a b'c \"d\" é.toml";
    folder.write(name, odd());
    folder.jitai(["run", name, "--store", "a b'c é?.sqlite"]).succeeded();
    assert!(fs::metadata(folder.path("a b'c é?.sqlite")).is_ok());
    folder.jitai(["status", "--store", "a b'c é?.sqlite"]).succeeded().prints("<script>");
}
