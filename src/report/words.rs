//! Number formats of units.

use crate::job::MetricUnit;

/// The format of numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Numbers {
    /// Unchanged.
    Plain,
    /// As a percentage.
    Percent,
}

impl Numbers {
    /// The factor from a number to its displayed form.
    pub fn factor(self) -> f64 {
        match self {
            Numbers::Plain => 1.0,
            Numbers::Percent => 100.0,
        }
    }
}

/// The format of numbers in a unit, and their number of decimals.
pub fn unit_numbers(unit: impl Into<MetricUnit>) -> (Numbers, usize) {
    match unit.into() {
        MetricUnit::Share => (Numbers::Percent, 1),
        MetricUnit::Steps => (Numbers::Plain, 1),
        MetricUnit::Return | MetricUnit::Plain => (Numbers::Plain, 0),
    }
}
