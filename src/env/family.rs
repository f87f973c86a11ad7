//! Families of environments: what a manifest can name as `environment.family`.
//!
//! In: the values of a family's keys. Out: an [`Environment`], which makes simulations. A family is declared
//! once and registered, as an algorithm is by the agents.

use std::any::Any;
use std::fmt;
use std::ops::Deref;
use std::sync::Arc;

use crate::env::scenario::{Scenario, ScenarioError};
use crate::env::simulation::Simulated;
use crate::env::vector::Interface;
use crate::key::{Constraint, Key, Value};
use crate::rng::Stream;

/// A family with keys for parameters: the names of the keys, `parameters.<name>`. `None` if a name is not of this form, or
/// if there are too many.
pub type WithParameters = fn(&[&str]) -> Option<&'static Family>;

/// A family of environments: its name, its keys and the rules between them.
pub struct Family {
    /// The name in manifests and in the store.
    pub name: &'static str,
    /// The keys of `[environment]`.
    pub keys: &'static [Key],
    /// The keys of `[population]`; empty where participants cannot differ.
    pub people: &'static [Key],
    /// Lists of constraints between these keys, beyond the ranges of single keys.
    pub constraints: &'static [&'static [Constraint]],
    /// The unit of rewards and returns.
    pub return_unit: &'static str,
    /// The metric that is the share of episodes that were terminated.
    pub termination_metric: &'static str,
    /// The key that names and tables of jobs show whether it varies or not; `None` for no key.
    pub headline: Option<&'static str>,
    /// Whether an optimum of its environments can be computed, at least of some.
    pub has_optimum: bool,
    /// Whether choices of action are counted by an inferred context.
    pub has_contexts: bool,
    /// Whether scenarios are letters joined by hyphens; names of features otherwise.
    pub has_letters: bool,
    /// The family with keys for these parameters, whose names the author chooses; `None` where there are no such names.
    pub with_parameters: Option<WithParameters>,
    /// Checks that an environment can have a scenario, as far as the family knows.
    pub check_scenario: fn(&Scenario) -> Result<(), ScenarioError>,
    /// What a scenario consists of, for messages: "expected …".
    pub expected_scenario: fn() -> String,
    /// Scenarios as examples; at least one.
    pub example_scenarios: &'static [&'static str],
    /// The environment with these values, one for each key of `[environment]` and of `[population]`, in their
    /// order; `None` if a value has another type.
    pub read: fn(&'static Family, &[Value], &[Value]) -> Option<Environment>,
}

// Families of outside programs share their name and are compared by the names of their parameters.
impl PartialEq for Family {
    fn eq(&self, other: &Family) -> bool {
        let names = |family: &Family| family.keys.iter().map(|key| key.name);
        self.name == other.name && names(self).eq(names(other))
    }
}

impl Eq for Family {}

impl fmt::Debug for Family {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

/// A family with values of its keys.
pub trait Model: Any + fmt::Debug + Send + Sync {
    /// The family.
    fn family(&self) -> &'static Family;

    /// The values of the family's keys of `[environment]`, in their order.
    fn values(&self) -> Vec<Value>;

    /// The values of the family's keys of `[population]`, in their order.
    fn people_values(&self) -> Vec<Value>;

    /// Whether the other environment is of the same family and has the same values.
    fn equals(&self, other: &dyn Model) -> bool;

    /// The version of the simulation's code with these values in a scenario; 1 by default. Raise it whenever a change of
    /// the code changes results.
    fn version(&self, _scenario: &Scenario) -> u32 {
        1
    }

    /// The exact error rate of the inferred context; `None` if there is none, or if it differs between
    /// participants.
    fn context_error(&self) -> Option<f64> {
        None
    }

    /// What an agent sees in a scenario, and how many actions it chooses among.
    fn interface(&self, scenario: &Scenario) -> Interface;

    /// The unit of rewards and returns; that of the family by default.
    fn return_unit(&self) -> &'static str {
        self.family().return_unit
    }

    /// The meaning of every action, by number.
    fn actions(&self) -> Vec<String>;

    /// The meaning of every entry of one observation of a scenario, without a one-hot of time.
    fn meanings(&self, scenario: &Scenario) -> Vec<Meaning>;

    /// How an environment describes itself that is not known in advance, as JSON for the record. None by default.
    fn description(&self) -> Option<String> {
        None
    }

