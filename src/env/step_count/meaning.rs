//! What actions and the entries of observations mean, for those who use a policy elsewhere.

use super::parameters::StepCount;
use super::scenario::Feature;
use crate::env::family::Meaning;
use crate::env::scenario::Scenario;

/// The meaning of the actions, by number.
pub(super) const ACTIONS: [&str; 4] = [
    "nothing",
    "a message that is not tailored",
    "a message tailored to context 0",
    "a message tailored to context 1",
];

/// What letters of estimates show, entry by entry.
const MOMENTS: [&str; 2] = ["mean", "standard deviation"];

/// What the clock shows.
pub(super) fn clock(environment: &StepCount) -> String {
    format!("clock ({})", environment.time_indicator.word())
}

/// The meaning of every entry of one observation, without a one-hot of time.
pub(super) fn meanings(environment: &StepCount, scenario: &Scenario) -> Vec<Meaning> {
    let each = scenario.features().into_iter();
    each.flat_map(|letter| (0..letter.width()).map(move |at| meaning(environment, letter, at)))
        .collect()
}

/// The meaning of an entry of an observation: the one of a feature at this index.
fn meaning(environment: &StepCount, feature: Feature, at: usize) -> Meaning {
    let (meaning, unit, scale) = match feature {
        Feature::Context => ("true context".to_owned(), "0 or 1", 1.0),
        Feature::Probability => {
            let context = environment.observed_probability;
            (format!("inferred probability of context {context}"), "probability", 1.0)
        }
        Feature::Likely => ("most likely context".to_owned(), "0 or 1", 1.0),
        Feature::Habituation => ("habituation".to_owned(), "0 to 1", 1.0),
        Feature::Disengagement => ("disengagement risk".to_owned(), "0 to 1", 1.0),
        Feature::Time => {
            let period = environment.time_indicator_period;
            (format!("{} modulo {period}", clock(environment)), "steps of the episode", 1.0)
        }
        Feature::Available => ("whether a message can be sent".to_owned(), "0 or 1", 1.0),
        Feature::Budget => {
            let budget = environment.message_budget;
            let noun = if budget == 1 { "message" } else { "messages" };
            (format!("remaining share of the {budget} {noun}"), "0 to 1", 1.0)
        }
        Feature::PreviousAction => {
            (format!("whether the previous action was {}", ACTIONS[at]), "0 or 1", 1.0)
        }
        Feature::PreviousSteps => ("steps walked in the previous step".to_owned(), "steps", 0.01),
        Feature::Filtered => {
            let context = environment.observed_probability;
            (format!("filtered probability of context {context}"), "probability", 1.0)
        }
        Feature::EstimatedHabituation => {
            (format!("{} of habituation as estimated", MOMENTS[at]), "0 to 1", 1.0)
        }
        Feature::EstimatedRisk => match MOMENTS.get(at) {
            Some(moment) => (format!("{moment} of disengagement risk as estimated"), "0 to 1", 1.0),
            None => {
                let near = "probability that a wrong message would end the episode";
                (near.to_owned(), "probability", 1.0)
            }
        },
    };
    Meaning { meaning, unit: unit.to_owned(), scale }
}
