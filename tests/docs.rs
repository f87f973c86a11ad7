//! The documents keep their word: their queries have answers, their manifests are in order, and
//! the commands, targets and files that they name exist.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::ops::ControlFlow;
use std::path::Path;

use jitai::env::{Environment, Feature};
use jitai::key::Keyed;
use jitai::manifest;
use jitai::store::{Answer, Reader};

#[path = "documents/examples.rs"]
mod examples;

use examples::{cell, fill_store, jitai, run};

const DOCUMENTS: [&str; 14] = [
    "README.md",
    "CONTRIBUTING.md",
    "docs/architecture.md",
    "docs/environment.md",
    "docs/manifest.md",
    "docs/store.md",
    "docs/analysis.md",
    "docs/decisions.md",
    "docs/report.md",
    "docs/statistics.md",
    "docs/fidelity.md",
    "docs/performance.md",
    "docs/reliability.md",
    "docs/cluster.md",
];

/// The job key that the documents show where a reader puts one of their own.
const KEY_TO_REPLACE: &str = "0123456789abcdef0123456789abcdef";

/// A fenced block of a document.
struct Block {
    document: &'static str,
    line: usize,
    /// What stands behind the fence.
    language: String,
    text: String,
}

fn read(document: &str) -> String {
    fs::read_to_string(document).unwrap_or_else(|error| panic!("{document}: {error}"))
}

fn blocks() -> Vec<Block> {
    let mut blocks: Vec<Block> = Vec::new();
    for document in DOCUMENTS {
        let mut open = false;
        for (number, line) in read(document).lines().enumerate() {
            match (line.strip_prefix("```"), open) {
                (Some(language), false) => {
                    let (line, language) = (number + 1, language.to_owned());
                    blocks.push(Block { document, line, language, text: String::new() });
                    open = true;
                }
                (Some(_), true) => open = false,
                (None, true) => {
                    let text = &mut blocks.last_mut().unwrap().text;
                    text.push_str(line);
                    text.push('\n');
                }
                (None, false) => {}
            }
        }
        assert!(!open, "{document} ends inside a block");
    }
    blocks
}

/// The rows of an answer, as text.
fn ask(reader: &Reader, sql: &str) -> Result<Vec<Vec<String>>, String> {
    let mut rows = Vec::new();
    let answered = reader.query(sql, |answer| {
        if let Answer::Row(values) = answer {
            rows.push(values.iter().map(cell).collect());
        }
        ControlFlow::Continue(())
    });
    answered.map(|()| rows).map_err(|error| error.to_string())
}

/// The quoted queries of `jitai query "…"` in shell examples.
fn queries_in_shell(block: &Block) -> Vec<String> {
    let of_line = |line: &str| {
        let rest = line.split_once("jitai query")?.1.split_once('"')?.1;
        Some(rest.split_once('"')?.0.to_owned())
    };
    block.text.lines().filter_map(of_line).collect()
}

#[test]
fn every_query_of_the_documents_has_an_answer() {
    let folder = tempfile::tempdir().unwrap();
    fill_store(folder.path());
    let reader = Reader::open(&folder.path().join("jitai.sqlite")).unwrap();
    let completed = "SELECT job_key FROM run_summary WHERE status = 'completed'";
    let key = ask(&reader, completed).unwrap()[0][0].clone();
    let (mut asked, mut faults) = (0, String::new());
    for block in blocks() {
        let queries = match block.language.as_str() {
            "sql" => vec![block.text.clone()],
            "console" => queries_in_shell(&block),
            _ => continue,
        };
        for sql in queries {
            asked += 1;
            let fault = match ask(&reader, &sql.replace(KEY_TO_REPLACE, &key)) {
                Ok(rows) if rows.is_empty() => "no row".to_owned(),
                Ok(_) => continue,
                Err(error) => error,
            };
            faults.push_str(&format!("{}:{}: {fault}\n{sql}\n", block.document, block.line));
        }
    }
    assert!(faults.is_empty(), "{faults}");
    assert!(asked >= 25, "{asked} queries were found");
}

/// A store of the experiment `readings`, in which a rule that learns nothing is what is read.
fn store_of_readings(folder: &Path, agent: &str, rule: &str, axes: &str) -> Reader {
    let manifest = format!(
        "format = 1
name = \"readings\"
seeds = 2
{axes}
[[agent]]
name = \"{agent}\"
algorithm = \"rule\"
rule = \"{rule}\"
"
    );
    fs::write(folder.join("readings.toml"), manifest).unwrap();
    run(folder, &["run", "readings.toml"], 0);
    Reader::open(&folder.join("jitai.sqlite")).unwrap()
}

