//! Bringing stores together: the completed and failed runs of many into one.
//!
//! In: paths of stores, which are only read, and the target, open for writing. Out: [`Merged`]. What
//! is copied, and what becomes of each run, is the affair of `copy`; this module opens the sources
//! (`snapshot.rs`) and reads them on several threads, while the caller's thread writes.
//!
//! - Sources are written in the order of their paths, so that a merge that was killed and repeated
//!   leaves the store of one that was not.
//! - What is wrong with a source as a whole is said before anything is written, damage excepted: a
//!   damaged source is named, and the others are merged.

mod listed;
mod merged;
mod snapshot;
mod threads;

pub use listed::stores_of;
pub use merged::{Conflict, Damage, MergeProgress, Merged, OtherManifest};
pub use threads::merge;
