//! Log relative risks against the authors' package (`tests/reference/emee.R`), and values of policies by hand.

use std::sync::Arc;

use serde_json::Value as Json;

use super::Estimation;
use super::emee::Rows;
use super::tests::{ANY, decision, declared};
use super::together::Together;
use super::value::{Courses, Made, NoValue};
use crate::job::{
    Decision, Effect, EstimateDeclaration, Estimator, StateNames, TargetPolicy, VALUE_TERMS,
};

fn texts(list: &Json) -> Vec<String> {
    serde_json::from_value(list.clone()).unwrap()
}

fn numbers(list: &Json) -> Vec<f64> {
    serde_json::from_value(list.clone()).unwrap()
}

/// The decisions of a case: person, step, available, action, probability, share, late and outcome.
fn recorded(case: &Json) -> Vec<Decision> {
    let of_row = |row: &Json| {
        let row = numbers(row);
        Decision {
            state: row[5..7].into(),
            can_send: row[2] == 1.0,
            ..decision(row[0] as u32, row[1] as u32, row[3] as u8, row[4], row[7])
        }
    };
    case["decisions"].as_array().unwrap().iter().map(of_row).collect()
}

fn estimation(of: EstimateDeclaration, decisions: &[Decision]) -> Estimation {
    let names = ["share", "late"].map(str::to_owned).to_vec();
    let mut estimation = Estimation::new(Arc::new(of), 2, &names.into());
    decisions.iter().for_each(|decision| estimation.add(decision));
    estimation
}

fn effects(of: EstimateDeclaration, decisions: &[Decision]) -> Vec<Result<Effect, String>> {
    estimation(of, decisions).finish().terms.into_iter().map(|term| term.effect).collect()
}

fn emee() -> EstimateDeclaration {
    EstimateDeclaration { estimator: Estimator::Emee, ..declared(&[], &[], ANY) }
}

#[test]
fn relative_risks_are_those_of_the_authors_package() {
    let text = include_str!("../../tests/reference/emee.json");
    let reference: Json = serde_json::from_str(text).unwrap();
    let mut compared = 0;
    for case in reference["cases"].as_array().unwrap() {
        let decisions = recorded(case);
        for model in case["models"].as_array().unwrap() {
            let of = EstimateDeclaration {
                control: texts(&model["control"]),
                moderators: texts(&model["moderators"]),
                numerator: model["numerator"].as_f64().unwrap(),
                ..emee()
            };
            let estimation = estimation(of, &decisions);
            let Together::Rows(rows) = &estimation.together else { panic!("{model}") };
            let plain = uncorrected(rows);
            let found = estimation.finish().terms.into_iter().map(|term| term.effect.unwrap());
            let found: Vec<Effect> = found.collect();
            let of = |value: fn(&Effect) -> f64| found.iter().map(value).collect::<Vec<f64>>();
            for (what, ours) in [
                ("estimate", of(|one| one.value)),
                ("standard_error", of(|one| one.standard_error)),
                ("low", of(|one| one.low)),
                ("high", of(|one| one.high)),
                ("uncorrected_error", plain),
            ] {
                let theirs = numbers(&model[what]);
                assert_eq!(ours.len(), theirs.len(), "{what}");
                for (ours, theirs) in ours.iter().zip(theirs) {
                    // Their solver stops at 1e-8.
                    assert!((ours - theirs).abs() < 1e-7, "{what} {model}: {ours}, not {theirs}");
                    compared += 1;
                }
            }
        }
    }
    assert_eq!(compared, (1 + 2 + 3 + 1 + 2 + 2) * 5);
}

/// The standard errors of the treatment without a correction for small samples.
fn uncorrected(rows: &Rows) -> Vec<f64> {
    let fit = rows.fit(false).unwrap();
    let size = rows.columns;
    (rows.controls..size).map(|index| fit.covariance[index * size + index].sqrt()).collect()
}

#[test]
fn outcomes_without_a_relative_risk_have_a_reason() {
    let rows = |outcome: fn(u32, u8) -> f64| -> Vec<Decision> {
        let of_person = |person: u32| {
            (0..4).map(move |step| {
                let action = u8::from((person + step).is_multiple_of(2));
                let one = decision(person, step, action, 0.5, outcome(person * 4 + step, action));
                Decision { state: [0.0, 0.0].into(), ..one }
            })
        };
        (1..12).flat_map(of_person).collect()
    };
    let reason =
        |outcome: fn(u32, u8) -> f64| effects(emee(), &rows(outcome))[0].clone().unwrap_err();
    assert!(reason(|_, _| 0.0).contains("no outcome is above 0"));
    assert!(reason(|_, action| f64::from(action)).contains("no finite solution"));
    let why = reason(|at, _| f64::from(at % 3) / 2.0);
    assert!(why.contains("has the outcome 0.5"), "{why}");
    assert!(why.contains("`estimator` = \"wcls\" is for other outcomes"), "{why}");
}

