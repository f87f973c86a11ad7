//! Compares the model of the test bed V2 of Oralytics with a trial of its official code, `tests/data/oralytics`.

use std::collections::HashMap;
use std::fs;
use std::path::Path;

use jitai::agent::{
    Actor, BanditAllocation, LinearThompson, LinearThompsonStudy, Rewards, Sharing, StudyPlan,
};
use jitai::env::declared::DeclaredModel;
use jitai::env::{
    Action, Environment, EpisodeStatus, LaneSet, LaneStreams, Observations, Scenario, Simulated,
    VectorEnvironment, contract,
};
use jitai::job::{ROWS, Trial, UpdateData};
use jitai::key::{Content, Keyed};
use jitai::rng::{Purpose, Stream};
use jitai::train::Study;
use jitai::{manifest, plan};
use nalgebra::{DMatrix, DVector};

/// A decision of the official trial.
#[derive(Clone, Debug)]
struct Decision {
    person: usize,
    action: bool,
    probability: f64,
    reward: f64,
    seconds: f64,
    /// Brushing, dosage and app, as the algorithm saw them.
    seen: [f64; 3],
}

fn golden() -> Vec<Decision> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/oralytics/golden_trial.csv");
    let text = fs::read_to_string(path).unwrap();
    let decision = |line: &str| {
        let fields: Vec<f64> = line.split(',').map(|field| field.parse().unwrap()).collect();
        Decision {
            person: fields[0] as usize,
            action: fields[2] == 1.0,
            probability: fields[3],
            reward: fields[4],
            seconds: fields[5],
            seen: [fields[6], fields[7], fields[8]],
        }
    };
    text.lines().skip(1).map(decision).collect()
}

/// A text of `experiments/oralytics`.
fn text(name: &str) -> String {
    fs::read_to_string(Path::new("experiments/oralytics").join(name)).unwrap()
}

/// A world of this model, these people, rows that it replays, and values of its parameters.
fn world(model: &str, people: &str, replay: &str, parameters: &str) -> Environment {
    let manifest = format!(
        "format = 1\nname = \"t\"\nscenarios = \"all\"\nseeds = 1\n[environment]\nfamily = \"declared\"\n\
         model = '''\n{model}'''\npeople = '''\n{people}'''\n{replay}{parameters}\n\
         [[agent]]\nname = \"random\"\nalgorithm = \"rule\"\nrule = \"random\"\n"
    );
    let manifest = manifest::parse("t.toml", manifest.as_bytes()).unwrap();
    plan::jobs(&manifest).next().unwrap().job.environment
}

/// V2 with the readings of the official code, whose people brush as long as the official ones, and open the app on these days.
fn official(decisions: &[Vec<&Decision>]) -> Environment {
    let model = text("v2.toml");
    let drawn = |name: &str| model.lines().find(|line| line.starts_with(name)).unwrap();
    let forced = model
        .replace(drawn("opened "), "opened = \"was_opened + 0 * opens_app\"")
        .replace(drawn("q "), "q = \"seconds + 0 * brushes * (square + count)\"")
        .replace("[linear]", "[replay]\ncolumns = [\"seconds\", \"was_opened\"]\n[linear]");
    let synthetic = text("synthetic_v2.csv");
    let (header, weights) = synthetic.split_once("\n0,").unwrap();
    let weights = weights.lines().next().unwrap();
    let (mut people, mut rows) = (header.to_owned(), "person,seconds,was_opened\n".to_owned());
    for (person, of_person) in decisions.iter().enumerate() {
        people += &format!("\n{person},{weights}");
        let opened = history(of_person);
        for (own, decision) in of_person.iter().enumerate() {
            let was_opened = u8::from(opened[own / 2]);
            rows += &format!("{person},{},{was_opened}\n", decision.seconds);
        }
    }
    let replay = format!("replay = '''\n{rows}'''\n");
    world(
        &forced,
        &(people + "\n"),
        &replay,
        "parameters = { habituation_factor = 0, stale_state = 1 }",
    )
}

