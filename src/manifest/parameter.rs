//! The parameters that a grid can vary, and the values that a manifest declares for them.

use crate::env::{Family, Scenario};
use crate::job::{Condition, short_name};
use crate::key::{Key, Parameter, Value, free_key};
use crate::manifest::section::Section;
use crate::text::nearest;

/// Every parameter, in the order of the grid: scenario, keys by section, seed.
pub fn parameters() -> Vec<Parameter> {
    let mut all = vec![Parameter::SCENARIO];
    for section in Section::all() {
        for key in section.keys() {
            let parameter = section.parameter(key.name);
            // A key of several algorithms is one parameter.
            if !all.contains(&parameter) {
                all.push(parameter);
            }
        }
    }
    all.push(Parameter::SEED);
    all
}

/// The parameter with this dotted name; `agent.parameters.<name>` and `environment.parameters.<name>` are
/// parameters of outside programs.
pub fn parameter(dotted: &str) -> Option<Parameter> {
    let of_jobs = [Parameter::SCENARIO, Parameter::SEED];
    let of_job = of_jobs.into_iter().find(|parameter| parameter.to_string() == dotted);
    let of_key = || {
        let (table, name) = dotted.split_once('.')?;
        let sections = Section::all().into_iter().filter(|section| section.name() == table);
        let mut found = sections.filter_map(|one| Some(one.parameter(one.find(name)?.1.name)));
        found.next()
    };
    of_job.or_else(of_key).or_else(|| free_parameters(dotted).next())
}

/// Whether a job can have a parameter in an environment of this family.
pub(super) fn is_in(family: &'static Family, parameter: Parameter) -> bool {
    let section = parameter.section().and_then(|name| Section::opened(name, family));
    section.is_none_or(|section| section.find(parameter.key()).is_some())
}

/// The parameter with this dotted name, or the only parameter of jobs in environments of this family whose last
/// part is this name.
pub(super) fn named(family: &'static Family, name: &str) -> Option<Parameter> {
    let is_meant = |parameter: &Parameter| {
        short_name(&parameter.to_string()) == name && is_in(family, *parameter)
    };
    let mut free = free_parameters(name);
    if let Some(of_program) = free.find(|parameter| {
        matches!(parameter, Parameter::Environment(_)) && is_in(family, *parameter)
    }) {
        return Some(of_program);
    }
    let mut meant = parameters().into_iter().filter(is_meant);
    parameter(name).or_else(|| meant.next().filter(|_| meant.next().is_none()))
}

/// The parameters of outside programs that a name can mean: `agent.parameters.<name>`,
/// `environment.parameters.<name>`, or both without the section.
pub fn free_parameters(name: &str) -> impl Iterator<Item = Parameter> {
    let of_agents = free_key(name.strip_prefix("agent.").unwrap_or(name));
    let of_environments = free_key(name.strip_prefix("environment.").unwrap_or(name));
    let of_agents = of_agents.map(|key| Parameter::Agent(key.name));
    let of_environments = of_environments.map(|key| Parameter::Environment(key.name));
    of_agents.into_iter().chain(of_environments)
}

/// The dotted name that a text probably means, among the parameters and `others`: the name whose last part
/// it is, or else the nearest name.
pub(super) fn meant(found: &str, others: &[&str]) -> Option<String> {
    let names: Vec<String> = parameters().iter().map(Parameter::to_string).collect();
    let all = || names.iter().map(String::as_str).chain(others.iter().copied());
    let last = |name: &str| name.rsplit('.').next().unwrap_or(name).to_owned();
    let exact = all().find(|name| *name == found || last(name) == found);
    // A bare key lacks its section. Edit distance would not suggest the full name.
    let bare = || {
        let lasts: Vec<String> = all().map(last).collect();
        let near = nearest(found, lasts.iter().map(String::as_str))?;
        all().find(|name| last(name) == near)
    };
    exact.or_else(|| nearest(found, all())).or_else(bare).map(str::to_owned)
}

/// The values of every key of a section: one value, or several that the grid sweeps.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameters {
    section: Section,
    values: Vec<Vec<Value>>,
}

impl Parameters {
    /// Takes one non-empty list of values for each key of the section, in the order of the keys.
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
        self.section.find(name).map(|(index, _)| self.values[index].as_slice())
    }

    /// One value for each key, at the index that `choose` returns for the key's index.
    pub(super) fn chosen(&self, choose: impl Fn(usize) -> usize) -> Vec<Value> {
        let values = self.values.iter().enumerate();
        values.map(|(index, values)| values[choose(index)].clone()).collect()
    }

    /// One condition per swept key: that the key has one of its values.
    pub fn conditions(&self) -> impl Iterator<Item = Condition> {
        self.iter().filter(|(_, values)| values.len() > 1).map(|(key, values)| Condition {
            parameter: self.section.parameter(key.name),
            values: values.to_vec(),
        })
    }
}

/// The scenario that a value names.
pub(super) fn scenario_of(value: &Value) -> Scenario {
    let Value::Text(text) = value else { unreachable!("a scenario is a text") };
    text.parse().expect("the manifest's scenarios are valid")
}

/// The seed that is a value.
pub(super) fn seed_of(value: &Value) -> u64 {
    let Value::Integer(seed) = value else { unreachable!("a seed is a whole number") };
    *seed
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

    #[test]
    fn a_last_part_that_one_parameter_has_names_it() {
        assert_eq!(named(Family::first(), "sigma"), Some(Parameter::Environment("sigma")));
        let first = Family::first();
        assert_eq!(named(first, "agent.gamma"), named(first, "gamma"));
        assert_eq!(named(first, "scenario"), Some(Parameter::SCENARIO));
        assert_eq!(named(first, "sigm"), None);
        let external = Family::named("external").unwrap();
        assert_eq!(named(first, "version"), Some(Parameter::Agent("version")));
        assert_eq!(named(external, "version"), None);
        assert_eq!(named(external, "sigma"), None);
        let of_first = parameters().into_iter().filter(|one| is_in(first, *one));
        let short: Vec<String> =
            of_first.map(|known| short_name(&known.to_string()).to_owned()).collect();
        for name in &short {
            let several = short.iter().filter(|other| *other == name).count() > 1;
            assert_eq!(named(first, name).is_none(), several, "{name}");
        }
    }
}
