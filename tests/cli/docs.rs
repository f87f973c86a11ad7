//! The documents are true: their queries have answers, their manifests are valid, and the commands,
//! targets and files that they name exist.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::ops::ControlFlow;
use std::path::Path;

use jitai::env::{Feature, StepCount};
use jitai::key::{Keyed, Parameter};
use jitai::manifest::{self, Published, PublishedRow};
use jitai::store::{Answer, Reader};

#[path = "../documents/examples.rs"]
mod examples;
#[path = "../documents/questions.rs"]
mod questions;

pub use examples::LEARNED;
use examples::{cell, fill_store, jitai, run};
use questions::questions;

const DOCUMENTS: [&str; 45] = [
    "README.md",
    "CONTRIBUTING.md",
    "docs/agents.md",
    "docs/analysis.md",
    "docs/architecture.md",
    "docs/bandits.md",
    "docs/beliefs.md",
    "docs/browse.md",
    "docs/cluster.md",
    "docs/commands.md",
    "docs/decisions.md",
    "docs/drawing.md",
    "docs/environment.md",
    "docs/estimates.md",
    "docs/after-study.md",
    "docs/recorded.md",
    "docs/external.md",
    "docs/fidelity-bots.md",
    "docs/fidelity.md",
    "docs/fit.md",
    "docs/pilot.md",
    "docs/index.md",
    "docs/install.md",
    "docs/manifest.md",
    "docs/models.md",
    "docs/notebooks.md",
    "docs/optimum.md",
    "docs/oralytics.md",
    "docs/trials.md",
    "docs/outside-environments.md",
    "docs/performance.md",
    "docs/pooling.md",
    "docs/python.md",
    "docs/questions.md",
    "docs/reliability.md",
    "docs/report.md",
    "docs/robustness.md",
    "docs/search.md",
    "docs/slurm.md",
    "docs/statistics.md",
    "docs/store-file.md",
    "docs/store.md",
    "docs/sweeps.md",
    "docs/tenets.md",
    "docs/tour.md",
];

/// Maximum number of lines of a page, not counting rows of tables.
const LINES_OF_A_PAGE: usize = 250;

/// The job key in the documents that readers replace by a key of their own.
const KEY_TO_REPLACE: &str = "0123456789abcdef0123456789abcdef";

/// A fenced block of a document.
struct Block {
    document: &'static str,
    line: usize,
    /// The text after the opening fence.
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

/// A store of the experiment `readings` with one agent, a rule that learns nothing.
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
    // In every setting, sending nothing earns 0.1 in each of 50 steps.
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
    // 5 minus 2630, 1871 and 1191; the square root of 11779177 / 3; -5677 / 3; 5 minus 1530 and 730.
    let numbers = ["2", "-2625", "-1866", "-1186", "1982", "-1892", "-1525", "-725", "0", "0"];
    let expected = changes.map(|changed| [&["dqn", changed], &numbers[..]].concat());
    assert_eq!(rows, expected);
}

