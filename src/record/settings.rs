//! The settings of jobs: every parameter except scenario and seed.
//!
//! A large experiment has few distinct settings per job, so jobs share a base and keep their differences
//! from it, and jobs that differ only in their seeds share their settings.

use std::sync::Arc;

use crate::job::{PlannedJob, Scalar, without_seed};
use crate::key::{Key, Value};

/// The parameters of a job except scenario and seed, by dotted name.
#[derive(Clone, Debug)]
pub struct Settings {
    base: Arc<Base>,
    /// Settings that differ from the base, with their indices in it, in ascending order.
    own: Vec<(usize, Scalar)>,
}

/// The settings of one job of an algorithm.
#[derive(Debug)]
struct Base {
    algorithm: &'static str,
    /// Dotted names and values, sorted by name.
    named: Vec<(String, Scalar)>,
    sections: Vec<Section>,
}

/// A section of the base.
#[derive(Debug)]
struct Section {
    keys: &'static [Key],
    values: Vec<Value>,
    /// The index of each key among the sorted names.
    indices: Vec<usize>,
}

impl Settings {
    /// All dotted names and values, in the order of the names.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Scalar)> {
        let mut own = self.own.iter().peekable();
        self.base.named.iter().enumerate().map(move |(index, (name, value))| {
            let own = own.next_if(|(at, _)| *at == index);
            (name.as_str(), own.map_or(value, |(_, own)| own))
        })
    }

    /// The value of the parameter of this dotted name, if the job has it.
    pub fn get(&self, name: &str) -> Option<&Scalar> {
        let named = &self.base.named;
        let index = named.binary_search_by(|(known, _)| known.as_str().cmp(name)).ok()?;
        Some(self.at(index))
    }

    /// The parameters of `other` whose values differ here or are missing here, in the order of their names.
    pub fn differing<'s>(&self, other: &'s Settings) -> Vec<&'s str> {
        if !Arc::ptr_eq(&self.base, &other.base) {
            let differs = |(name, value): &(&str, &Scalar)| self.get(name) != Some(value);
            return other.iter().filter(differs).map(|(name, _)| name).collect();
        }
        let indices = self.own.iter().chain(&other.own).map(|(index, _)| *index);
        let mut indices: Vec<usize> =
            indices.filter(|index| self.at(*index) != other.at(*index)).collect();
        indices.sort_unstable();
        indices.dedup();
        indices.into_iter().map(|index| other.base.named[index].0.as_str()).collect()
    }

    fn at(&self, index: usize) -> &Scalar {
        let own = self.own.iter().find(|(at, _)| *at == index);
        own.map_or(&self.base.named[index].1, |(_, own)| own)
    }
}

impl PartialEq for Settings {
    fn eq(&self, other: &Settings) -> bool {
        self.iter().eq(other.iter())
    }
}

/// The settings of jobs read one after another, shared where they are equal.
#[derive(Debug, Default)]
pub struct SharedSettings {
    /// One base per algorithm.
    bases: Vec<Arc<Base>>,
    /// The canonical form of the last job without its seed, and the job's settings.
    last: Option<(String, Arc<Settings>)>,
}

impl SharedSettings {
    /// The settings of a job.
    pub fn of(&mut self, planned: &PlannedJob) -> Arc<Settings> {
        let form = without_seed(planned.form.text());
        if let Some((last, settings)) = &self.last
            && *last == form
        {
            return settings.clone();
        }
        let settings = Arc::new(self.next(planned));
        self.last = Some((form.into_owned(), settings.clone()));
        settings
    }

    fn next(&mut self, planned: &PlannedJob) -> Settings {
        let base = self.bases.iter().find(|base| base.is_of(planned)).cloned();
        let base = base.unwrap_or_else(|| {
            self.bases.push(Arc::new(Base::of(planned)));
            self.bases[self.bases.len() - 1].clone()
        });
        let mut own = Vec::new();
        for (known, (_, _, values)) in base.sections.iter().zip(planned.job.sections()) {
            let both = known.values.iter().zip(&values).zip(&known.indices);
            let differing = both.filter(|((known, value), _)| known != value);
            own.extend(differing.map(|((_, value), index)| (*index, Scalar::from(value))));
        }
        own.sort_by_key(|(index, _)| *index);
        Settings { base, own }
    }
}

impl Base {
    fn of(planned: &PlannedJob) -> Base {
        let job = &planned.job;
        let mut all = job.parameters();
        all.retain(|(name, _)| name != "scenario" && name != "seed");
        let index = |name: String| {
            let found = all.binary_search_by(|(known, _)| known.cmp(&name));
            found.expect("every key of every section is among them")
        };
        let sections = job.sections().into_iter().map(|(section, keys, values)| Section {
            indices: keys
                .iter()
                .map(|key| index(section.parameter(key.name).to_string()))
                .collect(),
            keys,
            values,
        });
        let sections = sections.collect();
        Base { algorithm: job.algorithm(), named: all, sections }
    }

    /// Whether the job has the same parameters.
    fn is_of(&self, planned: &PlannedJob) -> bool {
        // An outside program's algorithms have the same name and differ in their keys.
        let keys = planned.job.agent.algorithm().keys();
        let is_same = |section: &Section| std::ptr::eq(section.keys, keys);
        self.algorithm == planned.job.algorithm() && self.sections.first().is_some_and(is_same)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::manifest::parse;
    use crate::plan;

    #[test]
    fn shared_settings_are_the_parameters_of_each_job() {
        let text = "format = 1\nextends = \"paper\"\nname = \"t\"\nscenarios = [\"P-H-D\", \"C-T\"]\nseeds = 2\n\
                    [environment]\nsigma = [0.4, 0.6]\nmu = [[0.1, 0.1], [0, 0.5]]\n\
                    [[agent]]\nname = \"other\"\nalgorithm = \"reinforce\"\nlayers = [[8], [16]]";
        let manifest = parse("t", text.as_bytes()).unwrap();
        let mut shared = SharedSettings::default();
        let read: Vec<(PlannedJob, Arc<Settings>)> =
            plan::jobs(&manifest).map(|planned| (planned.clone(), shared.of(&planned))).collect();
        for (planned, settings) in &read {
            let alone = SharedSettings::default().of(planned);
            let named = planned.job.parameters().into_iter();
            let named = named.filter(|(name, _)| name != "scenario" && name != "seed");
            let names: Vec<String> = named.map(|(name, _)| name).collect();
            assert_eq!(settings.iter().map(|(name, _)| name).collect::<Vec<_>>(), names);
            assert_eq!(*settings, alone);
            assert!(settings.iter().all(|(name, value)| settings.get(name) == Some(value)));
            // A job without shared settings has another base, which must not make a difference.
            for (_, other) in &read {
                assert_eq!(settings.differing(other), alone.differing(other));
            }
        }
        assert!(Arc::ptr_eq(&read[0].1, &read[1].1), "they differ only in their seeds");
        assert_eq!(read[0].1.differing(&read[2].1), ["environment.mu"]);
        assert_eq!(read[0].1.get("seed"), None);
    }
}
