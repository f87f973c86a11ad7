//! The parameters that differ between jobs, by which a reader distinguishes the jobs.

use std::collections::{BTreeMap, HashMap};
use std::hash::Hash;

use crate::job::distinct;
use crate::key::SectionName;
use crate::manifest::declared::Manifest;

/// The parameters in which the jobs of each agent differ, except scenario and seed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Varying(BTreeMap<String, Vec<String>>);

impl Varying {
    /// The parameters with several values for an agent, from triples of agent name, dotted name and value.
    pub fn among<A, N, V>(values: impl IntoIterator<Item = (A, N, V)>) -> Varying
    where
        A: AsRef<str> + Clone + Eq + Hash,
        N: AsRef<str> + Clone + Eq + Hash,
        V: PartialEq,
    {
        let mut first = HashMap::new();
        let mut varying = Varying::default();
        for (agent, name, value) in values {
            let key = (agent.clone(), name.clone());
            let first = first.entry(key).or_insert(None);
            match first {
                None => *first = Some(value),
                Some(first) if *first == value => {}
                Some(_) => varying.add(agent.as_ref(), name.as_ref()),
            }
        }
        varying
    }

    /// The parameters that manifests sweep, or set to different values.
    pub fn of(manifests: &[Manifest]) -> Varying {
        let agents = manifests.iter().flat_map(|one| one.agents.iter().map(move |a| (one, a)));
        Varying::among(agents.flat_map(|(manifest, agent)| {
            let sections = SectionName::ALL.map(|section| manifest.parameters(agent, section));
            let keys = sections.into_iter().flat_map(|parameters| {
                let name = |key: &str| format!("{}.{key}", parameters.section().name());
                parameters.iter().map(move |(key, values)| (name(key.name), values))
            });
            keys.flat_map(move |(name, values)| {
                values.iter().map(move |value| (agent.name.as_str(), name.clone(), value))
            })
        }))
    }

    fn add(&mut self, agent: &str, name: &str) {
        let names = self.0.entry(agent.to_owned()).or_default();
        if !names.iter().any(|known| known == name) {
            names.push(name.to_owned());
        }
    }

    /// The distinct dotted names.
    pub fn names(&self) -> Vec<String> {
        distinct(self.0.values().flatten().cloned())
    }

    /// The dotted names for an agent.
    pub fn of_agent(&self, agent: &str) -> &[String] {
        self.0.get(agent).map_or(&[], Vec::as_slice)
    }

    /// The same parameters without `name`.
    pub fn without(mut self, name: &str) -> Varying {
        for names in self.0.values_mut() {
            names.retain(|known| known != name);
        }
        self
    }
}
