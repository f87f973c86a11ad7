//! Stored jobs grouped by their content without the seed.

use std::collections::HashMap;

use crate::job::{Job, without_seed};

/// A value for each group of jobs that differ only in their seeds. Only one job per group is parsed, so
/// grouping many jobs is cheap.
#[derive(Debug, Default)]
pub(super) struct SeedGroups<T> {
    /// By canonical text without the seed; `None` for a job that this release cannot read.
    indices: HashMap<String, Option<usize>>,
    groups: Vec<(Job, T)>,
}

impl<T: Default> SeedGroups<T> {
    /// The value of the group that a job belongs to; `None` if this release cannot read the job.
    pub(super) fn of(&mut self, canonical: &str) -> Option<&mut T> {
        let stem = without_seed(canonical);
        let index = match self.indices.get(&*stem) {
            Some(index) => *index,
            None => {
                let index = Job::from_canonical(canonical).ok().map(|job| {
                    self.groups.push((job, T::default()));
                    self.groups.len() - 1
                });
                self.indices.insert(stem.into_owned(), index);
                index
            }
        };
        index.map(|index| &mut self.groups[index].1)
    }

    /// One job of each group with the group's value, in the order in which the groups first occurred.
    pub(super) fn into_iter(self) -> impl Iterator<Item = (Job, T)> {
        self.groups.into_iter()
    }
}
