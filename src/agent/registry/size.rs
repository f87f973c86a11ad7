//! The sizes of an agent's training, from the values of a cell, and the keys that make them.

use super::algorithm::{Agent, Algorithm, Task, Unsuited};
use crate::env::{Family, Scenario};
use crate::key::{Assignment, Key, Kind, Parameter, Size, Value};

impl Algorithm {
    /// The parameters that an agent and its task in an environment of a family are made of.
    pub fn parameters(&self, family: &'static Family) -> Vec<Parameter> {
        self.kinds(family).map(|(parameter, _)| parameter).chain([Parameter::SCENARIO]).collect()
    }

    /// Whether sizes can depend on a parameter; they depend neither on real numbers nor on texts.
    pub fn is_sized_by(&self, family: &'static Family, parameter: Parameter) -> bool {
        let kind = self.kinds(family).find(|(known, _)| *known == parameter).map(|(_, kind)| kind);
        kind.map_or(parameter == Parameter::SCENARIO, |kind| kind.smallest().is_some())
    }

    fn kinds(&self, family: &'static Family) -> impl Iterator<Item = (Parameter, Kind)> {
        let own = self.keys().iter().map(|key| (Parameter::Agent(key.name), key.kind));
        let environment = |key: &Key| (Parameter::Environment(key.name), key.kind);
        own.chain(family.keys.iter().map(environment))
    }

    /// The sizes above their limits, given the values of [`Algorithm::parameters`], each with the
    /// parameters that add to it and their values.
    pub fn too_large<'v>(
        &'static self,
        family: &'static Family,
        assignment: &Assignment<'v>,
    ) -> Vec<(Size, Assignment<'v>)> {
        let sizes = self.sizes(family, assignment).into_iter().filter(Size::is_too_large);
        sizes.map(|size| (size, self.adding_to(family, &size, assignment))).collect()
    }

    /// The parameters without whose values a size would be further below its limit.
    fn adding_to<'v>(
        &'static self,
        family: &'static Family,
        size: &Size,
        assignment: &Assignment<'v>,
    ) -> Assignment<'v> {
        let is_smaller = |parameter: Parameter, value: Value| {
            let sizes = self.sizes(family, &assignment.with(parameter, value));
            let other = sizes.iter().find(|other| other.what == size.what);
            other.is_none_or(|other| other.size < size.size || other.most > size.most)
        };
        let adds = |(parameter, kind): &(Parameter, Kind)| {
            kind.smallest().is_some_and(|value| is_smaller(*parameter, value))
        };
        let adding: Vec<Parameter> =
            self.kinds(family).filter(adds).map(|(parameter, _)| parameter).collect();
        let kept = assignment.0.iter().filter(|(parameter, _)| adding.contains(parameter));
        Assignment(kept.cloned().collect())
    }

    fn sizes(&'static self, family: &'static Family, assignment: &Assignment) -> Vec<Size> {
        self.judged(family, assignment, Agent::sizes).unwrap_or_default()
    }

    /// Whether the suitability of keys can depend on a parameter.
    pub fn is_suited_by(&self, family: &'static Family, parameter: Parameter) -> bool {
        self.suited().contains(&parameter) || self.is_sized_by(family, parameter)
    }

    /// The first key that does not suit the environment, given the values of [`Algorithm::parameters`].
    pub fn unsuited(
        &'static self,
        family: &'static Family,
        assignment: &Assignment,
    ) -> Option<Unsuited> {
        self.judged(family, assignment, Agent::unsuited).flatten()
    }

    /// What `judge` says of the agent in its task; `None` where the task is not known in advance.
    fn judged<T>(
        &'static self,
        family: &'static Family,
        assignment: &Assignment,
        judge: fn(&Agent, &Task) -> T,
    ) -> Option<T> {
        // What a program shows is known once it has started; its jobs fail then.
        if family.is_external() {
            return None;
        }
        let own = assignment.values_of(|parameter| matches!(parameter, Parameter::Agent(_)));
        let of_environment = |parameter: &Parameter| matches!(parameter, Parameter::Environment(_));
        let environment = assignment.values_of(of_environment);
        // Sizes do not depend on how participants differ.
        let people: Vec<Value> = family.people.iter().filter_map(Key::default).collect();
        let environment = (family.read)(family, &environment, &people);
        let scenario = assignment.text(Parameter::SCENARIO).parse::<Scenario>();
        let (agent, environment, scenario) =
            (Agent::with_values(self, own)?, environment?, scenario.ok()?);
        let task = Task { environment: &environment, scenario: &scenario, seed: 0, history: 1 };
        Some(judge(&agent, &task))
    }
}
