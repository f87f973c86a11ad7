//! The agents learn as well as an independent port of the published code.
//!
//! Reference values: the port's mean ± sd over ten seeds, and the published means of three seeds, for
//! P-H-D and L-H-D at sigma 0.6. Takes minutes on two cores; run by `make test-slow`.

use std::sync::Mutex;
use std::thread;

use jitai::agent::{Agent, DuelingDqn, Engine, Reinforce};
use jitai::analyse;
use jitai::env::{Scenario, StepCount};
use jitai::job::Evaluation;
use jitai::job::Job;
use jitai::job::Outcome;
use jitai::train::{self, Uncontrolled};

const SEEDS: std::ops::RangeInclusive<u64> = 1..=10;

/// The mean test return of each seed, in seed order, trained on two threads.
fn returns(agent: &Agent, scenario: &str, sigma: f64) -> Vec<f64> {
    let scenario: Scenario = scenario.parse().unwrap();
    let seeds = Mutex::new(SEEDS);
    let returns = Mutex::new(Vec::new());
    thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                loop {
                    let Some(seed) = seeds.lock().unwrap().next() else { break };
                    let job = Job {
                        environment: StepCount::paper(sigma).into(),
                        scenario: scenario.clone(),
                        agent: agent.clone(),
                        evaluation: Evaluation::default(),
                        trial: None,
                        seed,
                    };
                    let mean = mean_return(&job);
                    returns.lock().unwrap().push((seed, mean));
                }
            });
        }
    });
    let mut returns = returns.into_inner().unwrap();
    returns.sort_by_key(|(seed, _)| *seed);
    returns.into_iter().map(|(_, mean)| mean).collect()
}

fn mean_return(job: &Job) -> f64 {
    match train::run(job, &Uncontrolled) {
        Outcome::Completed(results) => {
            results.metrics.iter().find(|m| m.name == "mean_return").unwrap().value
        }
        other => panic!("seed {} did not complete: {other:?}", job.seed),
    }
}

fn mean_and_sd(values: &[f64]) -> (f64, f64) {
    let (mean, sd) = analyse::mean_and_sd(values);
    (mean, sd.unwrap())
}

/// Compares our ten seeds with the port's ten seeds, in joint standard errors.
fn agrees(agent: &Agent, scenario: &str, port: (f64, f64), published: f64) {
    let returns = returns(agent, scenario, 0.6);
    let (mean, sd) = mean_and_sd(&returns);
    let standard_error = ((sd * sd + port.1 * port.1) / 10.0).sqrt();
    let distance = (mean - port.0) / standard_error;
    println!(
        "{scenario}: {mean:.0} ± {sd:.0}, port {} ± {}, published {published}, \
         {distance:+.2} joint standard errors; seeds {returns:.0?}",
        port.0, port.1
    );
    assert!(distance.abs() < 3.0, "{scenario}: {distance:+.2} joint standard errors from the port");
}

#[test]
fn dueling_dqn_learns_p_h_d_as_the_port_does() {
    agrees(&Agent::of(&DuelingDqn::default()), "P-H-D", (2583.0, 96.0), 2630.0);
}

#[test]
fn dueling_dqn_learns_l_h_d_as_the_port_does() {
    agrees(&Agent::of(&DuelingDqn::default()), "L-H-D", (1834.0, 143.0), 1871.0);
}

#[test]
fn reinforce_learns_p_h_d_as_the_port_does() {
    agrees(&Agent::of(&Reinforce::default()), "P-H-D", (2382.0, 70.0), 2337.0);
}

#[test]
fn reinforce_learns_l_h_d_as_the_port_does() {
    agrees(&Agent::of(&Reinforce::default()), "L-H-D", (1769.0, 77.0), 1827.0);
}

/// Compares two ways to train the same agent, in joint standard errors.
#[cfg(feature = "burn")]
fn agree(fused: &Agent, burn: &Agent) {
    let [fused, burn] = [fused, burn].map(|agent| returns(agent, "P-H-D", 0.6));
    let ((a, sd_a), (b, sd_b)) = (mean_and_sd(&fused), mean_and_sd(&burn));
    let distance = (a - b) / ((sd_a * sd_a + sd_b * sd_b) / 10.0).sqrt();
    println!(
        "P-H-D: fused {a:.0} ± {sd_a:.0}, burn {b:.0} ± {sd_b:.0}, {distance:+.2} joint standard \
         errors; seeds {fused:.0?} and {burn:.0?}"
    );
    assert!(distance.abs() < 2.0, "{distance:+.2} joint standard errors between the engines");
}

#[cfg(feature = "burn")]
#[test]
fn both_engines_teach_the_dueling_dqn_equally_well() {
    let burn = DuelingDqn { engine: Engine::Burn, ..DuelingDqn::default() };
    agree(&Agent::of(&DuelingDqn::default()), &Agent::of(&burn));
}

#[cfg(feature = "burn")]
#[test]
fn both_engines_teach_reinforce_equally_well() {
    let burn = Reinforce { engine: Engine::Burn, ..Reinforce::default() };
    agree(&Agent::of(&Reinforce::default()), &Agent::of(&burn));
}

#[test]
fn dueling_dqn_settles_on_1533_in_l_t_without_noise() {
    let returns = returns(&Agent::of(&DuelingDqn::default()), "L-T", 0.0);
    let near = returns.iter().filter(|mean| (*mean - 1533.0).abs() <= 10.0).count();
    println!("L-T: {near} of {} seeds within 10 of 1533; {returns:.0?}", returns.len());
    assert!(near * 2 > returns.len(), "{near} of {} seeds within 10 of 1533", returns.len());
}
