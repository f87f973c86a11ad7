//! Recorded trials: `[data]` in the place of `[environment]`.

use crate::support::Folder;

/// The rows of an answer, without the names of its columns.
fn answers(folder: &Folder, sql: &str) -> Vec<String> {
    let answer = folder.jitai(["query", sql, "--format", "csv"]).succeeded();
    answer.stdout.lines().skip(1).map(str::to_owned).collect()
}

/// HeartSteps V1, which ships with its data.
fn heartsteps(more: &str) -> Folder {
    let folder = Folder::new();
    let text = include_str!("../../experiments/heartsteps/effects.toml");
    folder.write("m.toml", format!("{text}{more}"));
    folder.write("published.csv", include_str!("../../experiments/heartsteps/published.csv"));
    folder.write("trial_log.csv", include_str!("../../experiments/heartsteps/trial_log.csv"));
    folder
}

#[test]
fn heartsteps_gives_its_published_effects() {
    let folder = heartsteps("");
    folder.jitai(["check", "m.toml"]).succeeded().says("7540 decisions of 37 people are used");
    folder.jitai(["run", "m.toml"]).succeeded();
    let estimates = answers(
        &folder,
        "SELECT name, term, printf('%.4f', estimate), printf('%.4f', standard_error) FROM estimate ORDER BY name, term",
    );
    assert_eq!(
        estimates,
        ["by day,1,0.5074,0.1505", "by day,day,-0.0185,0.0061", "effect,1,0.1312,0.0674"]
    );
    // Every decision is a row, as those of any other job.
    let counts =
        "SELECT count(*), count(DISTINCT episode), sum(action), sum(can_send) FROM decision";
    assert_eq!(answers(&folder, counts), ["7540,37,3594,6061"]);
    let first =
        "SELECT step, action, action_probability, round(reward, 9), json_extract(state, '$.day')
        FROM decision WHERE episode = 1 ORDER BY step LIMIT 1";
    assert_eq!(answers(&folder, first), ["1,1,0.6,7.178926799,0"]);
    // Nothing runs twice, whatever the name of the file.
    folder.write("renamed.csv", folder.read("trial_log.csv").replace('\n', "\r\n"));
    let again = folder.read("m.toml").replace("trial_log.csv", "renamed.csv");
    folder.write("m.toml", again);
    folder.jitai(["run", "m.toml"]).succeeded();
    assert_eq!(folder.runs(), 1);
    let changed = folder.read("renamed.csv").replacen("1311.5", "1312.5", 1);
    folder.write("renamed.csv", changed);
    folder.jitai(["run", "m.toml", "--replace"]).succeeded();
    assert_eq!(folder.runs(), 2);
}

#[test]
fn diagnosands_are_those_of_their_analysis_although_randomisation_comes_first() {
    let folder = heartsteps(
        "[[analysis]]\nname = \"trials\"\nkind = \"operating_characteristics\"\n\
         diagnosands = { largest = \"max(estimate)\" }\n\
         [[analysis]]\nname = \"drawn\"\nkind = \"randomisation\"\n",
    );
    folder.jitai(["run", "m.toml"]).succeeded();
    folder.jitai(["report", "m.toml", "--out", "report"]).succeeded();
    let table = folder.read("report/tables/heartsteps-v1-trials.csv");
    let mut rows = csv::Reader::from_reader(table.as_bytes());
    let index = rows.headers().unwrap().iter().position(|name| name == "largest").unwrap();
    let largest = rows.records().map(|row| row.unwrap()[index].parse().unwrap());
    let largest: Vec<f64> = largest.collect();
    assert!(largest.iter().any(|one| (one - 0.1312).abs() < 1e-4), "{table}");
}

#[test]
fn a_recorded_trial_is_reported_merged_exported_and_forgotten_as_others_are() {
    let folder = heartsteps("");
    folder.jitai(["run", "m.toml"]).succeeded();
    folder.jitai(["report", "m.toml", "--out", "report"]).succeeded();
    // The manifest's first estimate is the first, although the store has it after "by day". A slope has an axis of its own.
    let table = folder.read("report/tables/heartsteps-v1-effects.md");
    let begins = ["| effect | wcls | 1 |", "| by day | wcls | 1 |", "| by day | wcls | day |"];
    let begins =
        begins.map(|cells| table.find(cells).unwrap_or_else(|| panic!("{cells}: {table}")));
    assert!(begins.is_sorted() && !table.contains("Effective"), "{table}");
    for (figure, axis) in
        [("-1", "effect, log steps<"), ("-2", "effect, log steps per unit of day<")]
    {
        let figure = folder.read(&format!("report/figures/heartsteps-v1-effects{figure}.svg"));
        assert!(figure.contains(axis) && figure.contains(">by day: "), "{figure}");
    }
    let page = folder.read("report/index.html");
    let places = ["Was it randomised as recorded?", "3 of 3 numbers are the published ones"];
    let places = places.map(|words| page.find(words).unwrap());
    assert!(places[0] < places[1]);
    assert!(page.contains("people are numbered, and their names are left in the file"));
    let tests = folder.read("report/tables/heartsteps-v1-randomisation.csv");
    // 3594 of 6061 with probability 0.6: z = -1.115 by hand.
    assert!(tests.contains("\nall,,1,6061,0.592971") && tests.contains(",0.26"), "{tests}");
    assert!(tests.contains("\npeople,37,"), "{tests}");
    folder.jitai(["export", "--out", "views"]).succeeded();
    assert_eq!(folder.read("views/decision.csv").lines().count(), 7541);
    folder.jitai(["merge", "jitai.sqlite", "--store", "other.sqlite"]).succeeded();
    folder.jitai(["doctor", "--store", "other.sqlite"]).succeeded();
    folder.jitai(["status"]).succeeded();
    // Written out, with its file, it is the same job.
    let resolved = folder.jitai(["plan", "m.toml", "--resolved"]).succeeded();
    folder.write("resolved.toml", resolved.stdout);
    folder.jitai(["run", "resolved.toml"]).succeeded();
    assert_eq!(folder.runs(), 1);
    folder
        .jitai(["run", "m.toml", "--set", "data.outcome=steps_after", "--set", "name=other"])
        .ended(2);
    let unit = ["run", "m.toml", "--set", "unit=\"log of steps\"", "--set", "name=\"other\""];
    folder.jitai(unit).succeeded();
    assert_eq!(folder.runs(), 2);
    folder.jitai(["forget", "other", "--results", "--yes"]).succeeded();
    // Its stored decisions are a recorded trial again, with the same effect.
    let key = answers(&folder, "SELECT job_key FROM run_summary")[0].clone();
    folder.jitai(["export", "--data", &key, "--out", "again"]).succeeded();
    let effect = "\n[[estimate]]\nname = \"effect\"\ncontrol = [\"before\"]\nnumerator = 0.6\n";
    folder.write("again/trial.toml", folder.read("again/trial.toml") + effect);
    folder.jitai(["run", "again/trial.toml", "--set", "name=\"again\""]).succeeded();
    let sql = "SELECT DISTINCT printf('%.9f', estimate) FROM estimate WHERE name = 'effect'";
    assert_eq!(answers(&folder, sql), ["0.131195276"]);
    folder.jitai(["forget", "again", "--results", "--yes"]).succeeded();
    folder.jitai(["forget", "heartsteps-v1", "--results", "--yes"]).succeeded();
    assert_eq!(folder.number("SELECT count(*) FROM decision"), 0);
}

