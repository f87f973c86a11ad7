//! How often statistics of few seeds are right, by simulation: the tables of `docs/statistics.md`.
//!
//! Seeds are normal. A seed's values in two conditions correlate, as common random numbers make them.

use std::f64::consts::TAU;

use jitai::statistics::{
    Sample, SeedPairing, detectable, interquartile_mean, paired_t_test, recovered, share_interval,
    t_test, unpaired_t_test,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Approximate number of conditions drawn per row of the table of inter-quartile means.
const DRAWN: usize = 20_000;

/// Number of simulated tests and recoveries per row.
const ROUNDS: usize = 100_000;

/// Correlations of a seed's values between two conditions.
const CORRELATIONS: [f64; 4] = [0.0, 0.3, 0.6, 1.0];

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let (radius, angle): (f64, f64) = (1.0 - rng.random::<f64>(), rng.random());
    (-2.0 * radius.ln()).sqrt() * (TAU * angle).cos()
}

/// Conditions of the same seeds, with mean 0 and deviation 1.
fn conditions(rng: &mut ChaCha8Rng, count: usize, seeds: u64, correlation: f64) -> Vec<Vec<f64>> {
    let (shared, own) = (correlation.sqrt(), (1.0 - correlation).sqrt());
    let common: Vec<f64> = (0..seeds).map(|_| normal(rng)).collect();
    let mut one = || common.iter().map(|common| shared * common + own * normal(rng)).collect();
    (0..count).map(|_| one()).collect()
}

/// A sample of values scaled by `sd` around `mean`.
fn sample(values: &[f64], mean: f64, sd: f64) -> Sample {
    let values = values.iter().map(|value| mean + sd * value);
    Sample::new((0..).zip(values), 0, 0).expect("no seed comes twice")
}

fn percent(hits: usize, rounds: usize) -> f64 {
    100.0 * hits as f64 / rounds as f64
}

/// The shares of tests of equal means that reject at 5 % and at 5 %/24.
fn unpaired_level(rng: &mut ChaCha8Rng, (n, m): (usize, usize), ratio: f64) -> [f64; 2] {
    let mut rejected = [0; 2];
    for _ in 0..ROUNDS {
        let first: Vec<f64> = (0..n).map(|_| ratio * normal(rng)).collect();
        let second: Vec<f64> = (0..m).map(|_| normal(rng)).collect();
        let p = unpaired_t_test(&first, &second).expect("they vary").p;
        rejected[0] += usize::from(p < 0.05);
        rejected[1] += usize::from(p < 0.05 / 24.0);
    }
    rejected.map(|hits| percent(hits, ROUNDS))
}

/// The same for pairs, and the share that detects the minimum detectable difference at both levels.
fn paired_level(rng: &mut ChaCha8Rng, seeds: u64, correlation: f64) -> [f64; 4] {
    let mut hits = [0; 4];
    // The standard error that the difference is detectable with is the true one.
    let error = ((2.0 - 2.0 * correlation) / seeds as f64).sqrt();
    let levels = [0.05, 0.05 / 24.0];
    // In standard errors, the difference depends on the number of seeds alone.
    let values: Vec<(f64, f64)> = (0..seeds).map(|seed| (seed as f64, 0.0)).collect();
    let any = paired_t_test(&values).expect("they vary");
    let shifts =
        levels.map(|level| detectable(&any, level).difference / any.standard_error * error);
    for _ in 0..ROUNDS {
        let both = conditions(rng, 2, seeds, correlation);
        let (first, second) = (sample(&both[0], 0.0, 1.0), sample(&both[1], 0.0, 1.0));
        let test = t_test(&first, &second, SeedPairing::Matched).expect("they vary");
        for (place, (level, shift)) in levels.into_iter().zip(shifts).enumerate() {
            let shifted = sample(&both[0], shift, 1.0);
            let found = t_test(&shifted, &second, SeedPairing::Matched).expect("they vary");
            hits[place] += usize::from(test.p < level);
            hits[2 + place] += usize::from(found.p < level);
        }
    }
    hits.map(|hits| percent(hits, ROUNDS))
}

