//! The letters of scenarios: the features that an agent can observe.

use crate::env::scenario::{Scenario, ScenarioError};
use crate::env::step_count::intervention::OPTIONS;

/// A feature of the state that observations can show.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Feature {
    /// `C`: the true context c_t, 0 or 1.
    Context,
    /// `P`: the inferred probability of a context, in [0, 1].
    Probability,
    /// `L`: the most likely context l_t, 0 or 1.
    Likely,
    /// `H`: habituation h_t, in [0, 1].
    Habituation,
    /// `D`: disengagement risk d_t, in [0, 1].
    Disengagement,
    /// `T`: the time indicator i_t = mod(t, period).
    Time,
    /// `A`: whether a message can be sent, 0 or 1.
    Available,
    /// `B`: the remaining share of the message budget, in [0, 1].
    Budget,
    /// `M`: the action taken in the last step, as one entry per action; all 0 in the first step.
    PreviousAction,
    /// `S`: the steps walked in the last step, in hundreds.
    PreviousSteps,
    /// `F`: the filtered probability of a context, in [0, 1].
    Filtered,
    /// `E`: the mean and the standard deviation of habituation, as a phone can estimate them.
    EstimatedHabituation,
    /// `R`: the mean and the standard deviation of disengagement risk as a phone can estimate them, and the
    /// probability that a wrong message would end the episode.
    EstimatedRisk,
}

impl Feature {
    /// All features, in the order of the documentation.
    pub const ALL: [Feature; 13] = [
        Feature::Context,
        Feature::Probability,
        Feature::Likely,
        Feature::Habituation,
        Feature::Disengagement,
        Feature::Time,
        Feature::Available,
        Feature::Budget,
        Feature::PreviousAction,
        Feature::PreviousSteps,
        Feature::Filtered,
        Feature::EstimatedHabituation,
        Feature::EstimatedRisk,
    ];

    /// The letter of this feature in a scenario.
    pub fn letter(self) -> char {
        match self {
            Feature::Context => 'C',
            Feature::Probability => 'P',
            Feature::Likely => 'L',
            Feature::Habituation => 'H',
            Feature::Disengagement => 'D',
            Feature::Time => 'T',
            Feature::Available => 'A',
            Feature::Budget => 'B',
            Feature::PreviousAction => 'M',
            Feature::PreviousSteps => 'S',
            Feature::Filtered => 'F',
            Feature::EstimatedHabituation => 'E',
            Feature::EstimatedRisk => 'R',
        }
    }

    /// The number of entries of an observation that the feature takes.
    pub fn width(self) -> usize {
        match self {
            Feature::PreviousAction => OPTIONS,
            Feature::EstimatedHabituation => 2,
            Feature::EstimatedRisk => 3,
            Feature::Context
            | Feature::Probability
            | Feature::Likely
            | Feature::Habituation
            | Feature::Disengagement
            | Feature::Time
            | Feature::Available
            | Feature::Budget
            | Feature::PreviousSteps
            | Feature::Filtered => 1,
        }
    }

    /// The feature of this letter.
    fn named(name: &str) -> Option<Feature> {
        Feature::ALL.into_iter().find(|feature| name.chars().eq([feature.letter()]))
    }
}

impl Scenario {
    /// The scenario that shows only this feature.
    pub fn of(feature: Feature) -> Scenario {
        let mut letter = [0; 4];
        let name: &str = feature.letter().encode_utf8(&mut letter);
        Scenario::of_names([name]).expect("a letter is a name")
    }

    /// The distinct features, in the order of the observation's entries.
    pub fn features(&self) -> Vec<Feature> {
        self.names().into_iter().flatten().filter_map(Feature::named).collect()
    }

    /// The number of entries of an observation, without a one-hot of time.
    pub fn width(&self) -> usize {
        self.features().iter().map(|feature| feature.width()).sum()
    }

    /// Whether it shows the context's probability and not the context.
    pub fn shows_probability_alone(&self) -> bool {
        let features = self.features();
        features.contains(&Feature::Probability) && !features.contains(&Feature::Context)
    }

    /// Whether it shows both habituation and disengagement risk.
    pub fn shows_state(&self) -> bool {
        let features = self.features();
        [Feature::Habituation, Feature::Disengagement].iter().all(|f| features.contains(f))
    }
}

/// Checks that every name of a scenario is a letter.
///
/// **Errors**: the first other name.
pub(super) fn check(scenario: &Scenario) -> Result<(), ScenarioError> {
    let unknown = |name: &str| ScenarioError::Unknown(name.to_owned());
    let mut names = scenario.names().ok_or_else(|| unknown(&scenario.to_string()))?;
    let other = names.find(|name| Feature::named(name).is_none());
    other.map_or(Ok(()), |name| Err(unknown(name)))
}

/// The scenario of these letters, joined by hyphens.
///
/// **Errors**: a name is not a letter, or occurs twice; there are none.
pub fn letters(text: &str) -> Result<Scenario, ScenarioError> {
    let scenario = text.parse()?;
    check(&scenario).map(|()| scenario)
}

/// What a scenario consists of, for messages.
pub(super) fn expected() -> String {
    let letters = Feature::ALL.map(|feature| feature.letter().to_string()).join(", ");
    format!("letters of {letters}, each at most once, joined by hyphens")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_of_a_scenario_is_a_letter() {
        let fault = |text: &str| check(&text.parse().unwrap());
        assert_eq!(fault("P-M-S-A-B"), Ok(()));
        assert_eq!(fault("F-E-R"), Ok(()));
        assert_eq!(fault("P-X"), Err(ScenarioError::Unknown("X".into())));
        assert_eq!(fault("PH"), Err(ScenarioError::Unknown("PH".into())));
        assert_eq!(fault("all"), Err(ScenarioError::Unknown("all".into())));
    }
}