#[test]
fn faults_of_the_file_and_of_the_table_are_said_before_anything_runs() {
    let folder = heartsteps("");
    let text = folder.read("m.toml");
    folder.write("m.toml", text.replace("log(steps_after)", "log(steps_afer)"));
    folder
        .jitai(["check", "m.toml"])
        .ended(2)
        .says("`outcome`: the data have no column `steps_afer`");
    folder.write("m.toml", text.replace("person = \"person\"\n", ""));
    folder.jitai(["check", "m.toml"]).ended(2).says("missing key `person` in [data]");
    folder.write("m.toml", format!("environment.sigma = 1\n{text}"));
    folder.jitai(["check", "m.toml"]).ended(2).says("[environment] or [data], not both");
    folder.write("m.toml", text.replace("control = [\"before\"]", "control = [\"befor\"]"));
    folder.jitai(["check", "m.toml"]).ended(2).says("the recorded state has no `befor`");
    folder.write("m.toml", &text);
    let log = folder.read("trial_log.csv");
    for (broken, said) in [
        (
            log.replacen("1311.5", "\"1311,5\"", 1),
            "line 2: column `steps_after` has `1311,5`, expected a number with a point",
        ),
        (
            log.replacen("1,0,0,2,1", "1,0,2015-08-01,2,1", 1),
            "line 2: column `day` has `2015-08-01`",
        ),
        (
            log.replacen("1,1,0,3,1,1", "1,1,0,2,1,1", 1),
            "line 3: the same decision of person 1 as line 2",
        ),
        (log.replace(',', ";"), "its fields are separated by semicolons"),
        (log.replacen("1,0,0,2,1,1", "1,0,0,2,0,1", 1), "line 2: action 1 where `available` is 0"),
        (log.replacen("1311.5,0.6", "1311.5,1.6", 1), "line 2: `probability` is 1.6"),
        (
            log.replacen("1311.5,0.6", "1311.5,0", 1),
            "line 2: action 1 was taken with the probability 0",
        ),
        (log.replacen("1,0,0,2", ",0,0,2", 1), "line 2: column `person` is empty"),
        (String::new(), "the file is empty"),
    ] {
        folder.write("trial_log.csv", broken);
        let found = folder.jitai(["run", "m.toml"]).ended(2).says(said);
        assert!(found.stderr.contains("trial_log.csv"), "{}", found.stderr);
    }
    assert!(folder.count_if_there("SELECT count(*) FROM run").is_none_or(|runs| runs == 0));
    // A byte-order mark and quotes are no faults.
    folder.write("trial_log.csv", format!("\u{feff}{log}"));
    folder.jitai(["check", "m.toml"]).succeeded();
}

