//! Fits beside published coefficients, and fits of simulated pilots, which give their coefficients back.

use std::collections::HashMap;
use std::fmt::Write;
use std::fs;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use jitai::env::declared::{Pilot, PilotError};
use jitai::env::{Action, EpisodeStatus, LaneSet, LaneStreams, VectorEnvironment};
use jitai::fit::{DrawnFrom, Fit, FitNote, Fitting, GroupFit, draws, files};
use jitai::rng::{Purpose, Stream};

use crate::models::world;

fn text(path: &str) -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(path)).unwrap()
}

fn fitted(model: &str, data: &str) -> (Pilot, Fit) {
    let pilot = match Pilot::read(model, data.as_bytes(), &|| false) {
        Ok(pilot) => pilot,
        Err(PilotError::Data(faults)) => panic!("{}", faults.text("data")),
        Err(PilotError::Model(faults)) => panic!("{:?}", faults.messages().collect::<Vec<_>>()),
        Err(PilotError::Stopped) => panic!("stopped"),
    };
    let stop = AtomicBool::new(false);
    let fit = Fit::new(&pilot, &mut Fitting { stop: &stop, progress: &mut |_, _| {} });
    (pilot, fit.unwrap())
}

/// A text without lines of comments.
fn uncommented(text: &str) -> String {
    text.lines().filter(|line| !line.starts_with('#')).map(|line| format!("{line}\n")).collect()
}

/// The rows of a CSV file, by the names of columns.
fn rows(text: &str) -> Vec<HashMap<String, String>> {
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    reader.deserialize().map(Result::unwrap).collect()
}

/// The estimates of a group by the names of their coefficients.
fn estimates(pilot: &Pilot, group: &GroupFit) -> HashMap<String, f64> {
    let name = |index: &usize| pilot.coefficients[*index].name.clone();
    group.free.iter().map(name).zip(group.values.iter().copied()).collect()
}

/// Compares a fit of ROBAS 2 with the fits of 16 people by another optimiser, whose gradients are below 1e-8.
fn compare(model: &str, state: &str, draw: &str, parts: &[(&str, &str)]) {
    let (pilot, fit) = fitted(model, &text("experiments/robas/robas_2_data.csv"));
    let mut known: HashMap<(String, String), (f64, f64)> = HashMap::new();
    for row in rows(&text("tests/data/fit/robas_2_map.csv")) {
        let Some((_, prefix)) = parts.iter().find(|(part, _)| *part == row["part"]) else {
            continue;
        };
        if row["state"] != state {
            continue;
        }
        let name = match row["coefficient"].as_str() {
            "sigma" => "sigma".to_owned(),
            "total" => format!("{prefix}prior_total"),
            // The name of a clock.
            "day" => format!("{prefix}a_day"),
            "intercept" => format!("{prefix}1"),
            feature => format!("{prefix}{feature}"),
        };
        let numbers = (row["value"].parse().unwrap(), row["objective"].parse().unwrap());
        known.insert((row["person"].clone(), name), numbers);
    }
    let index = pilot.draws.iter().position(|one| one.name == draw).unwrap();
    let mut compared = 0;
    for group in &fit.groups[index] {
        let person = &pilot.people[group.person.unwrap()].name;
        assert!(group.gradient_norm <= 1e-6 && group.is_usable(), "{person}: {:?}", group.notes);
        for (name, value) in estimates(&pilot, group) {
            let Some((theirs, objective)) = known.get(&(person.clone(), name.clone())) else {
                continue;
            };
            // The file has six decimals of objectives.
            let off = 1e-6 * objective.abs() + 5e-7;
            let better = objective + off;
            assert!(group.objective <= better, "{draw} of {person}: {}", group.objective);
            let is_same = (group.objective - objective).abs() <= off;
            assert!(
                !is_same || (value - theirs).abs() <= 1e-4,
                "{name} of {person}: {value} {theirs}"
            );
            compared += 1;
        }
    }
    assert_eq!(compared, known.len());
    assert_eq!(compared % 16, 0);
}

#[test]
fn fits_of_robas_2_are_those_of_another_optimiser() {
    let zip = text("experiments/robas/zip.toml");
    let root = text("experiments/robas/root.toml");
    let log = text("experiments/robas/log.toml");
    // The day of the study as one more feature.
    let with_day = |model: &str| {
        model
            .replace("\"prior_total\", \"share\"", "\"prior_total\", \"a_day\", \"share\"")
            .replace("[variables]\n", "[variables]\na_day = \"(day - 13.5) / 13.5\"\n")
    };
    for (model, draw, parts) in [
        (&zip, "quality", &[("zip_zero", "b_"), ("zip_log_mean", "p_")][..]),
        (&root, "brushes", &[("bernoulli", "b_")]),
        (&root, "root", &[("sqrt_normal", "m_")]),
        (&log, "seconds", &[("log_normal", "m_")]),
    ] {
        compare(model, "stationary", draw, parts);
        compare(&with_day(model), "non_stationary", draw, parts);
    }
}

