//! The jobs that a command is about: those of its manifests that a filter lets through.

use std::collections::hash_map::Entry;
use std::collections::{HashMap, HashSet};
use std::sync::Arc;
use std::time::Duration;

use super::Queued;
use crate::manifest::Manifest;
use crate::plan::{self, Filter, FilterError, JobKey, PlannedJob, Shard};

/// Jobs of manifests, at least one.
pub struct Selection<'a> {
    manifests: &'a [Manifest],
    filter: Option<&'a Filter>,
    part: Option<Arc<HashSet<JobKey>>>,
}

impl<'a> Selection<'a> {
    /// The jobs of the manifests that meet the filter.
    ///
    /// **Errors**: no job does, or no job has one of the values; the message says which condition
    /// is at fault.
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

    /// Of these jobs only those in a shard of them.
    pub fn shard(self, shard: Shard) -> Self {
        let jobs = self.manifests.iter().flat_map(|manifest| self.jobs(manifest));
        let keys = shard.keys(jobs.map(|planned| (planned.form.key(), planned.job.work())));
        self.part(keys)
    }

    /// Of these jobs only those with these keys.
    pub fn part(self, keys: HashSet<JobKey>) -> Self {
        Selection { part: Some(Arc::new(keys)), ..self }
    }

    /// The keys that [`Selection::shard`] or [`Selection::part`] confine the jobs to.
    pub fn keys(&self) -> Option<&HashSet<JobKey>> {
        self.part.as_deref()
    }

    /// The manifests.
    pub fn manifests(&self) -> &'a [Manifest] {
        self.manifests
    }

    /// Whether some jobs may have been left out.
    pub fn is_filtered(&self) -> bool {
        self.filter.is_some() || self.part.is_some()
    }

    /// The jobs of one of the manifests, one at a time; agents of equal content repeat theirs.
    pub fn jobs(&self, manifest: &'a Manifest) -> impl Iterator<Item = PlannedJob> + use<'a> {
        let (filter, part) = (self.filter, self.part.clone());
        plan::jobs(manifest).filter(move |job| {
            filter.is_none_or(|filter| filter.meets(job))
                && part.as_ref().is_none_or(|keys| keys.contains(&job.form.key()))
        })
    }

    /// The jobs of all the manifests, none twice. Of several time limits of a job, that of the most
    /// patient manifest holds.
    pub fn queue(&self) -> Vec<Queued> {
        let mut queue: Vec<Queued> = Vec::new();
        let mut places = HashMap::new();
        for manifest in self.manifests {
            let time_limit = manifest.time_limit_seconds.map(Duration::from_secs);
            for PlannedJob { agent, job, form } in self.jobs(manifest) {
                let key = form.key();
                match places.entry(key) {
                    Entry::Occupied(place) => {
                        let found: &mut Queued = &mut queue[*place.get()];
                        found.time_limit = longer(found.time_limit, time_limit);
                    }
                    Entry::Vacant(place) => {
                        place.insert(queue.len());
                        queue.push(Queued { key, agent: agent.to_string(), job, time_limit });
                    }
                }
            }
        }
        queue
    }
}

/// The longer of two limits; none is the longest.
fn longer(one: Option<Duration>, other: Option<Duration>) -> Option<Duration> {
    one.zip(other).map(|(one, other)| one.max(other))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_job_of_two_manifests_has_the_time_that_the_more_patient_gives_it() {
        let text = |limit: &str| {
            format!(
                "format = 1\nname = \"sweep\"\n{limit}\nscenarios = [\"C\"]\nseeds = 1\n\
                 environment.sigma = 1\n[[agent]]\nname = \"never\"\nalgorithm = \"rule\"\n\
                 rule = \"never\"\n"
            )
        };
        let five = ["time_limit_seconds = 5", "time_limit_seconds = 2"];
        for (limits, expected) in [(five, Some(Duration::from_secs(5))), ([five[0], ""], None)] {
            let parsed =
                limits.map(|limit| crate::manifest::parse("m", text(limit).as_bytes()).unwrap());
            let queue = Selection::new(&parsed, None).unwrap().queue();
            let found: Vec<_> = queue.iter().map(|queued| queued.time_limit).collect();
            assert_eq!(found, [expected]);
        }
    }
}
