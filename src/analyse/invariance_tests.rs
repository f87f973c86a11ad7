//! Transformations that must leave a statistic unchanged or change it in a known way, on random samples.

use super::sample::sample;
use super::*;
use crate::rng::{Purpose, Stream};

const ROUNDS: u64 = 60;

/// Multiples of 1/4, so that shifts and scalings by powers of two are exact and ties occur.
fn draw(stream: &mut Stream, n: usize) -> Vec<f64> {
    (0..n).map(|_| f64::from(stream.below(80)) / 4.0 - 10.0).collect()
}

/// Two arms of two to eight seeds each.
fn arms(seed: u64) -> (Vec<f64>, Vec<f64>) {
    let mut stream = Stream::new(seed, Purpose::Replay);
    let [m, n] = [0; 2].map(|_| 2 + stream.below(7) as usize);
    (draw(&mut stream, m), draw(&mut stream, n))
}

fn map(values: &[f64], function: impl Fn(f64) -> f64) -> Vec<f64> {
    values.iter().map(|value| function(*value)).collect()
}

fn contrasts(first: &[f64], second: &[f64]) -> [Contrast; 2] {
    let (first, second) = (sample(first), sample(second));
    [SeedPairing::Independent, SeedPairing::Matched]
        .map(|design| Contrast::new(&first, &second, design))
}

/// The numbers of a contrast. Numbers in units of the metric are divided by `unit`.
fn numbers(contrast: &Contrast, unit: f64) -> Vec<Result<f64, Undefined>> {
    let detectable = contrast.test.map(|test| detectable(&test, 0.05));
    let mut all = vec![
        contrast.difference.map(|difference| difference / unit),
        detectable.map(|detectable| detectable.difference / unit),
        detectable.map(|detectable| detectable.interval.high / unit),
        contrast.permutation_p,
    ];
    for test in [contrast.test, contrast.student] {
        all.extend([
            test.map(|test| test.t),
            test.map(|test| test.df),
            test.map(|test| test.p),
            test.map(|test| test.interval.low / unit),
            test.map(|test| test.interval.high / unit),
        ]);
    }
    all.push(contrast.hedges_g.map(|g| g.g));
    all.push(contrast.hedges_g.map(|g| g.interval.low));
    all.push(contrast.hedges_g.map(|g| g.interval.high));
    all.push(contrast.improvement.map(|improvement| improvement.probability));
    all.push(contrast.improvement.map(|improvement| improvement.interval.low));
    all.push(contrast.improvement.map(|improvement| improvement.interval.high));
    all
}

fn assert_equal(ours: &[Result<f64, Undefined>], theirs: &[Result<f64, Undefined>], what: &str) {
    assert_eq!(ours.len(), theirs.len());
    for (index, pair) in ours.iter().zip(theirs).enumerate() {
        match pair {
            (Ok(a), Ok(b)) => {
                assert!((a - b).abs() <= 1e-9 * (1.0 + a.abs()), "{what}, {index}: {a} and {b}");
            }
            (a, b) => assert_eq!(a, b, "{what}, {index}"),
        }
    }
}

#[test]
fn shifts_and_scales_change_nothing_but_the_unit() {
    for seed in 0..ROUNDS {
        let (first, second) = arms(seed);
        let shifted = contrasts(&map(&first, |x| x + 64.0), &map(&second, |x| x + 64.0));
        let scaled = contrasts(&map(&first, |x| x * 1024.0), &map(&second, |x| x * 1024.0));
        for (index, plain) in contrasts(&first, &second).iter().enumerate() {
            assert_equal(&numbers(&shifted[index], 1.0), &numbers(plain, 1.0), "shifted");
            assert_equal(&numbers(&scaled[index], 1024.0), &numbers(plain, 1.0), "scaled");
        }
    }
}

