//! Copying batches from a source to a target, in one transaction each.

use std::path::Path;

use rusqlite::Connection;

use crate::store::error::StoreError;
use crate::store::verify::CheckWeights;
use crate::store::writer::Store;

use super::rows::{CopiedRun, CopyBatch};
use super::source::{CopySource, Extent};
use super::target::{RunCopy, Target};

const ACTION: &str = "copy runs to the store";

/// The numbers of copied rows besides runs.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(in crate::store) struct Copied {
    /// The number of experiments inserted.
    pub(in crate::store) experiments: usize,
    /// The names of experiments with a different manifest in the target.
    pub(in crate::store) differing: Vec<String>,
    /// The number of jobs inserted.
    pub(in crate::store) jobs: usize,
    /// The number of rows of estimates added to runs that the target had.
    pub(in crate::store) estimates: usize,
    /// Whether part of the source's list of runs is unreadable.
    pub(in crate::store) runs_unreadable: bool,
}

/// Writes the batches of one source.
pub(in crate::store) struct Copier {
    target: Target,
    pub(in crate::store) copied: Copied,
}

impl Copier {
    /// The writer of batches from the store at `source`.
    pub(in crate::store) fn new(source: &Path) -> Self {
        Copier { target: Target::new(source), copied: Copied::default() }
    }

    /// Writes a batch. Calls `report` with the result for every run, once the result is on the disk.
    ///
    /// **Errors**: `to` cannot be written. Batches that were committed before remain.
    pub(in crate::store) fn write(
        &mut self,
        to: &mut Store,
        batch: &CopyBatch,
        mut report: impl FnMut(&CopiedRun, RunCopy),
    ) -> Result<(), StoreError> {
        let target = &mut self.target;
        match batch {
            CopyBatch::Experiments(rows, earlier) => {
                let copied = to.write(ACTION, |open| {
                    let copied = target.experiments(open, rows)?;
                    target.earlier_manifests(open, earlier)?;
                    Ok(copied)
                })?;
                self.copied.experiments += copied.inserted;
                self.copied.differing.extend(copied.differing);
            }
            CopyBatch::Jobs(rows) => {
                self.copied.jobs += to.write(ACTION, |open| Ok(target.jobs(open, rows)?))?;
            }
            CopyBatch::Memberships(rows) => {
                to.write(ACTION, |open| Ok(target.hold(open, rows)?))?
            }
            CopyBatch::Runs(runs) => {
                let became: Vec<RunCopy> = to.write_durably(ACTION, |open| {
                    runs.iter().map(|run| Ok(target.run(open, run)?)).collect()
                })?;
                self.copied.estimates = target.estimates;
                runs.iter().zip(became).for_each(|(run, became)| report(run, became));
            }
            CopyBatch::Conflicts(rows) => {
                to.write(ACTION, |open| Ok(target.conflicts(open, rows)?))?;
            }
            CopyBatch::Sessions(rows) => {
                to.write_durably(ACTION, |open| Ok(target.end_sessions(open, rows)?))?;
            }
        }
        Ok(())
    }
}

/// Copies everything that `to` lacks from `from`, which may be damaged. Calls `report` with the result for
/// every run that ended, once the result is on the disk.
///
/// **Errors**: `to` cannot be written. Batches that were committed before remain.
pub(in crate::store) fn copy(
    from: &Connection,
    to: &mut Store,
    check_weights: CheckWeights<'_>,
    mut report: impl FnMut(&CopiedRun, RunCopy),
) -> Result<Copied, StoreError> {
    // Every statement on the source sees the same snapshot.
    let snapshot = from
        .unchecked_transaction()
        .map_err(|source| StoreError::sqlite(&to.path, "read the source of a copy", source))?;
    let mut copier = Copier::new(Path::new(from.path().unwrap_or_default()));
    let source = CopySource::new(&snapshot, Extent::Everything(check_weights));
    let unreadable = source.read(|batch| copier.write(to, &batch, &mut report))?;
    Ok(Copied { runs_unreadable: unreadable, ..copier.copied })
}
