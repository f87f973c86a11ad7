//! Runs the programs in `examples/` unchanged.

#[cfg(feature = "burn")]
#[path = "../../examples/algorithm.rs"]
mod algorithm;
#[path = "../../examples/environment.rs"]
mod environment;
#[path = "../../examples/sweep.rs"]
mod sweep;

#[test]
fn a_sweep_from_rust_runs() {
    sweep::main().unwrap();
}

#[test]
fn an_own_environment_is_checked_and_learned_in() {
    environment::main().unwrap();
}

#[cfg(feature = "burn")]
#[test]
fn an_own_algorithm_is_registered_and_run() {
    algorithm::main().unwrap();
}
