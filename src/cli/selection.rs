//! The jobs that a command is about: those of its manifests that a filter lets through.

use std::collections::HashSet;

use crate::cli::Error;
use crate::cli::filter::Filter;
use crate::manifest::Manifest;
use crate::plan::{self, PlannedJob};
use crate::schedule::Queued;

/// Jobs of manifests, at least one.
pub(super) struct Selection<'a> {
    manifests: &'a [Manifest],
    filter: Option<&'a Filter>,
}

impl<'a> Selection<'a> {
    /// The jobs of the manifests that meet the filter.
    ///
    /// **Errors**: no job does, or no job has one of the values; the message says which condition
    /// is at fault.
    pub(super) fn new(
        manifests: &'a [Manifest],
        filter: Option<&'a Filter>,
    ) -> Result<Self, Error> {
        if let Some(filter) = filter {
            let jobs = || manifests.iter().flat_map(plan::jobs);
            if !jobs().any(|planned| filter.meets(&planned)) {
                return Err(Error::Usage(filter.why_none(jobs).to_string()));
            }
            if let Some(unmet) = filter.unmet_alternative(jobs) {
                return Err(Error::Usage(unmet.to_string()));
            }
        }
        Ok(Selection { manifests, filter })
    }

    /// The manifests.
    pub(super) fn manifests(&self) -> &'a [Manifest] {
        self.manifests
    }

    /// The jobs of one of the manifests, one at a time; agents of equal content repeat theirs.
    pub(super) fn jobs(&self, manifest: &'a Manifest) -> impl Iterator<Item = PlannedJob> + 'a {
        let filter = self.filter;
        plan::jobs(manifest).filter(move |job| filter.is_none_or(|filter| filter.meets(job)))
    }

    /// The jobs of all the manifests, none twice.
    pub(super) fn queue(&self) -> Vec<Queued> {
        let mut seen = HashSet::new();
        let jobs = self.manifests.iter().flat_map(|manifest| self.jobs(manifest));
        let queued = jobs.filter_map(|PlannedJob { agent, job, form }| {
            let key = form.key();
            seen.insert(key).then(|| Queued { key, agent: agent.to_string(), job })
        });
        queued.collect()
    }
}
