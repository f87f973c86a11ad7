//! Worlds that a model file declares: checked, tried, simulated, run in a trial, merged and reported.

use crate::support::Folder;

const MODEL: &str = include_str!("../../experiments/models/ten_lines.toml");

const MANIFEST: &str = r#"
format = 1
name = "walks"
scenarios = ["all", ["dose"]]
seeds = 2
[environment]
family = "declared"
model = "world.toml"
parameters = { effect = [3, 5] }
[trial]
people = 6
days = 30
[evaluation]
on = "trial"
record_decisions = "test"
[[agent]]
name = "bandit"
algorithm = "linear_thompson"
[[agent]]
name = "random"
algorithm = "rule"
rule = "random"
[[estimate]]
name = "effect"
agents = ["random"]
control = ["dose"]
truth = true
[[estimate]]
name = "plain"
agents = ["random"]
truth = true
[[estimate]]
name = "on_minutes"
agents = ["random"]
outcome = "minutes"
truth = true
"#;

fn folder(model: &str) -> Folder {
    let folder = Folder::with(MANIFEST);
    folder.write("world.toml", model);
    folder
}

#[test]
fn a_trial_in_a_declared_world_is_run_queried_merged_and_reported() {
    let folder = folder(MODEL);
    folder.jitai(["check", "sweep.toml"]).succeeded();
    folder.jitai(["run", "sweep.toml"]).succeeded().says("16 completed");
    // 16 trials of 6 people with 30 decisions. What follows the action is recorded with it.
    let same = "SELECT count(*) FROM decision WHERE json_extract(state, '$.minutes') = reward";
    assert_eq!(folder.number(same), 16 * 6 * 30);
    let differ = "SELECT count(*) FROM decision WHERE json_extract(state, '$.dose') = reward";
    assert_eq!(folder.number(differ), 0);
    // An outcome by its name is the reward, in every estimate and truth.
    let alike = "SELECT count(*) FROM estimate AS one JOIN estimate AS other USING (job_key) WHERE one.name = 'plain' \
                 AND other.name = 'on_minutes' AND one.estimate = other.estimate AND one.truth = other.truth";
    assert_eq!(folder.number(alike), 8);
    assert_eq!(
        folder.number("SELECT count(*) FROM estimate WHERE failure IS NULL AND name = 'effect'"),
        8
    );
    folder.jitai(["merge", "--store", "b.sqlite", "jitai.sqlite"]).succeeded();
    folder.jitai(["doctor", "--store", "b.sqlite"]).succeeded();
    folder.jitai(["report", "sweep.toml", "--store", "b.sqlite", "--out", "report"]).succeeded();
    assert!(folder.read("report/index.html").contains("minutes of walking"));
}

#[test]
fn the_days_of_people_are_drawn_from_recorded_decisions() {
    let days = "[[analysis]]\nname = \"days\"\nkind = \"days\"\nwhere = { agent.name = \"bandit\" }\npeople = [1, 6]\n\
                variables = [\"dose\", \"reward\"]\n";
    let folder = Folder::with(&format!("{MANIFEST}{days}"));
    folder.write("world.toml", MODEL);
    folder.jitai(["run", "sweep.toml"]).succeeded();
    folder.jitai(["report", "sweep.toml", "--out", "report"]).succeeded();
    // Two scenarios and two effects, each with the first of two seeds: two people, two variables, 30 decisions.
    let table = folder.read("report/tables/walks-days.csv");
    assert_eq!(table.lines().count(), 1 + 4 * 2 * 2 * 30, "{table}");
    let of_store = "SELECT count(*) FROM decision AS d JOIN arm_summary AS s USING (job_key) WHERE s.agent = 'bandit' \
                    AND s.seed = 1 AND d.episode IN (1, 6) AND d.action = 1";
    let marked = table.lines().filter(|line| line.contains(",1,dose,")).count();
    assert_eq!(marked as i64, folder.number(of_store));
    let figure = folder.read("report/figures/walks-days.svg");
    assert!(figure.contains("person 6") && figure.contains(">dose<"), "{figure}");
    // What does not exist is a fault, or is said.
    let none = days.replace("[1, 6]", "[1, 7]");
    folder.write("none.toml", format!("{MANIFEST}{none}"));
    folder
        .jitai(["check", "none.toml"])
        .ended(2)
        .says("there is no person 7: the test or trial has 6");
    let unknown = days.replace("\"reward\"]", "\"minuets\"]");
    folder.write("unknown.toml", format!("{MANIFEST}{unknown}"));
    folder.jitai(["report", "unknown.toml", "--out", "other"]).succeeded();
    let page = folder.read("other/index.html");
    assert!(page.contains("`minuets` is not recorded"), "{page}");
    let silent = MANIFEST.replace("record_decisions = \"test\"\n", "");
    folder.write("silent.toml", format!("{silent}{days}"));
    folder
        .jitai(["check", "silent.toml"])
        .ended(2)
        .says("kind \"days\" needs the decisions of the test or trial")
        .says("write record_decisions = \"test\"");
}

