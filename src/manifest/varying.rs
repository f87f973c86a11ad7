//! Which parameters differ between jobs: what a reader needs to tell them apart.

use std::collections::{BTreeMap, HashMap};
use std::hash::Hash;

use super::declared::Manifest;

/// The parameters in which the jobs of each agent differ, scenario and seed aside.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Varying(BTreeMap<String, Vec<String>>);

impl Varying {
    /// Those of which an agent has several values, of agents' names, dotted names and values.
    pub fn among<A, N, V>(values: impl IntoIterator<Item = (A, N, V)>) -> Varying
    where
        A: AsRef<str> + Clone + Eq + Hash,
        N: AsRef<str> + Clone + Eq + Hash,
        V: PartialEq,
    {
        let mut first = HashMap::new();
        let mut varying = Varying::default();
        for (agent, name, value) in values {
            let place = (agent.clone(), name.clone());
            let first = first.entry(place).or_insert(None);
            match first {
                None => *first = Some(value),
                Some(first) if *first == value => {}
                Some(_) => varying.add(agent.as_ref(), name.as_ref()),
            }
        }
        varying
    }

    /// Those that manifests sweep, or set otherwise than each other.
    pub fn of(manifests: &[Manifest]) -> Varying {
        let agents = manifests.iter().flat_map(|one| one.agents.iter().map(move |a| (one, a)));
        Varying::among(agents.flat_map(|(manifest, agent)| {
            let sections = [&manifest.environment, &agent.parameters, &manifest.evaluation];
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

    /// The dotted names, none twice.
    pub fn names(&self) -> Vec<String> {
        let mut names: Vec<String> = Vec::new();
        for name in self.0.values().flatten() {
            if !names.contains(name) {
                names.push(name.clone());
            }
        }
        names
    }

    /// The dotted names of an agent.
    pub fn of_agent(&self, agent: &str) -> &[String] {
        self.0.get(agent).map_or(&[], Vec::as_slice)
    }

    /// These without a parameter.
    pub fn without(mut self, name: &str) -> Varying {
        for names in self.0.values_mut() {
            names.retain(|known| known != name);
        }
        self
    }
}
