//! Trials: people who enter by a calendar, and agents that learn at calendar times.

use std::time::Duration;

use crate::support::Folder;

const PEOPLE: &str = include_str!("../../experiments/oralytics/synthetic_v2.csv");

const MANIFEST: &str = r#"format = 1
name = "trial"
scenarios = [["time_of_day", "brushing", "dosage", "app"]]
seeds = 2

[trial]
people = 6
days = 8
decisions_per_day = 2
entry = { every_days = 3, people = 2 }
update = { every_days = 2 }
pooling = ["full", "none"]

[environment]
family = "declared"
model = "oralytics_v2"
people = "people.csv"
days = 8

[evaluation]
on = "trial"
record_decisions = "test"

[[agent]]
name = "thompson"
algorithm = "linear_thompson"
action_centring = true
allocation = "logistic"
noise_sd = 60
prior_sd = 30

[[agent]]
name = "never"
algorithm = "rule"
rule = "never"
"#;

fn folder(manifest: &str) -> Folder {
    let folder = Folder::new();
    folder.write("trial.toml", manifest);
    folder.write("people.csv", PEOPLE);
    folder
}

#[test]
fn the_people_of_a_trial_are_its_evaluation() {
    let folder = folder(MANIFEST);
    let ran = folder.jitai(["run", "trial.toml", "--workers", "2"]).succeeded();
    // Lines and tables tell arms of the trial apart.
    let row = "thompson  time_of_day-brushing-dosage-app  none         2";
    assert!(ran.stdout.contains(row), "{}", ran.stdout);
    let planned = folder.jitai(["plan", "trial.toml", "--jobs"]).succeeded();
    assert!(planned.stdout.contains("pooling"), "{}", planned.stdout);
    assert_eq!(folder.number("SELECT count(*) FROM run_summary WHERE status = 'completed'"), 8);
    assert_eq!(folder.number("SELECT count(*) FROM evaluation_episode WHERE length = 16"), 48);
    assert_eq!(folder.number("SELECT count(*) FROM decision"), 8 * 6 * 16);
    let means = "SELECT count(*) FROM run_summary JOIN (SELECT job_key, avg(total_reward) AS mean \
                 FROM evaluation_episode GROUP BY 1) USING (job_key) WHERE abs(mean_return - mean) < 1e-9";
    assert_eq!(folder.number(means), 8);
    // Four people have entered by the fourth day; updates come every other day.
    let days = "SELECT count(*) FROM decision WHERE episode = 3 AND step = 5 \
                AND json_extract(state, '$.calendar_day') = 5";
    assert_eq!(folder.number(days), 8);
    let policy = |pooling: &str| {
        format!(
            "SELECT CAST(max(json_extract(state, '$.policy')) AS INTEGER) FROM decision JOIN parameter USING (job_key) \
             WHERE name = 'trial.pooling' AND value = '{pooling}' AND episode = 3 AND step = 5"
        )
    };
    // Everybody's agent on days 2 and 4; the third person's own, on the second day after the third.
    assert_eq!([policy("full"), policy("none")].map(|sql| folder.number(&sql)), [2, 1]);
    // Rules do not depend on pooling.
    let alike = "SELECT count(DISTINCT mean_return) FROM run_summary WHERE agent = 'never'";
    assert_eq!(folder.number(alike), 2);
    let apart = "SELECT count(DISTINCT mean_return) FROM run_summary WHERE agent = 'thompson'";
    assert_eq!(folder.number(apart), 4);
    folder.jitai(["run", "trial.toml"]).succeeded();
    assert_eq!(folder.runs(), 8);
    folder.jitai(["doctor"]).succeeded();
    folder.jitai(["report", "trial.toml", "--out", "report"]).succeeded();
    assert!(folder.read("report/index.html").contains("seconds of brushing"));
}

const POPULATION: &str = r#"format = 1
name = "population"
scenarios = ["P-H-D"]
seeds = 3

[trial]
people = 8
days = 10
decisions_per_day = 5

[environment]
sigma = 0.4

[population]
epsilon_h = { uniform = [0.02, 0.3] }

[evaluation]
on = "trial"
record_decisions = "test"

