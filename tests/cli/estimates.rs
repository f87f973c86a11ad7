//! Estimates of causal effects: at the end of a job, and added to completed jobs.

use crate::support::{Folder, until};

const MANIFEST: &str = r#"format = 1
name = "trial"
scenarios = ["P-H-D"]
seeds = 2
environment.sigma = 0.4

[evaluation]
test_episodes = 40

[[agent]]
name = "random"
algorithm = "rule"
rule = "random"

[[agent]]
name = "thompson"
algorithm = "linear_thompson"
episodes = 20
pi_min = 0.1
"#;

const ESTIMATES: &str = r#"
[[estimate]]
name = "effect"
control = ["habituation", "disengagement", "step"]
moderators = ["habituation"]

[[estimate]]
name = "each"
treatment = "each message"
numerator = 0.75

[[estimate]]
name = "later"
outcome = "habituation"
treatment = 2
agents = "random"
"#;

fn texts(folder: &Folder, sql: &str) -> Vec<String> {
    let store = folder.store();
    let mut statement = store.prepare(sql).unwrap();
    let texts = statement.query_map([], |row| row.get(0)).unwrap();
    texts.collect::<Result<_, _>>().unwrap()
}

/// The rows of estimates, with all digits.
fn estimates(folder: &Folder) -> Vec<String> {
    texts(
        folder,
        "SELECT concat_ws(' ', job_key, name, number, term, printf('%!.17g %!.17g %!.17g %!.17g %!.17g %!.17g', estimate,
            standard_error, degrees_of_freedom, low, high, p_value), failure) FROM every_estimate ORDER BY job_key, name, number",
    )
}

fn digests(folder: &Folder) -> Vec<String> {
    texts(folder, "SELECT hex(results_sha256) FROM run WHERE status = 'completed' ORDER BY job")
}

fn recorded() -> String {
    MANIFEST.replace("test_episodes = 40", "test_episodes = 40\nrecord_decisions = \"test\"")
}

#[test]
fn adding_an_estimate_to_completed_jobs_that_recorded_decisions_trains_nothing() {
    let folder = Folder::completed(&recorded());
    let before = digests(&folder);
    folder.write("sweep.toml", format!("{}{ESTIMATES}", recorded()));
    // A job of two manifests counts once.
    folder.write("other.toml", folder.read("sweep.toml").replace("\"trial\"", "\"other\""));
    for manifests in [&["plan", "sweep.toml"][..], &["plan", "sweep.toml", "other.toml"]] {
        let plan = folder.jitai(manifests.iter().copied()).succeeded();
        plan.says("estimates of 4 completed jobs to compute, without training");
    }
    folder
        .jitai(["run", "sweep.toml"])
        .succeeded()
        .says("estimates of 4 completed jobs computed from recorded decisions, without training");
    assert_eq!((folder.runs(), digests(&folder)), (4, before));
    // Two terms and three of every job, and one of the two jobs of an agent.
    let added = estimates(&folder);
    assert_eq!(added.len(), 4 * (2 + 3) + 2);
    assert_eq!(folder.number("SELECT count(*) FROM estimate WHERE failure IS NOT NULL"), 0);
    folder.jitai(["doctor"]).succeeded();
    let again = folder.jitai(["run", "sweep.toml"]).succeeded();
    assert!(!again.stderr.contains("estimates"), "{}", again.stderr);
    // Jobs that compute them at their end have the same bits, and the same results.
    let whole = Folder::completed(&format!("{}{ESTIMATES}", recorded()));
    assert_eq!(estimates(&whole), added);
    assert_eq!(digests(&whole), digests(&folder));
}

