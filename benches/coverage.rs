//! Coverage of the bootstrap interval of the inter-quartile mean, for conditions with the same true
//! value and normally distributed seeds, whose values correlate between conditions: the table of
//! `docs/statistics.md`.

use std::f64::consts::TAU;

use jitai::analyse::{Sample, interquartile_mean};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Approximate number of conditions drawn per row of the table.
const DRAWN: usize = 20_000;

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let (radius, angle): (f64, f64) = (1.0 - rng.random::<f64>(), rng.random());
    (-2.0 * radius.ln()).sqrt() * (TAU * angle).cos()
}

fn coverage(
    rng: &mut ChaCha8Rng,
    conditions: usize,
    seeds: u64,
    correlation: f64,
    rounds: usize,
) -> f64 {
    let (shared, own) = (correlation.sqrt(), (1.0 - correlation).sqrt());
    let holds = |_: &usize| {
        let common: Vec<f64> = (0..seeds).map(|_| normal(rng)).collect();
        let arm = |_| {
            let values = common.iter().map(|common| shared * common + own * normal(rng));
            Sample::new((0..).zip(values), 0, 0).expect("no seed comes twice")
        };
        let arms: Vec<Sample> = (0..conditions).map(arm).collect();
        let mean = interquartile_mean(&arms.iter().collect::<Vec<_>>()).expect("values");
        mean.interval.expect("they vary").contains(0.0)
    };
    (0..rounds).filter(holds).count() as f64 / rounds as f64
}

fn main() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    println!("conditions  correlation  seeds  coverage");
    for conditions in [1, 6, 20] {
        let correlations: &[f64] = if conditions == 1 { &[0.0] } else { &[0.0, 0.3, 0.6, 1.0] };
        for correlation in correlations {
            for seeds in [3, 5, 10, 20] {
                let rounds = DRAWN / conditions;
                let covered = coverage(&mut rng, conditions, seeds, *correlation, rounds);
                let covered = 100.0 * covered;
                println!("{conditions:10}  {correlation:11}  {seeds:5}  {covered:6.1} %");
            }
        }
    }
}
