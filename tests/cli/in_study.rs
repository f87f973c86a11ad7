//! Every update of an agent in a trial, computed once more from the views alone.

use std::collections::BTreeMap;

use serde_json::Value as Json;

use crate::support::Folder;

/// A decision as the view has it.
struct Row {
    person: i64,
    day: i64,
    action: usize,
    reward: f64,
    /// The intercept and what the agent observed.
    features: [f64; 4],
    /// Whether the agent learns from the decision.
    is_learned: bool,
}

/// What stands in a manifest beside the trial.
const REST: &str = r#"
[evaluation]
on = "trial"
record_decisions = "test"
record_posteriors = true

[[agent]]
name = "ts"
algorithm = "linear_thompson"
prior_sd = 40
noise_sd = 30
pi_min = 0.05
"#;

const PEOPLE: &str =
    "sigma = 0.5\nmu = [20, 60]\nrho_1 = 30\nstep_noise = \"gamma\"\nsigma_s = 20\n";

/// The rows of the trial of a seed.
fn rows(folder: &Folder, seed: i64) -> Vec<Row> {
    let store = folder.store();
    let sql = "SELECT episode, action, reward, can_send, state FROM decision JOIN run_summary USING (job_key)
        WHERE seed = ?1 ORDER BY episode, step";
    let mut statement = store.prepare(sql).unwrap();
    let read = statement.query_map([seed], |row| {
        let state: Json = serde_json::from_str(&row.get::<_, String>(4)?).unwrap();
        // Agents observe 32 bits of a number.
        let seen = |name: &str| f64::from(state[name].as_f64().unwrap() as f32);
        let reached = state.get("reached").is_none_or(|reached| *reached == 1.0);
        Ok(Row {
            person: row.get(0)?,
            day: state["calendar_day"].as_f64().unwrap() as i64,
            action: row.get(1)?,
            reward: row.get(2)?,
            features: [1.0, seen("probability"), seen("habituation"), seen("disengagement")],
            is_learned: row.get::<_, bool>(3)? && reached,
        })
    });
    read.unwrap().map(Result::unwrap).collect()
}

/// The solution of a linear system by elimination; the matrix is positive definite.
fn solved(mut matrix: [[f64; 4]; 4], mut right: [f64; 4]) -> [f64; 4] {
    for pivot in 0..4 {
        for row in (0..4).filter(|row| *row != pivot) {
            let factor = matrix[row][pivot] / matrix[pivot][pivot];
            let own = matrix[pivot];
            matrix[row]
                .iter_mut()
                .zip(own)
                .for_each(|(entry, of_pivot)| *entry -= factor * of_pivot);
            right[row] -= factor * right[pivot];
        }
    }
    std::array::from_fn(|row| right[row] / matrix[row][row])
}

/// The posterior means of an action from these rows.
fn means<'r>(rows: impl Iterator<Item = &'r Row>) -> [f64; 4] {
    let mut precision = [[0.0; 4]; 4];
    let mut information = [0.0; 4];
    (0..4).for_each(|place| precision[place][place] = 1.0 / 1600.0);
    for row in rows {
        for (place, one) in row.features.iter().enumerate() {
            information[place] += one * row.reward / 900.0;
            for (other, value) in row.features.iter().enumerate() {
                precision[place][other] += one * value / 900.0;
            }
        }
    }
    solved(precision, information)
}

