//! The sections of a manifest, and their keys.

use std::ops::{Index, IndexMut};

use crate::agent::Algorithm;
use crate::env::{Family, recorded};
use crate::job::{Evaluation, Trial};
use crate::key::{Key, Keyed, Parameter, SectionName};

/// The part of a manifest that a key belongs to, and the first part of its dotted name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Section {
    /// `[environment]` of this family.
    Environment(&'static Family),
    /// `[population]` of this family.
    Population(&'static Family),
    /// `[[agent]]` with this algorithm.
    Agent(&'static Algorithm),
    /// `[evaluation]`.
    Evaluation,
    /// `[trial]`, which has no keys where a manifest declares none.
    Trial(bool),
}

impl Section {
    /// Every section, in the order of the grid, with the families after the first one last.
    pub fn all() -> Vec<Section> {
        let agents = Algorithm::all().into_iter().map(Section::Agent);
        let with_people = |family: &&'static Family| {
            let people = (!family.people.is_empty()).then_some(Section::Population(family));
            std::iter::once(Section::Environment(family)).chain(people)
        };
        let (first, others) = Family::all().split_first().expect("there are families");
        let others = others.iter().flat_map(with_people);
        with_people(first)
            .chain(agents)
            .chain([Section::Evaluation, Section::Trial(true)])
            .chain(others)
            .collect()
    }

    /// The section of this name that agents of an environment of this family share; `None` for agents, of which
    /// each has its own. A manifest need not declare a trial.
    fn shared(name: SectionName, family: &'static Family, has_trial: bool) -> Option<Section> {
        Some(match name {
            SectionName::Environment => Section::Environment(family),
            SectionName::Population => Section::Population(family),
            SectionName::Agent => return None,
            SectionName::Evaluation => Section::Evaluation,
            SectionName::Trial => Section::Trial(has_trial),
        })
    }

    /// The section of this name that a manifest about this family opens; `None` for agents.
    pub fn opened(name: SectionName, family: &'static Family) -> Option<Section> {
        Section::shared(name, family, true)
    }

    /// Which section it is.
    pub fn which(self) -> SectionName {
        match self {
            Section::Environment(_) => SectionName::Environment,
            Section::Population(_) => SectionName::Population,
            Section::Agent(_) => SectionName::Agent,
            Section::Evaluation => SectionName::Evaluation,
            Section::Trial(_) => SectionName::Trial,
        }
    }

    /// The section's name in a manifest and in dotted names.
    pub fn name(self) -> &'static str {
        self.which().word()
    }

    /// The header of the section.
    pub fn header(self) -> String {
        match self {
            Section::Agent(_) => format!("[[{}]]", self.name()),
            Section::Environment(family) if family == &recorded::FAMILY => {
                format!("[{}]", recorded::DATA)
            }
            _ => format!("[{}]", self.name()),
        }
    }

    /// The family of an environment and its population.
    pub fn family(self) -> Option<&'static Family> {
        match self {
            Section::Environment(family) | Section::Population(family) => Some(family),
            Section::Agent(_) | Section::Evaluation | Section::Trial(_) => None,
        }
    }

    /// The algorithm of an agent.
    pub fn algorithm(self) -> Option<&'static Algorithm> {
        if let Section::Agent(algorithm) = self { Some(algorithm) } else { None }
    }

    /// Whether jobs have the section: all but a trial that the manifest does not declare.
    pub fn is_declared(self) -> bool {
        self != Section::Trial(false)
    }

    /// The unique title of the section: its name, or the name of its algorithm.
    pub fn title(self) -> String {
        match self {
            Section::Agent(algorithm) => algorithm.name().to_owned(),
            Section::Environment(family) | Section::Population(family)
                if family != Family::first() =>
            {
                format!("{} of {}", self.name(), family.name)
            }
            Section::Environment(_)
            | Section::Population(_)
            | Section::Evaluation
            | Section::Trial(_) => self.name().to_owned(),
        }
    }

    /// The section's keys, in the order the documentation lists them.
    pub fn keys(self) -> &'static [Key] {
        match self {
            Section::Environment(family) => family.keys,
            Section::Population(family) => family.people,
            Section::Agent(algorithm) => algorithm.keys(),
            Section::Evaluation => Evaluation::KEYS,
            Section::Trial(true) => Trial::KEYS,
            Section::Trial(false) => &[],
        }
    }

    /// The key called `name`, with its index in [`Section::keys`].
    pub fn find(self, name: &str) -> Option<(usize, &'static Key)> {
        self.keys().iter().enumerate().find(|(_, key)| key.name == name)
    }

    /// The key called `name` of this section, as a parameter.
    pub fn parameter(self, name: &'static str) -> Parameter {
        self.which().parameter(name)
    }
}

/// One value for each section that agents share.
#[derive(Clone, Debug, PartialEq)]
pub struct SharedSections<T>(Vec<(SectionName, T)>);

impl<T> SharedSections<T> {
    /// The values that `value_of` returns for the sections of a manifest about this family that declares no trial.
    pub(super) fn of(family: &'static Family, value_of: fn(Section) -> T) -> SharedSections<T> {
        let shared = |name| Some((name, value_of(Section::shared(name, family, false)?)));
        SharedSections(SectionName::ALL.into_iter().filter_map(shared).collect())
    }

