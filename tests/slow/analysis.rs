//! SQL, pandas and R agree on every number in the answers to the questions of the documents: those of
//! docs/analysis.md, questions.md, optimum.md and decisions.md.
//!
//! The tests look for R and for a Python with pandas, and leave out what is missing.

use std::env;
use std::ffi::OsStr;
use std::fs;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use jitai::estimate::Correction;
use jitai::store::{Answer, Reader};
use jitai::train::after_study_covariance;
use jitai::{manifest, plan};

#[path = "../documents/article.rs"]
mod article;
#[path = "../documents/examples.rs"]
mod examples;
#[path = "../documents/questions.rs"]
mod questions;

use crate::support::left_out;
use examples::cell;
use questions::{Question, questions};

/// Maximum difference of two equal numbers, relative to the larger one: R writes 15 digits.
const TOLERANCE: f64 = 1e-9;

/// Two numbers below this are equal: both are rounding errors of a difference that is 0.
const ROUNDING: f64 = 1e-9;

/// An answer as text, from SQL, pandas or R.
#[derive(Debug)]
struct Table {
    columns: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Table {
    /// The table with its columns in this order, and its rows sorted.
    fn arranged(&self, columns: &[String]) -> Table {
        let index = |name: &String| {
            let found = self.columns.iter().position(|column| column == name);
            found.unwrap_or_else(|| panic!("no column {name} in {:?}", self.columns))
        };
        let places: Vec<usize> = columns.iter().map(index).collect();
        let arrange = |row: &Vec<String>| places.iter().map(|at| row[*at].clone()).collect();
        let mut rows: Vec<Vec<String>> = self.rows.iter().map(arrange).collect();
        rows.sort_by_key(|row| row.iter().map(|cell| coarse(cell)).collect::<Vec<_>>());
        Table { columns: columns.to_vec(), rows }
    }
}

/// The cell with few digits, so that different roundings of one number are equal.
fn coarse(cell: &str) -> String {
    cell.parse::<f64>().map_or_else(|_| cell.to_owned(), |number| format!("{number:.6e}"))
}

fn equal(one: &str, other: &str) -> bool {
    match (one.parse::<f64>(), other.parse::<f64>()) {
        (Ok(one), Ok(other)) => {
            let size = one.abs().max(other.abs());
            (one - other).abs() <= TOLERANCE * size || size < ROUNDING
        }
        _ => one == other,
    }
}

fn answer_of_sql(reader: &Reader, sql: &str) -> Table {
    let mut table = Table { columns: Vec::new(), rows: Vec::new() };
    let hear = |answer: Answer<'_>| {
        match answer {
            Answer::Columns(names) => {
                table.columns = names.iter().map(|name| (*name).to_owned()).collect();
            }
            Answer::Row(values) => table.rows.push(values.iter().map(cell).collect()),
        }
        ControlFlow::Continue(())
    };
    reader.query(sql, hear).unwrap_or_else(|error| panic!("{error}\n{sql}"));
    table
}

fn answer_of_file(path: &Path) -> Table {
    let mut reader = csv::Reader::from_path(path).unwrap_or_else(|e| panic!("{path:?}: {e}"));
    let cells = |record: &csv::StringRecord| record.iter().map(str::to_owned).collect();
    let columns = cells(reader.headers().unwrap());
    Table { columns, rows: reader.records().map(|record| cells(&record.unwrap())).collect() }
}

/// The number of compared cells of an answer and the answer of SQL, or the first difference.
fn compare(number: usize, sql: &Table, other: &Table) -> Result<usize, String> {
    let (expected, found) = (sql.arranged(&sql.columns), other.arranged(&sql.columns));
    let size = (expected.rows.len(), found.rows.len());
    if size.0 != size.1 {
        return Err(format!("question {number}: {} rows, and {} in SQL", size.1, size.0));
    }
    for (one, two) in expected.rows.iter().zip(&found.rows) {
        if let Some(at) = (0..one.len()).find(|at| !equal(&one[*at], &two[*at])) {
            let column = &expected.columns[at];
            return Err(format!("question {number}, {column}:\n  SQL {one:?}\n      {two:?}"));
        }
    }
    Ok(size.0 * expected.columns.len())
}

