//! Submissions on a real Slurm cluster, on loopback: `make test-slurm`. Each test has its own cluster,
//! so that all tests may run at the same time.

mod cluster;
mod lost;
mod stopped;
mod submitting;
mod trouble;