/// Runs two seeds of a trial and compares every posterior with that of the people who were in the study on the day before;
/// returns the number of people who left an update's data by disengaging, over all updates.
#[track_caller]
fn assert_recomputed(trial: &str, environment: &str, (per_day, lag): (i64, i64)) -> usize {
    let folder = Folder::with(&format!(
        "format = 1\nname = \"odd\"\nscenarios = [\"P-H-D\"]\nseeds = 2\n\n[trial]\n{trial}\n\n[environment]\n{PEOPLE}{environment}\n{REST}"
    ));
    folder.write("stays.csv", "start_day,end_day\n0,9\n2,5\n2,11\n3,4\n1,10\n4,11\n");
    folder.jitai(["run", "sweep.toml", "--quiet"]).succeeded();
    let (mut updates, mut left) = (0, 0);
    for seed in [1, 2] {
        let rows = rows(&folder, seed);
        assert!(!rows.is_empty());
        let mut last: BTreeMap<i64, i64> = BTreeMap::new();
        last.extend(rows.iter().map(|row| (row.person, row.day)));
        let sql = format!(
            "SELECT step, action, mean FROM posterior JOIN run_summary USING (job_key) WHERE seed = {seed} ORDER BY 1, 2"
        );
        let store = folder.store();
        let mut statement = store.prepare(&sql).unwrap();
        let found = statement.query_map([], |row| {
            Ok((row.get::<_, i64>(0)?, row.get::<_, usize>(1)?, row.get::<_, String>(2)?))
        });
        for found in found.unwrap() {
            let (step, action, mean) = found.unwrap();
            let day = step / per_day;
            let counts =
                |row: &&Row| row.is_learned && row.day < day - lag && last[&row.person] >= day - 1;
            left += last.values().filter(|last| **last < day - 1).count();
            let mean_of =
                |action| means(rows.iter().filter(|row| row.action == action).filter(counts));
            let (message, nothing) = (mean_of(action), mean_of(0));
            let mean: Vec<f64> = serde_json::from_str(&mean).unwrap();
            for (found, (message, nothing)) in mean.iter().zip(message.iter().zip(nothing)) {
                let expected = message - nothing;
                assert!(
                    (found - expected).abs() < 1e-9 * expected.abs().max(1.0),
                    "seed {seed}, day {day}, action {action}: {found}, expected {expected}"
                );
            }
            updates += 1;
        }
    }
    assert!(updates > 12, "{updates}");
    left
}

#[test]
fn people_who_disengage_no_longer_count() {
    let trial = "people = 6\ndays = 12\nupdate = { every_days = 1, data = \"in_study\" }";
    assert!(assert_recomputed(trial, "horizon = 12\nepsilon_d = 0.5", (1, 0)) > 0);
}

#[test]
fn people_who_enter_in_groups_and_leave_as_they_like() {
    let trial = "people = 23\ndays = 9\ndecisions_per_day = 2\nentry = { every_days = 3, people = 4, first_day = 2 }\n\
        update = { every_days = 2, first_day = 5, data = \"in_study\", lag_days = 3, first_with_people = 7 }\n\
        outage = [11, 14]\ndropout = 0.08";
    let environment = "horizon = 18\nepsilon_d = 0.2\navailability = 0.8";
    assert!(assert_recomputed(trial, environment, (2, 3)) > 0);
}

#[test]
fn short_stays_that_end_with_the_trial() {
    let trial = "people = 6\ndays = 9\ndecisions_per_day = 3\nentry = \"stays.csv\"\n\
        update = { every_days = 1, data = \"in_study\" }";
    assert!(assert_recomputed(trial, "horizon = 27\nepsilon_d = 0.3", (3, 0)) > 0);
}

#[test]
fn outcomes_that_do_not_reach_the_agent() {
    let trial = "people = 9\ndays = 8\ndecisions_per_day = 2\nentry = { every_days = 1, people = 2 }\n\
        update = { every_days = 1, data = \"in_study\", lag_days = 1 }\nmissing_outcomes = 0.3\nunreported = 0.2";
    assert!(assert_recomputed(trial, "horizon = 16\nepsilon_d = 0.3", (2, 1)) > 0);
}

#[test]
fn dropout_after_the_end_changes_nothing() {
    let trial = "people = 12\ndays = 7\ndecisions_per_day = 2\nentry = { every_days = 5, people = 6, first_day = 1 }\n\
        update = { every_days = 1, data = \"in_study\", lag_days = 2 }\ndropout = 0.3\nmissing_outcomes = 0.1\noutage = [4]";
    assert!(
        assert_recomputed(trial, "horizon = 14\nepsilon_d = 0.5\nmessage_budget = 9", (2, 2)) > 0
    );
}
