//! The jobs of a command: the jobs of its manifests that match filter and shard.

use std::collections::hash_map::Entry;
use std::collections::{HashMap, HashSet};
use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use super::Queued;
use crate::job::{JobKey, PlannedJob};
use crate::manifest::Manifest;
use crate::plan::{self, Filter, FilterError, Shard};
use crate::store::JobStates;

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

    /// The distinct jobs of all manifests. A job in several manifests gets their longest time limit and the
    /// folder of the first.
    pub fn queue(&self) -> Vec<Queued> {
        let all = |keys: &[JobKey]| Ok::<_, Infallible>(vec![true; keys.len()]);
        match self.queue_where(all) {
            Ok(queue) => queue,
            Err(never) => match never {},
        }
    }

    /// The jobs of [`Selection::queue`] that are wanted. `are_wanted` receives distinct keys, many at a time;
    /// jobs that are not wanted are never kept.
    pub fn queue_where<E>(
        &self,
        mut are_wanted: impl FnMut(&[JobKey]) -> Result<Vec<bool>, E>,
    ) -> Result<Vec<Queued>, E> {
        let mut queue: Vec<Queued> = Vec::new();
        // The place in the queue of every job seen so far; `None` if it is not wanted.
        let mut places: HashMap<JobKey, Option<usize>> = HashMap::new();
        for manifest in self.manifests {
            let time_limit = manifest.time_limit_seconds.map(Duration::from_secs);
            let folder = manifest.folder();
            let mut jobs =
                self.jobs(manifest).map(|planned| (planned.form.key(), planned)).peekable();
            while jobs.peek().is_some() {
                let mut new = Vec::new();
                for (key, planned) in jobs.by_ref().take(JobStates::TOGETHER) {
                    match places.entry(key) {
                        Entry::Vacant(place) => {
                            place.insert(None);
                            new.push((key, planned));
                        }
                        Entry::Occupied(place) => {
                            if let Some(found) = place.get().map(|at| &mut queue[at]) {
                                found.time_limit = longer(found.time_limit, time_limit);
                            }
                        }
                    }
                }
                let keys: Vec<JobKey> = new.iter().map(|(key, _)| *key).collect();
                let wanted = new.into_iter().zip(are_wanted(&keys)?).filter(|(_, is)| *is);
                for ((key, PlannedJob { agent, job, .. }), _) in wanted {
                    places.insert(key, Some(queue.len()));
                    let (agent, folder) = (agent.to_string(), folder.to_owned());
                    queue.push(Queued { key, agent, job, time_limit, folder });
                }
            }
        }
        Ok(queue)
    }
}

/// The longer of two limits; `None` is unlimited.
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
