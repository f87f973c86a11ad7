//! Copying runs from one store to another, with all that belongs to them.
//!
//! In: a source, which is only read (`source.rs`), and the target, open for writing (`target.rs`).
//! Out: the target with every run that ended in the source and verifies, its job, session, results
//! and weights, and the experiments with their jobs; and for each run what became of it
//! ([`RunCopy`]).
//!
//! - Copying inserts what the target lacks and changes nothing that it has, so copying again inserts
//!   nothing. Row ids are those of the target.
//! - Results are verified as they are read: the rows that were hashed are the rows that are inserted
//!   (`results.rs`). A run that does not verify, or breaks a rule of the schema, is left out.
//! - The source may be damaged: what cannot be read is left out.
//! - The source is read as one snapshot. The target is written in batches of one transaction each,
//!   so that other writers get their turn; after a kill, copying again completes the rest.

mod results;
mod rows;
mod source;
mod sql;
mod target;
#[cfg(test)]
mod tests;
mod whole;

pub(super) use rows::{Batch, Ended};
pub(super) use source::{Extent, Source};
pub use target::Origin;
pub(super) use target::{Origins, RunCopy};
pub(super) use whole::{Copied, Copier, copy};