#[test]
fn the_value_of_a_policy_on_a_recorded_trial_has_its_errors() {
    // The trial's own probability earns the trial's mean outcome; another one near it earns nearly as much.
    let value = |name: &str, policy: f64| {
        format!(
            "\n[[estimate]]\nname = \"{name}\"\nestimator = \"value\"\ncontrol = [\"before\"]\npolicy = {policy}\n"
        )
    };
    let folder = heartsteps(&(value("as it was", 0.6) + &value("more often", 0.8)));
    folder.jitai(["run", "m.toml"]).succeeded();
    let sql = "SELECT printf('%.9f', avg(reward)) FROM decision";
    let mean = answers(&folder, sql);
    let sql = "SELECT printf('%.9f', estimate), standard_error > 0 FROM estimate WHERE name = 'as it was' AND term LIKE '%inverse%'";
    assert_eq!(answers(&folder, sql), [format!("{},1", mean[0])]);
    let sql = "SELECT count(*) FROM estimate WHERE name = 'more often' AND failure IS NULL AND effective_sample_size > 1000";
    assert_eq!(answers(&folder, sql), ["3"]);
    // The policy of the agent is that of agents which replay, if there are some.
    let agents =
        "[trial]\n[[agent]]\nname = \"bandit\"\nalgorithm = \"linear_thompson\"\npi_min = 0.2\n";
    let own =
        "[[estimate]]\nname = \"own\"\nestimator = \"value\"\npolicy = \"agent\"\nagainst = 1\n";
    let replay = heartsteps(&format!("{agents}{own}"));
    replay.jitai(["run", "m.toml"]).succeeded();
    assert_eq!(
        answers(&replay, "SELECT DISTINCT agent FROM estimate WHERE name = 'own'"),
        ["bandit"]
    );
    // Values have an axis of their own, and no test against 0.
    folder.jitai(["report", "m.toml", "--out", "report"]).succeeded();
    let table = folder.read("report/tables/heartsteps-v1-effects.csv");
    let mut rows = csv::Reader::from_reader(table.as_bytes());
    let names = rows.headers().unwrap().clone();
    let column = |name: &str| names.iter().position(|one| one == name).unwrap();
    let [p, size] = ["p", "effective_sample_size"].map(column);
    let has = rows.records().map(|row| row.unwrap());
    let has: Vec<[bool; 2]> = has.map(|row| [p, size].map(|at| !row[at].is_empty())).collect();
    let (effect, value) = ([true, false], [false, true]);
    assert_eq!(has, [[effect; 3].as_slice(), &[value; 6]].concat());
    let table = folder.read("report/tables/heartsteps-v1-effects.md");
    assert!(table.contains("a value of a policy is not tested against 0"), "{table}");
    let figure = folder.read("report/figures/heartsteps-v1-effects-3.svg");
    assert!(figure.contains(">value per decision, log steps<"), "{figure}");
    assert!(figure.contains("as it was: doubly_robust") && !figure.contains(">0<"), "{figure}");
}

#[test]
fn what_a_replaying_agent_would_have_earned_is_the_value_of_its_policy() {
    let folder = heartsteps(
        "\n[trial]\n[[agent]]\nname = \"never\"\nalgorithm = \"rule\"\nrule = \"never\"\n[[agent]]\nname = \"bandit\"\n\
         algorithm = \"linear_thompson\"\npi_min = 0.2\n[[estimate]]\nname = \"own\"\nestimator = \"value\"\n\
         policy = \"agent\"\ncontrol = [\"before\"]\nagents = [\"never\", \"bandit\"]\n[[estimate]]\nname = \"none\"\n\
         estimator = \"value\"\npolicy = 0\ncontrol = [\"before\"]\nagents = [\"recorded\"]\n",
    );
    folder.jitai(["run", "m.toml"]).succeeded();
    let of = |what: &str| {
        let sql = format!(
            "SELECT term, printf('%.9f %.9f %.6f', estimate, standard_error, effective_sample_size) FROM estimate \
             WHERE {what} AND failure IS NULL ORDER BY number"
        );
        answers(&folder, &sql)
    };
    let never = of("name = 'own' AND agent = 'never'");
    assert_eq!((never.len(), &never), (3, &of("name = 'none'")));
    let bandit = of("name = 'own' AND agent = 'bandit'");
    assert!(bandit.len() == 3 && bandit != never, "{bandit:?}");
}

#[test]
fn agents_that_cannot_replay_are_refused_in_a_sentence_each() {
    let agents = "[[agent]]\nname = \"dqn\"\nalgorithm = \"dueling_dqn\"\n[[agent]]\nname = \"mine\"\n\
                  algorithm = \"external\"\ncommand = [\"./agent\"]\nversion = \"1\"\n[[agent]]\nname = \"bandit\"\n\
                  algorithm = \"linear_thompson\"\n";
    let folder = heartsteps(agents);
    let refused = folder.jitai(["check", "m.toml"]).ended(2);
    for said in [
        "agent `dqn`: dueling_dqn cannot replay a recorded trial",
        "agent `mine`: an outside program cannot replay a recorded trial",
        "agent `bandit`: it learns at the updates of a trial, and the manifest has no [trial]",
    ] {
        assert!(refused.stderr.contains(said), "{said}: {}", refused.stderr);
    }
    let bandit =
        "agents = [\"b\"]\n[trial]\n[[agent]]\nname = \"b\"\nalgorithm = \"linear_thompson\"\n";
    let says = "an effect rests on the recorded probabilities, and agent `b` has others";
    heartsteps(bandit).jitai(["check", "m.toml"]).ended(2).says(says);
    let folder = heartsteps("[trial]\ndropout = 0.1\npeople = 12\n");
    let refused = folder.jitai(["check", "m.toml"]).ended(2);
    for said in ["`dropout` is for simulated people", "`people`: the file has 37 people"] {
        assert!(refused.stderr.contains(said), "{said}: {}", refused.stderr);
    }
    let folder = Folder::with(
        "format = 1\nname = \"t\"\nscenarios = [\"P\"]\nseeds = 1\nenvironment.sigma = 1\n[[agent]]\nname = \"a\"\n\
         algorithm = \"rule\"\nrule = \"recorded\"\n",
    );
    folder.jitai(["check", "sweep.toml"]).ended(2).says("the manifest has no [data]");
}

/// A trial of a world that is unavailable now and then, with everything that can happen in one.
const WORLD: &str = "format = 1\ntitle = \"t\"\ndays = 12\ndecisions_per_day = 2\n[variables]\n\
    dose = \"0.8 * default(dose[-1], 0) + default(action[-1], 0)\"\nfree = { bernoulli = 0.9 }\n\
    minutes = { gaussian = [\"2 + action * (1 - 0.4 * dose)\", 1] }\n[roles]\noutcome = \"minutes\"\n\
    available = \"free\"\nfeatures = [{ name = \"dose\", low = 0, high = 5 }]\n";

