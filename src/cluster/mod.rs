//! Submissions: jobs given to a cluster, and what comes back of them.
//!
//! In: manifests, a store and a profile. Out: an array of tasks that an engine runs, and from them
//! sealed parts in a shared folder, which a merge brings to the store.
//!
//! - The intent of a submission is on the disk before the engine is called. Whatever is killed, the
//!   next look finds the array by its name, or knows that there is none.
//! - A task works on frozen manifests and on a store in node-local scratch. What it hands in is
//!   copied to the shared folder, synced and renamed, and never changes.
//! - Two attempts at one chunk may run at the same time, when a node was taken for lost. Both hand in
//!   under names of their own, and jobs have the same bits in both.
//! - An engine that does not answer makes chunks unknown. Nothing is concluded from silence.
//! - An engine is four calls (`engine.rs`). It knows neither jobs nor folders.

mod attempt;
mod clock;
mod collect;
mod duration;
mod engine;
mod engines;
mod error;
mod folder;
mod pack;
mod profile;
#[cfg(test)]
mod profile_tests;
mod sbatch;
mod script;
mod slurm;
mod submit;
#[cfg(test)]
mod submit_tests;
mod survey;
mod task;

pub use collect::collect;
pub use engine::{Alive, Engine, EngineError, EngineKind, Limits, Phase};
pub use engines::connect;
pub use error::ClusterError;
pub use folder::{Stop, Submission, Submissions};
pub use profile::{Profile, schema};
pub use script::RUN_AGAIN;
pub use submit::{Cluster, Draft, Filled, Look, Request};
pub use survey::{Chunk, ChunkCounts, ChunkState, Loss, Survey};
pub use task::{Assignment, TaskEnd, run_chunk};
