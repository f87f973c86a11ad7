//! How exact the optima of environments drawn at random are, and how long they take. Those that may
//! be farther off than half a step are listed, and compared with what a search of several times the
//! usual length finds.
//!
//! `ENVIRONMENTS` and `HORIZONS` (with commas between) say how many are drawn and what for, `SEED`
//! says which, and `TIMES` says how many times the usual length is.

use std::env;
use std::num::{NonZeroU32, NonZeroUsize};
use std::thread;
use std::time::Instant;

use jitai::env::{Environment, Scenario};
use jitai::optimum::{Effort, optimum};
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// An error that is small enough, in steps walked.
const EXACT: f64 = 0.5;

/// A number between two whose logarithm is uniform, of two digits, as people write them.
fn between(rng: &mut ChaCha8Rng, least: f64, most: f64) -> f64 {
    let drawn = (least.ln() + rng.random::<f64>() * (most / least).ln()).exp();
    format!("{drawn:.1e}").parse().expect("a number")
}

fn draw(rng: &mut ChaCha8Rng) -> (Scenario, Environment) {
    let scenarios = ["P-H-D", "P-H-D", "L-H-D", "L-H-D", "C-H-D", "H-D"];
    let scenario = scenarios.choose(rng).expect("some").parse().expect("a scenario");
    let environment = Environment {
        delta_h: between(rng, 0.01, 0.5),
        epsilon_h: between(rng, 0.01, 0.3),
        delta_d: between(rng, 0.01, 0.5),
        epsilon_d: between(rng, 0.05, 0.7),
        disengagement_threshold: between(rng, 0.5, 1.0),
        ..Environment::paper(between(rng, 0.3, 2.0))
    };
    (scenario, environment)
}

fn main() {
    let given = |name: &str, usual: &str| env::var(name).unwrap_or_else(|_| usual.to_owned());
    let count: NonZeroUsize = given("ENVIRONMENTS", "40").parse().expect("ENVIRONMENTS is above 0");
    let count = count.get();
    let seed = given("SEED", "1").parse().expect("SEED is a whole number");
    let times: NonZeroU32 = given("TIMES", "10").parse().expect("TIMES is above 0");
    let usual = Effort::usual(thread::available_parallelism().unwrap_or(NonZeroUsize::MIN));
    println!(
        "scenario  sigma  delta_h  epsilon_h  delta_d  epsilon_d  threshold    optimum   error    \
         {times} times  error"
    );
    for horizon in given("HORIZONS", "50,1000,10000").split(',') {
        let horizon = horizon.parse().expect("HORIZONS are numbers with commas between");
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let (mut errors, mut seconds, mut apart) = (vec![], vec![], 0.0);
        for _ in 0..count {
            let (scenario, e) = draw(&mut rng);
            let e = Environment { horizon, ..e };
            let begun = Instant::now();
            let found = optimum(&e, &scenario, usual).expect("a scenario with H and D");
            seconds.push(begun.elapsed().as_secs_f64());
            errors.push(found.error);
            if found.error > EXACT {
                let longer = Effort { times, ..usual };
                let better = optimum(&e, &scenario, longer).expect("as before");
                apart = f64::max(apart, (better.mean_return - found.mean_return).abs());
                println!(
                    "{:8}  {:5}  {:7}  {:9}  {:7}  {:9}  {:9}  {:9.1}  {:6.2}  {:9.1}  {:5.2}",
                    scenario.to_string(),
                    e.sigma,
                    e.delta_h,
                    e.epsilon_h,
                    e.delta_d,
                    e.epsilon_d,
                    e.disengagement_threshold,
                    found.mean_return,
                    found.error,
                    better.mean_return,
                    better.error
                );
            }
        }
        seconds.sort_by(f64::total_cmp);
        errors.sort_by(f64::total_cmp);
        let exact = errors.partition_point(|error| *error <= EXACT);
        let others = match exact == count {
            true => String::new(),
            false => {
                format!(" the others {apart:.2} at most from what {times} times as long finds;")
            }
        };
        println!(
            "horizon {horizon}: {exact} of {count} within {EXACT}, the largest error {:.2};{others} \
             median {:.1} s, longest {:.1} s",
            errors[count - 1],
            seconds[count / 2],
            seconds[count - 1]
        );
    }
}
