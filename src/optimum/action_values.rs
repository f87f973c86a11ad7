//! The values of the actions in a state.

use crate::env::Action;

/// The value of each action in a state, in steps walked: its reward without the baseline, plus the mean
/// return after it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ActionValues {
    /// Nothing is sent.
    pub nothing: f64,
    /// A message that is not tailored.
    pub untailored: f64,
    /// A message tailored to the true context.
    pub suitable: f64,
    /// A message tailored to the other context.
    pub unsuitable: f64,
}

impl ActionValues {
    /// The best action if context 0 has this probability; ties go to the lowest number.
    pub fn best(&self, probability_of_zero: f64) -> Action {
        let tailored = |p: f64| p * self.suitable + (1.0 - p) * self.unsuitable;
        let values = [
            self.nothing,
            self.untailored,
            tailored(probability_of_zero),
            tailored(1.0 - probability_of_zero),
        ];
        let better =
            |best: usize, other: usize| if values[other] > values[best] { other } else { best };
        let best = (1..values.len()).fold(0, better);
        Action::from_index(best).expect("one value per action")
    }
}
