//! Constraints between keys: requirements that one key has on another, and limits on the size that
//! several keys together give a job.
//!
//! In: the values of some keys in one cell of a grid. Out: the violation, if there is one. The
//! constraints themselves stand beside the keys that they concern.

use std::borrow::Cow;

use super::content::Content;
use super::declare::Keyed;
use super::parameter::Parameter;
use super::value::Value;
use crate::text::FaultList;

/// A constraint on jobs.
#[derive(Debug)]
pub struct Constraint {
    /// The parameters concerned.
    pub parameters: &'static [Parameter],
    /// The violation by the values of these parameters, if there is one.
    pub violation: fn(&Assignment) -> Option<Violation>,
}

/// How values violate a constraint.
#[derive(Debug)]
pub enum Violation {
    /// Two keys contradict each other; the text says how.
    Contradiction(String),
    /// The values demand something impossible.
    Impossible {
        /// The fault.
        says: String,
        /// The remedy.
        help: String,
    },
    /// One key, or the scenario, demands something impossible.
    ImpossibleAt {
        /// The key.
        parameter: Parameter,
        /// The fault.
        says: String,
        /// The remedy.
        help: String,
    },
    /// These faults of a file that a key names.
    InFile {
        /// The key.
        parameter: Parameter,
        /// The content of the file.
        content: Content,
        /// The faults, by their positions in the text.
        faults: FaultList,
    },
    /// The keys together exceed a limit.
    TooLarge(Size),
}

/// A size to which several keys of a job contribute, and its limit: "`what` `size` `unit`; the
/// maximum is `most`".
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size {
    /// The quantity, as in "the network has".
    pub what: &'static str,
    /// The unit, as in "parameters".
    pub unit: &'static str,
    /// The actual size.
    pub size: u64,
    /// The maximum size.
    pub most: u64,
}

impl Size {
    /// Whether the size is above its limit.
    pub fn is_too_large(&self) -> bool {
        self.size > self.most
    }

    /// The violation, if the size is above its limit.
    pub fn violation(self) -> Option<Violation> {
        self.is_too_large().then_some(Violation::TooLarge(self))
    }
}

/// The values that a cell assigns to the parameters of a constraint. The value of
/// [`Parameter::SCENARIO`] is the name of the scenario.
#[derive(Clone, Debug)]
pub struct Assignment<'v>(pub Vec<(Parameter, Cow<'v, Value>)>);

impl<'v> Assignment<'v> {
    /// The same values, with another value of a parameter.
    pub fn with(&self, parameter: Parameter, value: Value) -> Assignment<'v> {
        let mut other = self.clone();
        let known = other.0.iter_mut().find(|(known, _)| *known == parameter);
        known.into_iter().for_each(|(_, known)| *known = Cow::Owned(value.clone()));
        other
    }

    /// The parameters with their values as a manifest writes them, without flags that are not set.
    pub fn listed(&self) -> String {
        let counted = self.0.iter().filter(|(_, value)| **value != Value::Flag(false));
        let pairs = counted.map(|(key, value)| format!("{} = {value}", key.key()));
        pairs.collect::<Vec<_>>().join(", ")
    }

    /// The parameters.
    pub fn parameters(&self) -> impl Iterator<Item = Parameter> {
        self.0.iter().map(|(parameter, _)| *parameter)
    }

    /// The value of a parameter; `None` if the cell has no such parameter.
    pub fn value(&self, parameter: Parameter) -> Option<&Value> {
        self.0.iter().find(|(known, _)| *known == parameter).map(|(_, value)| value.as_ref())
    }

    /// The values of the parameters of one kind, in their order.
    pub fn values_of(&self, is_of: fn(&Parameter) -> bool) -> Vec<Value> {
        let values = self.0.iter().filter(|(parameter, _)| is_of(parameter));
        values.map(|(_, value)| value.clone().into_owned()).collect()
    }

    /// The struct whose keys are the parameters of one kind; `None` if some keys are missing.
    pub fn keyed<T: Keyed>(&self, is_of: fn(&Parameter) -> bool) -> Option<T> {
        T::from_values(&self.values_of(is_of))
    }

    /// The value of an integer key; 1 for other keys.
    pub fn whole(&self, key: Parameter) -> u64 {
        if let Some(Value::Integer(whole)) = self.value(key) { *whole } else { 1 }
    }

    /// The value of a real-valued key; 0 for other keys.
    pub fn real(&self, key: Parameter) -> f64 {
        if let Some(Value::Real(real)) = self.value(key) { *real } else { 0.0 }
    }

    /// Whether a key has this word.
    pub fn is_word(&self, key: Parameter, word: &'static str) -> bool {
        self.value(key) == Some(&Value::Choice(word))
    }

    /// Whether a flag is set.
    pub fn is_set(&self, key: Parameter) -> bool {
        self.value(key) == Some(&Value::Flag(true))
    }

    /// The text of a parameter; empty for parameters without a text.
    pub fn text(&self, parameter: Parameter) -> &str {
        if let Some(Value::Text(text)) = self.value(parameter) { text } else { "" }
    }

    /// The value of a key as a manifest writes it.
    pub fn shown(&self, key: Parameter) -> String {
        self.value(key).map(ToString::to_string).unwrap_or_default()
    }

    /// The violation "`first` `says` `second`", with the values found.
    pub fn contradiction(&self, first: Parameter, says: &str, second: Parameter) -> Violation {
        let (one, other) = (self.shown(first), self.shown(second));
        let (first, second) = (first.key(), second.key());
        Violation::Contradiction(format!("`{first}` {says} `{second}`, found {one} and {other}"))
    }
}
