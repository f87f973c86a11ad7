//! # jitai
//!
//! Reinforcement-learning experiments for just-in-time adaptive interventions, from a declaration
//! to results that can be trusted.
//!
//! ```text
//! env, agent ──► manifest ──► plan ──► train ──► store ──► schedule ──► analyse ──► report
//!  what can       what an     what     one job,  one        who runs     pure        tables
//!  be simulated   author      should   from its  SQLite     it and       numbers     and
//!  and learned    declares    run      content   file       when                     figures
//! (kernel, rng,
//!  state, optimum)
//!                                   cli at the edge
//! ```
//!
//! ## Words
//!
//! - **manifest**: the TOML file an author writes; **experiment**: a named, expanded manifest in
//!   the store.
//! - **scenario**: what the agent observes (`P-H-D`); **agent**: a named algorithm with its
//!   hyper-parameters.
//! - **job**: one (environment, scenario, agent, seed, budget, evaluation): what *should* run.
//!   **job key**: hash of its canonical form and of the code's versions: its identity.
//! - **run**: one attempt at a job: what *did* happen. A job has at most one completed run.
//! - **episode**, **step**: as in the paper; an episode has at most `horizon` steps.
//! - **return**: undiscounted total reward of an episode, in steps walked.
//! - **metric**: a named number about a run; **learning curve**: a metric along training.
//!
//! ## Invariants
//!
//! - Data flows one way: each module imports only modules before it (`tests/imports.rs` holds
//!   the table). Training knows no database; only `store` has SQL; nothing imports `cli`.
//! - The results of a job depend on its content and the code alone. Every source of chance is a
//!   stream named in [`rng`]; there is no global generator. Every instruction set computes the same
//!   bits (see [`kernel`]); only jobs with `engine = "burn"` may end in others on another processor.
//! - A job that was stopped or killed goes on from a checkpoint of the same code to the same bits, or
//!   starts over; a checkpoint that is not to the byte what was written is never gone on with.
//! - A run's results are written in the transaction that completes it, or not at all.
//! - A completed run keeps the digest of its results, and an opened store has the schema that its
//!   migrations make: what has changed since can be found out.
//! - Statuses, outcomes and failures are enums that carry their evidence, matched exhaustively.

#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod agent;
pub mod analyse;
pub mod cli;
pub mod env;
pub mod kernel;
pub mod key;
pub mod kill_point;
pub mod manifest;
pub mod optimum;
pub mod plan;
pub mod record;
pub mod report;
pub mod rng;
pub mod schedule;
pub mod state;
pub mod store;
pub mod train;
