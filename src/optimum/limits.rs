//! Which optima can be computed.

use crate::env::{Environment, Feature, Scenario};

/// Longest horizon, in steps, for which an optimum is computed.
pub const LONGEST_OPTIMUM: u32 = 200;

/// Why no optimum is computed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoOptimum {
    /// The scenario hides a part of the state.
    #[error(
        "no optimum is computed for {scenario}, which does not show both habituation (H) and \
         disengagement risk (D); that of {shown} is an upper bound"
    )]
    StateHidden {
        /// The scenario.
        scenario: Scenario,
        /// The scenario with the features that it lacks.
        shown: String,
    },
    /// Episodes are too long.
    #[error(
        "no optimum is computed for a horizon of {horizon} steps; {LONGEST_OPTIMUM} are the most"
    )]
    TooLong {
        /// Steps of an episode.
        horizon: u32,
    },
}

/// Whether an optimum can be computed.
///
/// **Errors**: the scenario hides a part of the state, or the horizon is too long.
pub fn check(environment: &Environment, scenario: &Scenario) -> Result<(), NoOptimum> {
    if !scenario.shows_state() {
        let hidden = |feature: &Feature| !scenario.features().contains(feature);
        let state = [Feature::Habituation, Feature::Disengagement].into_iter();
        let lacking: String = state.filter(hidden).map(|f| format!("-{}", f.letter())).collect();
        let shown = format!("{scenario}{lacking}");
        return Err(NoOptimum::StateHidden { scenario: scenario.clone(), shown });
    }
    let horizon = environment.horizon;
    if horizon > LONGEST_OPTIMUM { Err(NoOptimum::TooLong { horizon }) } else { Ok(()) }
}