fn simulated(pooling: &str, agent: &str) -> String {
    format!(
        "format = 1\nname = \"simulated\"\nscenarios = \"all\"\nseeds = [5]\n[environment]\nfamily = \"declared\"\n\
         model = \"world.toml\"\n[trial]\npeople = 9\ndays = 12\ndecisions_per_day = 2\nentry_every_days = 2\n\
         entry_people = 3\ndropout = 0.03\nmissing_outcomes = 0.1\nunreported = 0.1\npooling = {pooling}\n\
         update_every_days = 3\n[evaluation]\non = \"trial\"\nrecord_decisions = \"test\"\n[[agent]]\nname = \"bandit\"\n\
         algorithm = \"linear_thompson\"\nnoise_sd = 1.0\nprior_sd = 1.0\npi_min = 0.05\n{agent}\n"
    )
}

/// The largest difference between a replay and its record.
fn difference(folder: &Folder) -> f64 {
    let sql = "SELECT max(abs(action_probability - json_extract(decision.state, '$.recorded_probability'))), count(*)
        FROM decision JOIN run_summary USING (job_key) WHERE agent = 'replayed'";
    let found = answers(folder, sql);
    let (difference, count) = found[0].split_once(',').unwrap();
    assert!(count.parse::<u32>().unwrap() > 100, "{found:?}");
    difference.parse().unwrap()
}

/// A folder in which a trial has been simulated and exported, with the key of its job.
fn exported(pooling: &str, agent: &str) -> Folder {
    let folder = Folder::new();
    folder.write("world.toml", WORLD);
    folder.write("sweep.toml", simulated(pooling, agent));
    folder.jitai(["run", "sweep.toml"]).succeeded();
    let key = answers(&folder, "SELECT job_key FROM run_summary")[0].clone();
    folder.jitai(["export", "--data", &key[..9], "--out", "log"]).succeeded();
    folder
}

#[test]
fn every_bandit_repeats_its_trial_when_it_is_read_back() {
    let (clipped, logistic) = ("allocation = \"clipped\"", "allocation = \"logistic\"");
    let centred = "action_centring = true";
    for (pooling, agent) in [
        ("\"full\"", ""),
        ("\"full\"", centred),
        ("\"full\"", "smoothing = 0.1"),
        ("\"full\"", clipped),
        ("\"none\"", logistic),
        ("\"none\"", centred),
        ("\"partial\"", "person_sd = 0.5"),
        ("\"partial\"", "action_centring = true\nperson_sd = \"estimated\""),
        ("4", clipped),
    ] {
        let folder = exported(pooling, agent);
        folder.jitai(["run", "log/trial.toml"]).succeeded();
        let found = difference(&folder);
        assert!(found < 1e-12, "{pooling}, {agent}: {found:e}");
        folder.jitai(["report", "log/trial.toml", "--out", "report"]).succeeded();
        let page = folder.read("report/index.html");
        assert!(page.contains("repeats the record"), "{pooling}, {agent}");
        assert!(page.contains("Was it randomised as recorded?"));
    }
}

#[test]
fn updates_that_lag_forget_and_pause_are_replayed() {
    let folder = exported("\"full\"", "");
    for keys in [
        "update_first_day = 5\nupdate_lag_days = 1",
        "update_data = \"in_study\"\noutage = [4, 9]",
        "update_first_with_people = 4",
    ] {
        let text = simulated("\"full\"", "")
            .replace("update_every_days = 3", &format!("update_every_days = 2\n{keys}"));
        folder.write("sweep.toml", text);
        folder.jitai(["run", "sweep.toml", "--replace"]).succeeded();
        let sql = "SELECT job_key FROM run_summary WHERE agent = 'bandit' ORDER BY started_at DESC";
        let key = answers(&folder, sql)[0].clone();
        folder.jitai(["export", "--data", &key, "--out", "log"]).succeeded();
        let text = folder
            .read("log/trial.toml")
            .replace("name = \"recorded", &format!("name = \"{}", &key[..6]));
        folder.write("log/trial.toml", text);
        folder.jitai(["run", "log/trial.toml"]).succeeded();
        assert!(difference(&folder) < 1e-12, "{keys}");
    }
}

#[test]
fn a_changed_outcome_is_found_at_the_first_update_after_it() {
    let folder = exported("\"full\"", "");
    // An outcome that reached the agent, on day 4; updates come every 3 days.
    let log = folder.read("log/trial.csv");
    let names: Vec<&str> = log.lines().next().unwrap().split(',').collect();
    let index = |name: &str| names.iter().position(|known| *known == name).unwrap();
    let is_meant = |fields: &[&str]| {
        fields[index("calendar_day")] == "4"
            && fields[index("available")] == "1"
            && fields[index("reached")] == "1"
    };
    let mut is_changed = false;
    let lines = log.lines().map(|line| {
        let mut fields: Vec<&str> = line.split(',').collect();
        if !is_changed && is_meant(&fields) {
            is_changed = true;
            fields[index("outcome")] = "9.5";
        }
        fields.join(",")
    });
    let changed: Vec<String> = lines.collect();
    folder.write("log/trial.csv", changed.join("\n"));
    folder.jitai(["run", "log/trial.toml"]).succeeded();
    assert!(difference(&folder) > 1e-6);
    folder.jitai(["report", "log/trial.toml", "--out", "report"]).succeeded();
    // The first in the order of time: by day, decision of the day, and person.
    let sql = "SELECT printf('day %d at decision %d of person %d', json_extract(decision.state, '$.calendar_day'), step, episode)
        FROM decision JOIN run_summary USING (job_key) WHERE agent = 'replayed' AND can_send
        AND abs(action_probability - json_extract(decision.state, '$.recorded_probability')) > 1e-12
        ORDER BY json_extract(decision.state, '$.calendar_day'), step % 2, episode LIMIT 1";
    let first = answers(&folder, sql)[0].clone();
    assert!(first.starts_with("day 6"), "{first}");
    assert!(folder.read("report/index.html").contains(&format!("first differs on {first} (")));
}