    /// The environment with the description of an earlier run; `None` by default.
    fn described(&self, description: &str) -> Option<Environment> {
        let _ = description;
        None
    }

    /// What a one-hot of time shows.
    fn clock(&self) -> String {
        "time".to_owned()
    }

    /// The number of steps of an episode that does not end early.
    fn longest_episode(&self) -> u32;

    /// The number of decisions of a day, where the environment has days of its own; `None` by default.
    fn decisions_per_day(&self) -> Option<u32> {
        None
    }

    /// Whether an episode can end before its last step. True by default.
    fn can_end_early(&self) -> bool {
        true
    }

    /// A simulation for the training, with this number of lanes, which shows `history` observations at a time.
    fn training(&self, scenario: &Scenario, history: usize, lanes: usize) -> Simulated;

    /// A simulation for the test, whose participants differ whatever the training meets.
    fn testing(&self, scenario: &Scenario, history: usize, lanes: usize) -> Simulated;

    /// The names of the numbers that a recorded state consists of. None by default.
    fn state_names(&self) -> Vec<String> {
        Vec::new()
    }

    /// The index in the recorded state of every feature of an observation; `None` for a feature that the state lacks. By
    /// default those of equal names.
    fn recorded_features(&self, scenario: &Scenario) -> Vec<Option<usize>> {
        let names = self.state_names();
        let features = self.interface(scenario).observations.features.into_iter();
        features.map(|feature| names.iter().position(|name| *name == feature.name)).collect()
    }

    /// How many of these names, the last ones, are of numbers that follow the choice of the action. None by default.
    fn late_state(&self) -> usize {
        0
    }

    /// The number of people among whom the participants are drawn, if it is finite. None by default.
    fn people_to_draw(&self) -> Option<usize> {
        None
    }

    /// The number of strata in which choices of action are counted. 1 by default.
    fn strata(&self) -> usize {
        1
    }

    /// Whether action 0 sends no message. True by default.
    fn has_nothing(&self) -> bool {
        true
    }

    /// The cost of a message to a person who does not differ; `None` if no message has a cost to anybody.
    fn message_cost(&self) -> Option<f64> {
        None
    }

    /// Whether the cost of a message differs between the moments of an episode. False by default.
    fn costs_vary(&self) -> bool {
        false
    }

    /// Whether bandits in a trial get the features of single observations in 64 bits. False by default.
    fn has_exact_features(&self) -> bool {
        false
    }

    /// The number of parameters in which participants of the test differ. None by default.
    fn differing(&self) -> usize {
        0
    }

    /// Describes the first `count` participants of a stream: participant from 1, index of the parameter, value.
    fn describe_participants(
        &self,
        stream: &mut Stream,
        count: u32,
        describe: &mut dyn FnMut(u32, u8, f64),
    ) {
        let _ = (stream, count, describe);
    }

    /// The same environment for another job, which shares no failures; `None`, the default, where simulations cannot fail.
    fn fresh(&self) -> Option<Environment> {
        None
    }

    /// Why a simulation could not go on. None by default.
    fn failure(&self) -> Option<String> {
        None
    }

    /// Whether messages can be unavailable at some steps for anybody.
    fn can_withhold(&self) -> bool {
        false
    }
}

/// The meaning of an entry of an observation.
#[derive(Clone, Debug, PartialEq)]
pub struct Meaning {
    /// What it is.
    pub meaning: String,
    /// Its unit before scaling; may be empty.
    pub unit: String,
    /// The factor that turns a number in this unit into the entry.
    pub scale: f64,
}

/// An environment as a job holds it: a family with values of its keys. Copies share the values.
#[derive(Clone)]
pub struct Environment(Arc<dyn Model>);

impl Environment {
    /// The environment of a model.
    pub fn of(model: impl Model) -> Environment {
        Environment(Arc::new(model))
    }

    /// The model, if it is of this type.
    pub fn model<M: Model>(&self) -> Option<&M> {
        (&*self.0 as &dyn Any).downcast_ref()
    }
}

impl Deref for Environment {
    type Target = dyn Model;

    fn deref(&self) -> &(dyn Model + 'static) {
        &*self.0
    }
}

impl PartialEq for Environment {
    fn eq(&self, other: &Environment) -> bool {
        Arc::ptr_eq(&self.0, &other.0) || self.0.equals(&**other)
    }
}

impl fmt::Debug for Environment {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}
