//! Whether trials without an effect of prompts in a state seem to have learned about it more often than they should.

use std::fs;
use std::path::Path;

use jitai::analyse::monte_carlo_p;
use jitai::job::{Outcome, Results};
use jitai::manifest;
use jitai::plan;
use jitai::train::{Uncontrolled, run};

/// Trials with the algorithm of Oralytics and invented people; prompts have no effect in an evening after little brushing.
const MANIFEST: &str = "format = 1
name = \"without\"
extends = \"oralytics_v4\"
seeds = 3200
[trial]
people = 8
days = 21
update = { every_days = 7, first_day = 7, data = \"all\" }
[environment]
family = \"declared\"
people = \"synthetic_v4.csv\"
days = 21
[environment.parameters]
no_effect = 1
no_effect_time_of_day = 1
no_effect_brushing = -0.7
no_effect_dosage = -0.1
[evaluation]
record_episodes = \"none\"
record_posteriors = true
";

const STATE: [f64; 4] = [1.0, -0.7, -0.1, 0.0];

fn results(text: &str) -> Vec<Results> {
    let folder = tempfile::tempdir().unwrap();
    let people = Path::new("experiments/oralytics/synthetic_v4.csv");
    fs::copy(people, folder.path().join("synthetic_v4.csv")).unwrap();
    let path = folder.path().join("t.toml");
    fs::write(&path, text).unwrap();
    let manifest = manifest::load(&path).unwrap();
    plan::jobs(&manifest)
        .map(|planned| match run(&planned.job, &Uncontrolled) {
            Outcome::Completed(results) => results,
            other => panic!("{other:?}"),
        })
        .collect()
}

fn statistic(results: &Results) -> f64 {
    results.posteriors.last().unwrap().standardised_effect(&STATE).unwrap()
}

#[test]
fn trials_without_an_effect_seldom_seem_to_have_learned() {
    let all: Vec<f64> = results(MANIFEST).iter().map(statistic).collect();
    let (tested, draws) = all.split_at(1600);
    let rejected = tested.iter().filter(|one| monte_carlo_p(**one, draws).unwrap() <= 0.05).count();
    // 3 to 7 %: with 1600 trials on each side, 2.6 standard deviations, that of the reference included.
    assert!((48..=112).contains(&rejected), "{rejected} of 1600");
}

#[test]
fn posteriors_are_those_of_all_updates_and_end_at_the_last_weights() {
    let text = MANIFEST.replace("seeds = 3200", "seeds = 1").replace("\"none\"", "\"all\"");
    let results = &results(&text)[0];
    let steps: Vec<(u32, u32)> =
        results.posteriors.iter().map(|one| (one.update, one.step)).collect();
    assert_eq!(steps, [(1, 14), (2, 28)]);
    for one in &results.posteriors {
        assert_eq!((one.action, one.mean.len(), one.covariance.len()), (1, 5, 25));
        for (i, j) in (0..25).map(|place| (place / 5, place % 5)) {
            assert!((one.covariance[5 * i + j] - one.covariance[5 * j + i]).abs() < 1e-9);
        }
    }
    // By hand: the mean over the standard deviation of the intercept.
    let last = results.posteriors.last().unwrap();
    let of_intercept = last.mean[0] / last.covariance[0].sqrt();
    assert_eq!(last.standardised_effect(&[0.0; 4]), Some(of_intercept));
    assert_eq!(last.standardised_effect(&[0.0; 3]), None);
}

#[test]
fn partial_pooling_keeps_the_posterior_of_each_person() {
    let text = MANIFEST
        .replace("seeds = 3200", "seeds = 1")
        .replace("[trial]\n", "[trial]\npooling = \"partial\"\n");
    let posteriors = results(&text).remove(0).posteriors;
    let people: Vec<(u32, u32)> = posteriors.iter().map(|one| (one.update, one.person)).collect();
    let expected =
        (1..=people.last().unwrap().0).flat_map(|update| (0..=8).map(move |i| (update, i)));
    assert_eq!(people, expected.collect::<Vec<_>>());
    for one in &posteriors {
        let (_, sd) = one.effect(&STATE).unwrap();
        match one.person {
            0 => assert!(one.deviation(&STATE).unwrap() > 0.0),
            _ => assert_eq!(one.deviation(&STATE), None),
        }
        assert!(sd > 0.0);
    }
}