/// Whether a program exists and succeeds with these arguments.
fn answers(program: &OsStr, arguments: &[&str]) -> bool {
    let mut command = Command::new(program);
    let run = command.args(arguments).stdout(Stdio::null()).stderr(Stdio::null()).status();
    run.is_ok_and(|status| status.success())
}

/// A Python that has pandas: from `ANALYSIS_PYTHON`, from `make analysis`, or `python3`.
fn python() -> Option<PathBuf> {
    let named = env::var_os("ANALYSIS_PYTHON").map(PathBuf::from);
    let candidates = [named, Some("target/analysis/bin/python".into()), Some("python3".into())];
    candidates
        .into_iter()
        .flatten()
        .find(|path| answers(path.as_os_str(), &["-c", "import pandas"]))
}

/// Says that a program is missing, and how to install it.
fn missing(program: &str) {
    left_out(program, "not at hand; `make analysis` installs it");
}

/// Runs a script that answers all questions, and compares its answers with those of SQL; returns the
/// number of compared cells.
fn agree(script: &mut Command, folder: &Path, sql: &[(usize, Table)]) -> usize {
    // Both languages sort texts and print numbers according to the locale.
    script.env("LC_ALL", "C.UTF-8");
    let output = script.arg(folder.join("jitai.sqlite")).arg(folder.join("answers")).output();
    let output = output.unwrap();
    let told = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{script:?}: {told}");
    let (mut cells, mut faults) = (0, Vec::new());
    for (number, table) in sql {
        let file = folder.join("answers").join(format!("{number}.csv"));
        if table.rows.is_empty() && !file.exists() {
            continue;
        }
        match compare(*number, table, &answer_of_file(&file)) {
            Ok(compared) => cells += compared,
            Err(fault) => faults.push(fault),
        }
        fs::remove_file(file).unwrap();
    }
    let more: Vec<_> = fs::read_dir(folder.join("answers")).unwrap().collect();
    assert!(more.is_empty(), "answers without a question: {more:?}");
    assert!(faults.is_empty(), "{script:?}:\n{}", faults.join("\n"));
    cells
}

/// The answers of SQL about the store in a folder, and the numbers of the questions whose answers have
/// no rows.
fn answers_of_sql(folder: &Path) -> (Vec<(usize, Table)>, Vec<usize>) {
    let reader = Reader::open(&folder.join("jitai.sqlite")).unwrap();
    let questions = questions();
    assert!(questions.len() >= 20, "{} questions were found", questions.len());
    assert!(questions.iter().map(|question| question.number).eq(1..=questions.len()));
    let answer = |question: Question| (question.number, answer_of_sql(&reader, &question.sql));
    let sql: Vec<(usize, Table)> = questions.into_iter().map(answer).collect();
    let silent = sql.iter().filter(|(_, table)| table.rows.is_empty());
    let silent = silent.map(|(number, _)| *number).collect();
    (sql, silent)
}

/// Compares the answers of pandas and R about the store in a folder, as far as they are installed.
fn all_agree(folder: &Path, sql: &[(usize, Table)]) {
    match python() {
        Some(python) => {
            let cells = agree(Command::new(python).arg("docs/analysis.py"), folder, sql);
            println!("pandas agreed on {cells} values");
        }
        None => missing("pandas"),
    }
    if answers(OsStr::new("Rscript"), &["-e", "library(DBI); library(RSQLite)"]) {
        let cells = agree(Command::new("Rscript").arg("docs/analysis.R"), folder, sql);
        println!("R agreed on {cells} values");
    } else {
        missing("R with DBI and RSQLite");
    }
}