#[test]
fn the_query_of_the_readings_has_the_error_of_three_seeds() {
    let folder = tempfile::tempdir().unwrap();
    let axes = "scenarios = [\"P-T\"]\nenvironment.sigma = 0.6\nevaluation.test_episodes = 2";
    let reader = store_of_readings(folder.path(), "reinforce", "random", axes);
    let returns = ask(&reader, "SELECT mean_return FROM run_summary").unwrap();
    let returns: Vec<f64> = returns.iter().map(|row| row[0].parse().unwrap()).collect();
    let &[one, other] = &returns[..] else { panic!("two seeds: {returns:?}") };
    // The standard deviation of two values is their distance over the square root of 2, and the
    // standard error of three seeds is the standard deviation over the square root of 3.
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

const SIGMA: Parameter = Parameter::Environment("sigma");

fn published_by_the_paper() -> Vec<PublishedRow> {
    let name = "experiments/paper/published.csv";
    Published::parse(Path::new(name), &read(name)).unwrap().rows
}

#[test]
fn the_query_of_the_readings_has_the_published_means() {
    let sql = read("experiments/readings.sql");
    let (means, _) = sql.split_once("), setting AS (").unwrap();
    let folder = tempfile::tempdir().unwrap();
    let axes = "scenarios = [\"P-T\"]\nenvironment.sigma = 0.6";
    let reader = store_of_readings(folder.path(), "dqn", "never", axes);
    let rows = ask(&reader, &format!("{means}) SELECT * FROM published")).unwrap();
    let published = published_by_the_paper();
    for row in &rows {
        let [agent, scenario, sigma, mean] = &row[..] else { panic!("{row:?}") };
        let at = Some(sigma.parse::<f64>().unwrap());
        let is_meant = |one: &&PublishedRow| {
            (&one.agent, &one.scenario) == (agent, scenario) && one.value_of(SIGMA) == at
        };
        let point = published.iter().find(is_meant).unwrap_or_else(|| panic!("no {row:?}"));
        assert_eq!(point.value, mean.parse::<f64>().unwrap(), "{row:?}");
    }
    assert_eq!(
        rows.len(),
        2 * (3 + 2),
        "two agents: three scenarios at one sigma, one at two more"
    );
}

#[test]
fn the_query_of_figure_5_of_bots_has_the_published_means() {
    let sql = read("experiments/bots/figure_5.sql");
    let (means, _) = sql.split_once("), point AS (").unwrap();
    let folder = tempfile::tempdir().unwrap();
    let axes = "scenarios = [\"P-T\"]\nenvironment.sigma = 0.6";
    let reader = store_of_readings(folder.path(), "dqn", "never", axes);
    let rows = ask(&reader, &format!("{means}) SELECT * FROM published")).unwrap();
    let points = read("experiments/bots/figure_5.csv");
    let points: Vec<Vec<&str>> = points.lines().map(|line| line.split(',').collect()).collect();
    for row in &rows {
        let [agent, first, mean, error] = &row[..] else { panic!("{row:?}") };
        let name = match agent.as_str() {
            "ts" => "ts_uninformative",
            "ts-trial" => "ts_mrt_prior",
            other => other,
        };
        let first: usize = first.parse().unwrap();
        let inside = |point: &&Vec<&str>| {
            let episode = point[1].parse().unwrap_or(0);
            point[0] == name && (first..first + 100).contains(&episode)
        };
        let average = |column: usize| {
            let values = points.iter().filter(inside).map(|point| point[column].parse::<f64>());
            values.map(Result::unwrap).sum::<f64>() / 100.0
        };
        assert!((average(2) - mean.parse::<f64>().unwrap()).abs() < 0.051, "{row:?}");
        assert!((average(3) - error.parse::<f64>().unwrap()).abs() < 0.051, "{row:?}");
    }
    assert_eq!(rows.len(), 5 * 15, "five curves by hundreds of episodes");
}

#[test]
fn the_query_of_figure_1_of_bots_has_the_published_values() {
    let sql = read("experiments/bots/figure_1.sql");
    let (values, _) = sql.split_once("), point AS (").unwrap();
    let folder = tempfile::tempdir().unwrap();
    let axes = "scenarios = [\"P-T\"]\nenvironment.sigma = 0.6";
    let reader = store_of_readings(folder.path(), "dqn", "never", axes);
    let rows = ask(&reader, &format!("{values}) SELECT * FROM published")).unwrap();
    let published: toml::Table = read("experiments/bots/published.toml").parse().unwrap();
    let rounds = published["rounds"].as_array().unwrap();
    let updated = rounds.iter().find(|one| one["legend"].as_str() == Some("TS(Update)")).unwrap();
    let column = |name: &str| updated[name].as_array().unwrap();
    for (index, row) in rows.iter().enumerate() {
        let numbers: Vec<f64> = row.iter().map(|cell| cell.parse().unwrap()).collect();
        assert_eq!(Some(numbers[0] as i64), column("batch")[index].as_integer());
        assert_eq!(Some(numbers[1]), column("value")[index].as_float());
        assert_eq!(Some(numbers[2]), column("half_height")[index].as_float());
    }
    assert_eq!(rows.len(), column("batch").len());
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
    let published = published_by_the_paper();
    let tiles = |agent: &str| -> Vec<f64> {
        let is_tile = |one: &&PublishedRow| one.agent == agent && one.subject == "heat-map tile";
        published.iter().filter(is_tile).map(|tile| tile.value).collect()
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
    // Two seeds per scenario, P-H-D before L-H-D, and 16 tiles, first without and then with the
    // one-hot.
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
            // A model is read with the manifest that has it.
            let text = match block.text.contains("[roles]") {
                true => format!(
                    "format = 1\nname = \"m\"\nscenarios = \"all\"\nseeds = 1\n[[agent]]\nname = \"a\"\n\
                     algorithm = \"rule\"\nrule = \"never\"\n[environment]\nfamily = \"declared\"\nmodel = '''\n{}'''\n",
                    block.text
                ),
                false => block.text.clone(),
            };
            if let Err(faults) = manifest::parse(&place, text.as_bytes()) {
                panic!("{faults}");
            }
            parsed += 1;
        }
    }
    assert!(parsed >= 2, "{parsed} manifests were found");
}

