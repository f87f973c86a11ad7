//! `optimum`, and rules as agents of a sweep.

use serde_json::Value;

use crate::support::Folder;

fn rows(folder: &Folder, arguments: &[&str]) -> Vec<Value> {
    let all = ["optimum", "--format", "json"].iter().chain(arguments).copied();
    folder.jitai(all).succeeded().json().as_array().unwrap().clone()
}

#[test]
fn optima_are_printed_for_scenarios_and_sigmas_with_their_error() {
    let folder = Folder::new();
    let sampled = ["--set", "first_context=sampled", "--sigma", "0.6,2"];
    let rows = rows(&folder, &[&["--scenario", "P-H-D,L-H-D"][..], &sampled].concat());
    let known = [
        ("P-H-D", 0.6, 2879.0),
        ("P-H-D", 2.0, 1603.0),
        ("L-H-D", 0.6, 2254.0),
        ("L-H-D", 2.0, 1457.0),
    ];
    assert_eq!(rows.len(), known.len());
    for (row, (scenario, sigma, optimum)) in rows.iter().zip(known) {
        assert_eq!((&row["scenario"], &row["sigma"]), (&scenario.into(), &sigma.into()));
        assert!((row["optimum"].as_f64().unwrap() - optimum).abs() < 3.0, "{row}");
        assert!(row["optimum_error"].as_f64().unwrap() < 0.1, "{row}");
    }
}

#[test]
fn arguments_without_an_optimum_are_refused() {
    let folder = Folder::new();
    let refused = |arguments: &[&str]| {
        let refused = folder.jitai(["optimum"].iter().chain(arguments).copied()).ended(2);
        assert_eq!(refused.stdout, "");
        refused
    };
    refused(&["--scenario", "P-H-D,P-T"]).says("no optimum is computed for P-T");
    refused(&["--set", "horizon=201"]).says("for a horizon of 201 steps; the maximum is 200");
    refused(&["--scenario", "X"]).says("`X` is not a feature");
    refused(&["--sigma=-1"]).says("expected a number from 0 to 1000000, found -1");
    refused(&["--sigma", "0.4,x"]).says("--sigma x: `sigma`: expected a number");
    refused(&["--sigma", "1\nhorizon = 3"]).says("expected a value on one line");
    refused(&["--set", "horizn=3"]).says("did you mean `horizon`?");
    refused(&["--set", "sigma=0.4"]).says("use --sigma");
    refused(&["--set", "horizon=3", "--set", "horizon=4"]).says("`horizon` is set twice");
}