[[agent]]
name = "thompson"
algorithm = "linear_thompson"

[[agent]]
name = "random"
algorithm = "rule"
rule = "random"

[[analysis]]
name = "slow"
kind = "contrast"
by = "agent.name"
between = ["thompson", "random"]
participants = { parameter = "epsilon_h", to_quantile = 0.5 }
"#;

#[test]
fn people_who_leave_or_do_not_report_have_no_known_optimum() {
    let folder = Folder::new();
    let (plain, _) = POPULATION.split_once("[population]").unwrap();
    let (_, rest) = POPULATION.split_once("[evaluation]").unwrap();
    let plain = format!("{plain}[evaluation]{}", rest.split("[[analysis]]").next().unwrap());
    for (keys, is_known) in [("", true), ("dropout = 0.1\n", false), ("unreported = 0.1\n", false)]
    {
        folder.write("trial.toml", plain.replace("people = 8\n", &format!("people = 8\n{keys}")));
        folder.jitai(["run", "trial.toml", "--replace"]).succeeded();
        folder.jitai(["report", "trial.toml", "--out", "report"]).succeeded();
        let page = folder.read("report/index.html");
        let says = "no optimum can be computed with `";
        assert_eq!(page.contains(says), !is_known, "{keys}");
        let table = folder.read("report/tables/population-arms.csv");
        let first = table.lines().nth(1).unwrap();
        assert_eq!(first.ends_with(",,,,"), !is_known, "{table}");
    }
}

#[test]
fn people_of_a_trial_are_participants_with_parameters() {
    let folder = Folder::new();
    folder.write("trial.toml", POPULATION);
    folder.jitai(["run", "trial.toml"]).succeeded();
    assert_eq!(folder.number("SELECT count(*) FROM participant"), 6 * 8);
    // Equal seeds have the same people, whichever agent they meet.
    assert_eq!(folder.number("SELECT count(DISTINCT value) FROM participant"), 3 * 8);
    // The columns of step_count have their values in trials too.
    let known = "SELECT count(*) FROM decision WHERE context IN (0, 1) AND habituation BETWEEN 0 AND 1 \
                 AND probability BETWEEN 0 AND 1 AND disengagement >= 0 AND typeof(context) = 'integer'";
    assert_eq!(folder.number(known), folder.number("SELECT count(*) FROM decision"));
    assert!(folder.number(known) > 6 * 8 * 10);
    folder.jitai(["doctor"]).succeeded();
    folder.jitai(["report", "trial.toml", "--out", "report"]).succeeded();
    let table = folder.read("report/tables/population-slow.csv");
    let row = table.lines().nth(1).unwrap();
    assert!(row.contains(",3,"), "{table}");
}

#[test]
fn a_trial_without_episodes_has_the_same_metrics() {
    let folder = folder(MANIFEST);
    let short =
        MANIFEST.replace("record_decisions = \"test\"", "record_episodes = [\"all\", \"none\"]");
    folder.write("short.toml", &short);
    folder.jitai(["run", "short.toml", "--workers", "2"]).succeeded();
    // Each value occurs with and without episodes: the mean, standard deviation, length, share of terminated
    // episodes, messages, and the return minus their cost.
    let alike = "SELECT sum(n) FROM (SELECT count(*) AS n FROM metric JOIN run_summary USING (job_key) \
                 WHERE name <> 'lower_quartile_return' GROUP BY agent, seed, name, value) WHERE n % 2 = 0";
    assert_eq!(folder.number(alike), 16 * 6);
    let quartiles = "SELECT count(*) FROM metric WHERE name = 'lower_quartile_return'";
    assert_eq!(folder.number(quartiles), 8);
    assert_eq!(folder.number("SELECT count(*) FROM run_summary WHERE sd_return > 0"), 16);
    assert_eq!(folder.number("SELECT count(DISTINCT job_key) FROM evaluation_episode"), 8);
    folder.jitai(["doctor"]).succeeded();
    // A report shows the same lower quartiles, from the episodes and from the metric.
    folder.jitai(["report", "short.toml", "--out", "report"]).succeeded();
    let arms = folder.read("report/tables/trial-arms.csv");
    let as_all = |line: &str| line.replace("record_episodes=none", "record_episodes=all");
    let mut lines: Vec<String> = arms.lines().skip(1).map(as_all).collect();
    lines.sort();
    assert_eq!(lines.len(), 8, "{arms}");
    assert!(lines.chunks(2).all(|pair| pair[0] == pair[1]), "{arms}");
    let both = MANIFEST.replace("record_decisions", "record_episodes = \"none\"\nrecord_decisions");
    folder.write("both.toml", &both);
    folder
        .jitai(["check", "both.toml"])
        .ended(2)
        .says("`record_episodes` leaves out the episodes of");
}