#[test]
fn upper_quartiles_are_the_same_whether_episodes_or_quartiles_are_stored() {
    let quartile = "[[analysis]]\nname = \"upper\"\nkind = \"contrast\"\nmetric = \"upper_quartile_return\"\nby = \"agent\"\n\
                    between = [\"bandit\", \"random\"]\n";
    let of_episodes = MANIFEST.replace("record_decisions = \"test\"\n", "");
    let table = |settings: &str| {
        let text = of_episodes.replace("on = \"trial\"\n", &format!("on = \"trial\"\n{settings}"));
        let folder = Folder::with(&format!("{text}{quartile}"));
        folder.write("world.toml", MODEL);
        folder.jitai(["run", "sweep.toml"]).succeeded();
        folder.jitai(["report", "sweep.toml", "--out", "report"]).succeeded();
        folder.read("report/tables/walks-upper.csv")
    };
    let both = "record_episodes = \"none\"\nrecord_quartiles = \"both\"\n";
    assert_eq!(table(""), table(both));
    // What nobody records, and what does nothing, are faults; some jobs with episodes are enough.
    for (settings, code, says) in [
        ("record_episodes = \"none\"\n", 2, "records the metric \"upper_quartile_return\""),
        ("record_quartiles = \"both\"\n", 2, "does nothing with record_episodes = \"all\""),
        ("record_episodes = [\"all\", \"none\"]\n", 0, "32 jobs"),
    ] {
        let text = of_episodes.replace("on = \"trial\"\n", &format!("on = \"trial\"\n{settings}"));
        let folder = Folder::with(&format!("{text}{quartile}"));
        folder.write("world.toml", MODEL);
        let checked = folder.jitai(["check", "sweep.toml"]).ended(code);
        let _ = if code == 0 { checked.prints(says) } else { checked.says(says) };
    }
}

#[test]
fn a_model_is_no_manifest_and_its_variables_may_have_names_of_columns() {
    let folder = folder(MODEL);
    let said = folder.jitai(["check", "world.toml"]).ended(2);
    said.says("this is a model, not a manifest")
        .says("jitai simulate --model world.toml")
        .says("1 fault");
    // Both stand in the table, the reward under the name of its role.
    let model = MODEL.replace("minutes = {", "reward = {").replace("\"minutes\"", "\"reward\"");
    folder.write("named.toml", model);
    let rows =
        folder.jitai(["simulate", "--model", "named.toml", "--episodes", "1", "--format", "csv"]);
    rows.succeeded().prints("person,step,can_send,action,dose,reward,outcome,roles.reward");
}