#[test]
fn pandas_and_r_answer_every_question_as_sql_does() {
    let folder = tempfile::tempdir().unwrap();
    examples::fill_store(folder.path());
    let (sql, silent) = answers_of_sql(folder.path());
    assert!(silent.is_empty(), "questions whose answer in SQL has no rows: {silent:?}");
    println!("SQL answered {} questions", sql.len());
    all_agree(folder.path(), &sql);
}

#[test]
fn questions_that_a_store_cannot_answer_stop_nobody() {
    let folder = tempfile::tempdir().unwrap();
    examples::fill_with_quickstart(folder.path());
    let (sql, silent) = answers_of_sql(folder.path());
    // The store has no other experiments, failures, shared jobs or second attempts.
    assert_eq!(silent, [14, 16, 17, 20, 22, 24, 25, 26, 27]);
    all_agree(folder.path(), &sql);
}

/// Creates `jitai.sqlite` in a folder, with a quickstart that sweeps a key of every kind: environment,
/// agent, budget and evaluation.
fn fill_with_every_kind_of_sweep(folder: &Path) {
    let text = examples::manifest_of_short_jobs("quickstart", "sigma = 0.6\ndelta_d = [0.1, 0.2]")
        .replace("episodes = 20\nlayers = [8]", "episodes = [10, 20]\nlayers = [[8], [4, 4]]")
        .replace(
            "test_episodes = 20",
            "test_episodes = 20\ntest_actions = [\"as_trained\", \"greedy\"]",
        );
    fs::write(folder.join("quickstart.toml"), text).unwrap();
    examples::run(folder, &["run", "quickstart.toml"], 0);
}

#[test]
fn no_recipe_pools_jobs_that_differ_in_another_parameter_than_seed() {
    let folder = tempfile::tempdir().unwrap();
    fill_with_every_kind_of_sweep(folder.path());
    let (sql, silent) = answers_of_sql(folder.path());
    assert_eq!(silent, [14, 16, 17, 20, 22, 24, 25, 26, 27]);
    let answer = |number: usize| &sql[number - 1].1;
    let column = |number: usize, name: &str| -> Vec<String> {
        let table = answer(number);
        let at = table.columns.iter().position(|column| column == name).unwrap();
        table.rows.iter().map(|row| row[at].clone()).collect()
    };
    // Two scenarios, and two values each of environment, agent, budget and evaluation.
    let cells = 2 * 2 * 2 * 2;
    for number in [1, 18] {
        assert_eq!(column(number, "seeds"), vec!["2"; 2 * 2 * cells], "question {number}");
    }
    for (number, rows) in [(2, 2 * cells), (3, 2 * cells * 2), (4, 2 * cells), (5, 4 * cells)] {
        assert_eq!(answer(number).rows.len(), rows, "question {number}");
    }
    for number in [6, 13] {
        assert_eq!(answer(number).rows.len(), 4 * cells * 2, "question {number}");
    }
    for number in [7, 8, 11] {
        assert_eq!(answer(number).rows.len(), 4 * cells, "question {number}");
    }
    let first = &column(1, "label")[0];
    for name in ["delta_d=", "layers=", "episodes=", "test_actions="] {
        assert!(first.contains(name), "{first}");
    }
    all_agree(folder.path(), &sql);
}

/// Every number in a JSON value, in its order.
fn numbers(of: &serde_json::Value) -> Vec<f64> {
    match of {
        serde_json::Value::Number(number) => number.as_f64().into_iter().collect(),
        serde_json::Value::Array(list) => list.iter().flat_map(numbers).collect(),
        serde_json::Value::Object(table) => table.values().flat_map(numbers).collect(),
        _ => Vec::new(),
    }
}

