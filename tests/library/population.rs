//! Participants who differ, from the manifest to analyses of a part of them.

use std::collections::HashMap;
use std::fs;
use std::sync::atomic::AtomicBool;

use jitai::agent::{
    Agent, DecisionRule, DuelingDqn, LinearThompson, Ppo, Reinforce, RuleParameters,
};
use jitai::env::{ParticipantSampler, Population, PopulationPhases, StepCount};
use jitai::experiment::{self, Event, Options, Selection, Store};
use jitai::job::Job;
use jitai::job::{Evaluation, RecordedDecisions};
use jitai::job::{Outcome, ParticipantValue, Phase, Results};
use jitai::key::{Distribution, Rows};
use jitai::manifest::{self};
use jitai::plan::{self};
use jitai::results::assemble;
use jitai::store::{Reader, examine};
use jitai::train::{self, Uncontrolled};

const TEXT: &str = r#"
    format = 1
    name = "people"
    scenarios = ["P-H-D"]
    seeds = [1, 2, 3]
    environment.sigma = 0.6
    evaluation.test_episodes = 50
    [population]
    epsilon_d = { uniform = [0.1, 0.7] }
    rows = [{ delta_d = 0.05, rho_2 = 100 }, { delta_d = 0.2, rho_2 = 300, }]
    [[agent]]
    name = "tailored"
    algorithm = "rule"
    rule = "tailored"
    [[agent]]
    name = "untailored"
    algorithm = "rule"
    rule = "untailored"
    [[analysis]]
    name = "fifth"
    kind = "contrast"
    by = "agent.name"
    between = ["tailored", "untailored"]
    pairing = "by_seed"
    participants = { parameter = "epsilon_d", from_quantile = 0.8 }
    [[analysis]]
    name = "all"
    kind = "contrast"
    by = "agent.name"
    between = ["tailored", "untailored"]
    pairing = "by_seed"
    [[analysis]]
    name = "everybody"
    kind = "contrast"
    by = "agent.name"
    between = ["tailored", "untailored"]
    pairing = "by_seed"
    participants = { parameter = "epsilon_d" }
"#;

fn people() -> Population {
    Population {
        epsilon_d: Distribution::Uniform([0.1, 0.9]),
        message_cost: Distribution::Values { values: vec![0.0, 4.0], weights: vec![] },
        ..Population::default()
    }
}

fn job(agent: Agent, population: Population) -> Job {
    Job {
        environment: (StepCount { horizon: 12, ..StepCount::paper(0.6) }, population).into(),
        scenario: "P-H-D".parse().unwrap(),
        agent,
        evaluation: Evaluation {
            test_episodes: 40,
            record_decisions: RecordedDecisions::All,
            ..Evaluation::default()
        },
        trial: None,
        seed: 3,
    }
}

/// Learners, followed by a rule.
fn agents() -> [Agent; 5] {
    let policy = Reinforce { episodes: 12, layers: vec![8], ..Reinforce::default() };
    let ppo = Ppo { episodes: 12, lanes: 4, steps: 12, minibatches: 2, ..Ppo::default() };
    [
        Agent::of(&DuelingDqn { episodes: 12, layers: vec![8], ..DuelingDqn::default() }),
        Agent::of(&Reinforce { trajectories_per_update: 4, ..policy }),
        Agent::of(&LinearThompson { episodes: 12, ..LinearThompson::default() }),
        Agent::of(&Ppo { layers: vec![8], ..ppo }),
        random(),
    ]
}

fn random() -> Agent {
    Agent::of(&RuleParameters::new(DecisionRule::Random))
}

fn results(job: &Job) -> Results {
    match train::run(job, &Uncontrolled) {
        Outcome::Completed(results) => results,
        other => panic!("the job did not complete: {other:?}"),
    }
}

fn of_phase(results: &Results, phase: Phase) -> Vec<ParticipantValue> {
    results.participants.iter().filter(|value| value.phase == phase).copied().collect()
}

#[test]
fn agents_with_one_seed_meet_the_same_people_in_training_and_in_the_test() {
    let all = agents().map(|agent| results(&job(agent, people())));
    let [dqn, reinforce, bandit, ppo, rule] = &all;
    for results in &all {
        assert_eq!(of_phase(results, Phase::Test), of_phase(rule, Phase::Test));
        assert_eq!(of_phase(results, Phase::Test).len(), 2 * 40);
    }
    assert_eq!(of_phase(dqn, Phase::Train).len(), 2 * 12);
    for other in [reinforce, bandit] {
        assert_eq!(of_phase(dqn, Phase::Train), of_phase(other, Phase::Train));
    }
    assert_eq!(of_phase(ppo, Phase::Train).len(), 2 * 12);
    assert!(of_phase(rule, Phase::Train).is_empty());
    let number = |phase| of_phase(dqn, phase)[0].value;
    assert_ne!(number(Phase::Train), number(Phase::Test));
    // Another seed gives other participants.
    let other = results(&Job { seed: 4, ..job(random(), people()) });
    assert_ne!(of_phase(&other, Phase::Test), of_phase(rule, Phase::Test));
}

