//! Planning: expands a manifest into jobs and gives each job its identity.
//!
//! In: a validated [`crate::manifest::Manifest`]. Out: [`Job`]s with their [`JobKey`]s. The result depends
//! only on the manifest, not on the clock, the disk, random numbers or earlier runs.

mod described;
mod earlier;
mod expand;
mod factors;
mod filter;
mod implied;
mod job;
mod shard;
mod swept;

pub use described::counted;
pub use earlier::{ChangedDefault, under_earlier_default};
pub use expand::{PlannedJob, count, expand, jobs};
pub use factors::Factors;
pub use filter::{Filter, FilterError};
pub use implied::{ImpliedParameter, implied_parameters};
pub use job::{CanonicalForm, Job, JobError, JobKey, Scalar, Versions, without_seed};
pub use shard::{Shard, ShardError};
pub use swept::Swept;
