//! Planning: expands a manifest into jobs, and selects jobs by filters and shards.
//!
//! In: a validated [`crate::manifest::Manifest`]. Out: [`crate::job::PlannedJob`]s. The result depends
//! only on the manifest, not on the clock, the disk, random numbers or earlier runs. The one exception is the race of
//! a search, which also depends on the results of its jobs: a caller passes them in.

mod earlier;
mod expand;
mod factors;
mod filter;
mod race;
#[cfg(test)]
mod race_tests;
mod rung;
mod shard;
mod staged;
mod swept;

pub use earlier::{ChangedDefault, under_earlier_default};
pub use factors::Factors;
pub use filter::{Filter, FilterError};
pub use race::{
    Cost, Race, RaceJobs, RaceOutcome, Races, Reference, at_stage, race_jobs, race_line,
};
pub use rung::{Entrant, Fate, Lead, Rung};
pub use shard::{Shard, ShardError};
pub use staged::{Staged, count, expand, jobs};
pub use swept::{Swept, headlines};