    /// The results of `change` for all sections.
    pub(super) fn map<U>(&self, change: impl Fn(SectionName, &T) -> U) -> SharedSections<U> {
        SharedSections(self.0.iter().map(|(name, value)| (*name, change(*name, value))).collect())
    }

    /// The sections with their values, in the order of grids.
    pub fn iter(&self) -> impl Iterator<Item = (SectionName, &T)> {
        self.0.iter().map(|(name, value)| (*name, value))
    }

    /// All values.
    pub(super) fn values_mut(&mut self) -> impl Iterator<Item = &mut T> {
        self.0.iter_mut().map(|(_, value)| value)
    }

    /// The sections with their values.
    pub(super) fn into_iter(self) -> impl Iterator<Item = (SectionName, T)> {
        self.0.into_iter()
    }
}

/// # Panics
/// For agents, of which each has its own section.
impl<T> Index<SectionName> for SharedSections<T> {
    type Output = T;

    fn index(&self, section: SectionName) -> &T {
        let found = self.0.iter().find(|(name, _)| *name == section);
        &found.expect("agents share the section").1
    }
}

/// # Panics
/// For agents, of which each has its own section.
impl<T> IndexMut<SectionName> for SharedSections<T> {
    fn index_mut(&mut self, section: SectionName) -> &mut T {
        let found = self.0.iter_mut().find(|(name, _)| *name == section);
        &mut found.expect("agents share the section").1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agent::Agent;
    use crate::key::{Content, Distribution, Kind, Rows, Value};

    /// Whether the section's struct accepts these values.
    fn fit(section: Section, values: Vec<Value>) -> bool {
        match section {
            Section::Environment(family) => {
                let people = family.people.iter().filter_map(Key::default).collect::<Vec<_>>();
                (family.read)(family, &values, &people).is_some()
            }
            Section::Population(family) => {
                let own = family.keys.iter().map(|key| extremes(key.kind)[0].clone());
                (family.read)(family, &own.collect::<Vec<_>>(), &values).is_some()
            }
            Section::Agent(algorithm) => Agent::with_values(algorithm, values).is_some(),
            Section::Evaluation => Evaluation::from_values(&values).is_some(),
            Section::Trial(_) => Trial::from_values(&values).is_some(),
        }
    }

    /// The smallest and the largest values of a kind.
    fn extremes(kind: Kind) -> Vec<Value> {
        match kind {
            Kind::Real { min, max } => vec![Value::Real(min), Value::Real(max)],
            Kind::PositiveReal { max } => vec![Value::Real(max)],
            Kind::Integer { min, max } => vec![Value::Integer(min), Value::Integer(max)],
            Kind::Flag => vec![Value::Flag(false), Value::Flag(true)],
            Kind::Choice(words) => words.iter().map(|word| Value::Choice(word)).collect(),
            Kind::RealPair { min, max } => vec![Value::RealPair([min, max])],
            Kind::Reals { least, most, min, max } => {
                vec![Value::Reals(vec![min; least]), Value::Reals(vec![max; most])]
            }
            Kind::Counts { most, max } => {
                vec![
                    Value::Wholes(Vec::new()),
                    Value::Wholes((max - most as u32 + 1..=max).collect()),
                ]
            }
            Kind::Widths { most, max } => vec![Value::Wholes(vec![max; most])],
            Kind::Text { most } => vec![Value::Text("x".repeat(most))],
            Kind::Words { most, longest } => vec![Value::Words(vec!["x".repeat(longest); most])],
            Kind::Scalar => vec![Value::Flag(true), Value::Text(String::new())],
            Kind::Distribution(of) => {
                let numbers = of.min.into_iter().chain([of.max]);
                numbers.map(|x| Value::Distribution(Distribution::Constant(x))).collect()
            }
            Kind::Rows(_) => vec![Value::Rows(Rows::default())],
            Kind::Content(_) => vec![Value::Content(Content::default())],
            Kind::AnyOf(kinds) => kinds.iter().copied().flat_map(extremes).collect(),
        }
    }

    #[test]
    fn every_value_that_a_key_admits_fits_its_field() {
        for section in Section::all() {
            let some = section.keys().iter().map(|key| extremes(key.kind)[0].clone());
            let some: Vec<Value> = some.collect();
            for (index, key) in section.keys().iter().enumerate() {
                let given = [key.default(), key.before()].into_iter().flatten();
                for value in extremes(key.kind).into_iter().chain(given) {
                    assert!(key.kind.admits(&value), "{} = {value}", key.name);
                    let mut values = some.clone();
                    values[index] = value.clone();
                    assert!(fit(section, values), "{} = {value}", key.name);
                }
            }
            if !some.is_empty() {
                assert!(!fit(section, some[1..].to_vec()), "{section:?}");
            }
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
    fn few_keys_must_be_given() {
        let keys = Section::all().into_iter().flat_map(|section| section.keys());
        let required = keys.filter(|key| key.default.is_none()).map(|key| key.name);
        assert_eq!(
            required.collect::<Vec<_>>(),
            [
                "sigma",
                "rule",
                "command",
                "version",
                "people",
                "days",
                "model",
                "file",
                "person",
                "order",
                "action",
                "probability",
                "outcome",
                "command",
                "version"
            ]
        );
    }
}
