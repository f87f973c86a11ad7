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

    /// Whether the evidence allows this disengagement risk after the step.
    #[inline(always)]
    pub(super) fn agrees(&self, dynamics: &Dynamics, risk: f64) -> bool {
        let reaches = risk >= dynamics.disengagement_threshold;
        self.disengaged.is_none_or(|disengaged| disengaged == reaches)
    }
}