#[test]
fn estimates_of_completed_jobs_and_new_jobs_share_the_workers() {
    for text in [recorded(), MANIFEST.to_owned()] {
        for format in ["text", "json"] {
            let folder = Folder::completed(&text);
            let more = text.replace("seeds = 2", "seeds = 3");
            assert_ne!(more, text);
            folder.write("sweep.toml", format!("{more}{ESTIMATES}"));
            let run = ["run", "sweep.toml", "--workers", "6", "--format", format];
            let ran = folder.jitai(run).succeeded();
            assert_eq!(folder.runs(), 6, "{}", ran.stderr);
            let lacking = "SELECT count(*) FROM job
                WHERE key NOT IN (SELECT job_key FROM estimate WHERE estimate IS NOT NULL)";
            assert_eq!(folder.number(lacking), 0, "{}", ran.stderr);
            let started = ran.stdout.matches("\"event\":\"started\"").count();
            assert_eq!(started, if format == "json" { 2 } else { 0 }, "{}", ran.stdout);
            let whole = Folder::completed(&format!("{more}{ESTIMATES}"));
            assert_eq!(estimates(&whole), estimates(&folder));
        }
    }
}

#[test]
fn the_reward_is_less_the_cost_of_messages() {
    let both = "\n[[estimate]]\nname = \"net\"\n\n[[estimate]]\nname = \"gross\"\noutcome = \"gross_reward\"\n";
    let with = |cost: &str| recorded().replace("sigma = 0.4", &format!("sigma = 0.4\n{cost}"));
    let differences = |folder: &Folder| {
        texts(
            folder,
            "SELECT printf('%.9f %.9f', g.estimate - n.estimate, g.standard_error - n.standard_error)
             FROM estimate AS n JOIN estimate AS g ON g.job_key = n.job_key AND g.term = n.term
             WHERE n.name = 'net' AND g.name = 'gross'",
        )
    };
    // A message that costs everybody 30 steps has an effect that is smaller by exactly 30.
    let all = with("environment.message_cost = [0, 30]");
    let folder = Folder::completed(&format!("{all}{both}"));
    let differing = differences(&folder);
    let with_cost = |cost: f64| {
        differing
            .iter()
            .filter(|row| row.trim_start_matches('-').starts_with(&format!("{cost:.9} ")))
            .count()
    };
    assert_eq!((differing.len(), with_cost(30.0), with_cost(0.0)), (8, 4, 4), "{differing:?}");
    assert!(
        differing.iter().all(|row| row.trim_end_matches(['0', '.']).ends_with([' ', '-'])),
        "{differing:?}"
    );
    for cost in
        ["environment.message_cost = 30", "population.message_cost = { uniform = [20, 40] }"]
    {
        let folder = Folder::completed(&with(cost));
        folder.write("sweep.toml", format!("{}{both}", with(cost)));
        folder.jitai(["run", "sweep.toml"]).succeeded();
        assert_eq!(
            estimates(&folder),
            estimates(&Folder::completed(&format!("{}{both}", with(cost))))
        );
    }
}

#[test]
fn jobs_without_recorded_decisions_have_the_same_estimates() {
    let folder = Folder::completed(&format!("{MANIFEST}{ESTIMATES}"));
    assert_eq!(folder.number("SELECT count(*) FROM decision"), 0);
    // Added later, the jobs are trained again.
    let later = Folder::completed(MANIFEST);
    let before = digests(&later);
    assert_eq!(before, digests(&folder));
    later.write("sweep.toml", format!("{MANIFEST}{ESTIMATES}"));
    later.jitai(["plan", "sweep.toml"]).succeeded().says(
        "4 of them by training again: their decisions, or the costs of messages, are not recorded",
    );
    later
        .jitai(["run", "sweep.toml"])
        .succeeded()
        .says("[4/4] ")
        .says("estimates of 4 completed jobs computed by training again, with the same results");
    assert_eq!((later.runs(), digests(&later)), (4, before));
    assert_eq!(estimates(&later), estimates(&folder));
    // The numbers do not depend on whether decisions are recorded, although the job does.
    let numbers = "SELECT DISTINCT concat_ws(' ', name, number, estimate, standard_error) FROM estimate ORDER BY 1";
    let whole = Folder::completed(&format!("{}{ESTIMATES}", recorded()));
    assert_eq!(texts(&whole, numbers), texts(&folder, numbers));
}

