//! Did it learn: posteriors at updates, and trials with and without an effect.

use std::fs;

use crate::support::Folder;

/// A message has 40 steps in `effect`, and none in the trials without.
const MANIFEST: &str = r#"format = 1
name = "learned"
scenarios = ["C-H"]
seeds = 40
zip = [["environment.rho_1", "environment.rho_2"]]

[environment]
horizon = 12
sigma = 0
epsilon_d = 0
epsilon_h = 0.01
rho_1 = [40, 0]
rho_2 = [40, 0]
step_noise = "gamma"
sigma_s = 30

[trial]
people = 8
days = 6
decisions_per_day = 2

[evaluation]
on = "trial"
record_posteriors = true

[[agent]]
name = "thompson"
algorithm = "linear_thompson"
pi_min = 0.1
prior_sd = 50
noise_sd = 40

[[analysis]]
name = "chance"
kind = "did_it_learn"
states = [[0, 0.1], [1, 0.5]]
without = { environment.rho_1 = 0 }
"#;

#[test]
fn learned_effects_stand_beside_those_of_trials_without_an_effect() {
    let folder = Folder::completed(MANIFEST);
    // Two arms of 40 trials with five updates and three messages each.
    assert_eq!(folder.number("SELECT count(*) FROM posterior"), 80 * 5 * 3);
    let shape = "SELECT count(*) FROM posterior WHERE json_array_length(mean) = 3 AND json_array_length(covariance) = 9";
    assert_eq!(folder.number(shape), 80 * 5 * 3);
    assert_eq!(folder.number("SELECT count(DISTINCT step) FROM posterior WHERE step % 2 = 0"), 5);
    folder.jitai(["report", "sweep.toml", "--out", "report"]).succeeded();
    let csv = folder.read("report/tables/learned-chance.csv");
    let mut reader = csv::Reader::from_reader(csv.as_bytes());
    let rows: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
    assert_eq!(rows.len(), 2, "{csv}");
    let headers = csv::Reader::from_reader(csv.as_bytes()).headers().unwrap().clone();
    let cell = |row: usize, name: &str| {
        let index = headers.iter().position(|one| one == name).unwrap();
        rows[row][index].to_owned()
    };
    let number = |row: usize, name: &str| cell(row, name).parse::<f64>().unwrap();
    for row in 0..2 {
        assert_eq!([cell(row, "trials"), cell(row, "trials_without")], ["40", "40"]);
        assert!(number(row, "statistic") > number(row, "without"), "{csv}");
        assert!(number(row, "rejected") > 0.5, "{csv}");
    }
    assert_eq!(cell(0, "state"), "(0, 0.1)");
    let page = folder.read("report/index.html");
    assert!(page.contains("of chance in 2."));
    let figures = fs::read_dir(folder.path("report/figures")).unwrap();
    let names = figures.map(|file| file.unwrap().file_name().into_string().unwrap());
    assert_eq!(
        names.filter(|name| name.starts_with("learned-chance-") && name.ends_with(".svg")).count(),
        2
    );
}

#[test]
fn what_cannot_be_compared_says_what_to_do() {
    let folder = Folder::new();
    let faults = |from: &str, to: &str| {
        folder.write("faulty.toml", MANIFEST.replace(from, to));
        folder.jitai(["check", "faulty.toml"])
    };
    faults("record_posteriors = true\n", "")
        .says("kind \"did_it_learn\" needs the posteriors at the updates of a trial")
        .says("write record_posteriors = true in [evaluation]");
    faults("without = { environment.rho_1 = 0 }\n", "")
        .says("missing key `without` in an [[analysis]] of kind \"did_it_learn\"");
    let few = faults("seeds = 40", "seeds = 39").succeeded();
    few.says("judges a trial by 38 without the effect").says("write seeds = 40 or more");
    assert!(!faults("seeds = 40", "seeds = 40").succeeded().stderr.contains("without the effect"));
    faults("[1, 0.5]", "[1]").says("the state [1.0] does not have a value for each feature");
    faults("states = [[0, 0.1], [1, 0.5]]", "states = [0, 1]")
        .says("`states`: expected a list of states, each a list of numbers");
}