/// A fast test compares the estimates of `emee` with these numbers.
#[test]
fn numbers_of_mrtanalysis_are_those_of_the_package() {
    let library = fs::canonicalize("target/analysis/R").unwrap_or_default();
    let mut script = Command::new("Rscript");
    script.env("R_LIBS", &library);
    let is_there = script.args(["-e", "library(MRTAnalysis)"]).output();
    if !is_there.is_ok_and(|output| output.status.success()) {
        // It is on CRAN and not in Debian, so that a machine with Debian's packages alone may lack it.
        return eprintln!(
            "left out: MRTAnalysis: not at hand; `make analysis` installs it where CRAN answers"
        );
    }
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("emee.json");
    let mut script = Command::new("Rscript");
    script.env("R_LIBS", &library).arg("tests/reference/emee.R").arg(&file);
    let output = script.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let read = |path: &Path| -> serde_json::Value {
        serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
    };
    let written = numbers(&read(&file)["cases"]);
    let recorded = numbers(&read(Path::new("tests/reference/emee.json"))["cases"]);
    assert_eq!(written.len(), recorded.len());
    for (one, other) in written.iter().zip(&recorded) {
        assert!((one - other).abs() <= 1e-6 * other.abs().max(1.0), "{one} and {other}");
    }
    println!("MRTAnalysis gave {} numbers", written.len());
}

/// A trial with availability and a budget, whose agent `random` is this.
fn limited_trial(agent: &str) -> String {
    format!(
        "format = 1\nname = \"trial\"\nscenarios = [\"P-H-D\"]\nseeds = 1\n\
         [environment]\nsigma = 0.6\navailability = 0.7\nmessage_budget = 12\nepsilon_d = 0.05\n\
         [evaluation]\nrecord_decisions = \"test\"\ntest_episodes = 8000\n\
         [[agent]]\nname = \"random\"\n{agent}\n"
    )
}

/// With a correct method, 95 % of the intervals of 200 trials contain the true effect, with a standard
/// error of 1.5 percentage points.
#[test]
fn intervals_of_excursion_effects_hold_the_exact_effect() {
    let Some(python) = python() else { return missing("pandas") };
    let shipped = fs::read_to_string("experiments/trial.toml").unwrap();
    let uniform = shipped.replace("seeds = 3", "seeds = 1") + "test_episodes = 8000\n";
    // Probabilities that vary with the state: a bandit after ten people.
    let bandit = "algorithm = \"linear_thompson\"\nepisodes = 10\nprior_sd = 100\npi_min = 0.05\n\
                  action_bias = [0, -50, -50, -50]";
    let limited = [bandit, "algorithm = \"rule\"\nrule = \"random\""].map(limited_trial);
    for text in [uniform].into_iter().chain(limited) {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("trial.toml"), text).unwrap();
        examples::run(folder.path(), &["run", "trial.toml", "--quiet"], 0);
        let mut script = Command::new(&python);
        script.arg("docs/excursion.py").arg(folder.path().join("jitai.sqlite"));
        let output = script.output().unwrap();
        let said = String::from_utf8_lossy(&output.stdout);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let last = said.lines().last().unwrap();
        let share = last.strip_prefix("200 trials of 40 people: ").unwrap();
        let share: f64 = share.split_once(' ').unwrap().0.parse().unwrap();
        assert!((93.0..=97.0).contains(&share), "{said}");
        print!("{said}");
    }
}

/// A small trial of Oralytics with invented people, who enter in two groups, and this agent.
fn pooled_trial(agent: &str) -> String {
    format!(
        "format = 1\nname = \"pooled\"\nseeds = 1\n\
         scenarios = [[\"time_of_day\", \"brushing\", \"app\"]]\n\
         [trial]\npeople = 16\ndays = 14\ndecisions_per_day = 2\nmissing_outcomes = 0.1\n\
         entry = {{ every_days = 7, people = 8 }}\nupdate = {{ every_days = 7, first_day = 7 }}\n\
         [environment]\nfamily = \"declared\"\nmodel = \"oralytics_v2\"\npeople = \"synthetic_v2.csv\"\ndays = 14\n\
         [evaluation]\non = \"trial\"\n\
         [[agent]]\nname = \"thompson\"\nalgorithm = \"linear_thompson\"\nprior_sd = 60\nnoise_sd = 60\n{agent}\n\
         [[estimate]]\nname = \"effect\"\ncontrol = [\"average_brushing\"]\nmoderators = [\"app_before\"]\n\
         standard_errors = \"after_study\"\n"
    )
}

