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

/// A model whose pilots are simulated and fitted.
struct Case<'a> {
    model: &'a str,
    /// The section [fit] without what all have in common.
    fit: &'a str,
    people: &'a str,
    replay: &'a str,
    /// Columns of people that the data have.
    known: &'a [&'a str],
}

impl Case<'_> {
    /// A pilot with actions at random: a CSV file of the recorded variables.
    fn simulated(&self, seed: u64) -> String {
        let truth = rows(&uncommented(self.people));
        let count = truth.len();
        let environment = world([self.model, self.people, self.replay], &[]);
        let mut lanes = environment.testing(&"all".parse().unwrap(), 1, count);
        let person = |person| Stream::of_person(seed, Purpose::Person, person);
        let mut streams = LaneStreams::PerLane((0..count as u32).map(person).collect());
        let mut choices = Stream::new(seed, Purpose::Exploration);
        lanes.assign(&(0..count as u32).collect::<Vec<_>>());
        lanes.reset(LaneSet::All, &mut streams);
        let names = environment.state_names().join(",");
        let known: String = self.known.iter().map(|name| format!(",{name}")).collect();
        let mut out = format!("person,decision,sent,{names}{known}\n");
        let mut rewards = vec![0.0; count];
        while lanes.any_running() {
            let could: Vec<bool> = (0..count).map(|lane| lanes.can_send(lane)).collect();
            let mut choose = |could: &bool| {
                let index = choices.below(2) as usize;
                Action::from_index(if *could { index } else { 0 }).unwrap()
            };
            let actions: Vec<Action> = could.iter().map(&mut choose).collect();
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
                let numbers: Vec<String> =
                    state.iter().map(|number| format!("{number:?}")).collect();
                let (time, action) = (times[lane], actions[lane].index());
                write!(out, "p{lane},{time},{action},{}", numbers.join(",")).unwrap();
                self.known.iter().for_each(|name| write!(out, ",{}", truth[lane][*name]).unwrap());
                out.push('\n');
            }
        }
        assert_eq!(environment.failure(), None);
        out
    }

    /// Fits pilots that are simulated with known coefficients: the coefficients lie within five standard errors, and their 95 %
    /// intervals cover them. Returns the share of intervals that do, their number and the last fit.
    fn recover(&self, pilots: u64) -> (f64, usize, Pilot, Fit) {
        let truth = rows(&uncommented(self.people));
        let common = "[fit]\nperson = \"person\"\norder = \"decision\"\naction = \"sent\"";
        let known = |name: &&str| format!("{name} = {{ first = \"{name}\" }}");
        let known: Vec<String> = self.known.iter().map(known).collect();
        let known = format!("people = {{ {} }}", known.join(", "));
        let model = format!("{}\n{common}\n{known}\n{}", self.model, self.fit);
        let (mut covered, mut count, mut last) = (0, 0, None);
        for seed in 0..pilots {
            let (pilot, fit) = fitted(&model, &self.simulated(7 + seed));
            // If the fit says that a coefficient is not identified, the others stand for it as well.
            let is_identified = |group: &&GroupFit| {
                !group.notes.iter().any(|note| matches!(note, FitNote::NotIdentified(_)))
            };
            let usable = fit.groups.iter().flatten().filter(|group| group.is_usable());
            let usable = usable.filter(is_identified);
            assert!(2 * usable.clone().count() > truth.len().min(fit.groups[0].len()), "{fit:?}");
            for group in usable {
                for (index, value) in group.free.iter().zip(&group.values) {
                    let (name, sd) =
                        (&pilot.coefficients[*index].name, group.error_of(*index).unwrap());
                    let of_person = &truth[group.person.unwrap_or(0)];
                    let z = (value - of_person[name].parse::<f64>().unwrap()) / sd;
                    assert!(z.abs() < 6.0, "{name}: {value} ± {sd}, seed {seed}");
                    covered += usize::from(z.abs() < 1.959964);
                    count += 1;
                }
            }
            last = Some((pilot, fit));
        }
        let share = covered as f64 / count as f64;
        let error = (0.95f64 * 0.05 / count as f64).sqrt();
        assert!((share - 0.95).abs() < f64::max(0.03, 4.0 * error), "{share} of {count}");
        let (pilot, fit) = last.unwrap();
        (share, count, pilot, fit)
    }
}

/// The number of simulated pilots of each model; `JITAI_PILOTS` overrides it.
fn pilots() -> u64 {
    std::env::var("JITAI_PILOTS").map_or(2, |n| n.parse().unwrap())
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
    let people = copies("b_x,b_1,g_x,g_1,s,z", "0.3,0.5,-0.2,0.4,0.7,-0.5", 20);
    let recover = |model: &str, fit: &str| {
        Case { model, fit, people: &people, replay: "", known: &[] }.recover(1)
    };
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
        recover(&model(draw, ""), "columns = { x = \"x\", y = \"y\" }\n");
    }
    // One fit for everybody.
    let pooled = "columns = { x = \"x\", y = \"y\" }\npooled = true\n";
    let (.., pilot, fit) = recover(&model("bernoulli = { logit = \"level\" }", ""), pooled);
    assert_eq!((fit.groups[0].len(), pilot.people.len()), (1, 20));
}

