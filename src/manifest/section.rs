//! The sections of a manifest that have keys.

use super::Evaluation;
use crate::agent::Algorithm;
use crate::env::Environment;
use crate::key::{Key, Keyed, Parameter};

/// The part of a manifest that a key belongs to, and the first part of its dotted name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Section {
    /// `[environment]`.
    Environment,
    /// `[[agent]]` with this algorithm.
    Agent(&'static Algorithm),
    /// `[evaluation]`.
    Evaluation,
}

impl Section {
    /// Every section, in the order of the grid.
    pub fn all() -> Vec<Section> {
        let agents = Algorithm::all().into_iter().map(Section::Agent);
        [Section::Environment].into_iter().chain(agents).chain([Section::Evaluation]).collect()
    }

    /// The section's name in a manifest and in dotted names.
    pub fn name(self) -> &'static str {
        match self {
            Section::Environment => "environment",
            Section::Agent(_) => "agent",
            Section::Evaluation => "evaluation",
        }
    }

    /// What tells the section from all others: its name, or that of its algorithm.
    pub fn title(self) -> &'static str {
        match self {
            Section::Agent(algorithm) => algorithm.name(),
            Section::Environment | Section::Evaluation => self.name(),
        }
    }

    /// The section's keys, in the order the documentation lists them.
    pub fn keys(self) -> &'static [Key] {
        match self {
            Section::Environment => Environment::KEYS,
            Section::Agent(algorithm) => algorithm.keys(),
            Section::Evaluation => Evaluation::KEYS,
        }
    }

    /// The key called `name`, with its place in [`Section::keys`].
    pub fn find(self, name: &str) -> Option<(usize, &'static Key)> {
        self.keys().iter().enumerate().find(|(_, key)| key.name == name)
    }

    /// The key called `name` of this section, as a parameter.
    pub fn parameter(self, name: &'static str) -> Parameter {
        match self {
            Section::Environment => Parameter::Environment(name),
            Section::Agent(_) => Parameter::Agent(name),
            Section::Evaluation => Parameter::Evaluation(name),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agent::Agent;
    use crate::key::{Kind, Value};

    /// Whether the section's typed struct takes these values.
    fn fit(section: Section, values: Vec<Value>) -> bool {
        match section {
            Section::Environment => Environment::from_values(&values).is_some(),
            Section::Agent(algorithm) => Agent::with_values(algorithm, values).is_some(),
            Section::Evaluation => Evaluation::from_values(&values).is_some(),
        }
    }

    /// The extremes of a kind.
    fn extremes(kind: Kind) -> Vec<Value> {
        match kind {
            Kind::Real { min, max } => vec![Value::Real(min), Value::Real(max)],
            Kind::PositiveReal { max } => vec![Value::Real(max)],
            Kind::Integer { min, max } => vec![Value::Integer(min), Value::Integer(max)],
            Kind::Flag => vec![Value::Flag(false), Value::Flag(true)],
            Kind::Choice(words) => words.iter().map(|word| Value::Choice(word)).collect(),
            Kind::RealPair { min, max } => vec![Value::RealPair([min, max])],
            Kind::Widths { most, max } => vec![Value::Widths(vec![max; most])],
        }
    }

    #[test]
    fn every_value_that_a_key_admits_fits_its_field() {
        for section in Section::all() {
            let some = section.keys().iter().map(|key| extremes(key.kind)[0].clone());
            let some: Vec<Value> = some.collect();
            for (place, key) in section.keys().iter().enumerate() {
                let given = [key.default(), key.before()].into_iter().flatten();
                for value in extremes(key.kind).into_iter().chain(given) {
                    assert!(key.kind.admits(&value), "{} = {value}", key.name);
                    let mut values = some.clone();
                    values[place] = value.clone();
                    assert!(fit(section, values), "{} = {value}", key.name);
                }
            }
            assert!(!fit(section, some[1..].to_vec()), "{section:?}");
        }
    }

    #[test]
    fn keys_of_several_algorithms_are_of_one_kind() {
        let sections = Section::all();
        for section in sections.iter().filter(|section| section.name() == "agent") {
            for key in section.keys() {
                for other in sections.iter().filter(|section| section.name() == "agent") {
                    let same = other.find(key.name);
                    assert!(same.is_none_or(|(_, same)| same.kind == key.kind), "{}", key.name);
                }
            }
        }
    }

    #[test]
    fn only_sigma_and_the_rule_must_be_given() {
        let keys = Section::all().into_iter().flat_map(|section| section.keys());
        let required = keys.filter(|key| key.default.is_none()).map(|key| key.name);
        assert_eq!(required.collect::<Vec<_>>(), ["sigma", "rule"]);
    }
}
