//! The two sides of a difference.

use super::written::quoted;
use crate::job::Condition;
use crate::key::Parameter;

/// Two sides of a difference: two conditions on the same parameter, with one value each.
#[derive(Clone, Debug, PartialEq)]
pub struct Sides {
    /// The minuend.
    pub first: Condition,
    /// The subtrahend.
    pub second: Condition,
}

impl Sides {
    /// `by` and `between`, as a manifest writes them.
    pub(super) fn written(&self) -> Vec<(&'static str, String)> {
        let value = |condition: &Condition| condition.values[0].to_string();
        let between = format!("[{}, {}]", value(&self.first), value(&self.second));
        vec![("by", quoted(&self.first.name())), ("between", between)]
    }

    /// Both sides.
    pub(super) fn both(&self) -> [&Condition; 2] {
        [&self.first, &self.second]
    }

    /// The dotted name of the key that distinguishes the sides; empty if no key does.
    pub fn key(&self) -> String {
        match self.first.parameter {
            Parameter::Job(_) | Parameter::AGENT_NAME => String::new(),
            parameter => parameter.to_string(),
        }
    }
}
