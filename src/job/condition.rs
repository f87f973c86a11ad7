//! Conditions on jobs, as exclusions, analyses and filters state them, and the trait for what they test.

use super::Scalar;
use crate::key::{Parameter, Value};

/// A condition on a job: the parameter has one of the values. Jobs without the parameter do not meet it.
#[derive(Clone, Debug, PartialEq)]
pub struct Condition {
    /// The parameter.
    pub parameter: Parameter,
    /// The values that meet the condition.
    pub values: Vec<Value>,
}

/// The subject of conditions: a job and the name of its agent.
pub trait Described {
    /// The value of a parameter, the agent's name included; `None` if the job has no such parameter.
    fn value(&self, parameter: Parameter) -> Option<Scalar>;
}

impl<T: Described> Described for &T {
    fn value(&self, parameter: Parameter) -> Option<Scalar> {
        (**self).value(parameter)
    }
}

impl Condition {
    /// The condition that a parameter has one of some texts.
    pub fn texts(
        parameter: Parameter,
        texts: impl IntoIterator<Item = impl ToString>,
    ) -> Condition {
        let values = texts.into_iter().map(|text| Value::Text(text.to_string())).collect();
        Condition { parameter, values }
    }

    /// Whether a job meets the condition.
    pub fn is_met_by(&self, job: &impl Described) -> bool {
        let found = job.value(self.parameter);
        found.is_some_and(|found| self.values.iter().any(|value| Scalar::from(value) == found))
    }

    /// The dotted name of the parameter.
    pub fn name(&self) -> String {
        self.parameter.to_string()
    }

    /// The values that meet the condition, as jobs have them.
    pub fn scalars(&self) -> Vec<Scalar> {
        self.values.iter().map(Scalar::from).collect()
    }

    /// The condition that is met if this one or the other is met; `None` if they concern different
    /// parameters.
    pub fn or(&self, other: &Condition) -> Option<Condition> {
        let mut either = self.clone();
        either.values.extend(other.values.iter().cloned());
        (self.parameter == other.parameter).then_some(either)
    }
}

/// The short name of a parameter beside others: the dotted name if another of them has the same short name.
pub fn short_beside(dotted: &str, others: impl IntoIterator<Item = impl AsRef<str>>) -> &str {
    let short = short_name(dotted);
    let is_same = |other: &str| other != dotted && short_name(other) == short;
    if others.into_iter().any(|other| is_same(other.as_ref())) { dotted } else { short }
}

/// The last part of a dotted name: `horizon` of `environment.horizon`. Keys of a population keep their full
/// names, because the environment has keys of the same name.
pub fn short_name(dotted: &str) -> &str {
    if dotted.starts_with("population.") {
        return dotted;
    }
    dotted.rsplit('.').next().unwrap_or(dotted)
}