#[test]
fn a_job_without_decisions_or_with_hidden_features_says_what_it_lacks() {
    let folder = Folder::completed(
        "format = 1\nname = \"t\"\nscenarios = [\"T\"]\nseeds = 1\nenvironment.sigma = 1\nenvironment.horizon = 6\n\
         trial = { people = 3, days = 6 }\nevaluation.on = \"trial\"\n[[agent]]\nname = \"a\"\n\
         algorithm = \"linear_thompson\"\n",
    );
    let key = answers(&folder, "SELECT job_key FROM run_summary")[0].clone();
    folder.jitai(["export", "--data", &key, "--out", "log"]).ended(2).says("stores no decisions");
    let text = folder.read("sweep.toml").replace(
        "evaluation.on = \"trial\"",
        "evaluation = { on = \"trial\", record_decisions = \"test\" }",
    );
    folder.write("sweep.toml", &text);
    folder.jitai(["run", "sweep.toml", "--replace"]).succeeded();
    let sql = "SELECT job_key FROM decision LIMIT 1";
    let key = answers(&folder, sql)[0].clone();
    folder
        .jitai(["export", "--data", &key, "--out", "log"])
        .succeeded()
        .says("lacks what the scenario T shows, so that the agent is not replayed");
    folder.jitai(["run", "log/trial.toml"]).succeeded();
    let rows = folder.read("log/trial.csv").lines().count() - 1;
    assert_eq!(folder.number("SELECT count(*) FROM decision"), 2 * rows as i64);
    // What the scenario shows is there in another one.
    folder.write("sweep.toml", text.replace("\"T\"", "\"P-H\""));
    folder.jitai(["run", "sweep.toml", "--replace"]).succeeded();
    let sql = "SELECT job_key FROM run_summary WHERE scenario = 'P-H'";
    let key = answers(&folder, sql)[0].clone();
    folder.jitai(["export", "--data", &key, "--out", "log"]).succeeded();
    folder.jitai(["run", "log/trial.toml"]).succeeded();
    let sql = "SELECT max(abs(action_probability - json_extract(decision.state, '$.recorded_probability'))) < 1e-12
        FROM decision JOIN run_summary USING (job_key) WHERE agent = 'replayed'";
    assert_eq!(answers(&folder, sql), ["1"]);
    folder.jitai(["export", "--data", "fffffff", "--out", "log"]).ended(2);
}

/// A trial of two people, two decisions a day.
const SMALL: &str = "id,n,day,sent,p,before,after\nann,0,3,1,0.6,211,340\nann,1,3,0,0.6,,3\nann,2,4,0,0.6,0,55\n\
    ann,3,4,1,0.6,97,120\nbob,0,5,0,0.6,34,18\nbob,1,5,1,0.6,0,77\nbob,2,6,1,0.6,15,29\nbob,3,6,0,0.6,8,30\n";

/// A manifest of the small trial, with more keys of `[data]` and after it.
fn small(more: &str) -> Folder {
    let folder = Folder::new();
    folder.write("trial.csv", SMALL);
    folder.write(
        "m.toml",
        format!(
            "format = 1\nname = \"small\"\n[data]\nfile = \"trial.csv\"\nperson = \"id\"\norder = \"n\"\n\
             action = \"sent\"\nprobability = \"p\"\noutcome = \"log(after)\"\ndecisions_per_day = 2\n\
             unit = \"log steps\"\nstate = {{ before = \"before\" }}\n{more}"
        ),
    );
    folder
}

#[test]
fn a_missing_number_of_the_state_is_null_and_estimates_leave_it_out() {
    let folder = heartsteps("");
    let row =
        folder.read("trial_log.csv").replacen("1,0,0,2,1,1,0.5,1311.5", "1,0,0,2,1,1,,1311.5", 1);
    folder.write("trial_log.csv", row);
    folder.jitai(["run", "m.toml"]).succeeded();
    assert_eq!(answers(&folder, "SELECT DISTINCT decisions FROM estimate"), ["6060"]);
    let folder = small("");
    folder.jitai(["check", "m.toml"]).succeeded().says("1 decisions have no `before`");
    folder.jitai(["run", "m.toml"]).succeeded();
    let sql = "SELECT count(*), sum(json_extract(state, '$.before') IS NULL), sum(json_type(state, '$.before') = 'null')
        FROM decision";
    assert_eq!(answers(&folder, sql), ["8,1,1"]);
    folder.jitai(["merge", "jitai.sqlite", "--store", "other.sqlite"]).succeeded();
    folder.jitai(["doctor", "--store", "other.sqlite"]).succeeded();
    folder.jitai(["report", "m.toml", "--out", "report"]).succeeded();
    // What is written out reads back, with its unit and its decisions per day.
    let key = answers(&folder, "SELECT job_key FROM run_summary")[0].clone();
    folder.jitai(["export", "--data", &key, "--out", "log"]).succeeded();
    let again = folder.read("log/trial.toml");
    assert!(again.contains("decisions_per_day = 2\nunit = \"log steps\"\n"), "{again}");
    folder.jitai(["run", "log/trial.toml"]).succeeded();
    assert_eq!(folder.runs(), 2);
}

