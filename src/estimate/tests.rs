//! Estimates by hand, and against numbers from statsmodels and geepack (`tests/reference/estimates.py`).

use std::sync::Arc;

use serde_json::Value as Json;

use super::wcls::Correction;
use super::{Estimation, with_standard_error};
use crate::job::{
    Decision, Effect, Estimate, EstimateDeclaration, Estimator, Messages, Phase, REWARD,
    StandardErrors, Treatment,
};
use crate::state::{Resumable, StateReader, StateWriter};

pub(super) fn declared(
    control: &[&str],
    moderators: &[&str],
    treatment: Treatment,
) -> EstimateDeclaration {
    let texts = |list: &[&str]| list.iter().map(|text| (*text).to_owned()).collect();
    EstimateDeclaration {
        control: texts(control),
        less_costs: false,
        estimator: Estimator::Wcls,
        moderators: texts(moderators),
        name: "effect".to_owned(),
        numerator: 0.5,
        outcome: REWARD.to_owned(),
        policy: None,
        against: None,
        standard_errors: StandardErrors::Nominal,
        steps: 1,
        treatment,
        truth: false,
    }
}

pub(super) const ANY: Treatment = Treatment::Messages(Messages::Any);
const EACH: Treatment = Treatment::Messages(Messages::Each);

/// A decision between two actions; the probability is that of action 1.
pub(super) fn decision(
    episode: u32,
    step: u32,
    action: u8,
    probability: f64,
    reward: f64,
) -> Decision {
    Decision {
        phase: Phase::Test,
        episode,
        step,
        state: [reward / 2.0].into(),
        available: true,
        can_send: true,
        chosen: action,
        action,
        probabilities: [1.0 - probability, probability].into(),
        reward,
        cost: 0.0,
        terminated: false,
        truncated: false,
    }
}

fn estimates(of: EstimateDeclaration, decisions: &[Decision]) -> Vec<Estimate> {
    let actions = decisions[0].probabilities.len();
    let mut estimation = Estimation::new(Arc::new(of), actions, &vec!["mood".to_owned()].into());
    decisions.iter().for_each(|decision| estimation.add(decision));
    estimation.finish().terms
}

/// Three people with a decision of each kind, whose differences are 3, 2 and 4.
fn six_rows() -> Vec<Decision> {
    let rows = [
        (1, 0, 1, 4.0),
        (1, 1, 0, 1.0),
        (2, 0, 0, 3.0),
        (2, 1, 1, 5.0),
        (3, 0, 1, 6.0),
        (3, 1, 0, 2.0),
    ];
    rows.map(|(person, step, action, reward)| decision(person, step, action, 0.5, reward)).into()
}

#[test]
fn the_cost_of_a_message_lessens_its_effect() {
    let mut rows = six_rows();
    rows.iter_mut().for_each(|one| one.cost = 0.5 * f64::from(one.action));
    let value = |less_costs: bool| {
        let of = EstimateDeclaration { less_costs, ..declared(&[], &[], ANY) };
        estimates(of, &rows)[0].effect.as_ref().unwrap().value
    };
    // Differences of 3, 2 and 4, and a cost of 1/2.
    assert!((value(false) - 3.0).abs() < 1e-12 && (value(true) - 2.5).abs() < 1e-12);
}

#[test]
fn a_state_called_step_is_no_feature() {
    let of = Arc::new(declared(&[], &["step"], ANY));
    let with = |names: &[&str]| {
        let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
        Estimation::new(of.clone(), 2, &names.to_vec().into()).finish().terms[0]
            .effect
            .clone()
            .unwrap_err()
    };
    assert!(with(&["mood", "step"]).contains("a number of the program's state"));
    assert!(with(&["mood"]).contains("it needs at least"));
}

#[test]
fn six_rows_by_hand() {
    let terms = estimates(declared(&[], &[], ANY), &six_rows());
    // All weights are 1. With X'X = diag(2, 1/2) of each person, the leverages are 1/3, so that scores grow by 3/2:
    // 0, -3/4 and 3/4, whose squares add up to 9/8. The variance is (2/3)² 9/8 = 1/2.
    let t = 3.0 / 0.5_f64.sqrt();
    let p_value = 1.0 - 2.0 * t.atan() / std::f64::consts::PI;
    // Student's t with one degree of freedom is the Cauchy distribution.
    let half = (0.475 * std::f64::consts::PI).tan() * 0.5_f64.sqrt();
    let [Estimate { term, effect: Ok(effect) }] = &terms[..] else { panic!("{terms:?}") };
    assert_eq!((term.as_str(), effect.degrees_of_freedom), ("1", 1.0));
    let found = [effect.value, effect.standard_error, effect.low, effect.high, effect.p_value];
    let expected = [3.0, 0.5_f64.sqrt(), 3.0 - half, 3.0 + half, p_value];
    for (found, expected) in found.iter().zip(expected) {
        assert!((found - expected).abs() < 1e-11 * expected.abs(), "{found}, not {expected}");
    }
}