/// The normalised averages of brushing and prompts before a decision, by the text of docs/oralytics.md.
fn averages(of_person: &[&Decision], own: usize) -> [f64; 2] {
    let count = if own.is_multiple_of(2) || own == 1 { own } else { own - 1 };
    let before = &of_person[..count];
    let factor = 13.0_f64 / 14.0;
    let average = |value: &dyn Fn(&Decision) -> f64| match count {
        0 => 0.0,
        1..14 => before.iter().map(|one| value(one)).sum::<f64>() / count as f64,
        _ => {
            let last = before.iter().rev().take(14).enumerate();
            let sum: f64 = last.map(|(age, one)| factor.powi(age as i32) * value(one)).sum();
            sum * (1.0 - factor) / (1.0 - factor.powi(14))
        }
    };
    let brushing = average(&|one| one.seconds);
    let prompts = average(&|one| f64::from(u8::from(one.action)));
    [(brushing - 90.5) / 89.5, 2.0 * (prompts - 0.5)]
}

/// A history of the app that fits what the algorithm saw of a person: whether it was opened on each day.
fn history(of_person: &[&Decision]) -> Vec<bool> {
    // The file does not say on which days the app was opened: every history that fits is followed.
    let mut fitting = vec![(vec![], 0.0)];
    for (day, decisions) in of_person.chunks(2).enumerate() {
        let mut next: Vec<(Vec<bool>, f64)> = Vec::new();
        for (opened, reported) in &fitting {
            for opens in if day == 0 { &[true][..] } else { &[true, false] } {
                let morning = averages(of_person, 2 * day)[0];
                let reported = if *opens { morning } else { *reported };
                let app = *opens && opened.last() == Some(&true);
                let fits = decisions.iter().enumerate().all(|(slot, decision)| {
                    let [now, dosage] = averages(of_person, 2 * day + slot);
                    let shown =
                        [if *opens { now } else { reported }, dosage, f64::from(u8::from(app))];
                    shown.iter().zip(decision.seen).all(|(one, other)| (one - other).abs() < 1e-9)
                });
                // Histories that lead to the same state have the same future.
                let is_new = next
                    .iter()
                    .all(|(known, value)| known.last() != Some(opens) || *value != reported);
                if fits && is_new {
                    next.push(([&opened[..], &[*opens]].concat(), reported));
                }
            }
        }
        fitting = next;
    }
    fitting.swap_remove(0).0
}

fn of_people(decisions: &[Decision]) -> Vec<Vec<&Decision>> {
    let of_person = |person| decisions.iter().filter(|one| one.person == person).collect();
    (0..70).map(of_person).collect()
}

/// What the algorithm sees, in the order of its features.
fn scenario() -> Scenario {
    "time_of_day-brushing-dosage-app".parse().unwrap()
}

#[test]
fn states_and_rewards_follow_from_the_actions_and_outcomes_of_the_official_trial() {
    let decisions = golden();
    assert_eq!(decisions.len(), 9800);
    let of_people = of_people(&decisions);
    let mut lanes = official(&of_people).training(&scenario(), 1, 70);
    lanes.assign(&(0..70).collect::<Vec<_>>());
    let mut streams = LaneStreams::Shared(Stream::new(0, Purpose::TestEnvironment));
    lanes.reset(LaneSet::All, &mut streams);
    let mut observations = Observations::new(4, 0);
    let (mut rewards, mut seen) = (vec![0.0; 70], Vec::new());
    for own in 0..140 {
        lanes.observe(&mut observations);
        let decisions: Vec<&Decision> = of_people.iter().map(|one| one[own]).collect();
        for (lane, decision) in decisions.iter().enumerate() {
            seen.clear();
            lanes.exact_features(lane, &observations, &mut seen);
            let errors =
                seen[1..].iter().zip(decision.seen).map(|(one, other)| (one - other).abs());
            let largest = errors.fold(0.0, f64::max);
            assert!(largest < 1e-12, "person {lane}, decision {own}: {largest:e}");
        }
        let actions: Vec<Action> = decisions.iter().map(|one| action(one)).collect();
        lanes.step(&actions, &mut rewards, &mut streams);
        let expected: Vec<f64> = decisions.iter().map(|one| one.reward).collect();
        assert_eq!(rewards, expected);
    }
    assert!(!lanes.any_running());
}

