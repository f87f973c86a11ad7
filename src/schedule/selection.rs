//! The jobs of a command: the jobs of its manifests, as far as their races have come, that match filter and shard.

use std::collections::HashSet;
use std::sync::Arc;

use super::race::at_stage;
use crate::job::{JobKey, PlannedJob, counted};
use crate::key::printable;
use crate::manifest::Manifest;
use crate::plan::{self, Filter, FilterError, Shard, Staged};
use crate::store::{Reader, StoreError, StoredArm};

/// A selection of jobs from at least one manifest.
#[derive(Clone)]
pub struct Selection<'a> {
    manifests: &'a [Manifest],
    staged: Vec<Staged<'a>>,
    filter: Option<&'a Filter>,
    shard: Option<Shard>,
    part: Option<Arc<HashSet<JobKey>>>,
}

impl<'a> Selection<'a> {
    /// The jobs of the manifests that match the filter; of a search, all that its races may come to.
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
        let staged = manifests.iter().map(Staged::whole).collect();
        Ok(Selection { manifests, staged, filter, shard: None, part: None })
    }

    /// The selection at the stage that the races of its manifests have come to in the store; `reader` is `None` if
    /// there is no store yet.
    ///
    /// **Errors**: the store fails.
    pub fn at_stage(&self, reader: Option<&Reader>) -> Result<Selection<'a>, StoreError> {
        let staged = at_stage(self.manifests, reader)?;
        let selection = Selection { staged, ..self.clone() };
        Ok(match self.shard {
            Some(shard) => Selection { part: None, ..selection }.shard(shard),
            None => selection,
        })
    }

    /// Whether both are at the same stage of all races.
    pub fn is_at_stage_of(&self, other: &Selection<'_>) -> bool {
        self.staged == other.staged
    }

    /// Restricts the selection to one shard of its jobs. Each rung of a race is divided by itself, because the next
    /// one begins when all of its jobs have ended.
    pub fn shard(self, shard: Shard) -> Self {
        let mut rungs: Vec<Vec<(JobKey, u64)>> = Vec::new();
        let mut known = HashSet::new();
        for (index, manifest) in self.manifests.iter().enumerate() {
            for planned in self.jobs(index) {
                let key = planned.form.key();
                let rung = manifest.search.as_ref().map_or(0, |one| one.rung_of(planned.job.seed));
                if known.insert(key) {
                    rungs.resize(rungs.len().max(rung + 1), Vec::new());
                    rungs[rung].push((key, planned.job.work()));
                }
            }
        }
        let keys = rungs.into_iter().flat_map(|jobs| shard.keys(jobs)).collect();
        Selection { shard: Some(shard), ..self.part(keys) }
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

    /// The manifests, each at the stage of the selection.
    pub fn staged(&self) -> &[Staged<'a>] {
        &self.staged
    }

    /// Whether a filter, shard or part restricts the selection.
    pub fn is_filtered(&self) -> bool {
        self.filter.is_some() || self.part.is_some()
    }

    /// The selected jobs of the manifest at this index, one at a time. Agents with equal content repeat their jobs.
    pub fn jobs(&self, manifest: usize) -> impl Iterator<Item = PlannedJob> + use<'a> {
        let (filter, part) = (self.filter, self.part.clone());
        self.staged[manifest].jobs().filter(move |job| {
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
        let score =
            |key: &JobKey| if first.contains(key) { Score::Value(1.0) } else { Score::Open };
        let staged = plan::at_stage(&manifests, |keys, _| {
            Ok::<_, FilterError>(keys.iter().map(score).collect())
        });
        let whole = Selection::new(&manifests, None).unwrap();
        let staged = Selection { staged: staged.unwrap(), ..whole };
        for number in ["1/2", "2/2"] {
            let selection = staged.clone().shard(number.parse().unwrap());
            let jobs = || selection.jobs(0);
            // Of 8 jobs of the first rung, and of 4 × 2 of the second.
            assert_eq!(jobs().filter(|planned| planned.job.seed == 1).count(), 4);
            assert_eq!(jobs().count(), 8);
        }
    }
}
