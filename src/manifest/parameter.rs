//! The parameters that a grid can vary, and the values that a manifest declares for them.

use super::condition::Condition;
use super::section::Section;
use crate::key::{Key, Parameter, Value};

/// Every parameter, in the order of the grid: scenario, keys by section, seed.
pub fn parameters() -> Vec<Parameter> {
    let mut all = vec![Parameter::Scenario];
    for section in Section::all() {
        for key in section.keys() {
            let parameter = section.parameter(key.name);
            // A key that several algorithms have is one parameter.
            if !all.contains(&parameter) {
                all.push(parameter);
            }
        }
    }
    all.push(Parameter::Seed);
    all
}

/// The parameter of this dotted name.
pub fn parameter(dotted: &str) -> Option<Parameter> {
    parameters().into_iter().find(|parameter| parameter.to_string() == dotted)
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

    /// One value for each key: the one that `choose` picks for it by its place.
    pub(super) fn chosen(&self, choose: impl Fn(usize) -> usize) -> Vec<Value> {
        let values = self.values.iter().enumerate();
        values.map(|(place, values)| values[choose(place)].clone()).collect()
    }

    /// Conditions that the swept keys have one of their values.
    pub fn conditions(&self) -> impl Iterator<Item = Condition> {
        self.iter().filter(|(_, values)| values.len() > 1).map(|(key, values)| Condition::Key {
            parameter: self.section.parameter(key.name),
            values: values.to_vec(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_parameter_is_found_by_its_dotted_name_and_none_is_listed_twice() {
        let all = parameters();
        for known in &all {
            assert_eq!(parameter(&known.to_string()), Some(*known));
            assert_eq!(all.iter().filter(|other| *other == known).count(), 1, "{known}");
        }
        assert!(all.contains(&Parameter::Agent("trajectories_per_update")));
        assert_eq!(parameter("sigma"), None);
    }
}
