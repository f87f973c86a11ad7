//! Copying runs from one store to another, with all data that belongs to them.
//!
//! In: a source, which is only read (`source.rs`), and the target, open for writing (`target.rs`). Out: the
//! target with every run that ended in the source and verifies; with the job, session, results and weights of
//! each run; and with the experiments and their jobs. For each run, the result of copying it is returned
//! ([`RunCopy`]).
//!
//! - Copying inserts rows that the target lacks and changes no existing rows, so copying again inserts
//!   nothing. Inserted rows get row ids of the target.
//! - Results are verified as they are read: the rows that were hashed are the rows that are inserted
//!   (`results.rs`). A run that does not verify, or violates the schema, is omitted.
//! - The source may be damaged: unreadable data is omitted.
//! - The source is read as one snapshot. The target is written in batches of one transaction each, so that
//!   other writers get their turn. After a kill, copying again completes the rest.

mod copier;
mod results;
mod rows;
mod source;
mod sql;
mod target;
#[cfg(test)]
mod tests;

pub(super) use copier::{Copied, Copier, copy};
pub(super) use rows::{CopyBatch, Ended};
pub(super) use source::{CopySource, Extent};
pub use target::Origin;
pub(super) use target::{Origins, RunCopy};