#[test]
fn swapped_arms_change_the_sign_and_keep_the_p_values() {
    for seed in 0..ROUNDS {
        let (first, second) = arms(seed);
        let swapped = contrasts(&second, &first);
        // Negated values give the swapped contrast: y - x = (-x) - (-y).
        let mirrored = contrasts(&map(&first, |x| -x), &map(&second, |x| -x));
        for (index, plain) in contrasts(&first, &second).iter().enumerate() {
            let swapped = &swapped[index];
            assert_equal(&numbers(swapped, 1.0), &numbers(&mirrored[index], 1.0), "mirrored");
            assert_eq!(swapped.difference, plain.difference.map(|difference| -difference));
            let p = |contrast: &Contrast| [contrast.test.map(|t| t.p), contrast.permutation_p];
            assert_equal(&p(swapped), &p(plain), "p values");
            let g = |contrast: &Contrast, sign: f64| [contrast.hedges_g.map(|g| sign * g.g)];
            assert_equal(&g(swapped, -1.0), &g(plain, 1.0), "Hedges' g");
            let wins = |contrast: &Contrast| contrast.improvement.unwrap().probability;
            assert!((wins(swapped) + wins(plain) - 1.0).abs() < 1e-12);
        }
    }
}

#[test]
fn the_order_of_seeds_changes_nothing() {
    for seed in 0..ROUNDS {
        let (first, second) = arms(seed);
        let turned: Vec<f64> = first.iter().rev().copied().collect();
        let (plain, other) = (contrasts(&first, &second), contrasts(&turned, &second));
        assert_equal(&numbers(&plain[0], 1.0), &numbers(&other[0], 1.0), "independent");
        let backwards = |values: &[f64]| {
            let pairs: Vec<(u64, f64)> = (1..).zip(values.iter().copied()).collect();
            Sample::new(pairs.into_iter().rev(), 0, 0).unwrap()
        };
        let same = Contrast::new(&backwards(&first), &backwards(&second), SeedPairing::Matched);
        assert_eq!(same, plain[1]);
    }
}

#[test]
fn intervals_contain_what_they_are_of_and_exclude_0_where_p_is_small() {
    for seed in 0..ROUNDS {
        let (first, second) = arms(seed);
        for contrast in contrasts(&first, &second) {
            if let Ok(test) = contrast.test {
                assert!(test.interval.contains(test.difference));
                assert_eq!(test.interval.contains(0.0), test.p >= 0.05, "{test:?}");
            }
            if let Ok(g) = contrast.hedges_g {
                assert_eq!(g.interval.contains(0.0), contrast.student.unwrap().p >= 0.05, "{g:?}");
            }
            let improvement = contrast.improvement.unwrap();
            assert!(improvement.interval.contains(improvement.probability));
            assert!(improvement.interval.low >= 0.0 && improvement.interval.high <= 1.0);
            assert!((0.0..=1.0).contains(&contrast.permutation_p.unwrap()));
        }
    }
}

#[test]
fn bootstraps_depend_on_the_values_alone() {
    let values = |turn: usize| -> Vec<Sample> {
        let condition = |seed| {
            let mut values = draw(&mut Stream::new(seed, Purpose::Replay), 6);
            values.rotate_left(turn);
            sample(&values)
        };
        (0..4).map(condition).collect()
    };
    let mean =
        |samples: &[Sample]| interquartile_mean(&samples.iter().collect::<Vec<_>>()).unwrap();
    let plain = mean(&values(0));
    assert_eq!(plain, mean(&values(0)));
    assert_eq!(plain, mean(&values(2)));
    let shifted: Vec<Sample> =
        values(0).iter().map(|sample_of| sample(&map(sample_of.values(), |x| x + 64.0))).collect();
    let (ours, theirs) = (plain.interval.unwrap(), mean(&shifted).interval.unwrap());
    assert!((ours.low + 64.0 - theirs.low).abs() < 1e-9, "{ours:?} {theirs:?}");
    assert!((ours.high + 64.0 - theirs.high).abs() < 1e-9, "{ours:?} {theirs:?}");
}