#[test]
fn readers_see_names_or_eight_digits_of_the_people_and_programs_see_all() {
    let text = MANIFEST.replace("pooling = [\"full\", \"none\"]\n", "");
    let text = text.replace("people = \"people.csv\"", "people = [\"people.csv\", \"fewer.csv\"]");
    let analysis = "[[analysis]]\nname = \"gain\"\nkind = \"contrast\"\nby = \"agent\"\n\
        between = [\"thompson\", \"never\"]\n";
    let folder = folder(&(text + analysis));
    let fewer: Vec<&str> = PEOPLE.lines().take(20).collect();
    folder.write("fewer.csv", fewer.join("\n"));
    let shown = folder.jitai(["run", "trial.toml"]).succeeded();
    folder.jitai(["report", "trial.toml", "--out", "report"]).succeeded();
    let digests = "SELECT DISTINCT value FROM parameter WHERE name = 'environment.people'";
    let store = folder.store();
    let mut digests = store.prepare(digests).unwrap();
    let digests = digests.query_map([], |row| row.get(0)).unwrap();
    let digests: Vec<String> = digests.collect::<Result<_, _>>().unwrap();
    assert_eq!(digests.len(), 2);
    let read = |file: &str| std::fs::read_to_string(folder.path("report").join(file)).unwrap();
    let plan = |format: &str| {
        folder.jitai(["plan", "trial.toml", "--jobs", "--format", format]).succeeded().stdout
    };
    let people = [shown.stdout, plan("table")];
    let reported = [
        read("tables/trial-arms.md"),
        read("tables/trial-arms.tex"),
        read("figures/trial-gain.svg"),
    ];
    let programs = [plan("csv"), plan("json"), read("tables/trial-arms.csv")];
    for digest in digests {
        assert_eq!(digest.len(), "synthetic:sha256:".len() + 64);
        let short = &digest[..digest.len() - 56];
        for text in &people {
            assert!(text.contains(short) && !text.contains(&digest), "{text}");
        }
        assert!(programs.iter().all(|text| text.contains(&digest)), "{programs:?}");
        let page = read("index.html");
        // The page has whole digests in queries alone.
        let is_query = |line: &&str| line.contains("FROM parameter WHERE job_key");
        assert!(page.contains("people=synthetic:fewer.csv"));
        for text in &reported {
            let is_named = ["people.csv", "fewer.csv"].iter().all(|name| text.contains(name));
            assert!(is_named && !text.contains("sha256"), "{text}");
        }
        assert!(page.lines().filter(|line| !is_query(line)).all(|line| !line.contains(&digest)));
    }
}

#[test]
fn a_trial_whose_bandit_has_no_posterior_fails_with_the_remedy() {
    let manifest =
        MANIFEST.replace("noise_sd = 60\nprior_sd = 30", "noise_sd = 0.01\nprior_sd = 1e6");
    let folder = folder(&manifest);
    folder.jitai(["run", "trial.toml", "--filter", "agent=thompson"]).ended(1);
    let failed = "SELECT count(*) FROM run_summary WHERE failure_kind = 'diverged' AND failure_message LIKE \
                  'after % steps the precision of a regression is not positive definite; choose a prior_sd %'";
    assert_eq!(folder.number(failed), 4);
    folder.jitai(["doctor"]).succeeded();
}