#[test]
fn least_squares_of_heartsteps_are_the_published_coefficients() {
    let model = text("experiments/heartsteps/contexts.toml");
    let (pilot, fit) = fitted(&model, &text("experiments/heartsteps/contexts.csv"));
    assert_eq!(pilot.draws[0].decisions.len(), 6394);
    let names = [
        ("b_one", "b_1"),
        ("b_day_steps", "b_day_steps"),
        ("b_steps_before", "b_steps_before"),
        ("b_temperature", "b_temperature"),
        ("b_step_variation", "b_variation"),
        ("b_home", "b_home"),
        ("b_dosage", "b_dosage"),
        ("sent_one", "sent_1"),
        ("sent_step_variation", "sent_variation"),
        ("sent_home", "sent_home"),
        ("sent_dosage", "sent_dosage"),
    ];
    let published = rows(&text("tests/data/fit/heartsteps_least_squares.csv"));
    assert_eq!(published.len(), 37);
    let mut without_home = 0;
    for row in &published {
        let person = pilot.people.iter().position(|one| one.name == row["person"]).unwrap();
        for (theirs, ours) in names {
            let index = pilot.coefficients.iter().position(|one| one.name == ours).unwrap();
            let (ours, theirs) = (fit.values[person][index], row[theirs].parse::<f64>().unwrap());
            assert!((ours - theirs).abs() <= 1e-8, "{:?}: {ours} {theirs}", row["person"]);
        }
        let is_rare = |note: &FitNote| matches!(note, FitNote::Rare(_));
        without_home += usize::from(fit.groups[0][person].notes.iter().any(is_rare));
    }
    assert_eq!(without_home, 11);
    let effects: Vec<&str> = pilot
        .coefficients
        .iter()
        .filter(|one| one.is_effect)
        .map(|one| one.name.as_str())
        .collect();
    assert_eq!(effects, ["sent_1", "sent_variation", "sent_home", "sent_dosage"]);
}

/// A pilot of people of a model, with actions at random: a CSV file of the recorded variables.
fn simulated(model: &str, people: &str, replay: &str, count: usize) -> String {
    let environment = world([model, people, replay], &[]);
    let mut lanes = environment.testing(&"all".parse().unwrap(), 1, count);
    let person = |person| Stream::of_person(7, Purpose::Person, person);
    let mut streams = LaneStreams::PerLane((0..count as u32).map(person).collect());
    let mut choices = Stream::new(7, Purpose::Exploration);
    lanes.assign(&(0..count as u32).collect::<Vec<_>>());
    lanes.reset(LaneSet::All, &mut streams);
    let mut out = format!("person,decision,sent,{}\n", environment.state_names().join(","));
    let mut rewards = vec![0.0; count];
    while lanes.any_running() {
        let choose = |()| Action::from_index(choices.below(2) as usize).unwrap();
        let actions: Vec<Action> = vec![(); count].into_iter().map(choose).collect();
        let running: Vec<bool> =
            lanes.statuses().iter().map(|status| *status == EpisodeStatus::Running).collect();
        let times = lanes.times().to_vec();
        let mut states = vec![Vec::new(); count];
        for (lane, state) in states.iter_mut().enumerate() {
            lanes.record_state(lane, state);
        }
        lanes.step(&actions, &mut rewards, &mut streams);
        for (lane, state) in states.iter_mut().enumerate().filter(|(lane, _)| running[*lane]) {
            lanes.complete(lane, rewards[lane], state, &mut 0.0);
            let numbers: Vec<String> = state.iter().map(|number| format!("{number:?}")).collect();
            let (time, action) = (times[lane], actions[lane].index());
            writeln!(out, "p{lane},{time},{action},{}", numbers.join(",")).unwrap();
        }
    }
    assert_eq!(environment.failure(), None);
    out
}

/// Fits a pilot that is simulated with known coefficients, and compares them in units of standard errors.
fn recover(model: &str, fit: &str, people: &str, replay: &str) -> (Pilot, Fit) {
    let truth = rows(&uncommented(people));
    let data = simulated(model, people, replay, truth.len());
    let (pilot, fit) = fitted(
        &format!(
            "{model}\n[fit]\nperson = \"person\"\norder = \"decision\"\naction = \"sent\"\n{fit}"
        ),
        &data,
    );
    let (mut squares, mut count) = (0.0, 0.0);
    let usable = fit.groups.iter().flatten().filter(|group| group.is_usable());
    assert!(2 * usable.clone().count() > truth.len().min(fit.groups[0].len()), "{fit:?}");
    for group in usable {
        let size = group.free.len();
        for (slot, (name, value)) in group
            .free
            .iter()
            .map(|one| &pilot.coefficients[*one].name)
            .zip(&group.values)
            .enumerate()
        {
            let sd = group.covariance[slot * size + slot].sqrt();
            let true_value: f64 = truth[group.person.unwrap_or(0)][name].parse().unwrap();
            let z = (value - true_value) / sd;
            assert!(z.abs() < 5.0, "{name}: {value} ± {sd} {true_value}");
            squares += z * z;
            count += 1.0;
        }
    }
    // The mean square of standard normal numbers is 1, with this standard deviation.
    let off = (squares / count - 1.0) / f64::sqrt(2.0 / count);
    assert!(off.abs() < 4.0, "{count} coefficients have a mean square of {}", squares / count);
    (pilot, fit)
}