#[test]
fn weights_make_a_difference_of_weighted_means() {
    let mut decisions = six_rows();
    let probabilities = [0.5, 0.25, 0.75, 0.2, 0.8, 0.4];
    for (decision, p) in decisions.iter_mut().zip(probabilities) {
        decision.probabilities = [1.0 - p, p].into();
    }
    // Without features, the estimate is Hájek's whatever the numerator.
    let mean = |action: u8| {
        let own = || decisions.iter().filter(|one| one.action == action);
        let sum = |value: fn(&Decision) -> f64| own().map(value).sum::<f64>();
        sum(|one| one.reward / one.action_probability()) / sum(|one| 1.0 / one.action_probability())
    };
    for numerator in [0.1, 0.5, 0.9] {
        let of = EstimateDeclaration { numerator, ..declared(&[], &[], ANY) };
        let effect = estimates(of.clone(), &decisions)[0].effect.clone().unwrap();
        let value = effect.value;
        assert!((value - (mean(1) - mean(0))).abs() < 1e-12, "{value}");
        // Of 0.25, 0.1875, 0.1875, 0.16, 0.16 and 0.24.
        let variance = effect.treatment_variance.unwrap();
        assert!((variance - 1.185 / 6.0).abs() < 1e-12, "{variance}");
        // The first decision of each person has its outcome with the second.
        let of = EstimateDeclaration { outcome: "mood".to_owned(), ..of };
        let mut estimation = Estimation::new(Arc::new(of), 2, &vec!["mood".to_owned()].into());
        decisions.iter().for_each(|decision| estimation.add(decision));
        let variance = estimation.treatment_variance().unwrap();
        assert!((variance - (0.25 + 0.1875 + 0.16) / 3.0).abs() < 1e-12, "{variance}");
    }
}

#[test]
fn decisions_without_a_possible_message_do_not_count() {
    let six = estimates(declared(&[], &[], ANY), &six_rows());
    let mut more = six_rows();
    more.extend((4..9).map(|person| Decision {
        can_send: false,
        ..decision(person, 0, 0, 0.5, 1000.0 * f64::from(person))
    }));
    assert_eq!(estimates(declared(&[], &[], ANY), &more), six);
}

#[test]
fn the_order_of_people_and_interruptions_change_no_bit() {
    let case = &reference()["cases"][2];
    let decisions = decisions(case);
    let names = ["mood", "load"].map(str::to_owned);
    let of = Arc::new(EstimateDeclaration {
        outcome: "load".to_owned(),
        ..declared(&["mood", "step"], &["mood"], EACH)
    });
    let new = || Estimation::new(of.clone(), 3, &names.to_vec().into());
    let mut by_person = new();
    decisions.iter().for_each(|decision| by_person.add(decision));
    let mut by_step = new();
    let mut sorted = decisions.clone();
    sorted.sort_by_key(|decision| decision.step);
    for decision in &sorted {
        by_step.add(decision);
        let mut bytes = Vec::new();
        by_step.save(&mut StateWriter::new(&mut bytes)).unwrap();
        by_step = new();
        by_step.restore(&mut StateReader::new(&mut &bytes[..])).unwrap();
    }
    assert_eq!(by_step.finish(), by_person.finish());
    assert!(by_person.finish().terms.iter().all(|term| term.effect.is_ok()));
}

#[test]
fn a_decision_without_its_outcome_is_left_out() {
    let of =
        Arc::new(EstimateDeclaration { outcome: "mood".to_owned(), ..declared(&[], &[], ANY) });
    let mut decisions = Vec::new();
    for person in 1..=8_u32 {
        for step in 0..5_u32 {
            let action = u8::from((person * 3 + step * step).is_multiple_of(2));
            decisions.push(decision(person, step, action, 0.5, f64::from(person * step % 7)));
        }
    }
    let effect = |decisions: &[Decision]| {
        let mut estimation = Estimation::new(of.clone(), 2, &vec!["mood".to_owned()].into());
        decisions.iter().for_each(|decision| estimation.add(decision));
        estimation.finish().terms[0].effect.clone().unwrap()
    };
    let all = effect(&decisions);
    // Without the number at step 2 of person 4, the outcome of step 1 is missing.
    let mut unavailable = decisions.clone();
    unavailable[16].can_send = false;
    decisions[17].state[0] = f64::NAN;
    let left = effect(&decisions);
    assert_eq!(left.decisions, all.decisions - 1);
    assert_eq!(left, effect(&unavailable));
}