#[test]
fn a_trial_gives_the_same_bits_on_any_number_of_workers() {
    let (one, two) = (folder(MANIFEST), folder(MANIFEST));
    one.jitai(["run", "trial.toml", "--workers", "1"]).succeeded();
    two.jitai(["run", "trial.toml", "--workers", "2", "--shard", "1/2"]).succeeded();
    two.jitai(["run", "trial.toml", "--workers", "2", "--shard", "2/2"]).succeeded();
    let rows = |folder: &Folder| -> Vec<(String, i64, f64)> {
        let store = folder.store();
        let sql = "SELECT job_key, episode, total_reward FROM evaluation_episode ORDER BY 1, 2";
        let mut rows = store.prepare(sql).unwrap();
        let rows = rows.query_map([], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?))).unwrap();
        rows.collect::<Result<_, _>>().unwrap()
    };
    let rows_of_one = rows(&one);
    assert_eq!(rows_of_one.len(), 48);
    assert_eq!(rows_of_one, rows(&two));
}

#[test]
fn what_does_not_suit_a_trial_is_refused_with_a_sentence() {
    let folder = folder(MANIFEST);
    for (from, to, expected) in [
        (
            "on = \"trial\"\n",
            "",
            "a trial is evaluated on its people, and `on` of [evaluation] is \"test\"",
        ),
        (
            "[trial]\npeople = 6\n",
            "[trial]\npeople = 0\n",
            "`people`: expected a whole number from 1",
        ),
        (
            "\ndays = 8\ndecisions",
            "\ndays = 9\ndecisions",
            "`days` = 9 with `decisions_per_day` = 2 are 18 decisions of a person",
        ),
        (
            "algorithm = \"rule\"\nrule = \"never\"",
            "algorithm = \"ppo\"",
            "agent `never`: ppo cannot act in a trial",
        ),
        (
            "on = \"trial\"\n",
            "on = \"trial\"\ntest_episodes = 3\n",
            "no test follows a trial that is the evaluation",
        ),
        (
            "pooling = [",
            "people_file = \"rows.csv\"\npooling = [",
            "`people_file`: seed 2 has no row for person 0",
        ),
        (
            "entry = { every_days = 3, people = 2 }",
            "entry = \"stays.csv\"",
            "`entry`: it has 2 rows, and people = 6",
        ),
        (
            "noise_sd = 60",
            "noise_sd = 60\nbaseline_means = [1, 2]",
            "`baseline_means` does not suit an environment with 5 features",
        ),
        (
            "people = \"people.csv\"",
            "people = \"none\"",
            "`people` names no file, and the model has columns of people: `sigma` and 32 more",
        ),
        (
            "people = \"people.csv\"\n",
            "",
            "`people` names no file, and the model has columns of people",
        ),
        (
            "noise_sd = 60",
            "noise_sd = 60\ndraw = [\"step\", \"episode\"]",
            "agent `thompson`: `draw` is not read in a trial",
        ),
        (
            "entry = { every_days = 3, people = 2 }",
            "entry = \"stays.csv\"\nentry_every_days = 3",
            "keys `entry_*` are not read beside it",
        ),
        (
            "update = { every_days = 2 }",
            "update = { every_days = 2, first_with_people = 9 }",
            "`update_first_with_people` = 9 is never reached with `people` = 6",
        ),
        (
            "update = { every_days = 2 }",
            "update = { every_days = 2, lag_days = 20 }",
            "no update has data before the last person leaves, so that the agent never learns",
        ),
        (
            "update = { every_days = 2 }",
            "update = { every_days = 2, first_day = 13 }",
            "no update comes before the last person leaves",
        ),
        // The calendar of a group ends with its last person, not with the trial.
        (
            "update = { every_days = 2 }\npooling = [\"full\", \"none\"]",
            "update = { every_days = 2, first_day = 9 }\npooling = 2",
            "no update comes before the last person leaves",
        ),
        (
            "pooling = [\"full\", \"none\"]",
            "pooling = [\"full\", \"none\"]\noutage = [1, 20]",
            "no update comes before the last person leaves",
        ),
        (
            "pooling = [\"full\", \"none\"]\n",
            "pooling = [\"full\", \"partial\"]\n[[estimate]]\nname = \"effect\"\nagents = \"thompson\"\n\
             standard_errors = \"after_study\"\n",
            "`standard_errors` = \"after_study\": they are supported for `pooling` = \"full\" and \"none\"",
        ),
        (
            "update = { every_days = 2 }",
            "update = 2",
            "`update`: expected a table, as in { every_days = 7 }",
        ),
        (
            "update = { every_days = 2 }",
            "update = { every_days = 2 }\nupdate_every_days = 3",
            "`update_every_days` is given twice: by itself, and in `update`",
        ),
        (
            "on = \"trial\"\n",
            "on = \"trial\"\ntest_actions = \"greedy\"\n",
            "`test_actions` is not read in a trial",
        ),
        (
            "on = \"trial\"\n",
            "on = \"trial\"\nfirst_episodes = [7]\n",
            "`first_episodes` must not exceed `people`, found [7] and 6",
        ),
        (
            "entry = { every_days = 3,",
            "entry = { every_days = 60000,",
            "the last person leaves on day 120008; the last day is 100000",
        ),
        (
            "[environment]",
            "[population]\nsigma = { uniform = [0, 1] }\n[environment]",
            "the people come from the file that [environment] names",
        ),
    ] {
        let manifest = MANIFEST.replacen(from, to, 1);
        assert_ne!(manifest, MANIFEST, "{from}");
        folder.write("trial.toml", &manifest);
        folder.write("stays.csv", "start_day,end_day\n0,8\n2,9\n");
        folder.write("rows.csv", "seed,person,row\n1,0,3\n1,1,3\n1,2,3\n1,3,3\n1,4,3\n1,5,3\n");
        folder.jitai(["check", "trial.toml"]).ended(2).says(expected);
    }
    // Without a trial, its people cannot be the evaluation.
    let without = MANIFEST.split("[trial]").next().unwrap().to_owned()
        + "[environment]"
        + MANIFEST.split("[environment]").nth(1).unwrap();
    folder.write("trial.toml", without);
    folder.jitai(["check", "trial.toml"]).ended(2).says("the manifest has no [trial]");
}

