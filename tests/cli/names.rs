//! Unusual and malicious names pass through every surface unchanged.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

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

/// Asserts that a text cannot move the cursor, reverse a line or break it.
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
    refused.says("no job has agent=\\u{202e}nobody\\u{1b}[31m; its values: \"=cmd(");
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
    let in_csv =
        |agent: &str| if agent.starts_with('=') { format!("'{agent}") } else { agent.into() };
    let defused = agents.map(in_csv);
    let expected_in_csv: Vec<_> = defused.iter().map(|agent| vec![EXPERIMENT, agent]).collect();
    assert_eq!(records, expected_in_csv);

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
    let mut defused = Vec::from(defused);
    names.sort();
    defused.sort();
    assert_eq!(names, defused);

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
        ("\\u202edrawkcab", "U+202E, a text-direction mark"),
        ("\u{2066}left", "U+2066, a text-direction mark"),
        ("lines\u{2028}two", "U+2028, a line separator"),
        ("z\u{200b}ero", "U+200B, a zero-width character"),
        ("\u{e0041}", "U+E0041, a zero-width character"),
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

/// A text for questions and titles, with characters that are special in HTML, spreadsheets, LaTeX,
/// Markdown and terminals.
const PROSE: &str = "</script><script>alert(1)</script>\n=cmd('|/C calc')!A0\r\n\u{202e}drawkcab \
     \\input{/etc/passwd} $x$ % & # _ ~ ^ | ` ![x](javascript:alert(1)) \"' <!--";

/// The manifest [`odd`] with this text in its question, its titles and, 10 kB long, its hypothesis, and
/// with analyses whose names are paths out of the folder.
fn odd_report() -> String {
    let analyses = [
        ("../../out", "kind = \"curve\""),
        ("/etc/passwd", "kind = \"contrast\"\nby = \"agent.name\"\nbetween = [A, B]"),
        ("..", "kind = \"action_choice\""),
        ("<img src=x onerror=alert(1)>", "kind = \"learning_curve\"\nwindow = 2"),
    ];
    let quoted = |text: &str| serde_json::json!(text).to_string();
    let analyses = analyses.map(|(name, keys)| {
        let keys = keys.replace("[A, B]", &format!("{:?}", [AGENTS[0], AGENTS[1]]));
        let (name, title) = (quoted(name), quoted(PROSE));
        format!("[[analysis]]\nname = {name}\ntitle = {title}\n{keys}\n")
    });
    let prose = format!(
        "question = {}\nhypothesis = {}\n",
        quoted(PROSE),
        quoted(&PROSE.repeat(10_000 / PROSE.len() + 1))
    );
    odd()
        .replace("format = 1\n", &format!("format = 1\n{prose}"))
        .replace("sigma = 0.6", "sigma = [0.4, 0.6]")
        + &analyses.concat()
}

fn below(folder: &Path) -> BTreeSet<std::path::PathBuf> {
    let mut found = BTreeSet::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(below(&path));
        }
        found.insert(path);
    }
    found
}

#[test]
fn a_report_on_harmful_names_and_prose_stays_in_its_folder_and_runs_nothing() {
    let folder = Folder::completed(&odd_report());
    let before = below(&folder.path("."));
    folder.jitai(["report", "sweep.toml", "--out", "deep/report"]).succeeded();
    let made: Vec<_> = below(&folder.path(".")).difference(&before).cloned().collect();
    let mut formats = BTreeSet::new();
    // Readers of a store recreate its log and the log's index.
    let of_store = |path: &&std::path::PathBuf| {
        path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("jitai.sqlite-"))
    };
    for path in made.iter().filter(|path| path.is_file() && !of_store(path)) {
        assert!(path.starts_with(folder.path("./deep/report")), "{}", path.display());
        let name = path.file_name().unwrap().to_str().unwrap();
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
        assert!(name.chars().all(plain) && name.len() < 100, "{name}");
        let format = name.rsplit('.').next().unwrap().to_owned();
        let bytes = fs::read(path).unwrap();
        let text = String::from_utf8_lossy(&bytes);
        match format.as_str() {
            "html" | "svg" | "md" => {
                assert_no_foreign_markup(name, &text);
                assert!(!text.contains('\u{202e}'), "{name} turns its text around");
            }
            "csv" => assert_no_formulas(name, &text),
            "tex" => assert!(!text.contains("\\input"), "{name}: {text}"),
            "sql" => {
                folder.jitai(["query", &text]).succeeded();
            }
            _ => {}
        }
        formats.insert(format);
    }
    for format in ["html", "svg", "png", "csv", "tex", "md", "sql"] {
        assert!(formats.contains(format), "{format} is not among {formats:?}");
    }
}

#[track_caller]
fn assert_no_foreign_markup(name: &str, text: &str) {
    for harmful in ["<script>alert", "</script><script>alert", "<img src=x"] {
        assert!(!text.contains(harmful), "{name} has {harmful}");
    }
}

#[track_caller]
fn assert_no_formulas(name: &str, text: &str) {
    for record in csv::Reader::from_reader(text.as_bytes()).records() {
        for cell in &record.unwrap() {
            let formula = cell.starts_with(['=', '+', '-', '@', '\t', '\r']);
            assert!(!formula || cell.parse::<f64>().is_ok(), "{name}: {cell}");
        }
    }
}

#[test]
fn a_name_of_ten_kilobytes_is_refused_in_one_line() {
    let folder = Folder::with(&odd().replace("<script>", &"x".repeat(10_000)));
    let check = folder.jitai(["check", "sweep.toml"]).ended(2);
    assert!(check.stderr.len() < 2_000, "{}", check.stderr);
    check.says("`name`: ");
}
