//! The library as a program uses it: manifests, jobs, simulations, training and the store.

mod after_study;
mod checkpoints;
mod decisions;
mod determinism;
mod environments;
mod fit;
mod imports;
mod learned;
mod manifests;
mod migrations;
mod models;
mod names;
mod optimum;
mod oralytics;
mod population;
mod remembering;
mod simulation;
mod step_count;
mod store;