#[test]
fn what_messages_cost_is_each_participants_own() {
    let results = results(&job(random(), people()));
    let names: Vec<&str> = ParticipantSampler::all_names().collect();
    let of_cost = |value: &&ParticipantValue| names[usize::from(value.parameter)] == "message_cost";
    let costs: HashMap<u32, f64> =
        results.participants.iter().filter(of_cost).map(|one| (one.episode, one.value)).collect();
    let paid: f64 = results
        .decisions
        .iter()
        .filter(|decision| decision.action > 0)
        .map(|decision| costs[&decision.episode])
        .sum();
    let metric = |name| results.metrics.iter().find(|metric| metric.name == name).unwrap().value;
    let expected = metric("mean_return") - paid / 40.0;
    assert!(paid > 0.0);
    assert!((metric("mean_net_return") - expected).abs() < 1e-9);
}

#[test]
fn people_in_the_test_alone_leave_the_training_as_it_was() {
    let in_test = Population { phases: PopulationPhases::Test, ..people() };
    for agent in &agents()[..4] {
        let alike = results(&job(agent.clone(), Population::default()));
        let tested = results(&job(agent.clone(), in_test.clone()));
        let trained = results(&job(agent.clone(), people()));
        assert!(alike.participants.is_empty());
        assert_eq!((&tested.weights, &tested.curve), (&alike.weights, &alike.curve));
        assert!(of_phase(&tested, Phase::Train).is_empty());
        assert_eq!(of_phase(&tested, Phase::Test), of_phase(&trained, Phase::Test));
        assert_ne!(tested.weights, trained.weights);
    }
}

#[test]
fn a_population_is_part_of_a_job_and_its_absence_is_not() {
    let plain = job(random(), Population::default());
    assert!(!plain.canonical().contains("population"));
    let job = job(random(), people());
    assert!(job.canonical().contains(
        r#""population":{"epsilon_d":"{ uniform = [0.1, 0.9] }","message_cost":"{ values = [0.0, 4.0] }"},"scenario""#
    ));
    assert_ne!(job.key(), plain.key());
    assert_eq!(Job::from_canonical(&job.canonical()).unwrap(), job);
    let empty = plain.canonical().replace(r#","scenario""#, r#","population":{},"scenario""#);
    assert!(Job::from_canonical(&empty).is_err());
}

#[test]
fn the_rows_of_a_file_are_the_job_and_not_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    let key_of = |rows: &str| {
        let text = format!(
            "format = 1\nname = \"t\"\nextends = \"paper\"\nscenarios = [\"C\"]\nseeds = 1\n\
             environment.sigma = 0\npopulation.rows = {rows}\n"
        );
        let path = folder.path().join("m.toml");
        fs::write(&path, &text).unwrap();
        let manifest = manifest::load(&path).unwrap();
        // A resolved manifest needs no file.
        let resolved = manifest::parse("elsewhere/m.toml", manifest.resolved().as_bytes()).unwrap();
        let first = |manifest| plan::jobs(manifest).next().unwrap().job;
        assert_eq!(first(&resolved), first(&manifest));
        first(&manifest).key()
    };
    file("people.csv", "delta_d,rho_2\n0.1,100\n0.2,200\n");
    file("again.csv", "rho_2, delta_d\r\n1e2, 0.10\r\n200.0, 0.2\r\n");
    let inline = "[{ delta_d = 0.1, rho_2 = 100 }, { delta_d = 0.2, rho_2 = 200 }]";
    let key = key_of("\"people.csv\"");
    assert_eq!(key, key_of("\"again.csv\""));
    assert_eq!(key, key_of(inline));
    assert_eq!(key, key_of("\"\"\"\ndelta_d,rho_2\n0.1,100\n0.2,200\"\"\""));
    file("people.csv", "delta_d,rho_2\n0.1,100\n0.2,201\n");
    assert_ne!(key, key_of("\"people.csv\""));
    let swept = manifest::parse(
        folder.path().join("m.toml").to_str().unwrap(),
        b"format = 1\nname = \"t\"\nextends = \"paper\"\nscenarios = [\"C\"]\nseeds = 1\n\
          environment.sigma = 0\npopulation.rows = [\"people.csv\", \"again.csv\"]\n\
          population.epsilon_d = [\"fixed\", 0.5, { uniform = [0, 1] }]\n",
    );
    assert_eq!(plan::count(&swept.unwrap()), 12);
}