fn action(decision: &Decision) -> Action {
    Action::from_index(usize::from(decision.action)).unwrap()
}

/// The algorithm of V2. Features begin with the intercept.
fn algorithm() -> LinearThompson {
    LinearThompson {
        noise_sd: 4058_f64.sqrt(),
        action_centring: true,
        baseline_means: vec![77.0, 0.0, 0.0, 17.0, 0.0],
        baseline_sds: vec![44.0, 23.0, 12.0, 15.0, 8.0],
        effect_means: vec![0.0, 0.0, 0.0, 0.0, 27.0],
        effect_sds: vec![13.0, 12.0, 32.0, 29.0, 20.0],
        allocation: BanditAllocation::Logistic,
        logistic_slope: 0.515,
        logistic_odds: 3.0,
        ..LinearThompson::default()
    }
}

/// The calendar of V2, with the readings of the official code.
fn calendar() -> Trial {
    let required = [70, 70].map(jitai::key::Value::Integer);
    let rows: String = (0..70).map(|person| format!("{person},{person}\n")).collect();
    Trial {
        people_file: Content::read(&ROWS, &format!("person,row\n{rows}")).unwrap(),
        decisions_per_day: 2,
        entry_every_days: 14,
        entry_people: 5,
        entry_first_day: 7,
        update_every_days: 7,
        update_data: UpdateData::InStudy,
        update_lag_days: 7,
        update_first_with_people: 15,
        ..Trial::with_required(&required)
    }
}

/// What a replay of the official trial with this calendar gives: the errors of all probabilities, and the largest error
/// of the posterior means of each week, relative to the largest mean.
fn replayed(calendar: &Trial) -> (Vec<f64>, Vec<f64>) {
    let decisions = golden();
    let of_people = of_people(&decisions);
    let mut lanes: Simulated = official(&of_people).training(&scenario(), 1, 70);
    let mut agent = LinearThompsonStudy::new(
        &algorithm(),
        &lanes,
        StudyPlan { people: 70, decisions: 140, sharing: Sharing::Everybody, keeps_updates: false },
        0,
    );
    let mut study = Study::new(calendar, 0);
    study.assign(&mut lanes);
    let mut streams = study.streams(0);
    let mut words = Stream::new(0, Purpose::TestActions);
    let (mut actions, mut probabilities) = (vec![Action::default(); 70], vec![0.0; 140]);
    let posteriors = posteriors();
    let (mut of_probabilities, mut of_means) = (Vec::new(), Vec::new());
    let mut time = 0;
    while !study.is_over() {
        study.begin_step(&mut lanes, &mut agent, &mut streams).unwrap();
        if time % 14 == 0 && time > 0 {
            // The first week has the prior.
            let theirs = &posteriors[time / 14 - 1];
            let scale = theirs.iter().map(|mean| mean.abs()).fold(0.0, f64::max);
            let ours = in_official_order(&agent.means(0));
            let errors =
                ours.iter().zip(theirs).map(|(ours, theirs)| (ours - theirs).abs() / scale);
            of_means.push(errors.fold(0.0, f64::max));
        }
        agent.act(&lanes, &mut words, &mut actions, Some(&mut probabilities));
        let mut rewards = vec![0.0; 70];
        let is_running = |person: &usize| lanes.statuses()[*person] == EpisodeStatus::Running;
        for person in (0..70).filter(is_running) {
            let decision = of_people[person][lanes.time(person) as usize];
            let second = &mut probabilities[2 * person..2 * person + 2];
            of_probabilities.push((second[1] - decision.probability).abs());
            second.copy_from_slice(&[1.0 - decision.probability, decision.probability]);
            actions[person] = action(decision);
        }
        lanes.step(&actions, &mut rewards, &mut streams);
        agent.replay(&actions, &probabilities);
        study.end_step(&[0; 70]);
        let rewards = Rewards { values: &rewards, reached: study.reached() };
        agent.observe(&lanes, rewards);
        time += 1;
    }
    (of_probabilities, of_means)
}

