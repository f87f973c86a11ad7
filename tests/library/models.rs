//! The models that ship: the paper's simulation beside the authors' trajectories, and every model in a whole trial.

use std::fs;
use std::path::{Path, PathBuf};

use jitai::env::{
    Action, Environment, EpisodeStatus, Family, LaneSet, LaneStreams, Simulated, VectorEnvironment,
};
use jitai::key::{Content, Kind, Value};
use jitai::rng::{Purpose, Stream};
use serde_json::Value as Json;

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("experiments/models")
}

/// A world of the family `declared`: the model, its people and its rows, empty for none, and parameters.
pub fn world(texts: [&str; 3], parameters: &[(&str, f64)]) -> Environment {
    let declared = Family::named("declared").unwrap();
    let names: Vec<String> =
        parameters.iter().map(|(name, _)| format!("parameters.{name}")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let family = declared.with_parameters.unwrap()(&names).unwrap();
    let mut values: Vec<Value> = texts
        .iter()
        .zip(declared.keys)
        .map(|(text, key)| match (text, key.kind) {
            (&"", _) => Value::Content(Content::default()),
            (text, Kind::Content(form)) => {
                Value::Content(Content::read(form, text).unwrap_or_else(|fault| panic!("{fault}")))
            }
            _ => unreachable!("the keys of the family are files"),
        })
        .collect();
    values.push(Value::Integer(0));
    // Keys of parameters stand in alphabetical order.
    let mut sorted = parameters.to_vec();
    sorted.sort_by_key(|(name, _)| *name);
    values.extend(sorted.into_iter().map(|(_, value)| Value::Real(value)));
    (family.read)(family, &values, &[]).unwrap()
}

fn state(world: &Simulated, environment: &Environment, name: &str) -> f64 {
    let mut state = Vec::new();
    world.record_state(0, &mut state);
    let index = environment.state_names().iter().position(|known| known == name);
    state[index.unwrap_or_else(|| panic!("`{name}` is recorded"))]
}

#[test]
fn the_papers_simulation_as_a_model_repeats_the_authors_trajectories() {
    let text = fs::read_to_string(folder().join("step_count.toml")).unwrap();
    // The contexts of the trajectories are replayed.
    let drawn = "context        = { bernoulli = 0.5 }\n";
    let text = text.replace(drawn, "").replace(
        "[parameters]",
        "[replay]\norder = \"own\"\ncolumns = [\"context\"]\n[parameters]",
    );
    let file: Json =
        serde_json::from_str(include_str!("../data/golden_trajectories.json")).unwrap();
    for case in file["cases"].as_array().unwrap() {
        let steps = case["steps"].as_array().unwrap();
        let rows: Vec<String> = steps.iter().map(|step| format!("1,{}", step["context"])).collect();
        let rows = format!("person,context\n{}\n", rows.join("\n"));
        let named = ["delta_h", "epsilon_h", "delta_d", "epsilon_d", "rho_1", "rho_2"];
        let mut parameters: Vec<(&str, f64)> =
            named.map(|name| (name, case["parameters"][name].as_f64().unwrap())).into();
        parameters
            .push(("threshold", case["parameters"]["disengagement_threshold"].as_f64().unwrap()));
        let days = format!("days = {}", case["horizon"]);
        let text = text.replace("days = 50", &days);
        let environment = world([&text, "", &rows], &parameters);
        let mut lane = environment.testing(&"all".parse().unwrap(), 1, 1);
        let mut streams = LaneStreams::Shared(Stream::new(1, Purpose::Environment));
        lane.reset(LaneSet::All, &mut streams);
        let mut reward = [0.0];
        let close = |ours: f64, theirs: &Json| (ours - theirs.as_f64().unwrap()).abs() <= 1e-12;
        for step in steps {
            assert_eq!(lane.statuses()[0], EpisodeStatus::Running);
            assert!(
                close(state(&lane, &environment, "habituation"), &step["habituation"]),
                "{step}"
            );
            assert!(
                close(state(&lane, &environment, "disengagement"), &step["disengagement"]),
                "{step}"
            );
            let action = Action::from_index(step["action"].as_u64().unwrap() as usize).unwrap();
            lane.step(&[action], &mut reward, &mut streams);
            assert!(close(reward[0], &step["reward"]), "{step}: {}", reward[0]);
        }
        let disengaged = case["disengaged"].as_bool().unwrap();
        assert_eq!(lane.statuses()[0] == EpisodeStatus::Terminated, disengaged);
        assert_eq!(environment.failure(), None);
    }
}

#[test]
fn every_model_that_ships_runs_through_whole_trials() {
    let mut count = 0;
    for entry in fs::read_dir(folder()).unwrap() {
        let path = entry.unwrap().path();
        let text = fs::read_to_string(&path).unwrap();
        if path.extension().is_none_or(|extension| extension != "toml")
            || text.contains("[environment]")
        {
            continue;
        }
        let beside = |suffix: &str| {
            let name = path.file_stem().unwrap().to_str().unwrap();
            fs::read_to_string(folder().join(format!("{name}_{suffix}.csv"))).unwrap_or_default()
        };
        let environment = world([&text, &beside("people"), &beside("rows")], &[]);
        let mut lanes = environment.testing(&"all".parse().unwrap(), 1, 50);
        let mut streams = LaneStreams::PerLane(
            (0..50).map(|person| Stream::of_person(3, Purpose::Person, person)).collect(),
        );
        let mut choices = Stream::new(3, Purpose::Exploration);
        lanes.reset(LaneSet::All, &mut streams);
        let actions = lanes.action_spec().count as u32;
        let mut rewards = vec![0.0; 50];
        let mut sum = 0.0;
        while lanes.any_running() {
            let chosen =
                [(); 50].map(|()| Action::from_index(choices.below(actions) as usize).unwrap());
            lanes.step(&chosen, &mut rewards, &mut streams);
            sum += lanes.outcomes(&rewards).iter().sum::<f64>();
        }
        assert_eq!(environment.failure(), None, "{}", path.display());
        assert!(sum.is_finite() && sum != 0.0, "{}: {sum}", path.display());
        count += 1;
    }
    assert_eq!(count, 7);
}

/// The mean outcome per action of a model of 4,000 people over whole trials, with actions at random.
fn means(name: &str) -> [f64; 2] {
    let text = fs::read_to_string(folder().join(name)).unwrap();
    let environment = world([&text, "", ""], &[]);
    let people = 4000;
    let mut lanes = environment.testing(&"all".parse().unwrap(), 1, people);
    let mut streams = LaneStreams::Shared(Stream::new(4, Purpose::TestEnvironment));
    let mut choices = Stream::new(4, Purpose::Exploration);
    lanes.reset(LaneSet::All, &mut streams);
    let (mut sums, mut counts) = ([0.0; 2], [0.0; 2]);
    let mut rewards = vec![0.0; people];
    while lanes.any_running() {
        let chosen: Vec<Action> = (0..people)
            .map(|lane| match lanes.can_send(lane) {
                true => Action::from_index(choices.below(2) as usize).unwrap(),
                false => Action::default(),
            })
            .collect();
        let can: Vec<bool> = (0..people).map(|lane| lanes.can_send(lane)).collect();
        lanes.step(&chosen, &mut rewards, &mut streams);
        for (lane, action) in chosen.iter().enumerate().filter(|(lane, _)| can[*lane]) {
            sums[action.index()] += rewards[lane];
            counts[action.index()] += 1.0;
        }
    }
    [0, 1].map(|action| sums[action] / counts[action])
}

#[test]
fn a_binary_outcome_has_its_relative_risk() {
    // The mean over t of exp(-1.5 + 0.5 t/T + 0.3 [t > T/2]) times exp(a (0.1 + 0.3 t/T)), T = 30.
    let expected = [0.0, 1.0].map(|action| {
        let risk = |t: u32| {
            let share = f64::from(t) / 30.0;
            let late = if share > 0.5 { 0.3 } else { 0.0 };
            (-1.5 + 0.5 * share + late + action * (0.1 + 0.3 * share)).exp()
        };
        (1..=30).map(risk).sum::<f64>() / 30.0
    });
    let found = means("binary_outcome.toml");
    // About 48,000 decisions each.
    for (found, expected) in found.iter().zip(expected) {
        assert!((found - expected).abs() < 0.01, "{found}, expected {expected}");
    }
}