/// Sixteen people with two decisions, as many of each kind as are expected: the second probability depends on the first
/// action. The outcomes are 1 + 2a, and 3b − ab + 1.
fn balanced(person: usize) -> [Made; 2] {
    let number = person / 20 % 16;
    let first = usize::from(number < 4);
    let second = usize::from(if first == 1 { number < 3 } else { number < 10 });
    let taken = [
        if first == 1 { 0.25 } else { 0.75 },
        match (first, second) {
            (0, _) => 0.5,
            (_, 1) => 0.75,
            _ => 0.25,
        },
    ];
    let (a, b) = (first as f64, second as f64);
    let outcomes = [1.0 + 2.0 * a, 3.0 * b - a * b + 1.0];
    [(0, first), (1, second)].map(|(step, action)| Made {
        person,
        step: step as u32,
        action,
        can_send: true,
        ratio: 0.5 / taken[step],
        outcome: outcomes[step],
        terminated: false,
    })
}

fn courses(steps: usize, made: Vec<Made>) -> Courses {
    let features = [1.0, 1.0].repeat(made.len());
    let policy = [0.5, 0.5].repeat(made.len());
    let stays = Vec::new();
    Courses {
        steps,
        controls: 1,
        terms: 1,
        actions: 2,
        policy,
        features,
        made,
        stays,
        misfit: None,
    }
}

#[test]
fn values_of_balanced_people_by_hand() {
    // As many of each kind in each of the twenty groups.
    let all: Vec<Made> = (0..320).flat_map(balanced).collect();
    let both = courses(2, all.clone()).value().unwrap();
    // 2, and 3/2 − 1/4 + 1.
    for found in both.values {
        assert!((found.value - (2.0 + 2.25) / 2.0).abs() < 1e-12, "{found:?}");
    }
    assert_eq!((both.people.len(), both.courses), (320, 320));
    // Weights of 1/(4p) for both decisions together: 4/3 of 3, 4 of 1, and 2/3 of 12, of 16.
    let squares = 3.0 * (16.0 / 9.0) + 16.0 + 12.0 * (4.0 / 9.0);
    assert!((both.effective_size - 20.0 * 256.0 / squares).abs() < 1e-9);
    // A single decision: 2, and the second outcome after the actions of the others: b is 1/2, a 1/4.
    let one = courses(1, all.clone()).value().unwrap();
    for found in &one.values {
        assert!((found.value - (2.0 + 2.375) / 2.0).abs() < 1e-12, "{found:?}");
    }
    // The model explains the first outcome and most of the second.
    assert!(one.values[2].standard_error() < one.values[0].standard_error());
    // The mean of each person's two weighted outcomes, with the residuals over n - 1.
    let sums: Vec<f64> =
        all.chunks(2).map(|own| own.iter().map(|one| one.ratio * one.outcome).sum()).collect();
    let mean = sums.iter().sum::<f64>() / 640.0;
    let squares: f64 = sums.iter().map(|sum| (sum - 2.0 * mean).powi(2)).sum();
    assert!((one.values[0].standard_error() - squares.sqrt() / 638.0).abs() < 1e-12);
}

#[test]
fn a_terminal_state_ends_a_course_and_a_cut_does_not_count() {
    let made = |person: usize, step: u32, terminated: bool| Made {
        person,
        step,
        action: 1,
        can_send: true,
        ratio: 1.0,
        outcome: 6.0,
        terminated,
    };
    let ended = |terminated: bool| {
        let of_person = |person: usize| {
            let last = if person < 6 { 3 } else { 1 };
            (0..last).map(move |step| made(person, step, terminated && person >= 6))
        };
        courses(2, (0..12).flat_map(of_person).collect()).value()
    };
    // Six people have two courses of 6, and those of six others end after one decision, with 3 each.
    let found = ended(true).unwrap();
    assert_eq!((found.courses, found.people.len()), (18, 12));
    assert!((found.values[0].value - (12.0 * 6.0 + 6.0 * 3.0) / 18.0).abs() < 1e-12);
    let found = ended(false).unwrap();
    assert_eq!((found.courses, found.people.len()), (12, 6));
    assert!((found.values[1].value - 6.0).abs() < 1e-12);
    // A terminal state ends no course that the person's stay would have cut.
    let mut cut = courses(
        2,
        (0..12).flat_map(|person| (0..2).map(move |step| made(person, step, step == 1))).collect(),
    );
    assert_eq!(cut.value().unwrap().courses, 12);
    cut.stays = vec![3; 12];
    assert_eq!(cut.value().unwrap().courses, 24);
    // A gap between two decisions cuts a course, too.
    let gaps = (0..12).flat_map(|person| [made(person, 0, false), made(person, 2, false)]);
    assert_eq!(courses(2, gaps.collect()).value().unwrap_err(), NoValue::People(0));
}

