//! `check`, `plan` and `schema`: their output about manifests before anything runs.

use std::time::{Duration, Instant};

use jitai::job::Versions;
use rusqlite::Connection;
use serde_json::{Value, json};

use crate::support::{Effort, Folder, assert_within, manifest};

const FAULTY: &str = "format = 1
name = \"faulty\"
scenarios = [\"P-H-D\", \"X\"]
seeds = 2
[environment]
siggma = 0.6
[[agent]]
name = \"r\"
algorithm = \"reinforce\"
episodes = \"many\"
";

#[test]
fn check_says_how_many_jobs_a_good_manifest_makes() {
    let folder = Folder::with(&manifest("sweep", "[0.4, 0.6]", "2", Effort::Trivial));
    let check = folder.jitai(["check", "sweep.toml"]).succeeded();
    assert_eq!(
        (check.stdout.as_str(), check.stderr.as_str()),
        ("sweep.toml: ok, 2 agents × 1 scenario × 2 sigma × 2 seeds = 8 jobs\n", "")
    );
    assert_eq!(
        folder.jitai(["check", "sweep.toml", "--format", "json"]).succeeded().json(),
        json!([])
    );
    assert!(!folder.path("jitai.sqlite").exists());
}

#[test]
fn check_reports_every_fault_of_every_manifest() {
    let folder = Folder::with(&manifest("sweep", "0.6", "1", Effort::Trivial));
    folder.write("faulty.toml", FAULTY);
    let check = folder.jitai(["check", "faulty.toml", "sweep.toml", "none.toml"]).ended(2);
    let check = check
        .says("faulty.toml:3:23: `scenarios`: `X` is not a feature")
        .says("faulty.toml:6:1: unknown key `siggma` in [environment]")
        .says("did you mean `sigma`?")
        .says("faulty.toml:10:12: `episodes`: expected a whole number")
        .says("3 faults in faulty.toml")
        .says("none.toml: no such file");
    assert!(check.stdout.ends_with(" = 2 jobs\n"), "{}", check.stdout);
}

#[test]
fn check_gives_faults_to_programs_with_file_line_and_column() {
    let folder = Folder::new();
    folder.write("faulty.toml", FAULTY);
    let check = folder.jitai(["check", "--format", "json", "faulty.toml", "none.toml"]).ended(2);
    let faults = check.json();
    let places: Vec<_> = faults
        .as_array()
        .unwrap()
        .iter()
        .map(|fault| [&fault["file"], &fault["line"], &fault["column"]].map(Value::clone))
        .collect();
    let expected = [
        [json!("faulty.toml"), json!(3), json!(23)],
        [json!("faulty.toml"), json!(6), json!(1)],
        [json!("faulty.toml"), json!(10), json!(12)],
        [json!("none.toml"), json!(null), json!(null)],
    ];
    assert_eq!(places, expected);
    assert_eq!(faults[1]["help"], "did you mean `sigma`?");
    assert_eq!(check.stderr, "");
}

#[test]
fn run_and_plan_refuse_a_faulty_manifest_as_check_does_and_make_no_store() {
    let folder = Folder::new();
    folder.write("faulty.toml", FAULTY);
    let check = folder.jitai(["check", "faulty.toml"]).ended(2);
    for verb in ["run", "plan"] {
        assert_eq!(folder.jitai([verb, "faulty.toml"]).ended(2).stderr, check.stderr);
    }
    assert!(!folder.path("jitai.sqlite").exists());
}

#[test]
fn manifests_of_one_name_are_not_taken_together() {
    let folder = Folder::with(&manifest("twin", "0.4", "1", Effort::Trivial));
    folder.write("other.toml", manifest("twin", "0.6", "1", Effort::Trivial));
    let run = folder.jitai(["run", "sweep.toml", "other.toml"]).ended(2);
    run.says("sweep.toml and other.toml have the same name, \"twin\"");
    let check = folder.jitai(["check", "sweep.toml", "other.toml"]).ended(2);
    check.says("sweep.toml and other.toml have the same name, \"twin\"");
}

#[test]
fn plan_counts_the_jobs_and_makes_no_store() {
    let folder = Folder::with(&manifest("sweep", "[0.4, 0.6]", "2", Effort::Trivial));
    let plan = folder.jitai(["plan", "sweep.toml", "--format", "json"]).succeeded();
    let plan = plan.says("8 jobs to run: about 0 s with ");
    let plan = plan.says("estimated from built-in speeds; no run has been timed yet").json();
    let expected = json!([{
        "experiment": "sweep", "jobs": 8, "completed": 0, "running": 0, "failed": 0,
        "interrupted": 0, "pending": 8, "seconds_left": 0.0,
    }]);
    assert_eq!(plan, expected);
    assert!(!folder.path("jitai.sqlite").exists());
}

#[test]
fn plan_knows_what_is_done_and_estimates_the_rest() {
    let folder = Folder::completed(&manifest("sweep", "[0.4, 0.6]", "2", Effort::Trivial));
    folder.jitai(["plan", "sweep.toml"]).succeeded().says("nothing to run");
    folder.write("sweep.toml", manifest("sweep", "[0.4, 0.6]", "3", Effort::Trivial));
    let arguments = ["plan", "sweep.toml", "--workers", "3", "--format", "json"];
    let plan =
        folder.jitai(arguments).succeeded().says("with 3 workers, estimated from earlier runs");
    let plan = plan.json();
    assert_eq!((&plan[0]["completed"], &plan[0]["pending"]), (&json!(8), &json!(4)));
    assert!(plan[0]["seconds_left"].as_f64().unwrap() >= 0.0, "{plan}");
}

/// The jobs of a manifest, with keys, agents, sigmas and seeds.
fn jobs(folder: &Folder, arguments: &[&str]) -> Vec<Value> {
    let all = ["plan", "--jobs", "--format", "json"].iter().chain(arguments).copied();
    folder.jitai(all).succeeded().json().as_array().unwrap().clone()
}

#[test]
fn plan_lists_jobs_as_the_run_makes_them() {
    let folder = Folder::with(&manifest("sweep", "[0.4, 0.6]", "2", Effort::Trivial));
    let jobs = jobs(&folder, &["sweep.toml"]);
    assert_eq!(jobs.len(), 8);
    assert!(jobs.iter().all(|job| job["state"] == "pending" && job["scenario"] == "P-H-D"));
    folder.jitai(["run", "sweep.toml"]).succeeded();
    for job in jobs {
        let found: i64 = folder
            .store()
            .query_row(
                "SELECT count(*) FROM run_summary
                 WHERE job_key = ?1 AND agent = ?2 AND sigma = ?3 AND seed = ?4",
                (
                    job["job_key"].as_str(),
                    job["agent"].as_str(),
                    job["sigma"].as_f64(),
                    job["seed"].as_i64(),
                ),
                |row| row.get(0),
            )
            .unwrap();
        assert_eq!(found, 1, "{job}");
    }
}

#[test]
fn jobs_are_named_by_what_the_manifest_sweeps() {
    let rates = manifest("sweep", "0.6", "2", Effort::Trivial)
        .replace("layers = [32, 32]", "layers = [32, 32]\nlearning_rate = [1e-3, 5e-4]");
    let folder = Folder::with(&rates);
    let listed = jobs(&folder, &["sweep.toml"]);
    assert_eq!(listed[0]["swept"], json!({ "agent.learning_rate": 0.001 }));
    assert_eq!(listed[5]["swept"], json!({}));
    let table = folder.jitai(["plan", "sweep.toml", "--jobs"]).succeeded();
    table.prints("learning_rate=0.001 ").prints("learning_rate=0.0005 ");
    let run = folder.jitai(["run", "sweep.toml"]).succeeded();
    run.says("dqn P-H-D sigma=0.6 seed=2 learning_rate=0.0005 (")
        .says("reinforce P-H-D sigma=0.6 seed=1 (");
}

#[test]
fn a_resolved_manifest_declares_the_same_jobs() {
    let folder = Folder::new();
    folder.write(
        "short.toml",
        "format = 1\nname = \"short\"\nextends = \"paper\"\nscenarios = [\"P-H-D\", \"C-T\"]\n\
         environment.sigma = { from = 0.4, to = 1.0, step = 0.2 }\n\
         [[exclude]]\nscenario = \"C-T\"\nagent.name = \"dqn\"\n",
    );
    let resolved = folder.jitai(["plan", "short.toml", "--resolved"]).succeeded().stdout;
    assert!(resolved.contains("learning_rate = 0.0005"), "{resolved}");
    assert!(!resolved.contains("extends"), "{resolved}");
    folder.write("resolved.toml", resolved);
    let short = jobs(&folder, &["short.toml"]);
    assert_eq!(short.len(), 36);
    assert_eq!(jobs(&folder, &["resolved.toml"]), short);
}

#[test]
fn a_filter_picks_jobs_by_any_parameter() {
    let folder = Folder::with(&manifest("sweep", "[0.4, 0.6, 1]", "2", Effort::Trivial));
    for (filter, count) in [
        ("agent=dqn", 6),
        ("sigma=0.4|1.0", 8),
        ("agent=reinforce,environment.sigma=0.60,seed=2", 1),
        ("algorithm=reinforce", 6),
        ("agent.name=reinforce", 6),
        ("layers=[32,32],sigma=1", 2),
    ] {
        assert_eq!(jobs(&folder, &["sweep.toml", "--filter", filter]).len(), count, "{filter}");
    }
}

#[test]
fn a_wrong_filter_is_refused_with_what_there_is() {
    let folder = Folder::with(&manifest("sweep", "0.6", "1", Effort::Trivial));
    for verb in ["plan", "run"] {
        let unknown = folder.jitai([verb, "sweep.toml", "--filter", "siggma=0.6"]).ended(2);
        unknown.says("no job has a parameter `siggma`").says("environment.sigma");
        for form in ["sigma", "sigma=", "=0.6", "agent=dqn,,", "layers=[32],32]"] {
            let wrong = folder.jitai([verb, "sweep.toml", "--filter", form]).ended(2);
            wrong.says("expected `name=value`");
        }
        let comma = folder.jitai([verb, "sweep.toml", "--filter", "sigma=0,6"]).ended(2);
        comma.says("write `sigma=0.6` for one number, and `sigma=0|6` for either value");
        let list = folder.jitai([verb, "sweep.toml", "--filter", "sigma=0.4,0.6"]).ended(2);
        list.says("a list; write `sigma=0.4|0.6` for either value");
        let nobody = folder.jitai([verb, "sweep.toml", "--filter", "sigma=0.6,agent=dqm"]).ended(2);
        nobody
            .says("no job with sigma=0.6 has agent=dqm, did you mean dqn?; its values: dqn, reinf");
        let nowhere = folder.jitai([verb, "sweep.toml", "--filter", "sigma=7"]).ended(2);
        nowhere.says("no job has sigma=7, did you mean 0.6?; its values: 0.6");
        let partly = folder.jitai([verb, "sweep.toml", "--filter", "agent=reinforce|dq"]).ended(2);
        partly.says("no job has agent=dq, did you mean dqn?; its values: dqn, reinforce");
    }
    assert!(!folder.path("jitai.sqlite").exists());
}

#[test]
fn a_filter_has_to_meet_a_job_of_any_manifest_not_of_each() {
    let folder = Folder::with(&manifest("sweep", "0.6", "1", Effort::Trivial));
    folder.write("other.toml", manifest("other", "0.4", "1", Effort::Trivial));
    for verb in ["plan", "run"] {
        let filter = [verb, "sweep.toml", "other.toml", "--filter", "sigma=0.4,agent=dqn"];
        folder.jitai(filter).succeeded().says("1 job ");
    }
    assert_eq!(folder.runs(), 1);
}

#[test]
fn plan_and_run_count_a_job_that_manifests_share_once() {
    let folder = Folder::completed(&manifest("sweep", "0.4", "2", Effort::Trivial));
    folder.write("wide.toml", manifest("wide", "[0.4, 0.6]", "3", Effort::Trivial));
    folder.write("other.toml", manifest("other", "0.6", "3", Effort::Trivial));
    let manifests = ["sweep.toml", "wide.toml", "other.toml"];
    let plan = folder.jitai(["plan", "--format", "json"].into_iter().chain(manifests)).succeeded();
    // Of 4, 12 and 6 jobs, 4 belong to the first two manifests, and 6 belong to the last two.
    let plan = plan.says("10 jobs are shared between the manifests and run once");
    let plan = plan.says("8 jobs to run: about ");
    let counted = |row: &Value| (row["jobs"].as_u64(), row["pending"].as_u64());
    let rows: Vec<_> = plan.json().as_array().unwrap().iter().map(counted).collect();
    assert_eq!(rows, [(Some(4), Some(0)), (Some(12), Some(8)), (Some(6), Some(6))]);
    let run = folder.jitai(["run"].into_iter().chain(manifests)).succeeded();
    run.says("8 jobs run, 12 completed in all, 0 failed");
    let plan = folder.jitai(["plan"].into_iter().chain(manifests)).succeeded();
    assert!(plan.says("nothing to run").stderr.lines().count() == 2);
}

#[test]
fn plan_knows_what_is_done_of_many_jobs() {
    let folder = Folder::completed(&manifest("sweep", "0.6", "2", Effort::Trivial));
    folder.write("sweep.toml", manifest("sweep", "0.6", "6000", Effort::Trivial));
    let begun = Instant::now();
    let plan = folder.jitai(["plan", "sweep.toml", "--format", "json"]).succeeded();
    assert_within(Duration::from_secs(5), begun);
    let row = &plan.says("11996 jobs to run: about").json()[0];
    assert_eq!((&row["jobs"], &row["completed"]), (&json!(12_000), &json!(4)));
    let listed = jobs(&folder, &["sweep.toml"]);
    assert_eq!(listed.len(), 12_000);
    let completed = listed.iter().filter(|job| job["state"] == "completed");
    assert_eq!(completed.map(|job| &job["seed"]).collect::<Vec<_>>(), [1, 2, 1, 2]);
}

#[test]
fn the_time_of_an_outside_program_is_not_known_before_it_has_run() {
    let agent = "[[agent]]\nname = \"program\"\nalgorithm = \"external\"\ncommand = [\"sh\", \"-c\", \
                 \"exit 3\"]\nversion = \"1\"\nepisodes = 5\n";
    let rule = "[[agent]]\nname = \"rule\"\nalgorithm = \"rule\"\nrule = \"never\"\n";
    let head = "format = 1\nname = \"sweep\"\nscenarios = [\"P-H-D\"]\nseeds = 2\nenvironment.sigma = 0.6\n\
                evaluation.test_episodes = 2\n";
    let folder = Folder::with(&format!("{head}{rule}{agent}"));
    let plan = || folder.jitai(["plan", "sweep.toml", "--format", "json", "--workers", "1"]);
    // The times of other jobs say nothing about a program.
    folder.jitai(["run", "sweep.toml", "--filter", "agent=rule"]).succeeded();
    let plan = plan().succeeded();
    let plan = plan.says("2 jobs to run with 1 worker; how long is not known");
    assert_eq!(plan.json()[0]["seconds_left"], json!(null));
    let rules = ["plan", "sweep.toml", "--filter", "agent=rule", "--format", "json"];
    assert_eq!(folder.jitai(rules).succeeded().json()[0]["seconds_left"], json!(0.0));
}

#[test]
fn one_thing_is_named_in_the_singular() {
    let folder = Folder::with(&manifest("sweep", "0.6", "1", Effort::Trivial));
    let one = ["--filter", "agent=dqn", "--workers", "1"];
    let verb = |verb| folder.jitai([verb, "sweep.toml"].into_iter().chain(one)).succeeded();
    verb("plan").says("1 job to run: about 0 s with 1 worker, estimated from built-in speeds");
    verb("run").says("1 job run, 1 completed in all, 0 failed");
    verb("run").says("nothing to run: the job is completed");
    folder.write("sweep.toml", manifest("sweep", "0.6", "[2]", Effort::Trivial));
    verb("plan").says("1 job to run: about").says("with 1 worker, estimated from earlier runs");
    let only = "[[exclude]]\nagent.name = \"dqn\"\n";
    folder.write("sweep.toml", manifest("sweep", "0.6", "1", Effort::Trivial) + only);
    folder.jitai(["check", "sweep.toml"]).succeeded().prints(" = 1 job\n");
}

#[test]
fn the_schema_is_json_and_the_one_that_is_shipped() {
    let folder = Folder::new();
    let schema = folder.jitai(["schema"]).succeeded();
    assert_eq!(schema.json()["type"], "object");
    assert_eq!(schema.stdout, include_str!("../../docs/manifest.schema.json"));
}

#[test]
fn set_gives_keys_other_values_and_the_store_keeps_the_text() {
    let folder = Folder::with(&manifest("sweep", "0.6", "2", Effort::Trivial));
    let set = ["--set", "sigma=[0.4, 0.8, 1.0]", "--set", "seeds=1"];
    let verb = |verb| folder.jitai([verb, "sweep.toml"].into_iter().chain(set));
    verb("check").succeeded().prints("2 agents × 1 scenario × 3 sigma × 1 seed = 6 jobs");
    verb("plan").succeeded().says("6 jobs to run");
    let run = verb("run").succeeded().says("6 jobs run, 6 completed in all, 0 failed");
    run.prints("sweep.toml --set 'sigma=[0.4, 0.8, 1.0]' --set 'seeds=1' --out report");
    let store = Connection::open(folder.path("jitai.sqlite")).unwrap();
    let text: String =
        store.query_row("SELECT manifest FROM experiment", [], |row| row.get(0)).unwrap();
    assert!(text.ends_with("# --set sigma=[0.4, 0.8, 1.0] --set seeds=1\n"), "{text}");
    folder.write("stored.toml", text);
    folder.jitai(["run", "stored.toml"]).succeeded().says("nothing to run");
    let refused = folder.jitai(["plan", "sweep.toml", "--set", "siggma=1"]).ended(2);
    refused.says("sweep.toml: --set siggma=1: no key `siggma`").says("did you mean `sigma`?");
    let refused = folder.jitai(["plan", "sweep.toml", "--set", "dqn.episodes=7"]).ended(2);
    refused.says("did you mean `agent.dqn.episodes`?");
    for (set, expected) in [
        ("sigma=0,4", "`sigma`: a decimal comma; numbers have a decimal point"),
        ("sigma=0.4,0.6", "write sigma = [0.4, 0.6]"),
        ("sigma=[0,4, 0,6]", "sigma = [0.4, 0.6]"),
        ("agent.episodes=1 000", "found \"1 000\""),
    ] {
        let refused = folder.jitai(["plan", "sweep.toml", "--set", set]).ended(2);
        refused.says(&format!("--set {set}")).says(expected);
    }
    folder.jitai(["plan", "sweep.toml", "--set", "sigma=[1,2]"]).succeeded();
    folder.jitai(["plan", "sweep.toml", "--set", "question=1, 2 or 3"]).succeeded();
    let refused = folder.jitai(["plan", "sweep.toml", "--set", "sigma"]).ended(2);
    refused.says("expected a key, an equals sign and a value");
}

/// A manifest with a curve along sigma and a comma in the name of an agent.
const WITH_A_CURVE: &str = "format = 1
name = \"curve\"
scenarios = [\"P-H-D\"]
seeds = 1
evaluation.test_episodes = 5
[environment]
sigma = [
  0.4,
  0.8,
]
[[agent]]
name = \"never, ever|x\"
algorithm = \"rule\"
rule = \"never\"
[[agent]]
name = \"random\"
algorithm = \"rule\"
rule = \"random\"
[[analysis]]
name = \"along-sigma\"
kind = \"curve\"
x = \"environment.sigma\"
[[analysis]]
name = \"difference\"
kind = \"contrast\"
by = \"agent.name\"
between = [\"random\", \"never, ever|x\"]
";

#[test]
fn an_analysis_that_loses_its_axis_to_an_option_is_left_out_with_a_hint() {
    let folder = Folder::with(WITH_A_CURVE);
    let hint = "sweep.toml: hint: analysis `along-sigma` is left out: `environment.sigma` is not swept: it \
                has one value";
    let one = ["--set", "sigma=0.4"];
    for verb in [&["check"][..], &["plan"], &["run", "-q"], &["report", "--out", "report"]] {
        let arguments = verb.iter().chain(&["sweep.toml"]).chain(&one).copied();
        folder.jitai(arguments).succeeded().says(hint);
    }
    assert!(folder.path("report/tables/curve-difference.csv").exists());
    assert!(!folder.path("report/tables/curve-along-sigma.csv").exists());
    let resolved = folder.jitai(["plan", "sweep.toml", "--resolved", "--set", "sigma=0.4"]);
    folder.write("resolved.toml", resolved.succeeded().stdout);
    folder.jitai(["check", "resolved.toml"]).succeeded().prints("2 jobs");
    // In the file itself, the analysis is at fault.
    folder.write("sweep.toml", WITH_A_CURVE.replace("  0.8,\n", ""));
    let fault = "sweep.toml:21:5: `environment.sigma` is not swept";
    folder.jitai(["check", "sweep.toml"]).ended(2).says(fault);
    folder.jitai(["run", "sweep.toml"]).ended(2).says(fault);
}

#[test]
fn a_fault_of_an_option_names_the_option_and_other_faults_their_lines_of_the_file() {
    let folder = Folder::with(&format!("{WITH_A_CURVE}[[exclude]]\nenvironment.sigma = 0.8\n"));
    let set = |option| folder.jitai(["check", "sweep.toml", "--set", option]).ended(2).stderr;
    let said = set("sigma=-1");
    assert!(said.starts_with("sweep.toml: --set sigma=-1: `sigma`: expected a number"), "{said}");
    // The edited text has four lines fewer.
    let said = set("sigma=0.4");
    let fault =
        "sweep.toml:29:21: no cell to exclude has `environment.sigma` = 0.8\n  29 | environment.s";
    assert!(said.starts_with(fault), "{said}");
}

#[test]
fn a_faulty_file_of_rows_does_not_hide_a_missing_file_of_published_numbers() {
    let folder = Folder::with(&WITH_A_CURVE.replace(
        "seeds = 1\n",
        "seeds = 1\npublished = \"none.toml\"\npopulation.rows = \"none.csv\"\n",
    ));
    folder
        .jitai(["check", "sweep.toml"])
        .ended(2)
        .says("sweep.toml:5:13: `published`: `none.toml` cannot be read")
        .says("sweep.toml:6:19: `rows`: `none.csv` cannot be read")
        .says("2 faults in sweep.toml");
}

#[test]
fn a_quoted_value_of_a_filter_may_contain_commas_and_bars() {
    let folder = Folder::with(WITH_A_CURVE);
    let plan =
        |filter| folder.jitai(["plan", "sweep.toml", "--format", "json", "--filter", filter]);
    let jobs = |filter| plan(filter).succeeded().json()[0]["jobs"].clone();
    assert_eq!(jobs("agent=\"never, ever|x\""), 2);
    assert_eq!(jobs("sigma=0.4, agent = \"never, ever|x\"|random"), 2);
    assert_eq!(jobs("agent=\"random\",sigma=\"0.4\"|0.8"), 2);
    plan("agent=\"never, ever|y\"")
        .ended(2)
        .says("no job has agent=\"never, ever|y\", did you mean \"never, ever|x\"?");
    plan("agent=\"never").ended(2).says("a value with a comma or a bar has double quotes");
    folder.jitai(["plan", "--help"]).succeeded().prints("stands in double quotes");
}

#[test]
fn hints_name_what_probably_differs_from_the_intent() {
    let folder = Folder::with(
        "format = 1\nname = \"h\"\nscenarios = [\"P-T\"]\nseeds = 1\nenvironment.sigma = [40, 80]\n\
         [[agent]]\nname = \"out\"\nalgorithm = \"external\"\n\
         command = [[\"no-such-program\"], [\"sh\", \"-e\", \"gone.sh\"], [\"sh\", \"here.sh\"]]\n\
         version = \"1\"\n[[agent]]\nname = \"ppo\"\nalgorithm = \"ppo\"\nepisodes = 100\n",
    );
    folder.write("here.sh", "");
    folder
        .jitai(["check", "sweep.toml"])
        .succeeded()
        .says("hint: `environment.sigma` = 40 is 40 times")
        .says("40 % is written 0.4")
        .says("hint: `command` of agent out cannot start on this machine: no-such-program is in no")
        .says("hint: `command` of agent out cannot start on this machine: gone.sh does not exist")
        .says("hint: agent ppo learns from at most 7 rollouts");
}

#[test]
fn check_names_the_letters_that_no_figure_can_draw() {
    let with = |label: &str| {
        format!(
            "format = 1\nname = \"агент λ\"\nscenarios = \"P-T\"\nseeds = 1\nenvironment.sigma = 0.4\n\
             [[agent]]\nname = \"Señal\"\nlabel = \"{label}\"\nalgorithm = \"rule\"\nrule = \"tailored\"\n"
        )
    };
    let folder = Folder::with(&with("日本 règle"));
    folder
        .jitai(["check", "sweep.toml"])
        .succeeded()
        .says("show a box for 日 (U+65E5), 本 (U+672C); their font has");
    folder.write("sweep.toml", with("règle"));
    let said = folder.jitai(["check", "sweep.toml"]).succeeded().stderr;
    assert!(!said.contains("a box for"), "{said}");
}

#[test]
fn a_plan_names_a_default_that_has_changed_since_the_jobs_were_completed() {
    let with = |keys: &str| {
        format!(
            "format = 1\nname = \"sweep\"\nscenarios = [\"C\"]\nseeds = 2\nenvironment.sigma = 0.4\n\
             evaluation.test_episodes = 1\n[[agent]]\nname = \"ppo\"\nalgorithm = \"ppo\"\nepisodes = 1\n\
             layers = [4]\n{keys}"
        )
    };
    let folder = Folder::with(&with("at_horizon = \"termination\"\n"));
    folder.jitai(["run", "sweep.toml", "--quiet"]).succeeded();
    folder.write("sweep.toml", with(""));
    let plan = folder.jitai(["plan", "sweep.toml"]).succeeded();
    plan.says("2 jobs to run, of ppo with at_horizon = \"truncation\", which is the default now")
        .says("to keep those results, write at_horizon = \"termination\" in the agent");
    let jobs = folder.jitai(["plan", "sweep.toml", "--jobs"]).succeeded();
    jobs.prints("at_horizon = \"truncation\" is the new default of ppo");
    // A manifest that keeps the former default has nothing to run.
    folder.write("sweep.toml", with("at_horizon = \"termination\"\n"));
    folder.jitai(["plan", "sweep.toml"]).succeeded().says("nothing to run");
}

#[test]
fn a_plan_names_a_new_default_beside_a_new_version_of_the_algorithm() {
    let with = |keys: &str| {
        format!(
            "format = 1\nname = \"sweep\"\nscenarios = [\"C\"]\nseeds = 2\nenvironment.sigma = 0.4\n\
             environment.availability = 0.5\nevaluation.test_episodes = 1\n[[agent]]\nname = \"ppo\"\n\
             algorithm = \"ppo\"\nepisodes = 1\nlayers = [4]\n{keys}"
        )
    };
    let folder = Folder::with(&with("at_horizon = \"termination\"\n"));
    folder.jitai(["run", "sweep.toml", "--quiet"]).succeeded();
    // As if the version before had completed the jobs.
    let store = Connection::open(folder.path("jitai.sqlite")).unwrap();
    let fixed = "SELECT sql FROM sqlite_schema WHERE name = 'job_is_fixed'";
    let trigger: String = store.query_row(fixed, [], |row| row.get(0)).unwrap();
    store.execute_batch("DROP TRIGGER job_is_fixed").unwrap();
    let mut jobs = store.prepare("SELECT id, algorithm_version, canonical FROM job").unwrap();
    let rows = jobs.query_map([], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?))).unwrap();
    let mut version = 0;
    for (id, now, canonical) in rows.collect::<rusqlite::Result<Vec<(i64, u32, String)>>>().unwrap()
    {
        version = now;
        let before = Versions { environment: 1, algorithm: now - 1 };
        let key = before.key_of(&canonical).to_string();
        let update = "UPDATE job SET key = ?2, algorithm_version = ?3 WHERE id = ?1";
        store.execute(update, (id, key, before.algorithm)).unwrap();
    }
    store.execute_batch(&trigger).unwrap();
    let plan = || folder.jitai(["plan", "sweep.toml"]).succeeded();
    let changed = format!("2 jobs to run again: ppo changed: {} → {version}", version - 1);
    assert!(!plan().says(&changed).stderr.contains("new default"));
    folder.write("sweep.toml", with(""));
    plan().says(&format!("{changed}, at_horizon = \"truncation\" is the new default of ppo"));
}