#[test]
fn other_results_store_no_estimates() {
    let folder = Folder::completed(MANIFEST);
    let other = rusqlite::Connection::open(folder.path("jitai.sqlite")).unwrap();
    let of_run =
        "FROM sqlite_schema WHERE type = 'trigger' AND tbl_name = 'run' AND sql LIKE '%UPDATE%'";
    let triggers = texts(&folder, &format!("SELECT name {of_run}"));
    let kept = texts(&folder, &format!("SELECT sql {of_run}"));
    triggers.iter().for_each(|name| other.execute_batch(&format!("DROP TRIGGER {name}")).unwrap());
    other.execute("UPDATE run SET results_sha256 = zeroblob(32) WHERE id = 1", []).unwrap();
    kept.iter().for_each(|sql| other.execute_batch(sql).unwrap());
    folder.write("sweep.toml", format!("{MANIFEST}{ESTIMATES}"));
    let ran = folder.jitai(["run", "sweep.toml"]).ended(1);
    ran.says("no estimates of 1 completed job: training again gave other results");
    assert_eq!(folder.number("SELECT count(DISTINCT job_key) FROM estimate"), 3);
}

#[test]
fn estimates_travel_with_their_runs() {
    let manifest = format!("{}{ESTIMATES}", recorded());
    let whole = Folder::completed(&manifest);
    let parts = Folder::with(&manifest);
    std::fs::create_dir(parts.path("parts")).unwrap();
    for shard in ["1/2", "2/2"] {
        let store = format!("parts/{}.sqlite", &shard[..1]);
        parts.jitai(["run", "sweep.toml", "--shard", shard, "--store", &store]).succeeded();
    }
    parts.jitai(["merge", "parts"]).succeeded();
    assert_eq!(estimates(&parts), estimates(&whole));
    // A store that has the runs gets the estimates alone, once.
    let other = Folder::completed(&recorded());
    let from = whole.path("jitai.sqlite").display().to_string();
    other.jitai(["merge", &from]).succeeded().prints("22 rows of estimates added");
    assert_eq!(estimates(&other), estimates(&whole));
    other.jitai(["merge", &from]).succeeded().prints("nothing to copy");
    other.jitai(["doctor", "--salvage", "saved.sqlite"]).succeeded();
    let saved = Folder::new();
    std::fs::rename(other.path("saved.sqlite"), saved.path("jitai.sqlite")).unwrap();
    assert_eq!(estimates(&saved), estimates(&whole));
    other.jitai(["export", "--out", "exported"]).succeeded();
    assert_eq!(other.read("exported/every_estimate.csv").lines().count(), 23);
    // The manifest of this store declares none.
    assert_eq!(other.read("exported/estimate.csv").lines().count(), 1);
    other.jitai(["forget", "trial", "--results", "--yes"]).succeeded();
    assert_eq!(other.number("SELECT count(*) FROM recorded_estimate"), 0);
}

#[test]
fn a_changed_estimate_is_found_left_out_and_computed_again() {
    let manifest = format!("{}{ESTIMATES}", recorded());
    let folder = Folder::completed(&manifest);
    let before = estimates(&folder);
    let raw = rusqlite::Connection::open(folder.path("jitai.sqlite")).unwrap();
    let trigger = "FROM sqlite_schema WHERE name = 'recorded_estimate_is_fixed'";
    let kept = texts(&folder, &format!("SELECT sql {trigger}"));
    raw.execute_batch("DROP TRIGGER recorded_estimate_is_fixed").unwrap();
    let change = "UPDATE recorded_estimate SET low = low - 1 WHERE number = 2 AND run = 1 AND declaration = (
        SELECT id FROM estimate_declaration WHERE json_extract(canonical, '$.name') = 'each')";
    assert_eq!(raw.execute(change, []).unwrap(), 1);
    raw.execute_batch(&kept[0]).unwrap();
    drop(raw);
    folder.jitai(["doctor"]).ended(3).prints("its estimates do not match their digests");
    folder.jitai(["doctor", "--salvage", "saved.sqlite"]).succeeded();
    let saved = Folder::with(&manifest);
    std::fs::rename(folder.path("saved.sqlite"), saved.path("jitai.sqlite")).unwrap();
    assert_eq!(estimates(&saved).len(), before.len() - 3);
    saved.jitai(["run", "sweep.toml"]).succeeded().says("estimates of 1 completed job computed");
    assert_eq!(estimates(&saved), before);
}