/// A Python that has lifejacket: from `LIFEJACKET_PYTHON`, or from `make analysis`.
fn lifejacket() -> Option<PathBuf> {
    let named = env::var_os("LIFEJACKET_PYTHON").map(PathBuf::from);
    let candidates = [named, Some("target/lifejacket/bin/python".into())];
    let has = |path: &PathBuf| answers(path.as_os_str(), &["-c", "import lifejacket"]);
    candidates.into_iter().flatten().find(has)
}

#[test]
fn standard_errors_after_a_study_are_those_of_lifejacket() {
    let Some(python) = lifejacket() else { return missing("lifejacket") };
    let agents = [
        "pi_min = 0.1",
        "features = \"interactions\"\npi_min = 0.05\naction_bias = [0, 10]",
        "action_centring = true\nallocation = \"logistic\"\nlogistic_slope = 0.1\npi_min = 0.1",
    ];
    for agent in agents {
        let folder = tempfile::tempdir().unwrap();
        fs::copy("experiments/oralytics/synthetic_v2.csv", folder.path().join("synthetic_v2.csv"))
            .unwrap();
        fs::write(folder.path().join("trial.toml"), pooled_trial(agent)).unwrap();
        let export = ["export", "--after-study", "trial.toml", "--out", "out"];
        examples::run(folder.path(), &export, 0);
        let output = Command::new(&python).arg(folder.path().join("out/analysis.py")).output();
        let output = output.unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let result = fs::read_to_string(folder.path().join("out/result.json")).unwrap();
        let theirs: serde_json::Value = serde_json::from_str(&result).unwrap();
        let manifest = manifest::load(&folder.path().join("trial.toml")).unwrap();
        let planned = plan::jobs(&manifest).next().unwrap();
        let declaration = &manifest.estimates_of(&planned.agent)[0];
        let covariance =
            after_study_covariance(&planned.job, declaration, Correction::None, &|| false).unwrap();
        let size = covariance.len().isqrt();
        let rows = theirs.as_array().unwrap();
        assert_eq!(rows.len(), size);
        for (index, row) in rows.iter().enumerate() {
            let ours = covariance[index * size + index].sqrt();
            let [after, nominal] =
                ["after_study", "nominal"].map(|name| row[name].as_f64().unwrap());
            assert!((ours / after - 1.0).abs() < 1e-6, "{agent}: {ours}, {row}");
            assert!((after / nominal - 1.0).abs() > 1e-3, "the learning makes a difference: {row}");
        }
        print!("lifejacket's standard errors with `{agent}`:\n{result}\n");
    }
}