/// Several rules in a scenario with an optimum and in a scenario without one.
const RULES: &str = "format = 1
name = \"rules\"
scenarios = [\"P-H-D\", \"P-T\"]
seeds = 2
environment.sigma = 0.6
environment.horizon = [10, 20]
evaluation.test_episodes = 50
[[agent]]
name = \"careful\"
algorithm = \"rule\"
rule = \"threshold\"
threshold = [0.6, 0.9]
[[agent]]
name = \"plain\"
algorithm = \"rule\"
rule = [\"never\", \"untailored\", \"tailored\", \"random\", \"optimal\"]
[[exclude]]
scenario = \"P-T\"
agent.rule = \"optimal\"
";

#[test]
fn a_manifests_optima_are_printed_and_where_there_is_none() {
    let folder = Folder::with(RULES);
    let told = folder.jitai(["optimum", "sweep.toml", "--format", "json"]).succeeded();
    let told = told.says("no optimum is computed for P-T");
    let rows = told.json();
    let rows = rows.as_array().unwrap();
    assert_eq!(rows.len(), 4, "two scenarios, two horizons");
    for row in rows {
        assert_eq!(row["experiment"], "rules");
        assert_eq!(row["optimum"].is_null(), row["scenario"] == "P-T", "{row}");
    }
    assert!(rows[0]["optimum"].as_f64().unwrap() < rows[1]["optimum"].as_f64().unwrap());
    assert_eq!((&rows[0]["horizon"], &rows[1]["horizon"]), (&10.into(), &20.into()));
}

#[test]
fn long_horizons_have_no_optimum_and_reports_say_so() {
    let folder = Folder::with(
        "format = 1\nname = \"long\"\nscenarios = [\"P-H-D\"]\nseeds = 2\nenvironment.sigma = 0.6\n\
         environment.horizon = [8, 201]\nevaluation.test_episodes = 20\n\
         [[agent]]\nname = \"plain\"\nalgorithm = \"rule\"\nrule = \"tailored\"\n",
    );
    let told = folder.jitai(["optimum", "sweep.toml", "--format", "json"]).succeeded();
    let rows = told.says("for a horizon of 201 steps; the maximum is 200").json();
    assert!(rows[0]["optimum"].is_f64() && rows[1]["optimum"].is_null(), "{rows}");
    folder.jitai(["run", "sweep.toml"]).succeeded();
    folder.jitai(["report", "sweep.toml", "--out", "report"]).succeeded();
    let arms = folder.read("report/tables/long-arms.csv");
    let mut lines = arms.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let optimum = lines.next().unwrap().iter().position(|name| *name == "optimum").unwrap();
    let known: Vec<bool> = lines.map(|fields| fields[optimum].parse::<f64>().is_ok()).collect();
    assert_eq!(known, [true, false], "{arms}");
    assert!(folder.read("report/index.html").contains("no optimum computed"));
    let long = ["simulate", "--policy", "optimal", "--set", "horizon=201"];
    folder.jitai(long).ended(2).says("for a horizon of 201 steps; the maximum is 200");
}

#[test]
fn rules_are_jobs_like_others_and_run_once() {
    let folder = Folder::with(RULES);
    folder.jitai(["run", "sweep.toml", "--filter", "rule=random"]).succeeded();
    // At this point, some rules are done and others are left.
    for verb in [&["status"][..], &["plan", "sweep.toml"], &["run", "sweep.toml"]] {
        folder.jitai(verb.iter().copied()).succeeded();
    }
    // Two scenarios, two horizons and two seeds; seven rules, one of which is missing in one scenario.
    let count = "SELECT count(*) FROM run_summary WHERE status = 'completed'";
    let store = folder.store();
    let number = |sql: &str| store.query_row(sql, [], |row| row.get::<_, i64>(0)).unwrap();
    assert_eq!(number(count), 8 * 7 - 4);
    assert_eq!(number("SELECT count(*) FROM learning_curve"), 0);
    assert_eq!(
        number(
            "SELECT count(DISTINCT value) FROM parameter WHERE name = 'agent.threshold' \
        AND job_key IN (SELECT job_key FROM run_summary WHERE agent = 'careful')"
        ),
        2
    );
    let again = folder.jitai(["run", "sweep.toml"]).succeeded();
    again.says("nothing to run: all 52 jobs are completed");
    folder.jitai(["plan", "sweep.toml"]).succeeded();
    let key: String = store
        .query_row("SELECT min(job_key) FROM run_summary WHERE agent = 'careful'", [], |row| {
            row.get(0)
        })
        .unwrap();
    let policy = format!("run:{key}");
    folder.jitai(["simulate", "--policy", &policy]).succeeded();
    let greedy = folder.jitai(["simulate", "--policy", &policy, "--greedy"]).ended(2);
    greedy.says("--greedy applies to trained policies only");
    let optimal: String = store
        .query_row(
            "SELECT min(job_key) FROM parameter WHERE name = 'agent.rule' AND value = 'optimal'",
            [],
            |row| row.get(0),
        )
        .unwrap();
    let policy = format!("run:{optimal}");
    folder.jitai(["simulate", "--policy", &policy, "--set", "horizon=200"]).succeeded();
    let long = folder.jitai(["simulate", "--policy", &policy, "--set", "horizon=201"]).ended(2);
    long.says("for a horizon of 201 steps");
}

#[test]
fn a_report_says_how_much_of_a_loss_is_won_back() {
    let of_environment = |name: &str, keys: &str| {
        format!(
            "format = 1\nname = \"{name}\"\nscenarios = [\"P-T\", \"P-H-D\"]\nseeds = 3\n{keys}\
             environment.sigma = [0.4, 0.6]\nevaluation.test_episodes = 20\n\
             [[agent]]\nname = \"plain\"\nalgorithm = \"rule\"\nrule = \"tailored\"\n\
             [[agent]]\nname = \"never\"\nalgorithm = \"rule\"\nrule = \"never\"\n\
             [[analysis]]\nname = \"tailoring\"\nkind = \"recovery\"\n\
             with = {{ agent.name = \"plain\", scenario = \"P-T\" }}\n\
             without = {{ agent.name = \"never\", scenario = \"P-T\" }}\n"
        )
    };
    let folder = Folder::with(&of_environment("won", ""));
    // No optimum can be computed with noise.
    folder.write("noisy.toml", of_environment("noisy", "environment.state_noise = \"uniform\"\n"));
    folder.jitai(["run", "sweep.toml", "noisy.toml"]).succeeded();
    folder.jitai(["report", "sweep.toml", "noisy.toml", "--out", "report"]).succeeded();
    let table = folder.read("report/tables/won-tailoring.csv");
    let mut lines = table.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let header = lines.next().unwrap();
    let rows: Vec<_> = lines.collect();
    assert_eq!(rows.len(), 2, "one for each sigma: {table}");
    for row in rows {
        let number = |name: &str| -> f64 {
            let index = header.iter().position(|column| *column == name).unwrap();
            row[index].parse().unwrap_or_else(|_| panic!("{name}: {table}"))
        };
        let (with, without) = (number("return_with"), number("return_without"));
        let share = (with - without) / (number("optimum") - without);
        assert!((number("recovered") - share).abs() < 1e-9, "{table}");
        assert!(number("low") < share && share < number("high"), "{table}");
    }
    let page = folder.read("report/index.html");
    let page = page.replace("<span class=\"whole\">P-T</span>", "P-T");
    assert!(page.contains("Of what never P-T loses against the optimum of "));
    assert!(page.contains("plain P-T recovers "));
    assert!(page.contains("2 of 2 shares (no optimum known"));
}