/// Forty people of a model with a binary outcome, whose risk and whose value under a policy are estimated.
const BINARY: &str = r#"format = 1
name = "binary"
scenarios = "all"
seeds = 3
environment = { family = "declared", model = "binary_outcome.toml" }
evaluation.on = "trial"

[trial]
people = 40
days = 30

[[agent]]
name = "random"
algorithm = "rule"
rule = "random"

[[estimate]]
name = "risk"
estimator = "emee"
control = ["share"]
moderators = ["share"]
truth = true

[[estimate]]
name = "value"
estimator = "value"
policy = 0.7
steps = 3
control = ["share"]
truth = true

[[estimate]]
name = "always"
estimator = "value"
policy = 1
steps = 30
"#;

#[test]
fn values_and_relative_risks_are_the_same_however_they_are_computed() {
    let model = std::fs::read_to_string("experiments/models/binary_outcome.toml").unwrap();
    let with = |manifest: &str| {
        let folder = Folder::with(manifest);
        folder.write("binary_outcome.toml", &model);
        folder.jitai(["run", "sweep.toml"]).succeeded();
        folder
    };
    let folder = with(BINARY);
    // The last, of thirty decisions one after the other, has too small a sample.
    assert_eq!(folder.number("SELECT count(*) FROM estimate WHERE failure IS NULL"), 15);
    let refused = texts(&folder, "SELECT failure FROM estimate WHERE name = 'always'");
    assert_eq!(refused.len(), 9);
    for why in refused {
        assert!(why.starts_with("its effective sample size is "), "{why}");
        assert!(why.contains(", below 10: the policy seldom takes the actions"), "{why}");
    }
    let queried = |what: &str, of: &str| -> f64 {
        let sql = format!("SELECT {what} FROM estimate WHERE {of}");
        folder.store().query_row(&sql, [], |row| row.get(0)).unwrap()
    };
    let size = queried("min(effective_sample_size)", "name = 'value'");
    assert!(size > 50.0 && size < 1120.0, "{size}");
    assert!(queried("count(effective_sample_size)", "name = 'risk'") == 0.0);
    for of in ["name = 'value'", "name = 'risk' AND term = '1'"] {
        let (off, error) =
            (queried("max(abs(estimate - truth))", of), queried("avg(standard_error)", of));
        assert!(off < 4.0 * error, "{of}: {off}, {error}");
    }
    // A policy of 0.7 of 0.8 available decisions, with a mean risk of exp(−1.5 + …) of about 0.4.
    let truth = queried("avg(truth)", "name = 'value'");
    assert!(truth > 0.35 && truth < 0.45, "{truth}");
    // From recorded decisions, and by training again, the numbers are the same.
    let numbers = "SELECT DISTINCT concat_ws(' ', name, number, estimate, standard_error, truth) FROM estimate ORDER BY 1";
    let (without, _) = BINARY.split_once("[[estimate]]").unwrap();
    for recorded in ["", "evaluation.record_decisions = \"test\"\n"] {
        let on = "evaluation.on = \"trial\"\n";
        let manifest = |text: &str| text.replace(on, &format!("{on}{recorded}"));
        let later = with(&manifest(without));
        later.write("sweep.toml", manifest(BINARY));
        later
            .jitai(["run", "sweep.toml"])
            .succeeded()
            .says("estimates of 3 completed jobs computed");
        assert_eq!(texts(&later, numbers), texts(&folder, numbers));
    }
    // A relative risk of steps walked is refused.
    let steps = format!(
        "{MANIFEST}[[estimate]]\nname = \"risk\"\nestimator = \"emee\"\nagents = \"random\"\n"
    );
    let steps = Folder::completed(&steps);
    let why = texts(&steps, "SELECT failure FROM estimate")[0].clone();
    assert!(why.contains("a relative risk is of outcomes that are 0 or 1, or counts"), "{why}");
}

