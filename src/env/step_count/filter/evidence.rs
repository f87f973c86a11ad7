//! What a filter learns from a step.

use crate::env::step_count::dynamics::Dynamics;
use crate::env::vector::Action;

/// What a phone learns from a step.
#[derive(Clone, Copy, Debug)]
pub(in crate::env::step_count) struct Evidence {
    /// The action that was taken.
    pub(in crate::env::step_count) action: Action,
    /// The steps walked; `None` if the scenario does not show them, or if the step was not paid.
    pub(in crate::env::step_count) steps: Option<f64>,
    /// Whether the step reached the threshold of disengagement; `None` if beliefs leave this out.
    pub(in crate::env::step_count) disengaged: Option<bool>,
    /// The probability of context 0 that is inferred from the feature after the step alone.
    pub(in crate::env::step_count) probability: f64,
}

impl Evidence {
    /// The evidence of the action and the feature alone, for a step on which no state of a filter agrees with the rest.
    pub(super) fn of_action(&self) -> Evidence {
        Evidence { steps: None, disengaged: None, ..*self }
    }

    /// The disengagement risks that the evidence allows after the step: at least the first and less than the second.
    #[inline(always)]
    pub(super) fn risks(&self, dynamics: &Dynamics) -> [f64; 2] {
        let threshold = dynamics.disengagement_threshold;
        match self.disengaged {
            None => [f64::NEG_INFINITY, f64::INFINITY],
            Some(false) => [f64::NEG_INFINITY, threshold],
            Some(true) => [threshold, f64::INFINITY],
        }
    }
}