#[test]
fn agents_see_one_observation_at_a_time_where_phones_do_not_report() {
    let manifest = MANIFEST
        .replace("pooling = [", "unreported = [0, 0.3]\npooling = [")
        .replace("noise_sd", "history = [1, 2]\nnoise_sd");
    let folder = folder(&manifest);
    let says = "`unreported` = 0.3 hides observations, and agent `thompson` with `history` = 2 would see them";
    folder.jitai(["check", "trial.toml"]).ended(2).says("trial.toml:12").says(says);
    // Each of the two alone is possible.
    let excluded = "\n[[exclude]]\ntrial.unreported = 0.3\nagent.history = 2\n";
    folder.write("trial.toml", manifest + excluded);
    folder.jitai(["check", "trial.toml"]).succeeded();
}

/// A program that sends an untailored message to everybody, and writes what it hears without observations into `log`.
const PROGRAM: &str = r#"
hear() { read -r line || exit 9; }
say() { printf '%s\n' "$1"; }
hear
case $line in *'"episodes":0,'*'"trial":{'*) ;; *) exit 8;; esac
say '{"type":"ready","protocol":1,"trials":true}'
while hear; do
  printf '%s\n' "$line" | sed 's/"observations":\[\[.*\]\],*//; s/,}/}/' >> log
  case $line in
    *'"type":"act"'*)
      lanes=${line#*'"lanes":['}; lanes=${lanes%%]*}
      say "{\"type\":\"choices\",\"actions\":[$(echo "$lanes" | sed 's/[0-9][0-9]*/1/g')]}";;
    *'"type":"end"'*) exit 0;;
  esac
done
"#;

const OUTSIDE: &str = r#"format = 1
name = "trial"
scenarios = ["P-H-D"]
seeds = 1

[trial]
people = 4
days = 3
decisions_per_day = 2
entry = { every_days = 2, people = 2 }
update_data = "in_study"
update_lag_days = 1
outage = [4, 5]
missing_outcomes = 1

[environment]
sigma = 0.6
horizon = 6

[evaluation]
on = "trial"
record_decisions = "test"

[[agent]]
name = "outside"
algorithm = "external"
command = ["sh", "program.sh"]
version = "1"