#[test]
fn stored_participants_are_those_of_the_runs_and_choose_the_episodes_of_analyses() {
    let manifests = [manifest::parse("people.toml", TEXT.as_bytes()).unwrap()];
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("jitai.sqlite");
    let mut store = Store::open(&path).unwrap();
    let never = AtomicBool::new(false);
    let selection = Selection::new(&manifests, None).unwrap();
    let mut ignore = |_: Event<'_>| {};
    experiment::run(&mut store, &selection, Options::default(), &never, &mut ignore).unwrap();
    drop(store);
    let raw = rusqlite::Connection::open(&path).unwrap();
    let names: Vec<&str> = ParticipantSampler::all_names().collect();
    let mut fifths: HashMap<(String, u64), f64> = HashMap::new();
    for planned in plan::jobs(&manifests[0]) {
        let results = results(&planned.job);
        let key = planned.form.key().to_string();
        let mut statement = raw
            .prepare(
                "SELECT phase, episode, name, value FROM participant WHERE job_key = ?1
                 ORDER BY episode, name",
            )
            .unwrap();
        let rows = statement
            .query_map([&key], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?)));
        let stored: Vec<(String, u32, String, f64)> = rows.unwrap().map(Result::unwrap).collect();
        let mut expected: Vec<(String, u32, String, f64)> = results
            .participants
            .iter()
            .map(|one| {
                let name = names[usize::from(one.parameter)].to_owned();
                ("test".to_owned(), one.episode, name, one.value)
            })
            .collect();
        expected.sort_by(|a, b| (a.1, &a.2).cmp(&(b.1, &b.2)));
        assert_eq!(stored, expected);
        assert_eq!(stored.len(), 3 * 50);
        // By hand, the ten of fifty participants with the largest epsilon_d.
        let mut ranked: Vec<(f64, u32)> = stored
            .iter()
            .filter(|row| row.2 == "epsilon_d")
            .map(|(_, episode, _, value)| (*value, *episode))
            .collect();
        ranked.sort_by(|one, other| one.0.total_cmp(&other.0));
        let of_fifth = ranked[40..].iter().map(|(_, episode)| *episode as usize - 1);
        let mean = of_fifth.map(|at| results.episodes[at].total_reward).sum::<f64>() / 10.0;
        fifths.insert((planned.agent.to_string(), planned.job.seed), mean);
    }
    let reported = assemble(&Reader::open(&path).unwrap(), &manifests, |_, _, _| {}).unwrap();
    let [(fifth, sql), (all, _), (everybody, _)] = &reported[0].findings[..] else {
        panic!("three analyses")
    };
    let rows = |finding: &jitai::findings::Finding| match &finding.content {
        jitai::findings::FindingContent::Contrast(figure) => figure.rows.clone(),
        other => panic!("no contrast: {other:?}"),
    };
    let difference = |agent: &str| -> f64 {
        (1..=3).map(|seed| fifths[&(agent.to_owned(), seed)]).sum::<f64>() / 3.0
    };
    let expected = difference("tailored") - difference("untailored");
    let found = rows(fifth)[0].contrast.difference.unwrap();
    assert!((found - expected).abs() < 1e-9, "{found} {expected}");
    assert_eq!(rows(fifth)[0].contrast.seeds, (3, 3));
    let (all, everybody) = (rows(all), rows(everybody));
    let gap = all[0].contrast.difference.unwrap() - everybody[0].contrast.difference.unwrap();
    assert!(gap.abs() < 1e-9, "{gap}");
    assert_ne!(rows(fifth)[0].contrast.difference, all[0].contrast.difference);
    // The query of the report selects the same episodes.
    let mut statement = raw.prepare(sql).unwrap();
    let rows =
        statement.query_map([], |row| Ok((row.get(0)?, row.get(2)?, row.get("total_reward")?)));
    let mut sums: HashMap<(String, u64), (f64, u32)> = HashMap::new();
    for (agent, seed, reward) in rows.unwrap().map(Result::<(String, u64, f64), _>::unwrap) {
        let sum = sums.entry((agent, seed)).or_default();
        *sum = (sum.0 + reward, sum.1 + 1);
    }
    assert_eq!(sums.len(), 6);
    for (arm, (sum, count)) in sums {
        assert_eq!(count, 10);
        assert!((sum / 10.0 - fifths[&arm]).abs() < 1e-9);
    }
    assert!(examine(&path, &|_, _| Ok(())).is_ok());
}

#[test]
fn the_view_names_every_parameter_by_its_place() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("jitai.sqlite");
    drop(Store::open(&path).unwrap());
    let raw = rusqlite::Connection::open(&path).unwrap();
    let sql = "SELECT sql FROM sqlite_schema WHERE name = 'participant'";
    let view: String = raw.query_row(sql, [], |row| row.get(0)).unwrap();
    for (index, name) in ParticipantSampler::all_names().enumerate() {
        assert!(view.contains(&format!("WHEN {index} THEN '{name}'\n")), "{index} {name}");
    }
}

#[test]
fn rows_are_drawn_with_their_weights() {
    let columns = match manifest::Section::Population(jitai::env::Family::first())
        .find("rows")
        .unwrap()
        .1
        .kind
    {
        jitai::key::Kind::Rows(columns) => columns,
        other => panic!("{other:?}"),
    };
    let rows = Rows::from_csv(columns, "delta_d,weight\n0.1,9\n0.2,1\n").unwrap();
    let population = Population { rows, ..Population::default() };
    let job = Job {
        evaluation: Evaluation { test_episodes: 2000, ..Evaluation::default() },
        ..job(random(), population)
    };
    let first = results(&job).participants.iter().filter(|one| one.value == 0.1).count();
    // Four standard errors of a share of 0.9.
    assert!((first as f64 / 2000.0 - 0.9).abs() < 4.0 * (0.09f64 / 2000.0).sqrt(), "{first}");
}
