//! Suites of minutes. Each has a target in the Makefile, which chooses it by the name of its module.

mod analysis;
mod kill;
mod kill_merge;
mod learning;
mod slurm;
#[path = "../cli/support.rs"]
#[allow(dead_code, reason = "the tests of the command line use the rest")]
mod support;
mod times;
#[cfg(not(feature = "parquet"))]
mod without_parquet;
