//! Statistics against numbers from scipy, statsmodels, mpmath and R (`tests/reference`).

use serde_json::Value;

use super::interval::critical;
use super::noncentral::noncentral_t;
use super::sample::sample;
use super::*;
use crate::estimate::{t_of_p, two_sided_p};

/// Relative tolerance of statistics that are computed to full precision.
const TOLERANCE: f64 = 1e-9;

fn reference() -> Value {
    serde_json::from_str(include_str!("../../tests/reference/statistics.json")).unwrap()
}

fn cases(name: &str) -> Vec<Value> {
    let cases = reference()[name].as_array().unwrap().clone();
    assert!(!cases.is_empty(), "{name}");
    cases
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(number).collect()
}

/// Numbers of a list of lists.
fn rows(value: &Value) -> Vec<Vec<f64>> {
    value.as_array().unwrap().iter().map(numbers).collect()
}

fn assert_near(ours: f64, theirs: f64, what: &str) {
    let off = (ours - theirs).abs();
    assert!(off <= TOLERANCE * theirs.abs().max(1e-300), "{what}: {ours}, not {theirs}");
}

/// The tolerance is relative to the largest of the width and the two ends, because an end may be near 0.
fn assert_interval(ours: Interval, theirs: &Value, tolerance: f64, what: &str) {
    let [low, high] = numbers(theirs)[..] else { panic!("{theirs} is no interval") };
    let most = tolerance * (high - low).max(low.abs()).max(high.abs());
    let off = (ours.low - low).abs().max((ours.high - high).abs());
    assert!(off <= most, "{what}: {ours:?}, not [{low}, {high}]");
}

#[test]
fn tails_of_students_t_are_exact_to_1e_200() {
    for row in rows(&reference()["two_sided_p"]) {
        let (t, df, p) = (row[0], row[1], row[2]);
        assert_near(two_sided_p(t, df), p, &format!("p of t {t}, df {df}"));
        assert_eq!(two_sided_p(-t, df), two_sided_p(t, df));
    }
}

#[test]
fn bounds_of_students_t() {
    for row in rows(&reference()["critical"]) {
        assert_near(critical(row[0]), row[1], &format!("critical t of df {}", row[0]));
    }
    for row in rows(&reference()["t_of_p"]) {
        assert_near(t_of_p(row[0], row[1]), row[2], &format!("t of p {}, df {}", row[0], row[1]));
    }
}

#[test]
fn noncentral_t_is_exact_to_1e_12() {
    for row in rows(&reference()["noncentral_t"]) {
        let ours = noncentral_t(row[0], row[1], row[2]);
        assert!((ours - row[3]).abs() <= 1e-12, "{row:?}: {ours}");
    }
}

#[test]
fn intervals_of_means() {
    for case in cases("mean_interval") {
        let ours = mean_interval(&numbers(&case["values"])).unwrap();
        assert_interval(ours, &case["interval"], TOLERANCE, "mean");
    }
}

fn assert_t_test(ours: Result<TTest, Undefined>, theirs: &Value, what: &str) {
    let ours = ours.unwrap();
    assert_near(ours.t, number(&theirs["t"]), &format!("{what}: t"));
    assert_near(ours.df, number(&theirs["df"]), &format!("{what}: df"));
    assert_near(ours.p, number(&theirs["p"]), &format!("{what}: p"));
    assert_interval(ours.interval, &theirs["interval"], TOLERANCE, what);
}

fn assert_effect(ours: &Contrast, theirs: &Value, prefix: &str, what: &str) {
    let read = |name: &str| &theirs[format!("{prefix}{name}")];
    if !read("hedges_g").is_null() {
        let g = ours.hedges_g.unwrap();
        assert_near(g.g, number(&read("hedges_g")["g"]), what);
        assert_interval(g.interval, &read("hedges_g")["interval"], TOLERANCE, what);
    }
    let improvement = ours.improvement.unwrap();
    assert_near(improvement.probability, number(&read("improvement")["probability"]), what);
    assert_interval(improvement.interval, &read("improvement")["interval"], TOLERANCE, what);
    assert_near(ours.permutation_p.unwrap(), number(read("permutation_p")), what);
}

#[test]
fn contrasts_of_independent_and_of_matched_seeds() {
    for case in cases("contrast") {
        let (first, second) = (numbers(&case["first"]), numbers(&case["second"]));
        let (first, second) = (sample(&first), sample(&second));
        let what = format!("{:?} against {:?}", first.values(), second.values());
        let ours = Contrast::new(&first, &second, SeedPairing::Independent);
        assert_t_test(ours.student, &case["student"], &what);
        assert_t_test(ours.test, &case["unpaired"], &what);
        assert_effect(&ours, &case, "", &what);
        if !case["paired"].is_null() {
            let ours = Contrast::new(&first, &second, SeedPairing::Matched);
            assert_t_test(ours.test, &case["paired"], &what);
            assert_effect(&ours, &case, "paired_", &what);
        }
    }
}