#[test]
fn a_trial_that_resumes_has_the_estimates_of_one_that_does_not() {
    let manifest = r#"format = 1
name = "trial"
scenarios = ["P-H-D"]
seeds = 1
environment = { sigma = 0.4, horizon = 1000 }
evaluation = { on = "trial", record_episodes = "none" }
[trial]
people = 800
days = 200
decisions_per_day = 5
entry = { every_days = 1 }
[[agent]]
name = "thompson"
algorithm = "linear_thompson"
pi_min = 0.1
[[estimate]]
name = "effect"
control = ["habituation", "calendar_day", "policy"]
"#;
    let whole = Folder::completed(manifest);
    assert_eq!(estimates(&whole).len(), 1);
    let stopped = Folder::with(manifest);
    let often = ["run", "sweep.toml", "--workers", "1", "--checkpoint-every", "0.01"];
    let running = stopped.start(often);
    until("a checkpoint was written", || {
        std::fs::read_dir(stopped.path("jitai.sqlite.checkpoints")).is_ok_and(|mut files| {
            files.any(|file| {
                file.is_ok_and(|file| {
                    file.path().extension().is_some_and(|form| form == "checkpoint")
                })
            })
        })
    });
    running.signal("INT");
    running.wait().ended(130);
    stopped.jitai(["run", "sweep.toml"]).succeeded().says(": resumed from");
    assert_eq!(estimates(&stopped), estimates(&whole));
}

#[test]
fn faulty_estimates_are_reported_where_they_stand() {
    let check = |estimate: &str| {
        let folder =
            Folder::with(&format!("{MANIFEST}[[estimate]]\nname = \"effect\"\n{estimate}\n"));
        folder.jitai(["check", "sweep.toml"]).stderr
    };
    for (estimate, expected) in [
        (
            "control = [\"habituatoin\"]",
            "22:11: `control`: the recorded state has no `habituatoin`",
        ),
        ("control = [\"habituatoin\"]", "did you mean `habituation`?"),
        ("moderators = [\"1\"]", "`moderators`: the constant 1 is always included"),
        ("treatment = 4", "`treatment`: the environment has no action 4"),
        ("treatment = \"a message\"", "`treatment`: expected \"any message\" or \"each message\""),
        ("numerator = 1", "`numerator`: expected a probability above 0 and below 1"),
        ("outcome = \"steps\"", "`outcome`: the recorded state has no `steps`"),
        ("estimator = \"gee\"", "`estimator`: expected \"wcls\""),
        (
            "estimator = \"value\"",
            "missing key `policy` in an [[estimate]] with `estimator` = \"value\"",
        ),
        (
            "estimator = \"value\"\npolicy = 1.2",
            "23:10: `policy`: expected the probability of a message, from 0 to 1, a list",
        ),
        ("estimator = \"value\"\npolicy = [0.5, 0.6, 0, 0]", "whose sum is 1"),
        (
            "estimator = \"value\"\npolicy = \"habituatoin\"",
            "23:10: `policy`: the recorded state has no `habituatoin`",
        ),
        (
            "estimator = \"value\"\npolicy = [0.5, 0.5]",
            "`policy` lists 2 numbers, and the environment has 4 actions",
        ),
        (
            "estimator = \"value\"\npolicy = 1\nnumerator = 0.3",
            "24:13: `numerator`: `estimator` = \"value\" does not use it",
        ),
        ("policy = 1", "`policy`: `estimator` = \"wcls\" does not use it"),
        (
            "estimator = \"emee\"\nstandard_errors = \"after_study\"",
            "`standard_errors`: `estimator` = \"emee\" does not use it",
        ),
        ("estimator = \"emee\"\nsteps = 2", "`steps`: `estimator` = \"emee\" does not use it"),
        ("agents = [\"rule\"]", "`agents`: no agent is called `rule`"),
        ("controls = []", "unknown key `controls` in an [[estimate]]"),
        ("[[estimate]]\nname = \"effect\"", "another [[estimate]] is called `effect`"),
        (
            "[[agent]]\nname = \"never\"\nalgorithm = \"rule\"\nrule = \"never\"",
            "not randomised: `never` draws no actions by chance",
        ),
    ] {
        let said = check(estimate);
        assert!(said.contains(expected), "{estimate}: {said}");
    }
    assert_eq!(check("control = [\"step\"]\nagents = [\"random\"]").lines().count(), 0);
}

