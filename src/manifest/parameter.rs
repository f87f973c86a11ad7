//! The names of what a grid varies, and the values that a manifest declares for them.

use std::fmt;

use serde::de::DeserializeOwned;

use super::condition::Condition;
use super::keys::{Key, Section, Value};

/// Something that a grid can vary, as zips and exclusions name it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Parameter {
    /// `scenario`.
    Scenario,
    /// `seed`.
    Seed,
    /// `environment.<key>`.
    Environment(&'static str),
    /// `agent.<key>`, of whichever agents have the key.
    Agent(&'static str),
    /// `evaluation.<key>`.
    Evaluation(&'static str),
}

impl Parameter {
    /// The key called `name` of `section`, as a parameter.
    pub(super) fn of(section: Section, name: &'static str) -> Parameter {
        match section {
            Section::Environment => Parameter::Environment(name),
            Section::DuelingDqn | Section::Reinforce | Section::Rule => Parameter::Agent(name),
            Section::Evaluation => Parameter::Evaluation(name),
        }
    }

    /// Every parameter, in the order of the grid: scenario, keys by table, seed.
    pub fn all() -> impl Iterator<Item = Parameter> {
        let keys = Section::ALL.into_iter().flat_map(|section| {
            let unseen = move |key: &&Key| {
                section != Section::Reinforce || Section::DuelingDqn.find(key.name).is_none()
            };
            section.keys().iter().filter(unseen).map(move |key| Parameter::of(section, key.name))
        });
        std::iter::once(Parameter::Scenario).chain(keys).chain(std::iter::once(Parameter::Seed))
    }

    /// The last part of its dotted name, as its section writes it.
    pub(super) fn key(self) -> &'static str {
        match self {
            Parameter::Scenario => "scenario",
            Parameter::Seed => "seed",
            Parameter::Environment(key) | Parameter::Agent(key) | Parameter::Evaluation(key) => key,
        }
    }

    /// The parameter of this dotted name.
    pub fn named(dotted: &str) -> Option<Parameter> {
        Parameter::all().find(|parameter| parameter.to_string() == dotted)
    }
}

impl fmt::Display for Parameter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Parameter::Scenario => f.write_str("scenario"),
            Parameter::Seed => f.write_str("seed"),
            Parameter::Environment(key) => write!(f, "environment.{key}"),
            Parameter::Agent(key) => write!(f, "agent.{key}"),
            Parameter::Evaluation(key) => write!(f, "evaluation.{key}"),
        }
    }
}

/// The values of every key of a section: one, or several that the grid sweeps.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameters {
    section: Section,
    values: Vec<Vec<Value>>,
}

impl Parameters {
    /// Takes one list of values for each of the section's keys, in their order, none empty.
    pub(super) fn new(section: Section, values: Vec<Vec<Value>>) -> Parameters {
        Parameters { section, values }
    }

    /// The section whose keys these are.
    pub fn section(&self) -> Section {
        self.section
    }

    /// Every key with its values, in the order of [`Section::keys`].
    pub fn iter(&self) -> impl Iterator<Item = (&'static Key, &[Value])> {
        self.section.keys().iter().zip(self.values.iter().map(Vec::as_slice))
    }

    /// The values of the key called `name`; `None` if the section has no such key.
    pub fn get(&self, name: &str) -> Option<&[Value]> {
        self.section.find(name).map(|(place, _)| self.values[place].as_slice())
    }

    /// Conditions that the swept keys have one of their values.
    pub fn conditions(&self) -> impl Iterator<Item = Condition> {
        self.iter().filter(|(_, values)| values.len() > 1).map(|(key, values)| Condition::Key {
            parameter: Parameter::of(self.section, key.name),
            values: values.to_vec(),
        })
    }

    /// The section's typed struct, with the value that `choose` picks for each key by its place.
    pub(super) fn typed<T: DeserializeOwned>(&self, choose: impl Fn(usize) -> usize) -> T {
        let keys = self.section.keys().iter().enumerate();
        let fields = keys.map(|(place, key)| {
            let value = &self.values[place][choose(place)];
            (key.name.to_owned(), serde_json::json!(value))
        });
        serde_json::from_value(serde_json::Value::Object(fields.collect()))
            .expect("values of the table's kinds fill the struct: the tests of the table say so")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_parameter_is_found_by_its_dotted_name_and_none_is_listed_twice() {
        let all: Vec<Parameter> = Parameter::all().collect();
        for parameter in &all {
            assert_eq!(Parameter::named(&parameter.to_string()), Some(*parameter));
            assert_eq!(all.iter().filter(|other| *other == parameter).count(), 1, "{parameter}");
        }
        assert!(all.contains(&Parameter::Agent("trajectories_per_update")));
        assert_eq!(Parameter::named("sigma"), None);
    }
}
