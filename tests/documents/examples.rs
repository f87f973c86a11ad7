//! The store of the documents' examples: short jobs in experiments with the names in the documents.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use jitai::store::SqlValue;

/// A value of an answer as text; empty for NULL.
pub fn cell(value: &SqlValue<'_>) -> String {
    match value {
        SqlValue::Null => String::new(),
        SqlValue::Integer(number) => number.to_string(),
        SqlValue::Real(number) => number.to_string(),
        SqlValue::Text(text) => (*text).to_owned(),
        SqlValue::Blob(bytes) => panic!("no view has bytes: {bytes:?}"),
    }
}

/// The output of `jitai` in a folder.
pub fn jitai<'a>(folder: &Path, arguments: impl IntoIterator<Item = &'a str>) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_jitai"));
    command.args(arguments).current_dir(folder).env_remove("JITAI_STORE").output().unwrap()
}

/// A manifest of short jobs under a name from the documents.
pub fn manifest_of_short_jobs(name: &str, environment: &str) -> String {
    format!(
        "format = 1
name = \"{name}\"
extends = \"paper\"
scenarios = [\"P-H-D\", \"L-H-D\"]
seeds = 2
[environment]
{environment}
[[agent]]
name = \"dqn\"
episodes = 20
layers = [8]
[[agent]]
name = \"reinforce\"
episodes = 20
layers = [8]
[evaluation]
curve_stride = 1
test_episodes = 20
"
    )
}

/// A manifest with a rule that needs no training, in the cells of the quickstart.
fn manifest_of_the_optimum() -> String {
    "format = 1
name = \"reference\"
scenarios = [\"P-H-D\", \"L-H-D\"]
seeds = 2
environment.sigma = [0.4, 0.6]
[[agent]]
name = \"optimal\"
algorithm = \"rule\"
rule = \"optimal\"
"
    .to_owned()
}

/// A manifest with one job, whose loss overflows.
fn manifest_that_diverges() -> String {
    format!(
        "format = 1
name = \"too-fast\"
scenarios = [\"P-H-D\"]
seeds = 1
environment.sigma = 0.6
[[agent]]
name = \"wild\"
algorithm = \"dueling_dqn\"
episodes = 50
layers = [{}]
batch = 8
learning_rate = 1.0
",
        ["64"; 24].join(", ")
    )
}

/// Creates `jitai.sqlite` in a folder, with the quickstart alone.
pub fn fill_with_quickstart(folder: &Path) {
    let text = manifest_of_short_jobs("quickstart", "sigma = [0.4, 0.6]");
    fs::write(folder.join("quickstart.toml"), text).unwrap();
    run(folder, &["run", "quickstart.toml"], 0);
}

/// The manifest of the trial in docs/decisions.md, with few episodes.
fn manifest_of_the_trial() -> String {
    let shipped = fs::read_to_string("experiments/trial.toml").unwrap();
    format!("{shipped}test_episodes = 200\n")
}

/// A manifest with participants who differ, and with agents that need no training.
fn manifest_of_people() -> &'static str {
    "format = 1
name = \"population\"
scenarios = [\"P-H-D\"]
seeds = 2
environment.sigma = 0.6
evaluation.test_episodes = 50
[population]
epsilon_d = [{ uniform = [0.0, 0.4] }, { uniform = [0.4, 0.8] }]
[[agent]]
name = \"tailored\"
algorithm = \"rule\"
rule = \"tailored\"
"
}

/// A trial whose agent learns on its third and fifth day.
pub const LEARNED: &str = r#"format = 1
name = "learned"
scenarios = ["C"]
seeds = 1
environment = { sigma = 0.4, horizon = 5 }
evaluation = { on = "trial", record_decisions = "test", record_posteriors = true }
trial = { people = 3, days = 5, pooling = ["full", "partial"], update = { every_days = 2 } }
[[agent]]
name = "thompson"
algorithm = "linear_thompson"
prior_sd = 100
noise_sd = 100
"#;

/// Creates `jitai.sqlite` in a folder, with the experiments of the documents' questions: two share
/// jobs, and one fails and is run again.
pub fn fill_store(folder: &Path) {
    fill_with_quickstart(folder);
    let manifests = [
        ("probabilities", manifest_of_short_jobs("probabilities", "sigma = 0.6"), 0),
        (
            "disengagement",
            manifest_of_short_jobs("disengagement", "sigma = 0.6\ndelta_d = [0.1, 0.2]"),
            0,
        ),
        ("reference", manifest_of_the_optimum(), 0),
        ("trial", manifest_of_the_trial(), 0),
        ("learned", LEARNED.to_owned(), 0),
        ("population", manifest_of_people().to_owned(), 0),
        ("too-fast", manifest_that_diverges(), 1),
    ];
    for (name, text, code) in manifests {
        let file = format!("{name}.toml");
        fs::write(folder.join(&file), text).unwrap();
        run(folder, &["run", &file], code);
    }
    run(folder, &["run", "too-fast.toml", "--retry-failed"], 1);
}

/// Runs `jitai` in a folder, and expects this exit code.
pub fn run(folder: &Path, arguments: &[&str], code: i32) {
    let output = jitai(folder, arguments.iter().copied());
    let told = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {told}");
}