#[test]
fn certain_decisions_are_left_out_as_the_failure_says() {
    let folder = heartsteps("");
    let row = folder.read("trial_log.csv").replacen("1311.5,0.6", "1311.5,1", 1);
    folder.write("trial_log.csv", row);
    folder.jitai(["run", "m.toml"]).succeeded();
    let failure = answers(&folder, "SELECT DISTINCT failure FROM estimate")[0].clone();
    assert!(failure.contains("probability 0 or 1, the first at step 1 of person 1"), "{failure}");
    let (_, advice) = failure.split_once("such as \"\"").unwrap();
    let advised = advice.split_once("\"\"").unwrap().0.replace("p >", "probability >");
    let advised = advised.replace("p <", "probability <").replace(", p,", ", probability,");
    let text = folder.read("m.toml");
    folder.write("m.toml", text.replace("= \"probability\"", &format!("= \"{advised}\"")));
    folder.jitai(["check", "m.toml"]).succeeded().says("1 decisions have no probability");
    folder.jitai(["run", "m.toml", "--replace"]).succeeded();
    assert_eq!(answers(&folder, "SELECT DISTINCT decisions FROM estimate"), ["6060"]);
}

#[test]
fn what_a_recorded_trial_cannot_have_is_refused() {
    let rule = "[[agent]]\nname = \"chance\"\nalgorithm = \"rule\"\nrule = \"random\"\n";
    let bandit = "[[agent]]\nname = \"recorded\"\nalgorithm = \"linear_thompson\"\n";
    for (more, said) in [
        (
            rule,
            "agent `chance`: it replays the updates of a trial, and the manifest has no [trial]",
        ),
        ("[evaluation]\ntest_episodes = 3\n", "`test_episodes`: the file has 2 people"),
        ("family = \"declared\"\n", "`family`: [data] is a recorded trial"),
        ("reached = [\"1\", \"0\"]\n", "`reached`: a manifest reads one recorded trial in one way"),
        (
            "calendar_day = \"day\"\n[trial]\nentry_every_days = 3\n",
            "`entry_every_days`: people enter by `calendar_day`",
        ),
    ] {
        small(more).jitai(["check", "m.toml"]).ended(2).says(said);
    }
    let says = "agent `recorded`: this is the name of the agent that repeats the recorded actions";
    small(&format!("[trial]\n{bandit}")).jitai(["check", "m.toml"]).ended(2).says(says);
    small("[evaluation]\ntest_episodes = 2\n").jitai(["check", "m.toml"]).succeeded();
    // A faulty file is the only fault, and the mark is at its name.
    let folder = small("[trial]\n");
    folder.write("trial.csv", SMALL.replacen("340", "many", 1));
    let found = folder.jitai(["check", "m.toml"]).ended(2).says("m.toml:4:8: `file`: `trial.csv`");
    assert!(found.stderr.contains("1 fault in m.toml"), "{}", found.stderr);
    folder.write("trial.csv", b"id,n\nJos\xe9,0\n");
    folder.jitai(["check", "m.toml"]).ended(2).says("it is not in UTF-8; save the file as UTF-8");
}

#[test]
fn files_as_spreadsheets_and_r_write_them_are_read_or_explained() {
    let folder = small("");
    let percent = "expected a number from 0 to 1; for percentages, write probability = \"p / 100\"";
    for (broken, said) in [
        (
            SMALL.replacen("ann,0,3,1", "ann,0,3,yes", 1),
            "line 2: column `sent` has `yes`, expected a number; write 1 for yes and 0 for no in the file",
        ),
        (SMALL.replace("0.6", "60"), &*format!("line 2: `probability` is 60, {percent}")),
        (SMALL.replace("0.6", "60 %"), "line 2: column `p` has `60 %`, expected a number without"),
        (SMALL.replacen("ann,2", "\"ann,2", 1), "line 4: a quote opens here, and none closes it"),
        (SMALL.replacen(",55", ",\"55", 1), "line 4: a quote opens here, and none closes it"),
        (SMALL.replacen("id,", "\"id,", 1), "line 1: a quote opens here, and none closes it"),
        (
            SMALL.replacen("ann,2", "\"ann,2", 1).replacen("bob,0", "\"bob\",0", 1),
            "line 4: the name of the person has a line break; a quote that opens in this line closes in a later one",
        ),
        (
            SMALL.replacen(",55", ",\"55", 1).replacen("bob,0", "\"bob\",0", 1),
            "line 4: 13 fields, and line 1 has 7; a quote that opens in this line closes in a later one",
        ),
        (
            SMALL.lines().skip(1).map(|line| format!("{line}\n")).collect(),
            "line 1: numbers, where the names of columns are expected: add a first line with the names",
        ),
    ] {
        folder.write("trial.csv", broken);
        let found = folder.jitai(["check", "m.toml"]).ended(2).says(said);
        let follows = ["with the probability 0", "listed twice", "no column"];
        assert!(follows.iter().all(|of| !found.stderr.contains(of)), "{}", found.stderr);
    }
    // One value between 0 and 1 is a share.
    folder.write("trial.csv", SMALL.replace("0.6", "60").replacen("60", "0.6", 1));
    let found = folder.jitai(["check", "m.toml"]).ended(2).says("`probability` is 60");
    assert!(!found.stderr.contains("percentages"), "{}", found.stderr);
    folder.write("trial.csv", SMALL.replace("0.6", "60"));
    let text = folder.read("m.toml");
    folder.write("m.toml", text.replace("\"p\"", "\"p / 100\""));
    folder.jitai(["check", "m.toml"]).succeeded();
    folder.write("m.toml", &text);
    folder.write("trial.csv", SMALL.replace(",1,0.6", ",T,0.6").replace(",0,0.6", ",F,0.6"));
    folder.jitai(["check", "m.toml"]).succeeded().says("8 decisions of 2 people are used");
}

