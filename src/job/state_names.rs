//! The names of the numbers in the recorded state of a decision.

use std::ops::{Deref, Range};

use crate::env::Environment;

/// The names in the order of the numbers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StateNames {
    names: Vec<String>,
    /// The numbers that follow the choice of the action; all others are known before it.
    late: Range<usize>,
}

impl StateNames {
    /// The names of an environment's state, and others behind them.
    pub fn new(environment: &Environment, others: impl IntoIterator<Item = String>) -> StateNames {
        let mut names = environment.state_names();
        let late = names.len() - environment.late_state()..names.len();
        names.extend(others);
        StateNames { names, late }
    }

    /// Whether the number at an index follows the choice of the action.
    pub fn is_late(&self, index: usize) -> bool {
        self.late.contains(&index)
    }

    /// The names.
    pub fn into_names(self) -> Vec<String> {
        self.names
    }
}

impl From<Vec<String>> for StateNames {
    /// Names of numbers that are all known before the choice.
    fn from(names: Vec<String>) -> StateNames {
        StateNames { names, late: 0..0 }
    }
}

impl Deref for StateNames {
    type Target = [String];

    fn deref(&self) -> &[String] {
        &self.names
    }
}
