//! What should run: expands a manifest into jobs and gives each its identity.
//!
//! In: a validated [`crate::manifest::Manifest`]. Out: [`Job`]s with their [`JobKey`]s. Pure: it
//! knows no clock, no disk, no random numbers, and nothing of what has run already.

mod described;
mod expand;
mod filter;
mod implied;
mod job;
mod shard;
mod swept;

pub use expand::{PlannedJob, count, expand, jobs};
pub use filter::{Filter, FilterError};
pub use implied::{ImpliedParameter, implied_parameters};
pub use job::{CanonicalForm, Job, JobError, JobKey, Scalar, Versions};
pub use shard::{Shard, ShardError};
pub use swept::Swept;
