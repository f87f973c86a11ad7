//! The names of the numbers in the recorded state of a decision.

use std::ops::{Deref, Range};

use crate::env::Environment;
use crate::env::recorded::{self, RECORDED_PROBABILITY};

/// The names in the order of the numbers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StateNames {
    names: Vec<String>,
    /// The numbers that follow the choice of the action; all others are known before it.
    late: Range<usize>,
    /// The index of the probability with which a trial that happened took its action.
    recorded: Option<usize>,
}

impl StateNames {
    /// The names of an environment's state, and others behind them.
    pub fn new(environment: &Environment, others: impl IntoIterator<Item = String>) -> StateNames {
        let mut names = environment.state_names();
        let late = names.len() - environment.late_state()..names.len();
        let is_recorded = environment.family() == &recorded::FAMILY;
        let recorded = names.iter().position(|name| is_recorded && name == RECORDED_PROBABILITY);
        names.extend(others);
        StateNames { names, late, recorded }
    }

    /// Names of the state of a trial that happened.
    #[cfg(test)]
    pub(crate) fn of_recorded(names: Vec<String>) -> StateNames {
        let recorded = names.iter().position(|name| name == RECORDED_PROBABILITY);
        StateNames { recorded, ..names.into() }
    }

    /// Whether the number at an index follows the choice of the action.
    pub fn is_late(&self, index: usize) -> bool {
        self.late.contains(&index)
    }

    /// The index of the probability with which a trial that happened took its action; `None` of all other trials.
    pub fn recorded(&self) -> Option<usize> {
        self.recorded
    }

    /// The names.
    pub fn into_names(self) -> Vec<String> {
        self.names
    }
}

impl From<Vec<String>> for StateNames {
    /// Names of numbers that are all known before the choice.
    fn from(names: Vec<String>) -> StateNames {
        StateNames { names, late: 0..0, recorded: None }
    }
}

impl Deref for StateNames {
    type Target = [String];

    fn deref(&self) -> &[String] {
        &self.names
    }
}