#[test]
fn what_is_left_out_or_looks_like_a_code_is_said_with_its_first_line() {
    let folder = small("reached = \"day < 6\"\n");
    let broken = [
        ("ann,1,3,0", "ann,1,3,NA"),
        ("ann,3,4,1,0.6", "ann,3,4,1,"),
        ("0.6,0,55", "0.6,0,0"),
        ("0.6,34,", "0.6,-99,"),
        ("0.6,8,", "0.6,-99,"),
    ];
    let file = broken.iter().fold(SMALL.to_owned(), |text, (one, by)| text.replacen(one, by, 1));
    folder.write("trial.csv", file);
    let code = "`before` is -99 in 2 rows, the first in line 6, which looks like a code for a missing number: write \
                \"if(before == -99, missing, before)\"";
    folder
        .jitai(["check", "m.toml"])
        .succeeded()
        .says("1 decisions have no action and are left out, the first in line 3")
        .says("1 decisions have no probability and are left out, the first in line 5")
        .says("1 decisions have no outcome and are left out, the first in line 4")
        .says("2 decisions have an outcome that did not reach the agent of the trial, the first in line 8")
        .says(code);
    let text = folder.read("m.toml");
    let missing = "{ before = \"if(before == -99, missing, before)\" }";
    folder.write("m.toml", text.replace("{ before = \"before\" }", missing));
    let found = folder.jitai(["check", "m.toml"]).succeeded();
    let found = found.says("3 decisions have no `before`, the first in line 3");
    assert!(!found.stderr.contains("looks like"), "{}", found.stderr);
}

#[test]
fn a_replay_is_reported_by_its_value_and_not_by_returns_of_recorded_actions() {
    let bandit =
        "\n[trial]\n[[agent]]\nname = \"bandit\"\nalgorithm = \"linear_thompson\"\npi_min = 0.2\n";
    let value = "[[estimate]]\nname = \"own\"\nestimator = \"value\"\npolicy = \"agent\"\nagents = \"bandit\"\n";
    let folder = heartsteps(bandit);
    let ran = folder.jitai(["run", "m.toml"]).succeeded();
    assert!(
        ran.stdout.contains("\nrecorded") && !ran.stdout.contains("\nbandit"),
        "{}",
        ran.stdout
    );
    folder.jitai(["report", "m.toml", "--out", "report"]).succeeded();
    assert!(!folder.read("report/index.html").contains("Missing:"));
    let agents = folder.read("report/tables/heartsteps-v1-agents.csv");
    assert!(agents.contains("recorded") && !agents.contains("bandit"), "{agents}");
    let effects = || folder.read("report/tables/heartsteps-v1-effects.csv");
    assert!(!effects().contains("trial_mean"));
    // A value stands beside the mean outcome of the trial's own decisions.
    folder.write("m.toml", folder.read("m.toml") + value);
    folder.jitai(["run", "m.toml"]).succeeded();
    folder.jitai(["report", "m.toml", "--out", "report"]).succeeded();
    let mean = answers(&folder, "SELECT printf('%.4f', avg(reward)) FROM decision")[0].clone();
    let effects = effects();
    let own: Vec<&str> = effects.lines().filter(|line| line.contains(",own,")).collect();
    assert!(effects.contains("effective_sample_size,trial_mean,published"), "{effects}");
    let has_mean = |line: &&str| line.contains(",7540,") && line.contains(&format!(",{mean}"));
    assert!(own.len() == 3 && own.iter().all(has_mean), "{mean}: {effects}");
}

#[test]
fn a_replay_is_no_trial_and_is_written_out_as_it_is_read() {
    let rule = "[[agent]]\nname = \"chance\"\nalgorithm = \"rule\"\nrule = \"random\"\n";
    let folder = small(&format!("calendar_day = \"day\"\n[trial]\n{rule}"));
    // A manifest that is written out in full has the calendar of the file as a text.
    let recorded = "[[agent]]\nname = \"recorded\"\nalgorithm = \"rule\"\nrule = \"recorded\"\n";
    folder.write("m.toml", folder.read("m.toml") + recorded);
    folder.jitai(["run", "m.toml"]).succeeded();
    let resolved = folder.jitai(["plan", "m.toml", "--resolved"]).succeeded();
    folder.write("resolved.toml", resolved.stdout);
    folder.jitai(["run", "resolved.toml"]).succeeded();
    assert_eq!(folder.runs(), 2);
    let key = |agent: &str| {
        let sql = format!("SELECT job_key FROM run_summary WHERE agent = '{agent}'");
        answers(&folder, &sql)[0].clone()
    };
    let refused = folder.jitai(["export", "--data", &key("chance"), "--out", "log"]).ended(2);
    assert!(refused.stderr.contains("it replayed a trial"), "{}", refused.stderr);
    folder.jitai(["export", "--data", &key("recorded"), "--out", "log"]).succeeded();
    folder.jitai(["run", "log/trial.toml"]).succeeded();
}

