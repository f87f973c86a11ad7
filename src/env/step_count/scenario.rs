//! What the agent observes.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

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
}

impl Feature {
    /// All features, in the order of the documentation.
    pub const ALL: [Feature; 10] = [
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
        }
    }

    /// The number of entries of an observation that the feature takes.
    pub fn width(self) -> usize {
        match self {
            Feature::PreviousAction => OPTIONS,
            Feature::Context
            | Feature::Probability
            | Feature::Likely
            | Feature::Habituation
            | Feature::Disengagement
            | Feature::Time
            | Feature::Available
            | Feature::Budget
            | Feature::PreviousSteps => 1,
        }
    }

    fn from_letter(letter: char) -> Option<Feature> {
        Feature::ALL.into_iter().find(|f| f.letter() == letter)
    }
}

/// An observation scenario: the features that an agent sees, in order, such as `P-H-D`.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Scenario(Vec<Feature>);

impl Scenario {
    /// The scenario that shows only this feature.
    pub fn of(feature: Feature) -> Scenario {
        Scenario(vec![feature])
    }

    /// The distinct features, in the order of the observation's entries; never empty.
    pub fn features(&self) -> &[Feature] {
        &self.0
    }

    /// The number of entries of an observation, without a one-hot of time.
    pub fn width(&self) -> usize {
        self.0.iter().map(|feature| feature.width()).sum()
    }

    /// Whether it shows the context's probability and not the context.
    pub fn shows_probability_alone(&self) -> bool {
        self.0.contains(&Feature::Probability) && !self.0.contains(&Feature::Context)
    }

    /// Whether it shows both habituation and disengagement risk.
    pub fn shows_state(&self) -> bool {
        [Feature::Habituation, Feature::Disengagement].iter().all(|f| self.0.contains(f))
    }
}

/// Why a text is not a scenario.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ScenarioError {
    /// The text is empty.
    #[error("a scenario needs at least one letter")]
    Empty,
    /// A part between hyphens is not a known letter.
    #[error("`{0}` is not a feature")]
    UnknownLetter(String),
    /// A letter is listed twice.
    #[error("feature `{0}` is listed twice")]
    Repeated(char),
}

impl FromStr for Scenario {
    type Err = ScenarioError;

    fn from_str(text: &str) -> Result<Self, ScenarioError> {
        if text.is_empty() {
            return Err(ScenarioError::Empty);
        }
        let mut features = Vec::new();
        for part in text.split('-') {
            let mut letters = part.chars();
            let feature = match (letters.next(), letters.next()) {
                (Some(letter), None) => Feature::from_letter(letter),
                _ => None,
            };
            let Some(feature) = feature else {
                return Err(ScenarioError::UnknownLetter(part.to_owned()));
            };
            if features.contains(&feature) {
                return Err(ScenarioError::Repeated(feature.letter()));
            }
            features.push(feature);
        }
        Ok(Scenario(features))
    }
}

impl fmt::Display for Scenario {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, feature) in self.0.iter().enumerate() {
            if i > 0 {
                f.write_str("-")?;
            }
            write!(f, "{}", feature.letter())?;
        }
        Ok(())
    }
}

impl TryFrom<String> for Scenario {
    type Error = ScenarioError;

    fn try_from(text: String) -> Result<Self, ScenarioError> {
        text.parse()
    }
}

impl From<Scenario> for String {
    fn from(scenario: Scenario) -> String {
        scenario.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenarios_read_back_as_written() {
        for text in ["C-H-D", "L-H-D", "P-H-D", "C-T", "L-T", "P-T", "T-D-P", "C", "P-M-S-A-B"] {
            assert_eq!(text.parse::<Scenario>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn faulty_scenarios_say_what_is_wrong() {
        let fault = |text: &str| text.parse::<Scenario>().unwrap_err();
        assert_eq!(fault(""), ScenarioError::Empty);
        assert_eq!(fault("P-X"), ScenarioError::UnknownLetter("X".into()));
        assert_eq!(fault("PH"), ScenarioError::UnknownLetter("PH".into()));
        assert_eq!(fault("P-"), ScenarioError::UnknownLetter(String::new()));
        assert_eq!(fault("P-H-P"), ScenarioError::Repeated('P'));
    }
}
