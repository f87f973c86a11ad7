//! What an agent observes of an environment: a scenario.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// The scenario that shows every feature.
const ALL: &str = "all";

/// Maximum length of the name of a feature, in characters.
const LONGEST_NAME: usize = 64;

/// An observation scenario: the features that an agent sees, in order, by their names joined by hyphens, such as
/// `P-H-D`; or `all`.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Scenario(Vec<String>);

impl Scenario {
    /// The scenario that shows every feature of an environment.
    pub fn all() -> Scenario {
        Scenario(vec![ALL.to_owned()])
    }

    /// The scenario that shows these features.
    ///
    /// **Errors**: a name is not one of a feature, or occurs twice; there are no names.
    pub fn of_names<'n>(
        names: impl IntoIterator<Item = &'n str>,
    ) -> Result<Scenario, ScenarioError> {
        let mut shown: Vec<String> = Vec::new();
        for name in names {
            let is_word = |c: char| c.is_ascii_alphanumeric() || c == '_';
            if name.is_empty() || name.len() > LONGEST_NAME || !name.chars().all(is_word) {
                return Err(ScenarioError::Unknown(name.to_owned()));
            }
            if shown.iter().any(|known| known == name) {
                return Err(ScenarioError::Repeated(name.to_owned()));
            }
            shown.push(name.to_owned());
        }
        if shown.is_empty() { Err(ScenarioError::Empty) } else { Ok(Scenario(shown)) }
    }

    /// The distinct names of the features, in the order of the observation's entries; never empty. `None` if every
    /// feature is shown.
    pub fn names(&self) -> Option<impl Iterator<Item = &str>> {
        let is_all = self.0.len() == 1 && self.0[0] == ALL;
        (!is_all).then(|| self.0.iter().map(String::as_str))
    }
}

/// Why a text is not a scenario.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ScenarioError {
    /// It names no feature.
    #[error("a scenario needs at least one feature")]
    Empty,
    /// A name is not one of a feature.
    #[error("`{0}` is not a feature")]
    Unknown(String),
    /// A feature is listed twice.
    #[error("feature `{0}` is listed twice")]
    Repeated(String),
}

impl FromStr for Scenario {
    type Err = ScenarioError;

    fn from_str(text: &str) -> Result<Self, ScenarioError> {
        if text.is_empty() {
            Err(ScenarioError::Empty)
        } else {
            Scenario::of_names(text.split('-'))
        }
    }
}

impl fmt::Display for Scenario {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0.join("-"))
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
        for text in ["C-H-D", "P-T", "C", "P-M-S-A-B", "position-pole_angle", "all"] {
            assert_eq!(text.parse::<Scenario>().unwrap().to_string(), text);
        }
        assert!(Scenario::all().names().is_none());
        assert!("C-T".parse::<Scenario>().unwrap().names().unwrap().eq(["C", "T"]));
    }

    #[test]
    fn faulty_scenarios_say_what_is_wrong() {
        let fault = |text: &str| text.parse::<Scenario>().unwrap_err();
        assert_eq!(fault(""), ScenarioError::Empty);
        assert_eq!(fault("P-"), ScenarioError::Unknown(String::new()));
        assert_eq!(fault("a b"), ScenarioError::Unknown("a b".into()));
        assert_eq!(fault("P-H-P"), ScenarioError::Repeated("P".into()));
    }
}