#[test]
fn probabilities_and_posteriors_of_the_official_trial_are_recomputed() {
    let (of_probabilities, of_means) = replayed(&calendar());
    assert_eq!((of_probabilities.len(), of_means.len()), (9800, 36));
    let off: Vec<f64> = of_probabilities.iter().copied().filter(|error| *error > 1e-8).collect();
    // SciPy's `norm.expect`, by which the official code integrates, is wrong at two decisions: it gives 0.6805033835 for
    // the integral 0.6805036221, and 0.7907205795 for 0.7907205587.
    assert!(off.len() == 2 && off[0] < 2.4e-7 && off[1] < 2.1e-8, "{off:?}");
    // The posteriors of weeks 2 to 5 are computed by the official code, but no policy until 15 people have entered.
    let from_the_first_week = Trial { update_first_with_people: 1, ..calendar() };
    let (_, of_all_means) = replayed(&from_the_first_week);
    let largest = of_means[5..].iter().chain(&of_all_means).copied().fold(0.0, f64::max);
    assert!(largest < 1e-12, "{largest:e}");
}

/// The posterior means of every update, in the official order.
fn posteriors() -> Vec<Vec<f64>> {
    let path =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/oralytics/golden_posteriors.csv");
    let text = fs::read_to_string(path).unwrap();
    let means = |line: &str| line.split(',').skip(1).map(|field| field.parse().unwrap()).collect();
    text.lines().skip(1).map(means).collect()
}

/// Means in blocks that begin with the intercept, in blocks that end with it.
fn in_official_order(means: &[f64]) -> Vec<f64> {
    means.chunks(5).flat_map(|block| [&block[1..], &block[..1]].concat()).collect()
}

#[test]
fn the_test_beds_keep_the_contract_of_environments() {
    for (model, people, parameters) in [
        ("v1.toml", "synthetic_v1.csv", ""),
        ("v2.toml", "synthetic_v2.csv", "parameters = { habituation_factor = 0, stale_state = 1 }"),
        ("v2.toml", "synthetic_v2_daily.csv", "parameters = { smaller = 1, rounded_down = 0 }"),
        ("v4.toml", "synthetic_v3.csv", "parameters = { habituation_factor = 0.5, daily = 0 }"),
        ("v4.toml", "synthetic_v4.csv", "parameters = { no_effect = 1, normalised_cost = 1 }"),
    ] {
        let days = format!("days = 20\n{parameters}");
        let environment = world(&text(model), &text(people), "", &days);
        let declared: &DeclaredModel = environment.model().unwrap();
        let other: Scenario = match model {
            "v1.toml" => "prompts-brushing_n".parse().unwrap(),
            _ => "app-brushing".parse().unwrap(),
        };
        for (scenario, history) in [(&Scenario::all(), 1), (&other, 3)] {
            contract::check(|lanes| declared.simulation(scenario, history, lanes), 200).unwrap();
        }
    }
}

/// The recorded states of these people at every decision with these actions, \[decisions, people, state\], and what each
/// decision cost, \[decisions, people\].
fn rolled(
    environment: &Environment,
    people: usize,
    prompts: impl Fn(u32) -> bool,
) -> (Vec<Vec<Vec<f64>>>, Vec<Vec<f64>>) {
    let mut lanes = environment.training(&Scenario::all(), 1, people);
    lanes.assign(&(0..people as u32).collect::<Vec<_>>());
    let mut streams = LaneStreams::Shared(Stream::new(1, Purpose::TestEnvironment));
    lanes.reset(LaneSet::All, &mut streams);
    let (mut states, mut costs) = (Vec::new(), Vec::new());
    let mut rewards = vec![0.0; people];
    while lanes.any_running() {
        let mut before = vec![Vec::new(); people];
        before.iter_mut().enumerate().for_each(|(lane, state)| lanes.record_state(lane, state));
        let prompted = usize::from(prompts(lanes.time(0)));
        let actions = vec![Action::from_index(prompted).unwrap(); people];
        lanes.step(&actions, &mut rewards, &mut streams);
        let outcomes = VectorEnvironment::outcomes(&lanes, &rewards).to_vec();
        costs.push(outcomes.iter().zip(&rewards).map(|(all, paid)| all - paid).collect());
        for (lane, state) in before.iter_mut().enumerate() {
            lanes.complete(lane, rewards[lane], state, &mut 0.0);
        }
        states.push(before);
    }
    (states, costs)
}

