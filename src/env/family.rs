//! Families of environments: what a manifest can name as `environment.family`.
//!
//! In: the values of a family's keys. Out: an [`Environment`], which makes simulations. A family is declared
//! once and registered, as an algorithm is by the agents.

use std::any::Any;
use std::fmt;
use std::ops::Deref;
use std::sync::Arc;

use crate::env::step_count::Scenario;
use crate::env::vector::Interface;
use crate::key::{Constraint, Key, Value};

/// A family of environments: its name, its keys and the rules between them.
pub struct Family {
    /// The name in manifests and in the store.
    pub name: &'static str,
    /// The keys of `[environment]`.
    pub keys: &'static [Key],
    /// The keys of `[population]`; empty where participants cannot differ.
    pub people: &'static [Key],
    /// Constraints between these keys, beyond the ranges of single keys.
    pub constraints: fn() -> Vec<&'static Constraint>,
    /// The unit of rewards and returns.
    pub return_unit: &'static str,
    /// The environment with these values, one for each key of `[environment]` and of `[population]`, in their
    /// order; `None` if a value has another type.
    pub read: fn(&[Value], &[Value]) -> Option<Environment>,
}

impl PartialEq for Family {
    fn eq(&self, other: &Family) -> bool {
        self.name == other.name
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

    /// The version of the simulation's code with these values; 1 by default. Raise it whenever a change of the
    /// code changes results.
    fn version(&self) -> u32 {
        1
    }

    /// The exact error rate of the inferred context; `None` if there is none, or if it differs between
    /// participants.
    fn context_error(&self) -> Option<f64> {
        None
    }

    /// What an agent sees in a scenario, and how many actions it chooses among.
    fn interface(&self, scenario: &Scenario) -> Interface;

    /// The number of steps of an episode that does not end early.
    fn longest_episode(&self) -> u32;

    /// Whether messages can be unavailable at some steps for anybody.
    fn can_withhold(&self) -> bool {
        false
    }
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
