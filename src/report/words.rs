//! Number formats of units.

use crate::job::MetricUnit;

/// The format of numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NumberFormat {
    /// Unchanged.
    Plain,
    /// As a percentage.
    Percent,
}

impl NumberFormat {
    /// The factor from a number to its displayed form.
    pub fn factor(self) -> f64 {
        match self {
            NumberFormat::Plain => 1.0,
            NumberFormat::Percent => 100.0,
        }
    }
}

/// The format of numbers in a unit, and their number of decimals.
pub fn unit_numbers(unit: impl Into<MetricUnit>) -> (NumberFormat, usize) {
    match unit.into() {
        MetricUnit::Share => (NumberFormat::Percent, 1),
        MetricUnit::Steps => (NumberFormat::Plain, 1),
        MetricUnit::Return | MetricUnit::Plain => (NumberFormat::Plain, 0),
    }
}