[[agent]]
name = "rule"
algorithm = "rule"
rule = "untailored"
"#;

/// The messages of the steps of a day in which these people are asked.
fn day(day: u32, lanes: &str) -> String {
    let [ones, nulls] =
        ["1", "null"].map(|word| lanes.split(',').map(|_| word).collect::<Vec<_>>().join(","));
    let step = |decision: u32| {
        format!(
            "{{\"type\":\"act\",\"day\":{day},\"decision\":{decision},\"lanes\":[{lanes}]}}\n\
             {{\"type\":\"rewards\",\"lanes\":[{lanes}],\"actions\":[{ones}],\"rewards\":[{nulls}]}}\n"
        )
    };
    step(0) + &step(1)
}

/// The message of an update.
fn update(day: u32, people: &str, before: u32, agent: &str) -> String {
    format!(
        "{{\"type\":\"update\",\"day\":{day},\"people\":[{people}],\"before\":{before},\"agent\":{agent}}}\n"
    )
}

#[test]
fn a_program_hears_the_calendar_of_its_trial() {
    let planned = [
        day(0, "0,1"),
        update(1, "0,1", 0, "null"),
        day(1, "0,1"),
        update(2, "0,1", 1, "null"),
        day(2, "0,1,2,3"),
        update(3, "0,1,2,3", 2, "null"),
        day(3, "2,3"),
        // An outage: no update on days 4 and 5.
        day(4, "2,3"),
    ];
    // Everybody leaves before the second day.
    let left = [
        day(0, "0,1"),
        update(1, "0,1", 0, "null"),
        update(2, "", 1, "null"),
        day(2, "2,3"),
        update(3, "2,3", 2, "null"),
    ];
    let unpooled = [
        day(0, "0,1"),
        update(1, "0", 0, "0"),
        update(1, "1", 0, "1"),
        day(1, "0,1"),
        update(2, "0", 1, "0"),
        update(2, "1", 1, "1"),
        day(2, "0,1,2,3"),
        update(3, "2", 2, "2"),
        update(3, "3", 2, "3"),
        day(3, "2,3"),
        day(4, "2,3"),
    ];
    for (more, expected) in [
        ("", planned.concat()),
        ("dropout = 1", left.concat()),
        ("pooling = \"none\"", unpooled.concat()),
    ] {
        let folder = Folder::new();
        folder.write("program.sh", PROGRAM);
        let manifest = OUTSIDE.replace("missing_outcomes", &format!("{more}\nmissing_outcomes"));
        folder.write("trial.toml", &manifest);
        folder.jitai(["run", "trial.toml", "--filter", "agent=outside"]).succeeded();
        assert_eq!(folder.read("log"), expected + "{\"type\":\"end\"}\n", "{more}");
    }
}

#[test]
fn a_program_that_plays_a_rule_meets_the_people_of_the_rule() {
    let folder = Folder::new();
    folder.write("program.sh", PROGRAM);
    let uncertain = "missing_outcomes = 0.3\ndropout = 0.1\nunreported = 0.4";
    let manifest = OUTSIDE
        .replace("missing_outcomes = 1", uncertain)
        .replace("people = 4", "people = 9")
        .replace(
            "[evaluation]",
            "[population]\nepsilon_h = { uniform = [0.01, 0.2] }\n\n[evaluation]",
        );
    folder.write("trial.toml", manifest.replace("seeds = 1", "seeds = 3"));
    folder.jitai(["run", "trial.toml"]).succeeded().says("6 jobs run, 6 completed in all");
    for (view, columns) in [
        ("evaluation_episode", "seed, episode, total_reward, length"),
        (
            "decision",
            "seed, episode, step, json_remove(state, '$.policy'), action, action_probability, reward",
        ),
    ] {
        let rows_of = |agent: &str| {
            format!(
                "SELECT {columns} FROM {view} JOIN run_summary USING (job_key) WHERE agent = '{agent}'"
            )
        };
        let count = |sql: &str| folder.number(&format!("SELECT count(*) FROM ({sql})"));
        let (rule, outside) = (rows_of("rule"), rows_of("outside"));
        assert!(count(&rule) >= 27, "{view}");
        assert_eq!(count(&format!("{rule} EXCEPT {outside}")), 0, "{view}");
        assert_eq!(count(&format!("{outside} EXCEPT {rule}")), 0, "{view}");
    }
    folder.jitai(["doctor"]).succeeded();
    let silent =
        "SELECT count(*) FROM decision WHERE json_extract(state, '$.reported') = 0 AND step = ";
    assert_eq!(folder.number(&format!("{silent}0")), 0);
    assert!(folder.number(&format!("{silent}2")) > 0);
}