/// A second experiment, which runs while the first is watched.
const WATCHED: &str = "format = 1
name = \"watched\"
extends = \"paper\"
scenarios = [\"P-H-D\"]
seeds = 40
environment.sigma = 0.6
[[agent]]
name = \"dqn\"
episodes = 60
layers = [8]
[[agent]]
name = \"reinforce\"
episodes = 60
layers = [8]
";

#[test]
fn datasette_answers_every_question_as_jitai_does_while_a_sweep_runs() {
    let python = python().filter(|path| answers(path.as_os_str(), &["-c", "import datasette"]));
    let Some(python) = python else { return missing("datasette") };
    let folder = tempfile::tempdir().unwrap();
    examples::fill_store(folder.path());
    let (sql, _) = answers_of_sql(folder.path());
    let experiments: Vec<String> = questions()
        .iter()
        .map(|question| format!("{}={}", question.slug(), question.experiment().unwrap_or("")))
        .collect();
    fs::write(folder.path().join("watched.toml"), WATCHED).unwrap();
    let mut script = Command::new(python);
    script.arg("tests/documents/ask_datasette.py").arg(env!("CARGO_BIN_EXE_jitai"));
    script.arg(folder.path().join("watched.toml")).arg(experiments.join("\n"));
    let cells = agree(&mut script, folder.path(), &sql);
    println!("datasette agreed on {cells} values");
}

/// Questions that DuckDB answers only after a change, as docs/browse.md describes.
#[cfg(feature = "parquet")]
const OTHERWISE_IN_DUCKDB: [usize; 3] = [13, 25, 27];

#[cfg(feature = "parquet")]
#[test]
fn duckdb_answers_from_parquet_as_jitai_does_from_the_store() {
    let python = python().filter(|path| answers(path.as_os_str(), &["-c", "import duckdb"]));
    let Some(python) = python else { return missing("duckdb") };
    let folder = tempfile::tempdir().unwrap();
    examples::fill_store(folder.path());
    examples::run(folder.path(), &["export", "--out", "results", "--format", "parquet"], 0);
    let (mut sql, _) = answers_of_sql(folder.path());
    sql.retain(|(number, _)| !OTHERWISE_IN_DUCKDB.contains(number));
    let numbers: Vec<String> = sql.iter().map(|(number, _)| number.to_string()).collect();
    let queries: serde_json::Map<String, serde_json::Value> = questions()
        .into_iter()
        .map(|question| (question.number.to_string(), question.sql.into()))
        .collect();
    let file = folder.path().join("queries.json");
    fs::write(&file, serde_json::Value::from(queries).to_string()).unwrap();
    let mut script = Command::new(python);
    script.arg("tests/documents/ask_duckdb.py").arg(numbers.join(",")).arg(file);
    let cells = agree(&mut script, folder.path(), &sql);
    println!("duckdb agreed on {cells} values");
}

/// A pandas script that checks that the Parquet files contain the same data as the CSV files.
#[cfg(feature = "parquet")]
const SAME_FRAMES: &str = "
import pathlib, sys
import pandas as pd
for path in sorted(pathlib.Path(sys.argv[1]).glob('*.parquet')):
    columns = pd.read_parquet(path)
    texts = {'value': str} if path.stem == 'parameter' else None
    lines = pd.read_csv(path.with_suffix('.csv'), dtype=texts, float_precision='round_trip')
    if path.stem == 'arm_summary':
        # Empty where nothing is swept, which a CSV file cannot tell from missing.
        lines['label'] = lines['label'].fillna('')
    pd.testing.assert_frame_equal(columns, lines, check_dtype=False, check_exact=True)
    print(path.name, *columns.shape)
";

#[cfg(feature = "parquet")]
#[test]
fn pandas_reads_the_same_from_parquet_as_from_csv() {
    let folder = tempfile::tempdir().unwrap();
    examples::fill_store(folder.path());
    for format in ["csv", "parquet"] {
        let arguments = ["export", "--out", "views", "--format", format];
        assert!(examples::jitai(folder.path(), arguments).status.success());
    }
    let python = python().filter(|path| answers(path.as_os_str(), &["-c", "import pyarrow"]));
    let Some(python) = python else {
        return missing("pandas with pyarrow");
    };
    let mut script = Command::new(python);
    let output = script.args(["-c", SAME_FRAMES]).arg(folder.path().join("views")).output();
    let output = output.unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let said = String::from_utf8_lossy(&output.stdout);
    assert_eq!(said.lines().count(), jitai::store::VIEWS.len(), "{said}");
    print!("pandas read from Parquet what it reads from CSV:\n{said}");
}
