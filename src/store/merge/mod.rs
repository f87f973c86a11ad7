//! Merging stores: copies the completed and failed runs of many stores into one.
//!
//! In: paths of stores, which are only read, and the target, open for writing. Out: [`Merged`]. The module
//! `copy` decides what is copied and what happens to each run. This module opens the sources (`snapshot.rs`)
//! and reads them on several threads, while the caller's thread writes.
//!
//! - Sources are written in the order of their paths, so that a merge that was killed and repeated gives the
//!   same store as an uninterrupted one.
//! - [`Sources::open`] rejects a source that is not a store before the target is opened. A damaged source is
//!   reported, and the others are merged.

mod listed;
mod merged;
mod snapshot;
mod threads;

pub use listed::stores_of;
pub use merged::{Conflict, Damage, MergeProgress, Merged, OtherManifest};
pub use threads::{Sources, merge};