#[test]
fn a_state_as_outcome_is_that_of_the_next_decision() {
    let mut decisions = Vec::new();
    for (person, next) in [(1, 4.0), (2, 6.0), (3, 9.0), (4, 1.0)] {
        let treated = u8::from(person % 2 == 0);
        // The state is half of the reward. The last decision of a person has no outcome.
        decisions.push(decision(person, 0, treated, 0.5, 100.0));
        decisions
            .push(Decision { can_send: person == 1, ..decision(person, 1, 1, 0.5, 2.0 * next) });
    }
    let of = EstimateDeclaration { outcome: "mood".to_owned(), ..declared(&[], &[], ANY) };
    let effect = estimates(of, &decisions)[0].effect.clone().unwrap();
    assert!((effect.value - (3.5 - 6.5)).abs() < 1e-12, "{effect:?}");
}

#[test]
fn an_effect_that_cannot_be_estimated_has_a_reason() {
    #[track_caller]
    fn assert_fails(of: EstimateDeclaration, decisions: &[Decision], expected: &str) {
        let terms = estimates(of, decisions);
        assert!(!terms.is_empty());
        for Estimate { effect, .. } in terms {
            let why = effect.unwrap_err();
            assert!(why.contains(expected), "{why}");
        }
    }
    let six = six_rows();
    let any = |control: &[&str], moderators: &[&str]| declared(control, moderators, ANY);
    assert_fails(any(&["burden"], &[]), &six, "no `burden`; it has mood and step");
    assert_fails(any(&[], &["mood", "step"]), &six, "needs at least 5 people");
    let of = EstimateDeclaration { treatment: Treatment::Action(2), ..any(&[], &[]) };
    assert_fails(of, &six, "no action 2");
    let mut certain = six.clone();
    certain[3].probabilities = [0.0, 1.0].into();
    assert_fails(any(&[], &[]), &certain, "the first at step 1 of person 2");
    let mut flat = six.clone();
    flat.extend((4..8).map(|person| decision(person, 0, 0, 0.5, 1.0)));
    flat.iter_mut().for_each(|decision| decision.state[0] = 7.0);
    assert_fails(any(&["mood"], &[]), &flat, "control feature `mood` is a linear combination");
    assert_fails(any(&[], &["mood"]), &flat, "term `mood` is a linear combination");
    // Of three actions, only the probability of the action taken is known.
    let of_choice = |mut decision: Decision| {
        decision.probabilities = [f64::NAN; 3].into();
        decision.probabilities[usize::from(decision.action)] = 0.3;
        decision
    };
    let partly: Vec<Decision> = six.into_iter().map(of_choice).collect();
    assert_fails(any(&[], &[]), &partly, "not known at 3 decisions");
    let known = EstimateDeclaration { treatment: Treatment::Action(1), ..any(&[], &[]) };
    assert!(estimates(known, &partly)[0].effect.is_ok());
}

#[test]
fn an_outcome_that_does_not_vary_has_no_effect_and_no_standard_error() {
    // Constant rewards, rewards of 0, and rewards that a feature explains up to the rounding of their size.
    let rows = |reward: fn(u32, u32) -> f64| -> Vec<Decision> {
        let of_person = |person: u32| {
            (0..6).map(move |step| {
                let action = u8::from((person * 7 + step * 5).is_multiple_of(3));
                let mood = f64::from((person * step + step) % 5) / 7.0;
                let one = decision(person, step, action, 0.4, reward(person, step));
                Decision { state: [mood].into(), ..one }
            })
        };
        (1..40).flat_map(of_person).collect()
    };
    let rounded: fn(u32, u32) -> f64 =
        |person, step| f64::from((person * step + step) % 5) / 7.0 * 250.0 + 1234.5;
    for reward in [|_, _| 0.0, |_, _| 1.0, |_, _| 60.1, rounded] {
        for moderators in [&[][..], &["mood"]] {
            for Estimate { effect, .. } in
                estimates(declared(&["mood"], moderators, ANY), &rows(reward))
            {
                let why = effect.unwrap_err();
                assert!(why.contains("the outcome does not vary"), "{why}");
            }
        }
    }
    // Noise that is small beside the outcome, and larger than its rounding, is noise.
    let noisy: fn(u32, u32) -> f64 =
        |person, step| 1e6 + f64::from((person * 31 + person * step * 7 + step * step) % 17) * 1e-3;
    let found = estimates(declared(&[], &[], ANY), &rows(noisy));
    assert!(found[0].effect.is_ok(), "{:?}", found[0].effect);
}