/// The share of intervals of the inter-quartile mean that hold the true value.
fn of_middle(rng: &mut ChaCha8Rng, count: usize, seeds: u64, correlation: f64) -> f64 {
    let rounds = DRAWN / count;
    let holds = |_: &usize| {
        let arms = conditions(rng, count, seeds, correlation);
        let arms: Vec<Sample> = arms.iter().map(|values| sample(values, 0.0, 1.0)).collect();
        let mean = interquartile_mean(&arms.iter().collect::<Vec<_>>()).expect("values");
        mean.interval.expect("they vary").contains(0.0)
    };
    percent((0..rounds).filter(holds).count(), rounds)
}

/// The share of intervals of a recovered share of 0.8 that hold it. The loss is five deviations.
fn of_recovery(rng: &mut ChaCha8Rng, seeds: u64, correlation: f64, design: SeedPairing) -> f64 {
    let (mut held, mut defined) = (0, 0);
    for _ in 0..ROUNDS {
        let both = conditions(rng, 2, seeds, correlation);
        let (with, without) = (sample(&both[0], 4.0, 0.5), sample(&both[1], 0.0, 1.0));
        let found = recovered(&with, &without, 5.0, design);
        if let Ok(interval) = found.and_then(|found| found.interval) {
            defined += 1;
            held += usize::from(interval.contains(0.8));
        }
    }
    percent(held, defined)
}

/// The share of intervals of a mean rate that hold it. The logits of seeds are normal.
fn of_rate(rng: &mut ChaCha8Rng, seeds: u64, middle: f64) -> f64 {
    const DEVIATION: f64 = 0.5;
    let logit = (middle / (1.0 - middle)).ln();
    let mut rate = || 1.0 / (1.0 + (-logit - DEVIATION * normal(rng)).exp());
    let truth = (0..1_000_000).map(|_| rate()).sum::<f64>() / 1_000_000.0;
    let holds = |_: &usize| {
        let values: Vec<f64> = (0..seeds).map(|_| rate()).collect();
        share_interval(&values).expect("they vary").contains(truth)
    };
    percent((0..ROUNDS).filter(holds).count(), ROUNDS)
}

fn main() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    println!("unpaired t test: rejections of equal means, of 5 % and of 0.21 % (5 %/24)");
    println!("seeds    sd ratio  at 5 %   at 0.21 %");
    for (n, m) in [(2, 2), (3, 3), (5, 5), (10, 10), (12, 2), (12, 3), (40, 2), (40, 5), (40, 40)] {
        for ratio in [1.0 / 3.0, 1.0, 3.0] {
            let [one, other] = unpaired_level(&mut rng, (n, m), ratio);
            println!("{n:2} : {m:2}  {ratio:8.2}  {one:4.1} %   {other:5.2} %");
        }
    }
    println!("\npaired t test, and its power at the minimum detectable difference");
    println!("seeds  correlation  at 5 %   at 0.21 %  power at 5 %  power at 0.21 %");
    for seeds in [2, 3, 5, 10, 20, 40] {
        for correlation in [0.0, 0.3, 0.6] {
            let [one, other, power, rest] = paired_level(&mut rng, seeds, correlation);
            println!(
                "{seeds:5}  {correlation:11}  {one:4.1} %   {other:5.2} %    {power:8.1} %    {rest:8.1} %"
            );
        }
    }
    println!("\nrecovered share of 0.8: coverage of its interval");
    println!("correlation  seeds  paired   unpaired");
    for correlation in CORRELATIONS {
        for seeds in [3, 5, 10, 20] {
            let [paired, unpaired] = [SeedPairing::Matched, SeedPairing::Independent]
                .map(|design| of_recovery(&mut rng, seeds, correlation, design));
            println!("{correlation:11}  {seeds:5}  {paired:4.1} %   {unpaired:4.1} %");
        }
    }
    println!("\ninter-quartile mean: coverage of its interval");
    println!("conditions  correlation  seeds  coverage");
    for count in [1, 6, 20] {
        let correlations = if count == 1 { &CORRELATIONS[..1] } else { &CORRELATIONS[..] };
        for correlation in correlations {
            for seeds in [3, 5, 10, 20] {
                let covered = of_middle(&mut rng, count, seeds, *correlation);
                println!("{count:10}  {correlation:11}  {seeds:5}  {covered:6.1} %");
            }
        }
    }
    println!("\nmean rate: coverage of its interval");
    println!("rate  seeds  coverage");
    for rate in [0.5, 0.9, 0.99] {
        for seeds in [3, 5, 10, 20] {
            println!("{rate:4}  {seeds:5}  {:4.1} %", of_rate(&mut rng, seeds, rate));
        }
    }
}