/// The same person many times, with other names.
fn copies(header: &str, row: &str, count: usize) -> String {
    let rows: String = (0..count).map(|index| format!("p{index},{row}\n")).collect();
    format!("person,{header}\n{rows}")
}

#[test]
fn a_simulated_pilot_gives_the_coefficients_of_every_distribution_back() {
    let model = |draw: &str, names: &str| {
        format!(
            "format = 1\ntitle = \"known\"\ndays = 400\n[linear]\nbase = {{ prefix = \"b_\", features = [\"x\", \"1\"] }}\n\
             gain = {{ prefix = \"g_\", features = [\"x\", \"1\"] }}\n[variables]\nx = {{ gaussian = [0, 1] }}\n\
             level = \"base + action * gain\"\ny = {{ {draw} }}\n{names}[roles]\noutcome = \"y\"\nfeatures = [\"x\"]\n"
        )
    };
    let fit = "columns = { x = \"x\", y = \"y\" }\n";
    let people = copies("b_x,b_1,g_x,g_1,s,z", "0.3,0.5,-0.2,0.4,0.7,-0.5", 20);
    for draw in [
        "gaussian = [\"level\", \"s\"]",
        "lognormal = [\"level\", \"s\"]",
        "bernoulli = { logit = \"level\" }",
        "bernoulli = \"sigmoid(level)\"",
        "poisson = { log_mean = \"level\" }",
        "poisson = \"exp(level)\"",
        "zero_inflated_poisson = [\"z\", \"1 + level\"]",
        "categorical = { logits = [0, \"level\", \"z\"] }",
    ] {
        recover(&model(draw, ""), fit, &people, "");
    }
    // One fit for everybody.
    let (pilot, fit) = recover(
        &model("bernoulli = { logit = \"level\" }", ""),
        "columns = { x = \"x\", y = \"y\" }\npooled = true\n",
        &people,
        "",
    );
    assert_eq!((fit.groups[0].len(), pilot.people.len()), (1, 20));
}

#[test]
fn simulated_pilots_of_models_that_ship_give_their_coefficients_back() {
    let dose = text("experiments/models/noisy_dose.toml").replace("days = 50", "days = 300");
    let dose =
        dose.replace("\"steps\"", "\"steps\"\nstate = [\"load\", \"dose\", \"seen\", \"steps\"]");
    recover(
        &dose,
        "columns = { dose = \"dose\", seen = \"seen\", steps = \"steps\" }\n",
        &text("experiments/models/noisy_dose_people.csv"),
        &text("experiments/models/noisy_dose_rows.csv"),
    );
    // No parameter is linear in the effects of Oralytics V1, which are known here.
    let v1 = text("experiments/oralytics/v1.toml").replace("days = 70", "days = 200");
    let v1 = v1.replace("state    = [", "state = [\"quality\", \"q\", ");
    let v1 = v1.replace("max(e_b * state, 0)", "0").replace("max(e_p * state, 0)", "0");
    recover(
        &v1.replace("\"quality\", ", "\"quality\", \"weekend\", "),
        "columns = { quality = \"quality\", q = \"q\" }\n\
         people = { first_weekend = { min = \"if(weekend, step, missing)\" } }\n",
        &text("experiments/oralytics/synthetic_v1.csv"),
        "",
    );
}

#[test]
fn the_people_of_heartsteps_that_ship_are_those_of_a_fit() {
    let model = text("experiments/heartsteps/trial_log.toml");
    let (pilot, fit) = fitted(&model, &text("experiments/heartsteps/trial_log.csv"));
    let drawn = draws(&pilot, &fit, 10, DrawnFrom::Estimates, 1);
    let mut compared = 0;
    for file in files(&pilot, &fit).into_iter().chain(drawn) {
        // Everything else is made by the command of docs/pilot.md.
        if file.name != "fit.json" {
            let shipped = text(&format!("experiments/heartsteps/fitted/{}", file.name));
            assert!(shipped.as_bytes() == file.bytes, "{} is another one", file.name);
            compared += 1;
        }
    }
    assert_eq!(compared, 13);
    // The manifest has the keys of the prior and the standard deviation.
    let manifest = text("experiments/heartsteps/next_trial.toml");
    for line in text("experiments/heartsteps/fitted/prior.toml")
        .lines()
        .filter(|line| !line.starts_with('#'))
    {
        assert!(manifest.contains(line), "{line}");
    }
    assert!(manifest.contains(&format!("sigma = {:?}", fit.parameters[0].1)));
}
