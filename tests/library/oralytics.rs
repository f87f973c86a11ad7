//! Compares the test bed V2 of Oralytics with a trial of its official code, `tests/data/oralytics`.

use std::fs;
use std::path::Path;

use jitai::env::oralytics::{Brushing, Oralytics, OralyticsModel, PEOPLE, Rounding};
use jitai::env::{EpisodeStatus, Scenario, VectorEnvironment, contract};
use jitai::key::Content;

/// A decision of the official trial.
#[derive(Clone, Debug)]
struct Decision {
    person: usize,
    action: bool,
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
            reward: fields[4],
            seconds: fields[5],
            seen: [fields[6], fields[7], fields[8]],
        }
    };
    text.lines().skip(1).map(decision).collect()
}

fn people(name: &str) -> Content {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("experiments/oralytics");
    Content::read(&PEOPLE, &fs::read_to_string(folder.join(name)).unwrap()).unwrap()
}

/// V2 with the readings of the official code, and invented people.
fn official() -> Oralytics {
    Oralytics {
        people: people("synthetic_v2.csv"),
        habituation_factor: 0.0,
        rounding: Rounding::Down,
        stale_state: true,
        ..Oralytics::default()
    }
}

fn simulation(parameters: Oralytics, lanes: usize) -> Brushing {
    OralyticsModel { parameters }.simulation(&Scenario::all(), 1, lanes)
}

#[test]
fn states_and_rewards_follow_from_the_actions_and_outcomes_of_the_official_trial() {
    let decisions = golden();
    let (mut largest, mut compared) = (0.0_f64, 0);
    for person in 0..70 {
        let of_person = decisions.iter().filter(|decision| decision.person == person);
        let of_person: Vec<&Decision> = of_person.collect();
        assert_eq!(of_person.len(), 140);
        // The file does not say on which days the app was opened: every history that fits is followed.
        let mut fitting: Vec<(Brushing, f64)> = [true, false]
            .map(|opens| {
                let mut lane = simulation(official(), 1);
                lane.begin(0, 0, opens);
                (lane, 0.0)
            })
            .into();
        for decision in of_person {
            let error_of = |lane: &Brushing| {
                let [_, brushing, dosage, app, ..] = lane.seen(0);
                let seen = [brushing, dosage, app];
                let errors = seen.iter().zip(decision.seen).map(|(one, other)| (one - other).abs());
                errors.fold(0.0, f64::max)
            };
            for (lane, error) in &mut fitting {
                *error = error.max(error_of(lane));
            }
            fitting.retain(|(_, error)| *error < 1e-9);
            assert!(!fitting.is_empty(), "no history of the app fits person {person}");
            let mut next = Vec::new();
            for (lane, error) in fitting {
                for opens in [true, false] {
                    let mut lane = lane.clone();
                    let reward = lane.force(0, decision.action, decision.seconds, opens);
                    assert_eq!(reward, decision.reward);
                    // Both histories are one where no day begins.
                    if opens || lane.statuses()[0] == EpisodeStatus::Running {
                        next.push((lane, error));
                    }
                }
            }
            next.dedup_by(|(one, _), (other, _)| format!("{one:?}") == format!("{other:?}"));
            fitting = next;
            compared += 1;
        }
        let least = fitting.iter().map(|(_, error)| *error).fold(f64::INFINITY, f64::min);
        largest = largest.max(least);
    }
    assert_eq!(compared, 9800);
    assert!(largest < 1e-12, "{largest:e}");
}

#[test]
fn the_test_beds_keep_the_contract_of_environments() {
    let v2 = official();
    let daily =
        Oralytics { people: people("synthetic_v2_daily.csv"), stationary: false, ..v2.clone() };
    for parameters in [v2, daily] {
        let parameters = Oralytics { days: 20, ..parameters };
        contract::check(|lanes| simulation(parameters.clone(), lanes), 200).unwrap();
    }
}