/// The rows of a file of people, as numbers by the name of the column; none for an empty field.
fn rows_of(people: &str) -> Vec<HashMap<&str, f64>> {
    let mut lines = people.lines().skip_while(|line| line.starts_with('#'));
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    lines
        .map(|line| {
            let fields = names.iter().copied().zip(line.split(','));
            fields.filter_map(|(name, field)| Some((name, field.parse().ok()?))).collect()
        })
        .collect()
}

/// A model that records these variables.
fn recording(model: &str, variables: &[&str]) -> String {
    let model = text(model);
    let state = model.lines().find(|line| line.starts_with("state ")).unwrap();
    model.replace(state, &format!("state = {variables:?}"))
}

#[test]
fn the_outcome_of_v2_follows_from_the_weights_of_people() {
    const SHOWN: [&str; 13] = [
        "time_of_day",
        "prior_total",
        "day_n",
        "share",
        "weekend",
        "opened",
        "zero",
        "amount",
        "on_zero",
        "mean_amount",
        "brushes",
        "count",
        "root",
    ];
    let model = recording("v2.toml", &[&SHOWN[..], &["q"]].concat());
    let people = text("synthetic_v2_daily.csv");
    let rows = rows_of(&people);
    let is_prompted = |time: usize| time.is_multiple_of(3);
    for (smaller, rounded_down) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
        let parameters = format!(
            "parameters = {{ smaller = {smaller}, rounded_down = {rounded_down}, effect_factor = 0.5 }}"
        );
        let environment = world(&model, &people, "", &parameters);
        let (states, _) = rolled(&environment, rows.len(), |time| is_prompted(time as usize));
        // Sums of deviations from the expected value, and of variances: opened, brushes, count, root.
        let mut sums = [[0.0; 2]; 4];
        for (person, row) in rows.iter().enumerate() {
            let seconds: Vec<f64> = states.iter().map(|all| all[person][13]).collect();
            for (time, state) in states.iter().enumerate() {
                let found = &state[person];
                let two = if time.is_multiple_of(2) { 1 } else { 2 };
                let total =
                    if time < 2 { 0.0 } else { seconds[time - two] + seconds[time - two - 1] };
                let last = || seconds[time - 14..time].iter().filter(|one| **one > 0.0).count();
                let x = [
                    (time % 2) as f64,
                    (total - 154.0) / 163.0,
                    ((time / 2) as f64 - 34.5) / 34.5,
                    if time < 14 { 0.0 } else { last() as f64 / 14.0 },
                    f64::from(u8::from(time % 14 >= 10)),
                ];
                let dot = |prefix: &str| {
                    let weight =
                        |name: &str| row.get(&*format!("{prefix}_{name}")).copied().unwrap_or(0.0);
                    SHOWN.iter().zip(x).map(|(name, x)| weight(name) * x).sum::<f64>() + weight("1")
                };
                let size = ["small", "smaller"][smaller];
                let dose = 0.5 * f64::from(u8::from(is_prompted(time)));
                let [zero, amount] = ["bernoulli", "amount"].map(dot);
                let effect = |part: &str| dose * dot(&format!("effect_{size}_{part}"));
                let mean = amount + effect("amount").max(0.0);
                let expected =
                    [&x[..], &[found[5], zero, amount, effect("bernoulli"), mean]].concat();
                for (index, (found, expected)) in found.iter().zip(expected).enumerate() {
                    let name = SHOWN[index];
                    assert!(
                        (found - expected).abs() < 1e-9,
                        "{name} at {time}: {found}, expected {expected}"
                    );
                }
                let [brushes, count, root] = [found[10], found[11], found[12]];
                let sigma = row.get("sigma").copied();
                let whole = match (sigma, rounded_down) {
                    (None, _) => count,
                    (Some(_), 0) => (root * root).round(),
                    (Some(_), _) => (root * root).floor(),
                };
                assert_eq!(found[13], brushes * whole.min(180.0));
                let chance = 1.0 / (1.0 + (zero - effect("bernoulli").max(0.0)).exp());
                let rate = if sigma.is_some() { 1.0 } else { mean.min(10.0).exp() };
                let mut add = |index: usize, deviation: f64, variance: f64| {
                    sums[index][0] += deviation;
                    sums[index][1] += variance;
                };
                add(0, found[5] - 0.7, 0.21);
                add(1, brushes - chance, chance * (1.0 - chance));
                add(2, (count - rate) / rate.sqrt(), 1.0);
                if let Some(sigma) = sigma {
                    add(3, (root - mean) / sigma, 1.0);
                }
            }
        }
        for [deviation, variance] in sums {
            assert!(variance > 500.0 && deviation.abs() < 4.0 * variance.sqrt(), "{sums:?}");
        }
    }
}