#[test]
fn corrections_keep_the_order_and_are_never_below_the_raw_p() {
    for seed in 0..ROUNDS {
        let mut stream = Stream::new(seed, Purpose::Replay);
        let family: Vec<Result<f64, Undefined>> = (0..1 + stream.below(12))
            .map(|_| match stream.below(6) {
                0 => Err(Undefined::NoVariance),
                part => Ok((stream.unit() * f64::from(part)).min(1.0)),
            })
            .collect();
        let corrected = correct(&family);
        for (p, one) in family.iter().zip(&corrected) {
            let (Ok(p), Ok(one)) = (p, one) else {
                assert_eq!(p.err(), one.err());
                continue;
            };
            assert!(one.holm >= one.benjamini_hochberg && one.benjamini_hochberg >= *p);
            assert!(one.holm <= 1.0);
            for (q, other) in family.iter().zip(&corrected) {
                if q.is_ok_and(|q| q >= *p) {
                    assert!(other.unwrap().holm >= one.holm);
                    assert!(other.unwrap().benjamini_hochberg >= one.benjamini_hochberg);
                }
            }
        }
    }
}

/// Degenerate samples, and one ordinary sample.
fn odd_samples() -> Vec<Sample> {
    let make_sample = |values: &[f64]| sample(values);
    vec![
        Sample::default(),
        Sample::new([], 3, 0).unwrap(),
        make_sample(&[f64::NAN, f64::INFINITY]),
        make_sample(&[5.0]),
        make_sample(&[5.0, f64::NAN, 5.0]),
        make_sample(&[0.1; 6]),
        make_sample(&[0.1, 0.1 + 1e-17, 0.1]),
        make_sample(&[0.0, -0.0, 0.0]),
        make_sample(&[1e300, -1e300, 1e300]),
        make_sample(&[f64::MAX, f64::MAX, f64::MAX]),
        make_sample(&[1e-300, 2e-300, 3e-300]),
        make_sample(&[f64::MIN_POSITIVE / 4.0, 0.0, 1.0]),
        make_sample(&[1.0, 1.0 + 1e-13, 1.0 - 1e-13]),
        make_sample(&[4.0, 2.0, 7.0, 1.0]),
    ]
}

#[test]
fn degenerate_samples_never_give_a_number_that_is_none() {
    for first in odd_samples() {
        for second in odd_samples() {
            for design in [SeedPairing::Independent, SeedPairing::Matched] {
                let contrast = Contrast::new(&first, &second, design);
                for number in numbers(&contrast, 1.0).into_iter().flatten() {
                    assert!(number.is_finite(), "{contrast:?}");
                }
            }
            if let Ok(Aggregate { value, interval }) = interquartile_mean(&[&first, &second]) {
                assert!(value.is_finite());
                assert!(interval.is_err() || interval.is_ok_and(|i| i.low.is_finite()));
            }
        }
        if let Ok(interval) = mean_interval(first.values()) {
            assert!(interval.low.is_finite() && interval.high.is_finite(), "{first:?}");
        }
    }
}

#[test]
fn a_failed_arm_is_reported_in_every_column() {
    let (failed, whole) = (Sample::new([], 3, 0).unwrap(), sample(&[1.0, 2.0, 3.0]));
    for design in [SeedPairing::Independent, SeedPairing::Matched] {
        for number in numbers(&Contrast::new(&whole, &failed, design), 1.0) {
            assert_eq!(number, Err(Undefined::NoSeeds));
        }
    }
    assert_eq!(interquartile_mean(&[&whole, &failed]), Err(Undefined::NoSeeds));
    assert_eq!(interquartile_mean(&[]), Err(Undefined::NoSeeds));
}

#[test]
fn arms_that_do_not_overlap_have_a_score_interval_with_a_width() {
    let score = improvement(&[4.0, 5.0, 6.0], &[1.0, 2.0, 3.0]).unwrap();
    assert_eq!((score.probability, score.interval.high), (1.0, 1.0));
    assert!(score.interval.low > 0.3 && score.interval.low < 0.8, "{score:?}");
}