/// The verbs that follow `jitai` in a line, each with the options up to the end of the command. A
/// command ends with its code span, its table cell or its line; a shell comment does not belong to it.
fn commands(line: &str) -> Vec<(String, BTreeSet<String>)> {
    let mut found = Vec::new();
    for part in line.split("jitai ").skip(1) {
        let command = part.split(['`', '#', '|', '"']).next().unwrap_or_default();
        let mut words = command.split_whitespace();
        let Some(verb) = words.next() else { continue };
        if !verb.chars().all(|c| c.is_ascii_lowercase() || c == '-') {
            continue;
        }
        let options = words.filter(|word| word.starts_with("--")).map(str::to_owned).collect();
        found.push((verb.to_owned(), options));
    }
    found
}

/// For each line of a document, its `jitai` commands: those of a shell example, and those in code
/// spans.
fn typed(document: &str) -> Vec<String> {
    let text = read(document);
    let of_line = |line: &str| match line.strip_prefix("$ ") {
        Some(command) => command.to_owned(),
        // In prose, only text directly after a back-quote is a command.
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
    // A long explanation continues in lines with more indentation.
    let first_words = verbs.lines().filter_map(|line| line.strip_prefix("  ")?.split(' ').next());
    for verb in first_words.filter(|verb| !verb.is_empty()) {
        let documented = help.contains_key(verb) || verb == "help";
        assert!(documented, "no document mentions `jitai {verb}`");
    }
    assert!(options_seen >= 20, "{options_seen} options were found");
}

/// The options after the command in a row of the table of commands.
fn options_of_row(row: &str) -> Vec<&str> {
    row.split('`').filter(|span| span.starts_with("--")).collect()
}

#[test]
fn the_table_of_commands_names_every_option() {
    let folder = tempfile::tempdir().unwrap();
    let page = read("docs/commands.md");
    let rows: Vec<&str> = page.lines().filter(|line| line.starts_with("| `jitai ")).collect();
    assert!(rows.len() >= 14, "{} commands have a row", rows.len());
    for row in rows {
        let verb = row["| `jitai ".len()..].split([' ', '`']).next().unwrap();
        let output = jitai(folder.path(), [verb, "--help"]);
        let help = String::from_utf8(output.stdout).unwrap();
        let offered = help
            .lines()
            .filter(|line| line.trim_start().starts_with('-'))
            .filter_map(|line| line.split_whitespace().find(|word| word.starts_with("--")));
        // Every command has `--help`, and the text below the table explains `--store` for all of them.
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
    for key in StepCount::KEYS {
        assert!(is_explained(key.name), "{}", key.name);
    }
    for feature in Feature::ALL {
        assert!(is_explained(&feature.letter().to_string()), "{feature:?}");
    }
}

/// The lines of a document outside fenced blocks.
fn prose(document: &str) -> Vec<String> {
    let mut is_code = false;
    let mut lines = Vec::new();
    for line in read(document).lines() {
        if line.starts_with("```") {
            is_code = !is_code;
        } else if !is_code {
            lines.push(line.to_owned());
        }
    }
    lines
}

/// The anchors of a document's headings, as code hosts and the site derive them: lower case, without
/// punctuation, with a hyphen for each blank.
fn anchors(document: &str) -> BTreeSet<String> {
    let title = |line: &String| {
        let title = line.trim_start_matches('#').strip_prefix(' ')?;
        line.starts_with('#').then(|| title.to_lowercase())
    };
    let kept = |c: &char| c.is_alphanumeric() || [' ', '-', '_'].contains(c);
    let anchor = |title: String| title.chars().filter(kept).collect::<String>().replace(' ', "-");
    prose(document).iter().filter_map(title).map(anchor).collect()
}

#[test]
fn every_anchor_of_the_documents_is_a_heading() {
    let others = ["CHANGELOG.md", "SECURITY.md", "python/README.md"];
    let (mut checked, mut faults) = (0, String::new());
    for document in DOCUMENTS.into_iter().chain(others) {
        let text = prose(document).join("\n");
        let folder = Path::new(document).parent().unwrap();
        for link in text.split("](").skip(1).filter_map(|rest| rest.split(')').next()) {
            let Some((path, anchor)) = link.split_once('#') else { continue };
            if path.contains("://") {
                continue;
            }
            checked += 1;
            let target = match path {
                "" => document.into(),
                path => folder.join(path),
            };
            if !anchors(target.to_str().unwrap()).contains(anchor) {
                faults.push_str(&format!("{document}: {link} is no heading\n"));
            }
        }
    }
    assert!(faults.is_empty(), "{faults}");
    assert!(checked >= 40, "{checked} anchors were found");
}

/// The readers of a document: the words between asterisks on their own line below the title.
fn readers(document: &str) -> Option<String> {
    let text = read(document);
    let (_, rest) = text.split_once("\n\n")?;
    let (line, _) = rest.split_once("\n\n")?;
    Some(line.strip_prefix('*')?.strip_suffix('*')?.to_owned())
}

#[test]
fn every_page_is_on_the_map_and_says_for_whom_it_is() {
    let files = fs::read_dir("docs").unwrap().map(|entry| entry.unwrap().path());
    let pages = files.filter(|path| path.extension().is_some_and(|kind| kind == "md"));
    let map = read("docs/index.md");
    let (users, maintainers) = map.split_once("## For maintainers").unwrap();
    let navigation = read("docs/site/mkdocs.yml");
    for page in pages {
        let name = page.file_name().unwrap().to_str().unwrap();
        let document = format!("docs/{name}");
        assert!(DOCUMENTS.contains(&document.as_str()), "{document} is checked by no test");
        let readers = readers(&document).unwrap_or_else(|| panic!("{document}: for whom?"));
        assert!(navigation.contains(&format!(": {name}\n")), "{name} is not on the site");
        let list = match readers.split([' ', ',', ':']).nth(1).unwrap() {
            "users" => users,
            "maintainers" => maintainers,
            "everyone" => continue,
            other => panic!("{document} is for {other}"),
        };
        assert!(list.contains(&format!("]({name})")), "{name} is not in its list of the map");
    }
}

#[test]
fn every_module_has_its_row_in_the_map_of_modules() {
    let map = read("docs/architecture.md");
    for entry in fs::read_dir("src").unwrap().map(Result::unwrap) {
        let file = entry.file_name().into_string().unwrap();
        let path = if entry.path().is_dir() { format!("{file}/mod.rs") } else { file.clone() };
        let name = file.trim_end_matches(".rs");
        let row = format!("\n| [`{name}`](../src/{path}) | ");
        assert!(["lib", "main"].contains(&name) || map.contains(&row), "no row of {name}");
    }
}

#[test]
fn every_page_is_short_enough_to_finish() {
    for document in DOCUMENTS {
        let lines = read(document).lines().filter(|line| !line.starts_with('|')).count();
        assert!(lines <= LINES_OF_A_PAGE, "{document} has {lines} lines besides its tables");
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

/// The Datasette file that offers the questions of the documents and hides the tables behind the views.
fn datasette(store: &Path) -> String {
    let quoted = |text: &str| serde_json::Value::from(text).to_string();
    let mut out = String::from(
        "# The questions of analysis.md, questions.md, optimum.md and decisions.md for Datasette, as browse.md\n\
         # describes. Changes belong there: `cargo test --test cli docs::` compares, and prints how to renew this file.\n\
         title: Results of jitai\ndatabases:\n  jitai:\n    queries:\n",
    );
    for question in questions() {
        let title = format!("{}. {}", question.number, question.title);
        out += &format!("      {}:\n        title: {}\n", question.slug(), quoted(&title));
        out += "        sql: |-\n";
        let any = |name| question.sql.replace(&format!("'{name}'"), ":experiment");
        let sql = question.experiment().map_or_else(|| question.sql.clone(), any);
        for line in sql.lines() {
            out += format!("          {line}").trim_end();
            out.push('\n');
        }
    }
    let tables = "SELECT name FROM sqlite_schema WHERE type = 'table' ORDER BY name";
    let connection = rusqlite::Connection::open(store).unwrap();
    let mut statement = connection.prepare(tables).unwrap();
    let names = statement.query_map([], |row| row.get::<_, String>(0)).unwrap();
    out += "    tables:\n";
    for name in names.map(Result::unwrap) {
        out += &format!("      {name}:\n        hidden: true\n");
    }
    out
}

#[test]
fn datasette_has_every_question_and_shows_views_alone() {
    let folder = tempfile::tempdir().unwrap();
    examples::fill_with_quickstart(folder.path());
    let expected = datasette(&folder.path().join("jitai.sqlite"));
    let slugs: BTreeSet<String> = questions().iter().map(questions::Question::slug).collect();
    assert_eq!(slugs.len(), questions().len(), "two queries have one name");
    let path = "docs/datasette.yaml";
    if fs::read_to_string(path).unwrap_or_default() != expected {
        let renewed = Path::new(env!("CARGO_TARGET_TMPDIR")).join("datasette.yaml");
        fs::write(&renewed, expected).unwrap();
        panic!(
            "{path} differs from the questions of the documents; cp {} {path}",
            renewed.display()
        );
    }
}