#[test]
fn the_query_of_the_readings_answers_as_worked_by_hand() {
    // Sending nothing earns 0.1 in each of 50 steps, in every setting.
    let folder = tempfile::tempdir().unwrap();
    let axes = "scenarios = [\"P-H-D\", \"L-H-D\", \"P-T\"]
environment.sigma = [0.6, 0.0, 1.0]
environment.initial_habituation = [0.1, 0.0]
evaluation.test_actions = [\"as_trained\", \"greedy\"]";
    let reader = store_of_readings(folder.path(), "dqn", "never", axes);
    let mut rows = ask(&reader, &read("experiments/readings.sql")).unwrap();
    rows.sort();
    let changes = [
        "as published",
        "environment.initial_habituation 0.0",
        "environment.initial_habituation 0.0, evaluation.test_actions greedy",
        "evaluation.test_actions greedy",
    ];
    // 5 less 2630, 1871 and 1191; the root of 11779177 / 3; -5677 / 3; 5 less 1530 and 730.
    let numbers = ["2", "-2625", "-1866", "-1186", "1982", "-1892", "-1525", "-725", "0", "0"];
    let expected = changes.map(|changed| [&["dqn", changed], &numbers[..]].concat());
    assert_eq!(rows, expected);
}

#[test]
fn the_query_of_the_readings_tells_the_error_of_three_seeds() {
    let folder = tempfile::tempdir().unwrap();
    let axes = "scenarios = [\"P-T\"]\nenvironment.sigma = 0.6\nevaluation.test_episodes = 2";
    let reader = store_of_readings(folder.path(), "reinforce", "random", axes);
    let returns = ask(&reader, "SELECT mean_return FROM run_summary").unwrap();
    let returns: Vec<f64> = returns.iter().map(|row| row[0].parse().unwrap()).collect();
    let &[one, other] = &returns[..] else { panic!("two seeds: {returns:?}") };
    // The deviation of two values is their distance over the root of 2.
    let error = ((one - other).abs() / 6.0_f64.sqrt()).round();
    assert!(error > 0.0, "{returns:?}");
    let difference = f64::midpoint(one, other) - 2227.0;
    let rows = ask(&reader, &read("experiments/readings.sql")).unwrap();
    let (difference, error) = (difference.round().to_string(), error.to_string());
    let distance = difference.trim_start_matches('-');
    let expected = [
        "reinforce",
        "as published",
        "2",
        "",
        "",
        &difference,
        distance,
        &difference,
        "",
        "",
        &error,
        &error,
    ];
    assert_eq!(rows, [expected]);
}

#[test]
fn the_query_of_the_readings_has_the_published_means() {
    let sql = read("experiments/readings.sql");
    let (means, _) = sql.split_once("), setting AS (").unwrap();
    let folder = tempfile::tempdir().unwrap();
    let axes = "scenarios = [\"P-T\"]\nenvironment.sigma = 0.6";
    let reader = store_of_readings(folder.path(), "dqn", "never", axes);
    let rows = ask(&reader, &format!("{means}) SELECT * FROM published")).unwrap();
    let published: toml::Table = read("experiments/paper/published.toml").parse().unwrap();
    let curves = published["curve"].as_array().unwrap();
    for row in &rows {
        let [agent, scenario, sigma, mean] = &row[..] else { panic!("{row:?}") };
        let names = |curve: &&toml::Value| {
            curve["agent"].as_str() == Some(agent) && curve["scenario"].as_str() == Some(scenario)
        };
        let curve = curves.iter().find(names).unwrap_or_else(|| panic!("no curve for {row:?}"));
        let sigma: f64 = sigma.parse().unwrap();
        let sigmas = curve["sigma"].as_array().unwrap();
        let at = sigmas.iter().position(|value| value.as_float() == Some(sigma)).unwrap();
        assert_eq!(curve["return"][at].as_integer(), Some(mean.parse().unwrap()), "{row:?}");
    }
    assert_eq!(
        rows.len(),
        2 * (3 + 2),
        "two agents: three scenarios at one sigma, one at two more"
    );
}

#[test]
fn the_query_of_the_heat_maps_has_the_published_tiles_and_answers_as_worked_by_hand() {
    let folder = tempfile::tempdir().unwrap();
    let manifest = "format = 1
name = \"heat-maps\"
scenarios = [\"P-H-D\", \"L-H-D\"]
seeds = 2
[environment]
sigma = 0.6
delta_d = [0.1, 0.2, 0.3, 0.4]
epsilon_d = [0.1, 0.2, 0.3, 0.4]
time_one_hot = [false, true]
[[agent]]
name = \"reinforce\"
algorithm = \"rule\"
rule = \"tailored\"
";
    fs::write(folder.path().join("maps.toml"), manifest).unwrap();
    run(folder.path(), &["run", "maps.toml"], 0);
    let reader = Reader::open(&folder.path().join("jitai.sqlite")).unwrap();
    let published: toml::Table = read("experiments/paper/published.toml").parse().unwrap();
    let maps = published["heat_map"].as_array().unwrap();
    let tiles = |agent: &str| -> Vec<f64> {
        let map = maps.iter().find(|map| map["agent"].as_str() == Some(agent)).unwrap();
        let rows = map["effect"].as_array().unwrap().iter();
        rows.flat_map(|row| row.as_array().unwrap()).map(|tile| tile.as_float().unwrap()).collect()
    };
    let sql = read("experiments/heat_maps.sql");
    let (table, _) = sql.split_once("), run AS (").unwrap();
    for agent in ["dqn", "reinforce"] {
        let query = format!(
            "{table}) SELECT effect FROM published WHERE agent = '{agent}' ORDER BY delta_d, epsilon_d"
        );
        let ours = ask(&reader, &query).unwrap();
        let ours: Vec<f64> = ours.iter().map(|row| row[0].parse().unwrap()).collect();
        assert_eq!(ours, tiles(agent), "{agent}");
    }
    let runs = "SELECT d.value, e.value, o.value, s.scenario, s.mean_return
        FROM run_summary AS s
        JOIN parameter AS d ON d.job_key = s.job_key AND d.name = 'environment.delta_d'
        JOIN parameter AS e ON e.job_key = s.job_key AND e.name = 'environment.epsilon_d'
        JOIN parameter AS o ON o.job_key = s.job_key AND o.name = 'environment.time_one_hot'
        ORDER BY o.value, d.value, e.value, s.scenario DESC, s.seed";
    let returns = ask(&reader, runs).unwrap();
    let returns: Vec<f64> = returns.iter().map(|row| row[4].parse().unwrap()).collect();
    // Two seeds of a scenario, P-H-D before L-H-D, and 16 tiles without and with the one-hot.
    let by_hand = |returns: &[f64]| -> [String; 3] {
        let (mut mean, mut square, mut noise) = (0.0, 0.0, 0.0);
        for (tile, published) in returns.chunks(4).zip(tiles("reinforce")) {
            let [p, q, l, m] = tile[..] else { panic!("{tile:?}") };
            let difference = (p + q) / 2.0 - (l + m) / 2.0 - published;
            // The variance of two values is half the square of their distance.
            let variances = ((p - q) * (p - q) + (l - m) * (l - m)) / 2.0;
            mean += difference / 16.0;
            square += difference * difference / 16.0;
            noise += variances * (1.0 / 2.0 + 1.0 / 3.0) / 16.0;
        }
        [mean, square.sqrt(), noise.sqrt()].map(|number| number.round().to_string())
    };
    let [without, with] = [0, 1].map(|half| by_hand(&returns[64 * half..][..64]));
    assert!(without[0] != "0" && without[2] != "0", "{without:?}");
    let row = |one_hot: &str, numbers: [String; 3]| {
        let words = ["reinforce", one_hot, "16", "2"].map(str::to_owned);
        words.into_iter().chain(numbers).collect::<Vec<String>>()
    };
    assert_eq!(ask(&reader, &sql).unwrap(), [row("0", without), row("1", with)]);
}

#[test]
fn every_whole_manifest_of_the_documents_is_in_order() {
    let mut parsed = 0;
    for block in blocks() {
        if block.language == "toml" && block.text.contains("format = 1") {
            let place = format!("{}:{}", block.document, block.line);
            if let Err(faults) = manifest::parse(&place, block.text.as_bytes()) {
                panic!("{faults}");
            }
            parsed += 1;
        }
    }
    assert!(parsed >= 2, "{parsed} manifests were found");
}

/// The verbs that follow `jitai` in a line, each with the options up to the end of the command.
/// A command ends with its code span, its table cell or its line; a comment is no part of it.
fn commands(line: &str) -> Vec<(String, BTreeSet<String>)> {
    let mut found = Vec::new();
    for part in line.split("jitai ").skip(1) {
        let command = part.split(['`', '#', '|', '"']).next().unwrap_or_default();
        let mut words = command.split_whitespace();
        let Some(verb) = words.next() else { continue };
        if !verb.chars().all(|c| c.is_ascii_lowercase()) {
            continue;
        }
        let options = words.filter(|word| word.starts_with("--")).map(str::to_owned).collect();
        found.push((verb.to_owned(), options));
    }
    found
}

/// Lines in which `jitai` is typed: those of shell examples, and those with code spans of it.
fn typed(document: &str) -> Vec<String> {
    let text = read(document);
    let of_line = |line: &str| match line.strip_prefix("$ ") {
        Some(command) => command.to_owned(),
        // In prose, only what stands directly behind a back-quote is a command.
        None => line.split("`jitai ").skip(1).map(|rest| format!("jitai {rest} ")).collect(),
    };
    text.lines().map(of_line).collect()
}

#[test]
fn every_command_of_the_documents_exists_with_its_options() {
    let folder = tempfile::tempdir().unwrap();
    let mut help: BTreeMap<String, String> = BTreeMap::new();
    let mut options_seen = 0;
    for document in DOCUMENTS.into_iter().chain(["CHANGELOG.md"]) {
        for (verb, options) in typed(document).iter().flat_map(|line| commands(line)) {
            let help = help.entry(verb.clone()).or_insert_with(|| {
                let output = jitai(folder.path(), [verb.as_str(), "--help"]);
                assert!(output.status.success(), "{document}: `jitai {verb}` does not exist");
                String::from_utf8(output.stdout).unwrap()
            });
            for option in &options {
                options_seen += 1;
                let known = help
                    .split_whitespace()
                    .any(|word| word.trim_end_matches(',') == option.trim_end_matches(','));
                assert!(known, "{document}: `jitai {verb}` has no {option}");
            }
        }
    }
    let overview = String::from_utf8(jitai(folder.path(), ["--help"]).stdout).unwrap();
    let verbs = overview.split_once("Commands:").unwrap().1.split_once("Options:").unwrap().0;
    // A long explanation goes on in lines that are indented further.
    let first_words = verbs.lines().filter_map(|line| line.strip_prefix("  ")?.split(' ').next());
    for verb in first_words.filter(|verb| !verb.is_empty()) {
        let documented = help.contains_key(verb) || verb == "help";
        assert!(documented, "no document mentions `jitai {verb}`");
    }
    assert!(options_seen >= 20, "{options_seen} options were found");
}

/// The options that a row of the README's table of commands names behind the command.
fn options_of_row(row: &str) -> Vec<&str> {
    row.split('`').filter(|span| span.starts_with("--")).collect()
}

#[test]
fn the_table_of_commands_names_every_option() {
    let folder = tempfile::tempdir().unwrap();
    let readme = read("README.md");
    for row in readme.lines().filter(|line| line.starts_with("| `jitai ")) {
        let verb = row["| `jitai ".len()..].split([' ', '`']).next().unwrap();
        let output = jitai(folder.path(), [verb, "--help"]);
        let help = String::from_utf8(output.stdout).unwrap();
        let offered = help
            .lines()
            .filter(|line| line.trim_start().starts_with('-'))
            .filter_map(|line| line.split_whitespace().find(|word| word.starts_with("--")));
        // Every command has `--help`; `--store` is explained for all of them below the table.
        for option in offered.filter(|option| !["--help", "--store"].contains(option)) {
            assert!(row.contains(option), "`jitai {verb}` has {option}, and its row does not");
        }
        for option in options_of_row(row) {
            let name = option.split_whitespace().next().unwrap();
            assert!(help.contains(name), "`jitai {verb}` has no {name}");
        }
    }
}

#[test]
fn the_page_of_the_environment_has_every_key_and_every_letter() {
    let page = read("docs/environment.md");
    let rows: Vec<&str> = page.lines().filter(|line| line.starts_with("| `")).collect();
    let is_explained = |name: &str| {
        let name = format!("`{name}`");
        rows.iter().any(|row| row.split('|').nth(1).is_some_and(|cell| cell.contains(&name)))
    };
    for key in Environment::KEYS {
        assert!(is_explained(key.name), "{}", key.name);
    }
    for feature in Feature::ALL {
        assert!(is_explained(&feature.letter().to_string()), "{feature:?}");
    }
}

#[test]
fn every_file_and_target_of_the_documents_exists() {
    let makefile = read("Makefile");
    for document in DOCUMENTS.into_iter().chain(["CHANGELOG.md"]) {
        let text = read(document);
        let folder = Path::new(document).parent().unwrap();
        for link in text.split("](").skip(1).filter_map(|rest| rest.split(')').next()) {
            let path = link.split('#').next().unwrap();
            if !path.is_empty() && !path.contains("://") {
                assert!(folder.join(path).exists(), "{document}: no {path}");
            }
        }
        for span in text.split('`').filter(|span| span.starts_with("experiments/")) {
            assert!(Path::new(span).exists(), "{document}: no {span}");
        }
        for target in text.split("`make ").skip(1).filter_map(|rest| rest.split('`').next()) {
            assert!(makefile.contains(&format!("\n{target}:")), "{document}: no target {target}");
        }
    }
}