#[test]
fn faults_of_a_model_stand_beside_those_of_its_manifest() {
    let faulty = MODEL
        .replace("effect - 2 * dose", "efect - 2 * dos")
        .replace("days = 30", "days = 30\nday = 2");
    let folder = folder(&faulty);
    let faults = folder.jitai(["check", "sweep.toml"]).ended(2);
    let says = faults.says("world.toml:6:1: a model has no key `day`").says("did you mean `days`?");
    says.says("`model`: `").says("has 1 fault");
    // Names are judged beside the file of people, once the model can be read.
    folder.write("world.toml", MODEL.replace("effect - 2 * dose", "efect - 2 * dos"));
    let faults = folder.jitai(["check", "sweep.toml"]).ended(2);
    faults
        .says("`efect` is not declared")
        .says("did you mean `effect`?")
        .says("`dos` is not declared");
    let folder = self::folder(MODEL);
    folder.write(
        "sweep.toml",
        MANIFEST.replace("effect = [3, 5]", "efect = 3").replace("[\"dose\"]", "[\"dos\"]"),
    );
    let faults = folder.jitai(["check", "sweep.toml"]).ended(2);
    faults.says("the model has no parameter `efect`").says("`dos` is not a feature of the model");
}

#[test]
fn a_world_whose_numbers_run_out_is_found_before_and_named_when_it_runs() {
    let unbounded = MODEL.replace("{ name = \"dose\", low = 0, high = 5 }", "\"dose\"");
    let explodes = unbounded.replace("0.8 * default(dose[-1], 0)", "30 * default(dose[-1], 1)");
    let folder = self::folder(&explodes);
    folder.jitai(["check", "--try", "sweep.toml"]).ended(2).says("explodes: it is");
    folder.write(
        "world.toml",
        explodes.replace("\"dose\"", "{ name = \"dose\", low = 0, high = 5 }"),
    );
    let left = "`dose` is 30, expected a number from 0 to 5, its bounds in [roles] for person 1";
    folder.jitai(["check", "--try", "sweep.toml"]).ended(2).says(left);
    let missing = MODEL.replace("default(action[-1], 0)", "if(step == 12, log(0), 0)");
    folder.write("world.toml", missing);
    folder
        .jitai(["check", "--try", "sweep.toml"])
        .ended(2)
        .says("`dose` is missing for person 1 at decision 12");
    folder
        .jitai(["run", "sweep.toml"])
        .ended(1)
        .says("`dose` is missing for person 1 at decision 12");
    assert_eq!(folder.number("SELECT count(*) FROM run WHERE failure_kind = 'diverged'"), 16);
}

#[test]
fn people_of_a_model_are_simulated_with_every_variable() {
    let folder = folder(MODEL);
    let simulated = ["simulate", "--model", "world.toml", "--episodes", "2", "--format", "csv"];
    let rolled = folder.jitai(simulated).succeeded();
    let lines: Vec<&str> = rolled.stdout.lines().collect();
    assert_eq!(lines[0], "person,step,can_send,action,dose,minutes,outcome,reward");
    assert_eq!(lines.len(), 1 + 2 * 30);
    assert!(lines[1].starts_with("1,0,1,") && lines[60].starts_with("2,29,1,"));
    let never = folder
        .jitai(simulated.into_iter().chain(["--policy", "never", "--set", "effect=9"]))
        .succeeded();
    assert!(
        never
            .stdout
            .lines()
            .skip(1)
            .all(|line| line.contains(",1,0,0.0,") || line.contains(",1,0,0,"))
    );
    folder
        .jitai(["simulate", "--model", "world.toml", "--policy", "tailored"])
        .ended(2)
        .says("random, never or fixed");
    folder
        .jitai(["simulate", "--model", "world.toml", "--set", "efect=9"])
        .ended(2)
        .says("no parameter `efect`");
}

