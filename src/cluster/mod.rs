//! Submissions: jobs submitted to a cluster, and the collection of their results.
//!
//! In: manifests, a store and a profile. Out: an array of tasks that an engine runs. The tasks write
//! sealed parts to a shared folder, and a merge copies the parts into the store.
//!
//! - The intent of a submission is on the disk before the engine is called. After a kill at any point,
//!   the next command finds the array by its name, or finds that the array does not exist.
//! - A task works on frozen manifests and on a store in node-local scratch. Every part that it hands in
//!   is copied to the shared folder, synced and renamed, and never changes.
//! - If a node was wrongly considered lost, two attempts at one chunk may run at the same time. They
//!   hand in parts under different names, with bit-identical results.
//! - While the engine does not answer, the state of unfinished chunks is unknown, and no conclusion is
//!   drawn.
//! - An engine consists of four calls (`engine.rs`) and uses neither jobs nor folders.

mod attempt;
mod clock;
mod collect;
mod engine;
mod engines;
mod error;
mod folder;
mod order;
mod pack;
mod profile;
#[cfg(test)]
mod profile_tests;
mod slurm;
mod submit;
#[cfg(test)]
mod submit_tests;
mod survey;
mod task;

pub use collect::{collect, forget, has_new_parts};
pub use engine::{Alive, Engine, EngineError, Limits, TaskPhase};
pub use engines::{EngineKind, connect};
pub use error::ClusterError;
pub use folder::{HandedIn, Part, Stop, Submission, Submissions};
pub use order::RUN_AGAIN;
pub use profile::{Profile, schema};
pub use submit::{Cluster, ClusterLook, Filled, Request, SubmissionDraft};
pub use survey::{Chunk, ChunkCounts, ChunkState, ChunkSurvey, Loss};
pub use task::{TaskEnd, TaskOrder, run_chunk};