#[test]
fn an_effect_without_a_standard_error_has_a_reason() {
    let effect = estimates(declared(&[], &[], ANY), &six_rows())[0].effect.clone().unwrap();
    let nothing = Effect { value: 0.0, ..effect };
    for (standard_error, expected) in
        [(0.0, "is 0"), (f64::NAN, "not a number"), (1e301, "too large")]
    {
        let why = with_standard_error(nothing, standard_error).unwrap_err();
        assert!(why.contains(expected), "{why}");
    }
    assert_eq!(with_standard_error(effect, effect.standard_error), Ok(effect));
}

fn reference() -> Json {
    serde_json::from_str(include_str!("../../tests/reference/estimates.json")).unwrap()
}

fn numbers(list: &Json) -> Vec<f64> {
    list.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
}

fn decisions(case: &Json) -> Vec<Decision> {
    let whole = |row: &Json, key: &str| row[key].as_u64().unwrap() as u32;
    let rows = case["decisions"].as_array().unwrap().iter();
    let decisions = rows.map(|row| Decision {
        state: numbers(&row["state"]).into(),
        can_send: row["can_send"].as_bool().unwrap(),
        probabilities: numbers(&row["probabilities"]).into(),
        reward: row["reward"].as_f64().unwrap(),
        ..decision(whole(row, "person"), whole(row, "step"), whole(row, "action") as u8, 0.5, 0.0)
    });
    decisions.collect()
}

#[test]
fn estimates_are_those_of_statsmodels_and_geepack() {
    let reference = reference();
    let names = ["mood", "load"].map(str::to_owned);
    let mut compared = 0;
    for case in reference["cases"].as_array().unwrap() {
        let decisions = decisions(case);
        for model in case["models"].as_array().unwrap() {
            let treatment = match model["treatment"].as_str() {
                Some(word) => Treatment::Messages(Messages::named(word).unwrap()),
                None => Treatment::Action(model["treatment"].as_u64().unwrap() as u8),
            };
            let features =
                |key: &str| -> Vec<String> { serde_json::from_value(model[key].clone()).unwrap() };
            let of = EstimateDeclaration {
                control: features("control"),
                moderators: features("moderators"),
                numerator: reference["numerator"].as_f64().unwrap(),
                ..declared(&[], &[], treatment)
            };
            let mut estimation = Estimation::new(Arc::new(of), 3, &names.to_vec().into());
            decisions.iter().for_each(|decision| estimation.add(decision));
            let near = |ours: f64, theirs: f64, what: &str| {
                let off = (ours - theirs).abs();
                assert!(off < 1e-8 * theirs.abs().max(1.0), "{what} {model}: {ours}, not {theirs}");
            };
            let effects = estimation.finish().terms.into_iter().map(|term| term.effect.unwrap());
            let effects: Vec<Effect> = effects.collect();
            let corrected = [
                ("estimate", effects.iter().map(|one| one.value).collect::<Vec<_>>()),
                ("standard_error", effects.iter().map(|one| one.standard_error).collect()),
            ];
            let without = estimation.uncorrected();
            let plain = [
                ("geepack_estimate", without.iter().map(|one| one.0).collect()),
                ("uncorrected_error", without.iter().map(|one| one.1).collect::<Vec<_>>()),
            ];
            for (what, ours) in corrected.into_iter().chain(plain) {
                let theirs = numbers(&model[what]);
                assert_eq!(ours.len(), theirs.len(), "{what}");
                ours.iter().zip(theirs).for_each(|(ours, theirs)| near(*ours, theirs, what));
                compared += 1;
            }
        }
    }
    assert_eq!(compared, 3 * 5 * 4);
}

impl Estimation {
    /// The coefficients of the treatments with standard errors that are not corrected for small samples.
    fn uncorrected(&self) -> Vec<(f64, f64)> {
        let fit = self.sums().fit(Correction::None).unwrap();
        let size = fit.coefficients.len();
        let first = 1 + self.declaration().control.len();
        let error = |index: usize| fit.covariance[index * size + index].sqrt();
        (first..size).map(|index| (fit.coefficients[index], error(index))).collect()
    }
}
