//! Stated errors and computing times of the optima of random environments.
//!
//! `ENVIRONMENTS` is the number of environments, `HORIZONS` is a comma-separated list of their
//! horizons, and `SEED` is the seed of the draws.

use std::env;
use std::num::NonZeroUsize;
use std::time::Instant;

use jitai::env::{Scenario, StepCount};
use jitai::optimum::optimum;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Error below which an optimum counts as exact, in steps walked.
const EXACT: f64 = 0.5;

/// A log-uniform number between `least` and `most`, rounded to two significant digits, as people write
/// them.
fn between(rng: &mut ChaCha8Rng, least: f64, most: f64) -> f64 {
    let drawn = (least.ln() + rng.random::<f64>() * (most / least).ln()).exp();
    format!("{drawn:.1e}").parse().expect("a number")
}

fn draw(rng: &mut ChaCha8Rng) -> (Scenario, StepCount) {
    let scenarios = ["P-H-D", "P-H-D", "L-H-D", "L-H-D", "C-H-D", "H-D"];
    let scenario = scenarios.choose(rng).expect("some").parse().expect("a scenario");
    let environment = StepCount {
        delta_h: between(rng, 0.01, 0.5),
        epsilon_h: between(rng, 0.01, 0.3),
        delta_d: between(rng, 0.01, 0.5),
        epsilon_d: between(rng, 0.05, 0.7),
        disengagement_threshold: between(rng, 0.5, 1.0),
        ..StepCount::paper(between(rng, 0.3, 2.0))
    };
    (scenario, environment)
}

fn main() {
    let given = |name: &str, usual: &str| env::var(name).unwrap_or_else(|_| usual.to_owned());
    let count: NonZeroUsize = given("ENVIRONMENTS", "40").parse().expect("ENVIRONMENTS is above 0");
    let count = count.get();
    let seed = given("SEED", "1").parse().expect("SEED is a whole number");
    println!(
        "horizon  scenario  sigma  delta_h  epsilon_h  delta_d  epsilon_d  threshold    optimum   \
         error  seconds"
    );
    for horizon in given("HORIZONS", "50,200").split(',') {
        let horizon = horizon.parse().expect("HORIZONS are numbers with commas between");
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let (mut errors, mut seconds) = (vec![], vec![]);
        for _ in 0..count {
            let (scenario, e) = draw(&mut rng);
            let e = StepCount { horizon, ..e };
            let begun = Instant::now();
            let found = optimum(&e, &scenario).expect("HORIZONS are short enough");
            seconds.push(begun.elapsed().as_secs_f64());
            errors.push(found.error);
            println!(
                "{horizon:7}  {:8}  {:5}  {:7}  {:9}  {:7}  {:9}  {:9}  {:9.2}  {:6.2}  {:7.2}",
                scenario.to_string(),
                e.sigma,
                e.delta_h,
                e.epsilon_h,
                e.delta_d,
                e.epsilon_d,
                e.disengagement_threshold,
                found.mean_return,
                found.error,
                seconds[seconds.len() - 1]
            );
        }
        seconds.sort_by(f64::total_cmp);
        errors.sort_by(f64::total_cmp);
        let exact = errors.partition_point(|error| *error <= EXACT);
        println!(
            "horizon {horizon}: {exact} of {count} within {EXACT}, the largest error {:.2}; \
             median {:.1} s, longest {:.1} s",
            errors[count - 1],
            seconds[count / 2],
            seconds[count - 1]
        );
    }
}