/// Compares the coefficients of simulated pilots of a model, and says how many intervals cover them.
fn covers(name: &str, case: &Case<'_>) {
    let (share, count, ..) = case.recover(pilots());
    println!(
        "{name}: {pilots} pilots, {:.1} % of {count} intervals",
        100.0 * share,
        pilots = pilots()
    );
}

/// The names of columns with a prefix.
fn names_of<'a>(people: &'a str, prefixes: &[&str]) -> Vec<&'a str> {
    let header = people.lines().find(|line| !line.starts_with('#')).unwrap();
    let is_known = |name: &&str| prefixes.iter().any(|prefix| name.starts_with(prefix));
    header.split(',').filter(is_known).collect()
}

#[test]
fn simulated_pilots_of_models_without_a_pilot_give_their_coefficients_back() {
    let dose = text("experiments/models/noisy_dose.toml").replace("days = 50", "days = 300");
    let dose =
        dose.replace("\"steps\"", "\"steps\"\nstate = [\"load\", \"dose\", \"seen\", \"steps\"]");
    let case = Case {
        model: &dose,
        fit: "columns = { dose = \"dose\", seen = \"seen\", steps = \"steps\" }\n",
        people: &text("experiments/models/noisy_dose_people.csv"),
        replay: &text("experiments/models/noisy_dose_rows.csv"),
        known: &[],
    };
    covers("noisy_dose", &case);
    // No parameter is linear in the effects of Oralytics, which are known here, and no rate of a count is bounded.
    let v1 = text("experiments/oralytics/v1.toml").replace("days = 70", "days = 200");
    let people = text("experiments/oralytics/synthetic_v1.csv");
    let case = Case {
        model: &v1.replace("state    = [", "state = [\"quality\", \"q\", "),
        fit: "columns = { quality = \"quality\", q = \"q\" }\n",
        people: &people,
        replay: "",
        known: &names_of(&people, &["e_", "first_weekend"]),
    };
    covers("v1", &case);
    let people = text("experiments/oralytics/synthetic_v4.csv");
    let v4 = text("experiments/oralytics/v4.toml").replace("days = 70", "days = 200");
    let state = "state = [\"opened\", \"brushes\", \"count\", \"q\", ";
    let given =
        "columns = { opened = \"opened\", brushes = \"brushes\", count = \"count\", q = \"q\" }\n";
    let case = Case {
        model: &v4.replace("state    = [", state).replace("min(log_mean, 10)", "log_mean"),
        fit: given,
        people: &people,
        replay: "",
        known: &names_of(&people, &["effect_", "app_open"]),
    };
    covers("v4", &case);
    // The people whose seconds are a count.
    let people = text("experiments/oralytics/synthetic_v2.csv");
    let sigma = |line: &str| line.split(',').nth(13).is_some_and(str::is_empty);
    let is_kept = |line: &&str| line.starts_with("person") || sigma(line);
    let people: String = people.lines().filter(is_kept).map(|line| format!("{line}\n")).collect();
    let v2 = text("experiments/oralytics/v2.toml").replace("days = 70", "days = 200");
    let v2 = v2.replace("default(0 * sigma, -1) == 0", "0").replace("default(sigma, 0)", "1");
    let case = Case {
        model: &v2.replace("state    = [", state).replace("min(mean_amount, 10)", "mean_amount"),
        fit: given,
        people: &people,
        replay: "",
        known: &names_of(&people, &["effect_"]),
    };
    covers("v2", &case);
}

#[test]
fn simulated_pilots_of_fitted_people_give_their_coefficients_back() {
    for (name, folder, data, given, known) in [
        ("zip", "robas", "robas_2_data", "quality = \"quality\", brushed = \"brushed\"", true),
        (
            "log",
            "robas",
            "robas_2_data",
            "brushes = \"brushes\", seconds = \"seconds\", brushed = \"brushed\"",
            true,
        ),
        ("contexts", "heartsteps", "contexts", "steps = \"steps\"", false),
        (
            "trial_log",
            "heartsteps",
            "trial_log",
            "steps = \"steps\", reachable = \"reachable\"",
            false,
        ),
    ] {
        let model = text(&format!("experiments/{folder}/{name}.toml"));
        let (pilot, fit) = fitted(&model, &text(&format!("experiments/{folder}/{data}.csv")));
        let made = files(&pilot, &fit);
        let file = |name: &str| {
            let file = made.iter().find(|file| file.name == name).unwrap();
            String::from_utf8(file.bytes.clone()).unwrap()
        };
        let (people, replay) = (file("people.csv"), file("residuals.csv"));
        let simulation = model.split("[fit]").next().unwrap();
        let simulation =
            simulation.replace("days = 70", "days = 200").replace("days = 42", "days = 80");
        let known = if known { names_of(&people, &["e_", "first_weekend"]) } else { Vec::new() };
        let case = Case {
            model: &simulation,
            fit: &format!("columns = {{ {given} }}\n"),
            people: &people,
            replay: if known.is_empty() { &replay } else { "" },
            known: &known,
        };
        covers(name, &case);
    }
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
