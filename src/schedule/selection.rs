//! The jobs of a command: the jobs of its manifests that match filter and shard.

use std::collections::HashSet;
use std::sync::Arc;

use crate::job::{JobKey, PlannedJob};
use crate::manifest::Manifest;
use crate::plan::{self, Filter, FilterError, Shard};

/// A selection of jobs from at least one manifest.
pub struct Selection<'a> {
    manifests: &'a [Manifest],
    filter: Option<&'a Filter>,
    part: Option<Arc<HashSet<JobKey>>>,
}

impl<'a> Selection<'a> {
    /// The jobs of the manifests that match the filter.
    ///
    /// **Errors**: no job matches, or one of the filter's values occurs in no job; the message names the
    /// condition.
    pub fn new(manifests: &'a [Manifest], filter: Option<&'a Filter>) -> Result<Self, FilterError> {
        if let Some(filter) = filter {
            let jobs = || manifests.iter().flat_map(plan::jobs);
            if !jobs().any(|planned| filter.meets(&planned)) {
                return Err(filter.why_none(jobs));
            }
            if let Some(unmet) = filter.unmet_alternative(jobs) {
                return Err(unmet);
            }
        }
        Ok(Selection { manifests, filter, part: None })
    }

    /// Restricts the selection to one shard of its jobs.
    pub fn shard(self, shard: Shard) -> Self {
        let jobs = self.manifests.iter().flat_map(|manifest| self.jobs(manifest));
        let keys = shard.keys(jobs.map(|planned| (planned.form.key(), planned.job.work())));
        self.part(keys)
    }

    /// Restricts the selection to the jobs with these keys.
    pub fn part(self, keys: HashSet<JobKey>) -> Self {
        Selection { part: Some(Arc::new(keys)), ..self }
    }

    /// The keys to which [`Selection::shard`] or [`Selection::part`] restricted the selection.
    pub fn keys(&self) -> Option<&HashSet<JobKey>> {
        self.part.as_deref()
    }

    /// The manifests.
    pub fn manifests(&self) -> &'a [Manifest] {
        self.manifests
    }

    /// Whether a filter, shard or part restricts the selection.
    pub fn is_filtered(&self) -> bool {
        self.filter.is_some() || self.part.is_some()
    }

    /// The selected jobs of one manifest, one at a time. Agents with equal content repeat their jobs.
    pub fn jobs(&self, manifest: &'a Manifest) -> impl Iterator<Item = PlannedJob> + use<'a> {
        let (filter, part) = (self.filter, self.part.clone());
        plan::jobs(manifest).filter(move |job| {
            filter.is_none_or(|filter| filter.meets(job))
                && part.as_ref().is_none_or(|keys| keys.contains(&job.form.key()))
        })
    }
}