#[test]
fn the_view_has_the_declarations_of_the_manifest_as_it_is() {
    let folder = Folder::completed(&recorded());
    let declared = |text: &str| {
        folder.write(
            "sweep.toml",
            format!("{}\n[[estimate]]\nname = \"effect\"\n{text}", recorded()),
        );
        folder.jitai(["run", "sweep.toml"]).succeeded();
        let of_name =
            "SELECT DISTINCT CAST(json_extract(declaration, '$.treatment') AS TEXT) FROM estimate";
        assert_eq!(folder.number("SELECT count(*) FROM estimate"), 4);
        texts(&folder, of_name)
    };
    assert_eq!(declared(""), ["any message"]);
    assert_eq!(declared("treatment = 2\n"), ["2"]);
    assert_eq!(folder.number("SELECT count(*) FROM every_estimate"), 8);
    // The rows of an earlier declaration are there when the manifest has it again.
    assert_eq!(declared(""), ["any message"]);
    // Another experiment with the same jobs declares nothing of its own.
    let other = recorded().replace("\"trial\"", "\"other\"");
    folder.write("other.toml", other);
    folder.jitai(["run", "other.toml"]).succeeded();
    assert_eq!(folder.number("SELECT count(*) FROM estimate WHERE experiment = 'other'"), 0);
}

#[test]
fn an_estimator_of_a_newer_release_is_named_and_the_others_are_read() {
    let folder = Folder::completed(&recorded());
    let before = estimates(&folder);
    let newer = r#"{"control":[],"estimator":"dcee","moderators":[],"name":"distal","numerator":0.5,
        "outcome":"reward","treatment":"any message"}"#;
    let raw = rusqlite::Connection::open(folder.path("jitai.sqlite")).unwrap();
    raw.execute("INSERT INTO estimate_declaration (canonical) VALUES (?1)", [newer]).unwrap();
    drop(raw);
    folder
        .jitai(["doctor"])
        .ended(3)
        .prints("or of a newer release of jitai")
        .prints("the estimator \"dcee\" is unknown");
    assert_eq!(estimates(&folder), before);
    folder.jitai(["report", "sweep.toml", "--out", "report"]).succeeded();
}

#[test]
fn estimates_that_fail_are_counted_with_their_reason() {
    // One person is too few.
    let one = recorded().replace("test_episodes = 40", "test_episodes = 1");
    let estimate = "[[estimate]]\nname = \"mood\"\nmoderators = [\"context\"]\n";
    let folder = Folder::completed(&format!("{one}\n{estimate}"));
    let said = "estimates of 4 completed jobs failed, the first, `mood`, because it needs at least";
    folder.jitai(["run", "sweep.toml"]).succeeded().says(said);
    folder.jitai(["status"]).succeeded().prints(said);
    folder.jitai(["report", "sweep.toml", "--out", "report"]).succeeded();
    assert!(folder.read("report/index.html").contains("estimates of 4 completed jobs failed"));
}