#[test]
fn names_of_people_are_nowhere_in_a_store_or_a_page() {
    let folder = small("");
    let text = SMALL
        .replace("id,", "id,mailbox,")
        .replace("ann,", "annegret,a@here,")
        .replace("bob,", "bobarino,b@here,");
    folder.write(
        "m.toml",
        folder.read("m.toml").replace("\"trial.csv\"", &format!("'''\n{text}'''")),
    );
    folder.jitai(["run", "m.toml"]).succeeded();
    folder.jitai(["report", "m.toml", "--out", "report"]).succeeded();
    let names = ["annegret", "bobarino", "@here", "mailbox"];
    let lacks = |of: &str, bytes: &[u8]| {
        let found = |name: &str| bytes.windows(name.len()).any(|part| part == name.as_bytes());
        names.iter().for_each(|name| assert!(!found(name), "{name} is in {of}"));
    };
    for entry in std::fs::read_dir(folder.path("")).unwrap().map(|entry| entry.unwrap().path()) {
        if entry.to_string_lossy().contains("jitai.sqlite") {
            lacks("the store", &std::fs::read(entry).unwrap());
        }
    }
    lacks("the page", folder.read("report/index.html").as_bytes());
    let resolved = folder.jitai(["plan", "m.toml", "--resolved"]).succeeded().stdout;
    lacks("the resolved manifest", resolved.as_bytes());
    // The stored manifest, and a file with other names, are the same job.
    let manifest = || {
        let answer = folder
            .jitai(["query", "SELECT manifest FROM experiment", "--format", "csv"])
            .succeeded()
            .stdout;
        answer.split_once('\n').unwrap().1.trim_end().trim_matches('"').replace("\"\"", "\"")
    };
    folder.write("stored.toml", manifest());
    folder.jitai(["run", "stored.toml"]).succeeded();
    folder.write("resolved.toml", resolved);
    folder.jitai(["run", "resolved.toml"]).succeeded();
    let other = small("");
    other.write("trial.csv", SMALL.replace("ann", "eve"));
    other
        .jitai(["run", "m.toml", "--store", &folder.path("jitai.sqlite").to_string_lossy()])
        .succeeded();
    assert_eq!(folder.runs(), 1);
    // Whoever asks for names has them.
    let kept = folder.read("m.toml").replace("unit =", "keep_identifiers = true\nunit =");
    folder.write("kept.toml", kept);
    folder.jitai(["run", "kept.toml", "--replace"]).succeeded();
    assert!(manifest().contains("annegret"));
}

#[test]
fn forgotten_names_are_no_bytes_of_the_store() {
    let folder = small("keep_identifiers = true\n");
    folder.write("trial.csv", SMALL.replace("ann", "annegret"));
    folder.jitai(["run", "m.toml"]).succeeded();
    let has_name = || {
        let files = ["jitai.sqlite", "jitai.sqlite-wal"]
            .map(|name| std::fs::read(folder.path(name)).unwrap_or_default());
        files.iter().any(|bytes| bytes.windows(8).any(|part| part == b"annegret"))
    };
    assert!(has_name());
    folder.jitai(["forget", "small", "--results", "--yes"]).succeeded();
    assert!(!has_name());
}

#[test]
fn what_follows_the_recorded_action_is_no_feature_and_errors_of_unknown_learning_are_refused() {
    let estimate = |more: &str| small(&format!("[[estimate]]\nname = \"effect\"\n{more}\n"));
    let says = "`control`: `recorded_probability` follows the action";
    let found = estimate("control = [\"recorded_probability\"]")
        .jitai(["check", "m.toml"])
        .ended(2)
        .says(says);
    assert!(found.stderr.contains("declare the probability itself in `state`"), "{}", found.stderr);
    let says = "the recorded state has no `mood`";
    let found = estimate("moderators = [\"mood\"]").jitai(["check", "m.toml"]).ended(2).says(says);
    assert!(found.stderr.contains("it has before, step"), "{}", found.stderr);
    let says = "the algorithm that drew the recorded actions is not known";
    estimate("standard_errors = \"after_study\"").jitai(["check", "m.toml"]).ended(2).says(says);
}

#[test]
fn decisions_count_from_one_number_for_all_people() {
    let days = "SELECT group_concat(step) FROM (SELECT step FROM decision WHERE episode = 2 ORDER BY step)";
    let folder = small("");
    // The first decision of one of three people is no row of the file.
    let rows = SMALL.replacen("bob,0,5,0,0.6,34,18\n", "", 1) + "cat,0,5,0,0.6,34,18\n";
    folder.write("trial.csv", &rows);
    folder.jitai(["run", "m.toml"]).succeeded();
    assert_eq!(answers(&folder, days), ["\"1,2,3\""]);
    // What is written out of two of them counts in the same way.
    folder.write("trial.csv", rows.replace("cat,0,5,0,0.6,34,18\n", ""));
    folder.write(
        "m.toml",
        folder.read("m.toml").replace("\"n\"", "[\"floor(n / 2)\", \"n - 2 * floor(n / 2)\"]"),
    );
    folder.jitai(["run", "m.toml", "--store", "two.sqlite"]).succeeded();
    let steps = || {
        folder.jitai(["query", days, "--format", "csv", "--store", "two.sqlite"]).succeeded().stdout
    };
    assert!(steps().ends_with("\"1,2,3\"\n"), "{}", steps());
    let key = folder
        .jitai([
            "query",
            "SELECT job_key FROM run_summary",
            "--format",
            "csv",
            "--store",
            "two.sqlite",
        ])
        .succeeded();
    let key = key.stdout.lines().last().unwrap().to_owned();
    folder.jitai(["export", "--data", &key, "--out", "log", "--store", "two.sqlite"]).succeeded();
    folder.jitai(["run", "log/trial.toml", "--store", "three.sqlite"]).succeeded();
    let again = folder
        .jitai(["query", days, "--format", "csv", "--store", "three.sqlite"])
        .succeeded()
        .stdout;
    assert_eq!(again, steps());
}

#[test]
fn what_did_not_reach_the_agent_is_written_out_again() {
    let folder = small("reached = \"if(n == 2, 0, 1)\"\n");
    folder.jitai(["run", "m.toml"]).succeeded();
    let key = answers(&folder, "SELECT job_key FROM run_summary")[0].clone();
    folder.jitai(["export", "--data", &key, "--out", "log"]).succeeded();
    let trial = folder.read("log/trial.csv");
    let reached =
        trial.lines().next().unwrap().split(',').position(|name| name == "reached").unwrap();
    let written: Vec<&str> =
        trial.lines().skip(1).map(|line| line.split(',').nth(reached).unwrap()).collect();
    assert_eq!(written.iter().filter(|one| **one == "0").count(), 2, "{trial}");
    assert!(folder.read("log/trial.toml").contains("reached = \"reached\""));
    folder
        .jitai(["check", "log/trial.toml"])
        .succeeded()
        .says("2 decisions have an outcome that did not reach");
}