#[test]
fn a_value_without_a_number_has_a_reason() {
    let of = |policy: f64, steps: u32| EstimateDeclaration {
        estimator: Estimator::Value,
        policy: Some(TargetPolicy::Message(policy)),
        steps,
        ..declared(&[], &[], ANY)
    };
    let rows = |people: u32, p: f64| -> Vec<Decision> {
        let of_person = |person: u32| {
            (0..4).map(move |step| {
                let action = u8::from((person + step * step).is_multiple_of(5));
                let one = decision(person, step, action, p, f64::from(person % 3 + step));
                Decision { state: [0.5, 0.0].into(), ..one }
            })
        };
        (1..=people).flat_map(of_person).collect()
    };
    let found = effects(of(0.6, 1), &rows(20, 0.2));
    assert_eq!(found.len(), VALUE_TERMS.len());
    for effect in found {
        let effect = effect.unwrap();
        assert_eq!((effect.decisions, effect.degrees_of_freedom), (80, 19.0));
        assert!(effect.effective_sample_size.unwrap() < 80.0 && effect.low < effect.high);
    }
    let reason = |of, rows: &[Decision]| effects(of, rows)[1].clone().unwrap_err();
    let why = reason(of(1.0, 4), &rows(20, 0.2));
    assert!(why.contains("effective sample size is 0.0 of 20, below 10"), "{why}");
    assert!(why.contains("fewer `steps`"), "{why}");
    let why = reason(of(0.6, 1), &rows(1, 0.2));
    assert!(why.contains("at least 2 people with 1 decision"), "{why}");
    let why = reason(of(0.6, 5), &rows(9, 0.2));
    assert!(why.contains("with 5 decisions one after the other; found 0"), "{why}");
    let mut certain = rows(20, 0.2);
    certain[2].probabilities = [1.0, 0.0].into();
    let why = reason(of(0.6, 1), &certain);
    assert!(why.contains("had probability 0, the first at step 2 of person 1"), "{why}");
    // A policy that never sends is known from decisions that could not have been messages.
    assert!(effects(of(0.0, 1), &certain)[0].is_ok());
    let three = EstimateDeclaration {
        policy: Some(TargetPolicy::Actions(vec![0.5, 0.25, 0.25])),
        ..of(0.5, 1)
    };
    let why = reason(three, &rows(20, 0.2));
    assert_eq!(why, "`policy` lists 3 numbers, and the environment has 2 actions");
    let named = |name: &str| EstimateDeclaration {
        policy: Some(TargetPolicy::Named(name.to_owned())),
        ..of(0.5, 1)
    };
    let why = reason(named("load"), &rows(20, 0.2));
    assert!(why.contains("the recorded state has no `load`"), "{why}");
    let mut over = rows(20, 0.2);
    over[5].state[0] = 1.25;
    let why = reason(named("share"), &over);
    assert_eq!(why, "its `policy` is 1.25 at step 1 of person 2, which is no probability");
}