#[test]
fn faults_of_files_that_options_name_are_said_of_the_options() {
    let folder = folder(include_str!("../../experiments/models/noisy_dose.toml"));
    let people = include_str!("../../experiments/models/noisy_dose_people.csv");
    folder.write("people.csv", people);
    for (rows, said) in [
        (None, "= name a CSV file, as in --rows rows.csv"),
        (Some(""), "`--rows`: `rows.csv`, expected a line of names and at least one row below it"),
        (Some("person,load\n"), "expected a line of names and at least one row below it"),
        (Some("person,lod\na,1\n"), "options: `--rows` has no column `load`"),
        (Some("person,load\na,x\n"), "options: `--rows`: line 2 has `x` in column `load`"),
    ] {
        let mut arguments = vec!["simulate", "--model", "world.toml", "--people", "people.csv"];
        if let Some(rows) = rows {
            folder.write("rows.csv", rows);
            arguments.extend(["--rows", "rows.csv"]);
        }
        folder.jitai(arguments).ended(2).says(said);
    }
    folder.write("rows.csv", "person,load\na,1\n");
    folder
        .jitai(["simulate", "--model", "world.toml", "--rows", "rows.csv"])
        .ended(2)
        .says("name their file: --people people.csv");
}

#[test]
fn parameters_of_a_preset_stand_beside_those_of_a_manifest_and_all_can_be_set() {
    let folder = Folder::with(
        "format = 1\nname = \"t\"\nextends = \"oralytics_v2\"\nseeds = 1\n[environment]\nfamily = \"declared\"\n\
         people = \"people.csv\"\nparameters = { habituation_factor = [0, 0.5] }\n",
    );
    folder.write("people.csv", include_str!("../../experiments/oralytics/synthetic_v2.csv"));
    let plan = ["plan", "sweep.toml", "--resolved"];
    let resolved = folder.jitai(plan).succeeded();
    resolved.prints("habituation_factor = [0, 0.5]").prints("stale_state = 1");
    let set = |setting: &'static str| {
        let arguments = plan.into_iter().chain(["--set", setting]);
        folder.jitai(arguments)
    };
    // A parameter of the manifest, of the preset, and of the model alone.
    set("environment.parameters.habituation_factor=1").succeeded().prints("habituation_factor = 1");
    set("environment.parameters.stale_state=0").succeeded().prints("stale_state = 0");
    set("environment.parameters.smaller=1").succeeded().prints("smaller = 1");
    set("environment.parameters.smalle=1").ended(2).says("did you mean `smaller`?");
}

#[test]
fn a_state_without_an_effect_needs_a_trial_in_this_state() {
    let folder = Folder::with(
        "format = 1\nname = \"t\"\nextends = \"oralytics_v4\"\nseeds = 40\n\
         zip = [[\"environment.parameters.no_effect\", \"environment.parameters.no_effect_brushing\", \
         \"environment.parameters.no_effect_app\"]]\n\
         scenarios = [[\"brushing\", \"app\"]]\n[environment]\nfamily = \"declared\"\npeople = \"people.csv\"\n\
         [environment.parameters]\nno_effect = [0, 1, 1]\nno_effect_brushing = [0, 0.1, -0.7]\n\
         no_effect_app = [0, 1, 0]\n[evaluation]\nrecord_posteriors = true\n\
         [[agent]]\nname = \"thompson\"\nbaseline_means = [0, 0, 0]\nbaseline_sds = [30, 30, 30]\neffect_means = [0, 0, 0]\neffect_sds = [30, 30, 30]\n\
         [[analysis]]\nname = \"learned\"\nkind = \"did_it_learn\"\nstates = [[0.1, 1], [-0.7, 0]]\n\
         without = { environment.parameters.no_effect = 1 }\n\
         without_at = [\"environment.parameters.no_effect_brushing\", \"environment.parameters.no_effect_app\"]\n",
    );
    folder.write("people.csv", include_str!("../../experiments/oralytics/synthetic_v4.csv"));
    folder.jitai(["check", "sweep.toml"]).succeeded();
    let text = folder.read("sweep.toml");
    // Each number occurs, in another trial.
    folder.write("sweep.toml", text.replace("[-0.7, 0]]", "[-0.7, 1]]"));
    let says = "no trial has the state [-0.7, 1.0] in the parameters of `without_at`";
    folder.jitai(["check", "sweep.toml"]).ended(2).says(says);
    folder.write("sweep.toml", text.replace("[-0.7, 0]]", "[-0.7]]"));
    folder.jitai(["check", "sweep.toml"]).ended(2).says("does not have a value for each feature");
}
