//! Submissions on a real Slurm cluster, on loopback: `make test-slurm`. Each test has its own cluster,
//! so that all tests may run at the same time.

#[path = "../cli/support.rs"]
#[allow(dead_code, reason = "the tests of the command line use the rest")]
mod support;

mod cluster;
mod lost;
mod stopped;
mod submitting;
mod trouble;