#[test]
fn corrections_for_families_with_ties_and_with_undefined_tests() {
    for case in cases("multiplicity") {
        let p = case["p"].as_array().unwrap().iter();
        let family: Vec<_> = p.map(|p| p.as_f64().ok_or(Undefined::NoSeeds)).collect();
        for (index, corrected) in correct(&family).iter().enumerate() {
            let Ok(ours) = corrected else {
                assert_eq!(*corrected, Err(Undefined::NoSeeds));
                assert!(case["holm"][index].is_null());
                continue;
            };
            assert_near(ours.holm, number(&case["holm"][index]), "Holm");
            let theirs = number(&case["benjamini_hochberg"][index]);
            assert_near(ours.benjamini_hochberg, theirs, "Benjamini-Hochberg");
        }
    }
}

#[test]
fn minimum_detectable_differences_are_those_of_statsmodels() {
    for row in cases("detectable") {
        let [n, level, exact, low, high] = [0, 1, 3, 4, 5].map(|at| number(&row[at]));
        // With a standard error of 1, the difference is the shift.
        let third = (3.0_f64).sqrt();
        let values = [2.0 - third, 2.0, 2.0 + third];
        let test = TTest { df: n - 1.0, ..paired_t_test(&values.map(|x| (x, 0.0))).unwrap() };
        assert_near(test.standard_error, 1.0, "standard error");
        let Detectable { difference, interval } = detectable(&test, level);
        // The root search of statsmodels stops at a tolerance of about 1e-6, and fails far in the tail.
        if let Some(theirs) = row[2].as_f64() {
            assert!((difference - theirs).abs() <= 1e-5 * theirs, "{difference}, not {theirs}");
        }
        assert_near(difference, exact, "minimum detectable difference");
        assert_near(interval.low, low, "its lower end");
        assert_near(interval.high, high, "its upper end");
    }
}

#[test]
fn recoveries_of_independent_and_of_matched_seeds() {
    for case in cases("recovery") {
        let [with, without] = ["with", "without"].map(|side| sample(&numbers(&case[side])));
        let optimum = number(&case["optimum"]);
        for (design, name) in
            [(SeedPairing::Independent, "unpaired"), (SeedPairing::Matched, "paired")]
        {
            let ours = recovered(&with, &without, optimum, design).unwrap();
            assert_near(ours.share, number(&case["share"]), "share");
            assert_interval(ours.interval.unwrap(), &case[name], TOLERANCE, name);
        }
    }
}

#[test]
fn quantiles_are_those_of_numpy() {
    for case in cases("quantile") {
        let ours = quantile(&numbers(&case["values"]), number(&case["share"])).unwrap();
        assert_near(ours, number(&case["quantile"]), "quantile");
    }
}

/// Both sides resample, the reference 200,000 times and ours 10,000 times, so the ends are
/// uncertain by about 2 % of the width (three standard errors).
const DRAWN: f64 = 0.02;

fn assert_drawn(ours: Interval, theirs: &Value) {
    let [low, high] = numbers(theirs)[..] else { panic!("{theirs} is no interval") };
    let off = (ours.low - low).abs().max((ours.high - high).abs());
    assert!(off <= DRAWN * (high - low), "{ours:?}, not [{low}, {high}]");
}

#[test]
fn interquartile_means_with_bootstrap_intervals() {
    for case in cases("interquartile_mean") {
        let of_seeds = |first: fn(u64) -> u64| {
            let conditions = (0..).zip(rows(&case["conditions"]));
            let condition = |(index, values): (u64, Vec<f64>)| {
                Sample::new((first(index)..).zip(values), 0, 0).unwrap()
            };
            let conditions: Vec<Sample> = conditions.map(condition).collect();
            interquartile_mean(&conditions.iter().collect::<Vec<_>>()).unwrap()
        };
        let (apart, joint) = (of_seeds(|index| 100 * index), of_seeds(|_| 0));
        for ours in [apart, joint] {
            assert_near(ours.value, number(&case["value"]), "inter-quartile mean");
        }
        assert_drawn(apart.interval.unwrap(), &case["interval"]);
        assert_drawn(joint.interval.unwrap(), &case["joint_interval"]);
    }
}

#[test]
fn moving_means_are_those_of_single_episodes() {
    for case in cases("moving_mean") {
        let pairs = |value: &Value| -> Vec<(u32, f64)> {
            rows(value).iter().map(|row| (row[0] as u32, row[1])).collect()
        };
        let [stride, window] = ["stride", "window"].map(|name| number(&case[name]) as u32);
        let (ours, theirs) =
            (moving_mean(&pairs(&case["points"]), stride, window), pairs(&case["smooth"]));
        assert_eq!(ours.len(), theirs.len());
        for (ours, theirs) in ours.iter().zip(theirs) {
            assert_eq!(ours.0, theirs.0);
            assert_near(ours.1, theirs.1, "moving mean");
        }
    }
}

#[test]
fn joint_intervals_with_published_numbers() {
    for case in cases("agreement") {
        let (ours, published) = (numbers(&case["ours"]), numbers(&case["published"]));
        let ours = UncertainNumber { value: ours[0], standard_error: ours[1], df: ours[2] };
        let theirs =
            UncertainNumber::of_published(published[0], published[1], published[2]).unwrap();
        assert_near(theirs.standard_error, number(&case["standard_error"]), "published error");
        let joint = agreement(&ours, &theirs).unwrap();
        assert_interval(joint.interval, &case["interval"], TOLERANCE, "joint");
        assert_eq!(joint.verdict == Verdict::Inside, case["inside"].as_bool().unwrap());
    }
}