#[test]
fn a_standard_deviation_below_zero_is_not_another_model() {
    let people = text("synthetic_v2.csv");
    let of_first = rows_of(&people)[0]["sigma"].to_string();
    let people = people.replacen(&format!(",{of_first},"), &format!(",-{of_first},"), 1);
    let environment = world(&text("v2.toml"), &people, "", "");
    rolled(&environment, 1, |_| false);
    let failure = environment.failure().unwrap();
    assert!(failure.contains("`root`"), "{failure}");
}

#[test]
fn people_habituate_to_many_prompts_and_recover() {
    for (model, people) in [("v2.toml", "synthetic_v2.csv"), ("v4.toml", "synthetic_v3.csv")] {
        for (factor, expected) in [
            (1.0, [1.0, 1.0, 1.0, 1.0, 1.0]),
            (0.5, [1.0, 0.5, 0.25, 0.5, 1.0]),
            // A person who has stopped responding responds fully again, however often that has happened.
            (0.0, [1.0, 0.0, 0.0, 1.0, 1.0]),
        ] {
            let parameters = format!("days = 35\nparameters = {{ habituation_factor = {factor} }}");
            let environment = world(&text(model), &text(people), "", &parameters);
            // Two weeks with a prompt at every decision, and three without.
            let (states, _) = rolled(&environment, 3, |time| time < 28);
            for (index, state) in states.iter().flat_map(|all| &all[..]).enumerate() {
                // Weeks end after the decisions 14, 28, and so on.
                let week = ((index / 3).max(1) - 1) / 14;
                assert_eq!(state[2], expected[week], "{model}, {factor}, decision {}", index / 3);
            }
        }
    }
}

#[test]
fn a_prompt_costs_where_brushing_is_good_or_prompts_are_frequent() {
    for (model, people, scale) in [
        ("v2.toml", "synthetic_v2.csv", ""),
        ("v4.toml", "synthetic_v3.csv", ""),
        ("v4.toml", "synthetic_v3.csv", "normalised_cost = 1, "),
    ] {
        let costs = "cost_of_good_brushing = 7, cost_of_frequent_prompts = 30";
        let parameters = format!("parameters = {{ {scale}{costs} }}");
        let environment = world(&text(model), &text(people), "", &parameters);
        // More and more prompts.
        let (states, costs) = rolled(&environment, 12, |time| time % 7 < time / 14);
        let mut seen = [0, 0];
        for (time, (states, costs)) in states.iter().zip(costs).enumerate() {
            let is_prompted = time % 7 < time / 14;
            for (state, cost) in states.iter().zip(costs) {
                let [mut brushing, mut prompts] = [state[0], state[1]];
                assert_eq!(state[5], cost);
                if !scale.is_empty() {
                    // Seconds are never that many.
                    (brushing, prompts) = ((brushing - 90.5) / 89.5, 2.0 * (prompts - 0.5));
                }
                let is_good = brushing > 111.0 && prompts > 0.5;
                let due = [is_good, prompts > 0.8].map(|is_due| is_due && is_prompted);
                let expected =
                    7.0 * f64::from(u8::from(due[0])) + 30.0 * f64::from(u8::from(due[1]));
                assert_eq!(cost, expected, "{model}, decision {time}");
                due.iter().zip(&mut seen).for_each(|(due, seen)| *seen += usize::from(*due));
            }
        }
        assert!(seen[1] > 0 && (seen[0] > 0) == scale.is_empty(), "{model}: {seen:?}");
    }
}

