//! The jobs of a command: the jobs of its manifests that match filter and shard.

use std::collections::HashSet;
use std::sync::Arc;

use crate::job::{JobKey, PlannedJob, counted};
use crate::key::printable;
use crate::manifest::Manifest;
use crate::plan::{self, Filter, FilterError, Shard};
use crate::store::StoredArm;

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
            if let Some(ambiguous) = filter.ambiguous(jobs()) {
                return Err(ambiguous);
            }
            if !jobs().any(|planned| filter.meets(&planned)) {
                return Err(filter.why_none(jobs));
            }
            if let Some(unmet) = filter.unmet_alternative(jobs) {
                return Err(unmet);
            }
        }
        Ok(Selection { manifests, filter, part: None })
    }

    /// Restricts the selection to one shard of its jobs. Each rung of a race is divided by itself, because the next
    /// one begins when all of its jobs have ended.
    pub fn shard(self, shard: Shard) -> Self {
        let mut rungs: Vec<Vec<(JobKey, u64)>> = Vec::new();
        let mut known = HashSet::new();
        for manifest in self.manifests {
            for planned in self.jobs(manifest) {
                let key = planned.form.key();
                let rung = manifest.search.as_ref().map_or(0, |one| one.rung_of(planned.job.seed));
                if known.insert(key) {
                    rungs.resize(rungs.len().max(rung + 1), Vec::new());
                    rungs[rung].push((key, planned.job.work()));
                }
            }
        }
        let keys = rungs.into_iter().flat_map(|jobs| shard.keys(jobs)).collect();
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

    /// The filter.
    pub fn filter(&self) -> Option<&'a Filter> {
        self.filter
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

/// The jobs of an experiment that living commands with filters run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Filtered {
    /// The filters.
    pub filters: Vec<String>,
    /// The jobs that meet one of them.
    pub keys: HashSet<JobKey>,
}

impl Filtered {
    /// The jobs of these arms that meet one of the filters; `None` without filters, or if one cannot be read.
    pub fn of(filters: Vec<String>, arms: &[StoredArm]) -> Option<Filtered> {
        if filters.is_empty() {
            return None;
        }
        let parsed: Vec<Filter> =
            filters.iter().map(|text| text.parse().ok()).collect::<Option<_>>()?;
        let mut keys = HashSet::new();
        for arm in arms {
            let mut job = arm.job.clone();
            for (key, seed) in arm.keys.iter().zip(&arm.seeds) {
                job.seed = *seed;
                if parsed.iter().any(|filter| filter.meets(&(&*arm.agent, &job))) {
                    keys.insert(*key);
                }
            }
        }
        Some(Filtered { filters, keys })
    }

    /// The filters, and how many of `all` jobs meet them.
    pub fn described(&self, all: u64) -> String {
        let filters: Vec<String> =
            self.filters.iter().map(|text| format!("--filter {}", printable(text))).collect();
        format!("{} selects {} of {}", filters.join(", "), self.keys.len(), counted(all, "job"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::Score;
    use crate::manifest::parse;

    #[test]
    fn a_rung_is_divided_into_shards_by_itself() {
        let text = "format = 1\nname = \"t\"\nscenarios = [\"P-H-D\"]\nenvironment.sigma = 0.6\n\
                    search = { samples = 8, rungs = [1, 3], keep = 0.5, fresh = 2 }\n\
                    [[agent]]\nname = \"a\"\nalgorithm = \"reinforce\"\n\
                    learning_rate = { log_uniform = [1e-4, 1e-2] }\n";
        let manifests = [parse("t", text.as_bytes()).unwrap()];
        let first: HashSet<JobKey> = plan::jobs(&manifests[0])
            .filter(|planned| planned.job.seed == 1)
            .map(|planned| planned.form.key())
            .collect();
        let of = |key: &JobKey| if first.contains(key) { Score::Value(1.0) } else { Score::Open };
        let staged = plan::at_stage(&manifests, |keys, _| {
            Ok::<_, FilterError>(keys.iter().map(of).collect())
        });
        let staged = staged.unwrap();
        for number in ["1/2", "2/2"] {
            let selection = Selection::new(&staged, None).unwrap().shard(number.parse().unwrap());
            let jobs = || selection.jobs(&staged[0]);
            // Of 8 jobs of the first rung, and of 4 × 2 of the second.
            assert_eq!(jobs().filter(|planned| planned.job.seed == 1).count(), 4);
            assert_eq!(jobs().count(), 8);
        }
    }
}