#[test]
fn a_policy_can_be_a_number_of_the_state_or_the_agent() {
    let mut rows: Vec<Decision> = Vec::new();
    for person in 1..=20_u32 {
        for step in 0..4_u32 {
            let action = u8::from((person * 3 + step).is_multiple_of(2));
            let reward = f64::from(person % 4 + step * u32::from(action));
            let one = decision(person, step, action, 0.25 + 0.5 * f64::from(step % 2), reward);
            rows.push(Decision { state: [0.75, 0.0].into(), ..one });
        }
    }
    let of = |policy: TargetPolicy| {
        let estimator = Estimator::Value;
        let of = EstimateDeclaration { estimator, policy: Some(policy), ..declared(&[], &[], ANY) };
        effects(of, &rows)
    };
    let named = |name: &str| of(TargetPolicy::Named(name.to_owned()));
    assert_eq!(named("share"), of(TargetPolicy::Message(0.75)));
    // What the agent did itself is the mean.
    let mean = rows.iter().map(|one| one.reward).sum::<f64>() / 80.0;
    for effect in named("agent").into_iter().take(2) {
        let effect = effect.unwrap();
        assert!((effect.value - mean).abs() < 1e-12, "{effect:?}");
        assert_eq!(effect.effective_sample_size, Some(80.0));
    }
    // In a recorded trial, the actions were taken with other probabilities than the agent's. Without a number of the state,
    // a decision is left out.
    let mut replayed = rows.clone();
    for one in &mut replayed {
        one.state = [0.75, 0.5].into();
    }
    replayed[7].state[0] = f64::NAN;
    let names = ["mood", "recorded_probability"].map(str::to_owned).to_vec();
    let of = EstimateDeclaration {
        estimator: Estimator::Value,
        policy: Some(TargetPolicy::Named("agent".to_owned())),
        ..declared(&["mood"], &[], ANY)
    };
    let effect = of_recorded(of.clone(), 2, &names, &replayed)[0].clone().unwrap();
    let kept = replayed.iter().enumerate().filter(|(index, _)| *index != 7);
    let weighted = kept.map(|(_, one)| one.action_probability() / 0.5 * one.reward);
    assert!((effect.value - weighted.sum::<f64>() / 79.0).abs() < 1e-12, "{effect:?}");
    assert_eq!(effect.decisions, 79);
    // In another trial, a number of this name is like any other.
    let mut estimation = Estimation::new(Arc::new(of), 2, &names.into());
    replayed.iter().for_each(|decision| estimation.add(decision));
    let effect = estimation.finish().terms[0].effect.clone().unwrap();
    let mean = rows.iter().enumerate().filter(|(index, _)| *index != 7);
    let mean = mean.map(|(_, one)| one.reward).sum::<f64>() / 79.0;
    assert!((effect.value - mean).abs() < 1e-12, "{effect:?}");
}

/// The effects of a trial that happened, which has this number of actions.
fn of_recorded(
    of: EstimateDeclaration,
    actions: usize,
    names: &[String],
    decisions: &[Decision],
) -> Vec<Result<Effect, String>> {
    let names = StateNames::of_recorded(names.to_vec());
    let mut estimation = Estimation::new(Arc::new(of), actions, &names);
    decisions.iter().for_each(|decision| estimation.add(decision));
    estimation.finish().terms.into_iter().map(|term| term.effect).collect()
}

#[test]
fn a_value_needs_the_actions_of_its_policy_in_a_trial_that_happened() {
    let names = ["recorded_probability".to_owned()];
    let of = |policy: Vec<f64>| EstimateDeclaration {
        estimator: Estimator::Value,
        policy: Some(TargetPolicy::Actions(policy)),
        ..declared(&[], &[], ANY)
    };
    // The agent that replays the trial has probabilities of its own.
    let rows = |taken: f64, probabilities: &[f64]| -> Vec<Decision> {
        let of_person = |person: u32| {
            (0..4).map(move |step| {
                let action = u8::from((person + step).is_multiple_of(2));
                let one = decision(person, step, action, 0.5, f64::from(person % 3 + step));
                Decision { state: [taken].into(), probabilities: probabilities.into(), ..one }
            })
        };
        (1..=20).flat_map(of_person).collect()
    };
    let mut replayed = rows(0.5, &[0.4, 0.6]);
    let found = |policy: Vec<f64>, rows: &[Decision]| {
        of_recorded(of(policy.clone()), policy.len(), &names, rows)[1].clone()
    };
    assert!(found(vec![0.5, 0.5], &replayed).is_ok());
    // Person 1 took action 1 at step 3, with certainty.
    replayed[3].state[0] = 1.0;
    let why = found(vec![0.5, 0.5], &replayed).unwrap_err();
    assert!(why.contains("had probability 0, the first at step 3 of person 1"), "{why}");
    assert!(found(vec![0.0, 1.0], &replayed).is_ok());
    // Of three actions, the rule `recorded` has the probabilities of all.
    let third = rows(0.5, &[0.5, 0.5, 0.0]);
    let why = found(vec![0.4, 0.3, 0.3], &third).unwrap_err();
    assert!(why.contains("80 decisions at which an action of the policy"), "{why}");
    assert!(found(vec![0.6, 0.4, 0.0], &third).is_ok());
    // Of another agent, they are not known.
    assert!(found(vec![0.4, 0.3, 0.3], &rows(0.5, &[0.6, 0.4, 0.0])).is_ok());
}