#[test]
fn an_effect_is_removed_in_one_state_and_changed_as_little_as_possible_elsewhere() {
    // Time of day, brushing, dosage, app, weekend, day, 1.
    let state = DVector::from_row_slice(&[1.0, -0.7, -0.1, 0.0, 2.0 / 7.0, 0.0, 1.0]);
    let levels: [&[f64]; 7] =
        [&[0.0, 1.0], &THREE, &THREE, &[0.0, 1.0], &[0.0, 1.0], &THREE, &[1.0]];
    let mut moments = vec![Vec::new()];
    for levels in levels {
        let longer =
            |x: &Vec<f64>| levels.iter().map(|one| [&x[..], &[*one]].concat()).collect::<Vec<_>>();
        moments = moments.iter().flat_map(longer).collect();
    }
    let mut second = DMatrix::<f64>::zeros(7, 7);
    for x in &moments {
        let x = DVector::from_row_slice(x);
        second += &x * x.transpose() / moments.len() as f64;
    }
    let direction = second.cholesky().unwrap().solve(&state);
    let shown = [
        "time_of_day",
        "brushing_now",
        "dosage",
        "app_before",
        "weekend",
        "day_n",
        "zero",
        "amount",
        "logit",
        "log_mean",
    ];
    let model = recording("v4.toml", &shown);
    let at = "no_effect = 1, no_effect_time_of_day = 1, no_effect_brushing = -0.7, no_effect_dosage = -0.1, no_effect_app = 0";
    let people = text("synthetic_v4.csv");
    let environment = world(&model, &people, "", &format!("parameters = {{ {at} }}"));
    let rows = rows_of(&people);
    let weight = |person: usize, name: String| rows[person][&*name];
    let names = ["time_of_day", "brushing_now", "dosage", "app_before", "weekend", "day_n", "1"];
    let (states, _) = rolled(&environment, 20, |_| true);
    let mut changed = [0, 0];
    for (person, found) in states.iter().flat_map(|all| all.iter().enumerate()) {
        let mut x = DVector::from_element(7, 1.0);
        x.rows_mut(0, 6).copy_from_slice(&found[..6]);
        for (index, part) in ["bernoulli", "amount"].into_iter().enumerate() {
            let old = names.map(|name| weight(person, format!("effect_{part}_{name}")));
            let old = DVector::from_row_slice(&old);
            // e = e_old - M^-1 s (s.e_old) / (s.M^-1 s) is 0 at s, and closest to e_old in the mean of ((e - e_old).x)^2.
            let new = &old - &direction * (state.dot(&old) / state.dot(&direction));
            assert!(new.dot(&state).abs() < 1e-12);
            let gain = [new.dot(&x).min(0.0), new.dot(&x).max(0.0)][index];
            let [before, after] = [found[6 + index], found[8 + index]];
            assert!((after - before - gain).abs() < 1e-9, "{after} - {before}, expected {gain}");
            changed[index] += usize::from(gain != 0.0);
        }
    }
    assert!(changed.iter().all(|count| *count > 500), "{changed:?}");
}

const THREE: [f64; 3] = [-0.75, 0.0, 0.75];
