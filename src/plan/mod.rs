//! Planning: expands a manifest into jobs, and selects jobs by filters and shards.
//!
//! In: a validated [`crate::manifest::Manifest`]. Out: [`crate::job::PlannedJob`]s. The result depends
//! only on the manifest, not on the clock, the disk, random numbers or earlier runs.

mod earlier;
mod expand;
mod factors;
mod filter;
mod shard;
mod swept;

pub use earlier::{ChangedDefault, under_earlier_default};
pub use expand::{count, expand, jobs};
pub use factors::Factors;
pub use filter::{Filter, FilterError};
pub use shard::{Shard, ShardError};
pub use swept::{Swept, headlines};
