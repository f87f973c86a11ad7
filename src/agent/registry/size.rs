//! The sizes of an agent's training, from the values of a cell, and the keys that make them.

use super::algorithm::{Agent, Algorithm, Task};
use crate::env::{Environment, Scenario, StepCount};
use crate::key::{Assignment, Key, Keyed, Kind, Parameter, Size, Value};

impl Algorithm {
    /// The parameters that an agent and its task are made of.
    pub fn parameters(&self) -> Vec<Parameter> {
        self.kinds().map(|(parameter, _)| parameter).chain([Parameter::SCENARIO]).collect()
    }

    /// Whether sizes can depend on a parameter; they depend neither on real numbers nor on texts.
    pub fn is_sized_by(&self, parameter: Parameter) -> bool {
        let kind = self.kinds().find(|(known, _)| *known == parameter).map(|(_, kind)| kind);
        kind.map_or(parameter == Parameter::SCENARIO, |kind| kind.smallest().is_some())
    }

    fn kinds(&self) -> impl Iterator<Item = (Parameter, Kind)> {
        let own = self.keys().iter().map(|key| (Parameter::Agent(key.name), key.kind));
        let environment = |key: &Key| (Parameter::Environment(key.name), key.kind);
        own.chain(StepCount::KEYS.iter().map(environment))
    }

    /// The sizes above their limits, given the values of [`Algorithm::parameters`], each with the
    /// parameters that add to it and their values.
    pub fn too_large<'v>(
        &'static self,
        assignment: &Assignment<'v>,
    ) -> Vec<(Size, Assignment<'v>)> {
        let sizes = self.sizes(assignment).into_iter().filter(Size::is_too_large);
        sizes.map(|size| (size, self.adding_to(&size, assignment))).collect()
    }

    /// The parameters without whose values a size would be further below its limit.
    fn adding_to<'v>(&'static self, size: &Size, assignment: &Assignment<'v>) -> Assignment<'v> {
        let is_smaller = |parameter: Parameter, value: Value| {
            let sizes = self.sizes(&assignment.with(parameter, value));
            let other = sizes.iter().find(|other| other.what == size.what);
            other.is_none_or(|other| other.size < size.size || other.most > size.most)
        };
        let adds = |(parameter, kind): &(Parameter, Kind)| {
            kind.smallest().is_some_and(|value| is_smaller(*parameter, value))
        };
        let adding: Vec<Parameter> =
            self.kinds().filter(adds).map(|(parameter, _)| parameter).collect();
        let kept = assignment.0.iter().filter(|(parameter, _)| adding.contains(parameter));
        Assignment(kept.cloned().collect())
    }

    fn sizes(&'static self, assignment: &Assignment) -> Vec<Size> {
        let own = assignment.values_of(|parameter| matches!(parameter, Parameter::Agent(_)));
        let environment: Option<StepCount> =
            assignment.keyed(|parameter| matches!(parameter, Parameter::Environment(_)));
        let scenario = assignment.text(Parameter::SCENARIO).parse::<Scenario>();
        let made = (Agent::with_values(self, own), environment, scenario.ok());
        let (Some(agent), Some(environment), Some(scenario)) = made else { return Vec::new() };
        let environment = Environment::from(environment);
        agent.sizes(&Task { environment: &environment, scenario: &scenario, seed: 0, history: 1 })
    }
}
