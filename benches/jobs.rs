//! Whole jobs in the published settings, P-H-D at sigma 0.6: training and 1000 test episodes.

use jitai::manifest::{Agent, DuelingDqn, Engine, Environment, Evaluation, Reinforce};
use jitai::plan::Job;
use jitai::record::Outcome;
use jitai::train::{self, Unwatched};

fn main() {
    divan::main();
}

fn run(agent: Agent, time_one_hot: bool) {
    let job = Job {
        environment: Environment { time_one_hot, ..Environment::paper(0.6) },
        scenario: "P-H-D".parse().unwrap(),
        agent,
        evaluation: Evaluation { curve_stride: 500, ..Evaluation::default() },
        seed: 1,
    };
    assert!(matches!(train::run(&job, &Unwatched), Outcome::Completed(_)));
}

#[divan::bench(sample_count = 5, sample_size = 1, args = [false, true])]
fn dueling_dqn(time_one_hot: bool) {
    run(Agent::DuelingDqn(DuelingDqn::default()), time_one_hot);
}

#[divan::bench(sample_count = 5, sample_size = 1, args = [false, true])]
fn reinforce(time_one_hot: bool) {
    run(Agent::Reinforce(Reinforce::default()), time_one_hot);
}

/// 15,000 updates of 50 trajectories.
#[divan::bench(sample_count = 5, sample_size = 1, args = [false, true])]
fn reinforce_of_50(time_one_hot: bool) {
    let reinforce =
        Reinforce { episodes: 750_000, trajectories_per_update: 50, ..Reinforce::default() };
    run(Agent::Reinforce(reinforce), time_one_hot);
}

/// A tenth of the budget, by Burn and by the kernels, to compare.
#[divan::bench(sample_count = 5, sample_size = 1, args = [Engine::Fused, Engine::Burn])]
fn a_tenth_of_dueling_dqn(engine: Engine) {
    run(Agent::DuelingDqn(DuelingDqn { episodes: 100, engine, ..DuelingDqn::default() }), false);
}

/// A tenth of the budget, by Burn and by the kernels, to compare.
#[divan::bench(sample_count = 5, sample_size = 1, args = [Engine::Fused, Engine::Burn])]
fn a_tenth_of_reinforce(engine: Engine) {
    run(Agent::Reinforce(Reinforce { episodes: 1500, engine, ..Reinforce::default() }), false);
}