#[test]
fn where_nothing_can_be_sent_a_policy_of_the_state_may_be_missing() {
    let rows = |missing: f64| -> Vec<Decision> {
        let of_person = |person: u32| {
            (0..4).map(move |step| {
                let action = u8::from(step != 2 && (person + step).is_multiple_of(2));
                let one = decision(person, step, action, 0.5, f64::from(person % 3 + step));
                let share = if step == 2 { missing } else { 0.75 };
                Decision { state: [share, 0.0].into(), can_send: step != 2, ..one }
            })
        };
        (1..=20).flat_map(of_person).collect()
    };
    let of = |policy: TargetPolicy| EstimateDeclaration {
        estimator: Estimator::Value,
        policy: Some(policy),
        steps: 2,
        ..declared(&[], &[], ANY)
    };
    let named = effects(of(TargetPolicy::Named("share".to_owned())), &rows(f64::NAN));
    assert!(named.iter().all(Result::is_ok), "{named:?}");
    assert_eq!(named, effects(of(TargetPolicy::Message(0.75)), &rows(0.5)));
}

#[test]
fn a_difference_of_two_policies_has_the_error_of_each_persons_difference() {
    let rows: Vec<Decision> = (1..=30)
        .flat_map(|person: u32| {
            (0..4).map(move |step| {
                let action = u8::from((person * person + 3 * step).is_multiple_of(3));
                let one = decision(
                    person,
                    step,
                    action,
                    0.4,
                    f64::from(person * (step + 1) % 7 + u32::from(action)),
                );
                // The number is missing before one decision, under the policy that is named.
                let share = if person == 5 && step == 1 { f64::NAN } else { 0.5 };
                Decision { state: [share, 0.0].into(), ..one }
            })
        })
        .collect();
    let of = |policy: TargetPolicy, against: Option<TargetPolicy>, steps: u32| {
        let estimator = Estimator::Value;
        let of = EstimateDeclaration {
            estimator,
            policy: Some(policy),
            against,
            steps,
            ..declared(&[], &[], ANY)
        };
        effects(of, &rows).into_iter().map(Result::unwrap).collect::<Vec<_>>()
    };
    let (often, seldom) = (TargetPolicy::Message(0.7), TargetPolicy::Message(0.2));
    for steps in [1, 2] {
        let (one, other) = (of(often.clone(), None, steps), of(seldom.clone(), None, steps));
        let both = of(often.clone(), Some(seldom.clone()), steps);
        for ((one, other), both) in one.iter().zip(&other).zip(&both) {
            assert_eq!(both.value, one.value - other.value);
            let sizes = [one.effective_sample_size, other.effective_sample_size];
            assert_eq!(
                both.effective_sample_size,
                sizes.into_iter().min_by(|a, b| a.unwrap().total_cmp(&b.unwrap())).unwrap()
            );
        }
    }
    // With weights, the difference is the mean of each decision's outcome times both weights' difference.
    let weight = |decision: &Decision| if decision.action == 1 { 0.5 / 0.4 } else { -0.5 / 0.6 };
    let sums: Vec<f64> =
        rows.chunks(4).map(|own| own.iter().map(|one| weight(one) * one.reward).sum()).collect();
    let value = sums.iter().sum::<f64>() / 120.0;
    let squares: f64 = sums.iter().map(|sum| ((sum - 4.0 * value) / 116.0).powi(2)).sum();
    let found = &of(often.clone(), Some(seldom.clone()), 1)[0];
    assert!(
        (found.value - value).abs() < 1e-12
            && (found.standard_error - squares.sqrt()).abs() < 1e-12,
        "{found:?}"
    );
    // A policy with a missing number has a decision less.
    let named = TargetPolicy::Named("share".to_owned());
    assert_eq!(of(often.clone(), Some(named), 1)[0].decisions, 119);
    let same = EstimateDeclaration {
        estimator: Estimator::Value,
        policy: Some(often.clone()),
        against: Some(often),
        ..declared(&[], &[], ANY)
    };
    let why = effects(same, &rows)[0].clone().unwrap_err();
    assert_eq!(
        why,
        "its standard error is rounding alone: the difference is the same for every person"
    );
}