#[test]
fn a_program_that_does_not_act_as_trials_need_fails_with_the_reason() {
    for (from, to, expected) in [
        (
            ",\"trials\":true",
            "",
            "expected `trials` = true in \"ready\", because the job is a trial",
        ),
        ("/1/g", "/7/g", "expected an action from 0 to 3 for lane 0, found 7"),
        ("while hear; do", "while hear; do exit 3", "exited with code 3 in the trial, on day 0"),
    ] {
        let folder = Folder::new();
        assert!(PROGRAM.contains(from), "{from}");
        folder.write("program.sh", PROGRAM.replacen(from, to, 1));
        folder.write("trial.toml", OUTSIDE);
        folder.jitai(["run", "trial.toml"]).ended(1).says("1 completed in all, 1 failed");
        let sql = "SELECT failure_message FROM run_summary WHERE failure_kind = 'external'";
        let message: String = folder.store().query_row(sql, [], |row| row.get(0)).unwrap();
        assert!(message.contains(expected), "{message}");
    }
}

#[test]
fn a_stay_shorter_than_days_ends_with_the_trial() {
    let folder = Folder::with(
        "format = 1\nname = \"t\"\nscenarios = [\"P-H-D\"]\nseeds = 1\nenvironment = { sigma = 0.4, horizon = 3 }\n\
         trial = { people = 3, days = 3, entry = \"stays.csv\" }\n\
         evaluation = { on = \"trial\", record_decisions = \"test\" }\n\
         [[agent]]\nname = \"random\"\nalgorithm = \"rule\"\nrule = \"random\"\n",
    );
    folder.write("stays.csv", "start_day,end_day\n1,3\n0,3\n2,3\n");
    folder.start(["run", "sweep.toml"]).wait_for(Duration::from_secs(60)).succeeded();
    let ends = |truncated: bool| {
        folder.number(&format!(
            "SELECT sum(10 * episode + step) FROM decision WHERE truncated = {truncated}"
        ))
    };
    // Persons 1 to 3 have 2, 3 and 1 decisions, and the last of each is the end.
    assert_eq!([ends(true), ends(false)], [11 + 22 + 30, 10 + 20 + 21]);
}

/// An environment of six steps.
const SIX_STEPS: &str = r#"
import json, sys
steps = {}
for line in sys.stdin:
    m = json.loads(line)
    rows = [[0.0] for _ in m["lanes"]] if isinstance(m.get("lanes"), list) else []
    if m["type"] == "describe":
        said = {"type": "description", "protocol": 1, "features": [{"name": "x"}], "actions": ["a", "b"], "horizon": 6}
    elif m["type"] == "reset":
        steps.update({(m["instance"], lane): 0 for lane in m["lanes"]})
        said = {"type": "began", "observations": rows}
    elif m["type"] == "step":
        for lane in m["lanes"]:
            steps[m["instance"], lane] += 1
        ends = [steps[m["instance"], lane] == 6 for lane in m["lanes"]]
        said = {"type": "stepped", "observations": rows, "rewards": [1.0] * len(rows), "truncated": ends}
    else:
        continue
    print(json.dumps(said), flush=True)
"#;

