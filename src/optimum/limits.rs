//! The environments and scenarios for which an optimum can be computed.

use crate::env::{
    Belief, DisengagementReward, Feature, Population, Scenario, StateNoise, StepCount, StepNoise,
    fewest_steps,
};
use crate::key::Keyed;

/// Longest horizon, in steps, for which an optimum is computed.
pub const LONGEST_OPTIMUM: u32 = 200;

/// Why no optimum is computed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoOptimum {
    /// The environment is of a family without an optimum.
    #[error("no optimum is computed in environments of the family {family}")]
    Family {
        /// The family.
        family: &'static str,
    },
    /// The scenario hides part of the state.
    #[error(
        "no optimum is computed for {scenario}, which does not show both habituation (H) and \
         disengagement risk (D); the optimum for {shown} is an upper bound"
    )]
    StateHidden {
        /// The scenario.
        scenario: Scenario,
        /// The scenario with its missing features added.
        shown: String,
    },
    /// A key of the environment has a value that the recursion does not support.
    #[error("no optimum can be computed with `{key}` = {value}")]
    NotKnown {
        /// The key.
        key: &'static str,
        /// Its value, as a manifest writes it.
        value: String,
    },
    /// Participants differ.
    #[error(
        "no optimum can be computed where participants differ in {}", names.join(", ")
    )]
    PeopleDiffer {
        /// The parameters that differ.
        names: Vec<&'static str>,
    },
    /// Episodes are too long.
    #[error(
        "no optimum is computed for a horizon of {horizon} steps; the maximum is {LONGEST_OPTIMUM}"
    )]
    TooLong {
        /// The number of steps in an episode.
        horizon: u32,
    },
}

/// Checks that an optimum can be computed.
///
/// **Errors**: the scenario hides part of the state, a key of the environment has a value that the recursion
/// does not support, or the horizon is too long.
pub fn check(environment: &StepCount, scenario: &Scenario) -> Result<(), NoOptimum> {
    if !scenario.shows_state() {
        let hidden = |feature: &Feature| !scenario.features().contains(feature);
        let state = [Feature::Habituation, Feature::Disengagement].into_iter();
        let lacking: String = state.filter(hidden).map(|f| format!("-{}", f.letter())).collect();
        let shown = format!("{scenario}{lacking}");
        return Err(NoOptimum::StateHidden { scenario: scenario.clone(), shown });
    }
    let knows_context = Belief::new(environment, scenario) == Belief::Certain;
    if let Some(key) = unsolved(environment, knows_context) {
        let value = environment.to_json()[key].to_string();
        return Err(NoOptimum::NotKnown { key, value });
    }
    let horizon = environment.horizon;
    if horizon > LONGEST_OPTIMUM { Err(NoOptimum::TooLong { horizon }) } else { Ok(()) }
}

/// Checks that all participants have the same parameters, as an optimum requires.
///
/// **Errors**: participants differ.
pub fn check_people(population: &Population) -> Result<(), NoOptimum> {
    let names: Vec<&str> = population.names().collect();
    if names.is_empty() { Ok(()) } else { Err(NoOptimum::PeopleDiffer { names }) }
}

/// The lower bound of the mean of gamma-distributed steps; smaller means are raised to it.
const LEAST_MEAN: f64 = 1e-5;

/// A key with a value that the recursion does not support, if there is one.
///
/// Gamma-distributed steps have the same mean as noise-free steps, and nothing else depends on them. An unpaid last
/// step does not affect the mean return, and a policy sends nothing in it. Where the context is known and the baseline
/// is the same in both, a right message is worth the same in both, whichever contexts follow.
fn unsolved(e: &StepCount, knows_context: bool) -> Option<&'static str> {
    let least = fewest_steps(e);
    let ends_at_once = e.initial_disengagement >= e.disengagement_threshold;
    let are_alike = knows_context && e.mu[0] == e.mu[1];
    let zero = e.disengagement_reward == DisengagementReward::Zero;
    let unsolved = [
        ("state_noise", e.state_noise != StateNoise::None),
        ("step_noise", e.step_noise == StepNoise::Gamma && least < LEAST_MEAN),
        ("parameter_spread", e.parameter_spread > 0.0),
        // If the baselines differ, the lost baseline depends on the context.
        ("disengagement_reward", zero && (e.mu[0] != e.mu[1] || ends_at_once)),
        ("steps_cut_at_zero", e.steps_cut_at_zero && least < 0.0),
        ("context_probability", e.context_probability != 0.5 && !are_alike),
        ("context_persistence", e.context_persistence > 0.0 && !are_alike),
        ("availability", e.availability < 1.0),
        ("message_budget", e.message_budget < e.horizon),
    ];
    unsolved.into_iter().find_map(|(key, is_unsolved)| is_unsolved.then_some(key))
}
