//! Ranges of numbers.

/// The numbers that a key or a draw of a distribution accepts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NumberRange {
    /// The minimum; `None` for numbers above 0.
    pub min: Option<f64>,
    /// The maximum.
    pub max: f64,
}

impl NumberRange {
    /// Whether a number lies in the range.
    pub fn admits(self, number: f64) -> bool {
        let is_high_enough = self.min.map_or(number > 0.0, |min| number >= min);
        is_high_enough && number <= self.max
    }

    /// The description of the numbers, to follow "expected".
    pub fn expectation(self) -> String {
        match self.min {
            Some(min) => format!("a number from {min} to {}", self.max),
            None => format!("a number above 0 and at most {}", self.max),
        }
    }
}