#[test]
fn a_program_with_another_horizon_than_the_trial_is_an_error_of_the_job() {
    for (days, suits) in [(4, false), (9, false), (6, true)] {
        let folder = Folder::with(&format!(
            "format = 1\nname = \"t\"\nscenarios = [\"all\"]\nseeds = 1\n\
             environment = {{ family = \"external\", command = [\"python3\", \"six.py\"], version = \"1\" }}\n\
             trial = {{ people = 2, days = {days} }}\nevaluation = {{ on = \"trial\" }}\n\
             [[agent]]\nname = \"random\"\nalgorithm = \"rule\"\nrule = \"random\"\n"
        ));
        folder.write("six.py", SIX_STEPS);
        let ran = folder.start(["run", "sweep.toml"]).wait_for(Duration::from_secs(60));
        if suits {
            ran.succeeded();
            assert_eq!(folder.number("SELECT sum(length) FROM evaluation_episode"), 12);
            folder.jitai(["check", "--try", "sweep.toml"]).succeeded();
        } else {
            let says = format!(
                "`days` = {days} with `decisions_per_day` = 1 are {days} decisions of a person; the program describes a \
                 `horizon` of 6"
            );
            ran.ended(1).says(&says);
            folder.jitai(["check", "--try", "sweep.toml"]).ended(2).says(&says);
        }
    }
}

#[test]
fn partial_pooling_without_deviations_is_full_pooling_in_a_whole_trial() {
    let text = MANIFEST
        .replace("pooling = [", "update_data = \"in_study\"\ndropout = 0.05\npooling = [")
        .replace("pooling = [\"full\", \"none\"]", "pooling = [\"full\", \"partial\"]")
        .replace("prior_sd = 30", "prior_sd = 30\nperson_sd = 0");
    let folder = folder(&text);
    folder.jitai(["run", "trial.toml", "--quiet"]).succeeded();
    let of = |pooling: &str| {
        format!(
            "(SELECT d.* , r.seed FROM decision AS d JOIN run_summary AS r USING (job_key)
              JOIN parameter AS p USING (job_key)
              WHERE r.agent = 'thompson' AND p.name = 'trial.pooling' AND p.value = '{pooling}')"
        )
    };
    let query = format!(
        "SELECT count(*) > 100, max(abs(f.action_probability - p.action_probability)) < 1e-9, sum(f.action <> p.action)
         FROM {} AS f JOIN {} AS p USING (seed, episode, step)",
        of("full"),
        of("partial")
    );
    let row = |row: &rusqlite::Row<'_>| Ok((row.get(0)?, row.get(1)?, row.get(2)?));
    let same: (bool, bool, i64) = folder.store().query_row(&query, [], row).unwrap();
    assert_eq!(same, (true, true, 0));
}

#[test]
fn a_trial_after_partial_pooling_begins_without_the_deviations_of_the_first() {
    let text = MANIFEST
        .replace("pooling = [\"full\", \"none\"]", "pooling = \"partial\"")
        .replace("seeds = 2", "seeds = 1")
        .replace("prior_sd = 30", "prior_sd = 30\nperson_sd = 10");
    let folder = folder(&text);
    folder.jitai(["run", "trial.toml", "--quiet"]).succeeded();
    let key: String = folder
        .store()
        .query_row("SELECT job_key FROM run_summary WHERE agent = 'thompson'", [], |row| row.get(0))
        .unwrap();
    folder.jitai(["export", "--policy", &key, "--out", "pilot"]).succeeded();
    let policy: serde_json::Value =
        serde_json::from_str(&folder.read("pilot/policy.json")).unwrap();
    let posterior = &policy["posterior"];
    let width = posterior["mean"][0].as_array().unwrap().len();
    let sds = posterior["person_sd"][0].as_array().unwrap();
    assert!(sds.len() == width && sds.iter().all(|sd| *sd == 10.0), "{sds:?}");
    let means = posterior["person_mean"].as_array().unwrap();
    assert_eq!((means.len(), means[0][0].as_array().unwrap().len()), (6, width));
    // From a file and from the store, it is the same job.
    for prior in ["pilot/policy.json", &format!("run:{key}")] {
        let next = text
            .replace("name = \"trial\"", "name = \"next\"")
            .replace("prior_sd = 30\n", &format!("prior_from = {prior:?}\n"));
        folder.write("next.toml", next);
        folder.jitai(["run", "next.toml"]).succeeded();
    }
    assert_eq!(folder.number("SELECT count(*) FROM run_summary WHERE experiment = 'next'"), 2);
}
