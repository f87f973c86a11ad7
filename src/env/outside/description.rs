//! What a program says about its environment.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

use crate::env::observation::{FeatureSpec, ObservationSpec};
use crate::env::scenario::Scenario;
use crate::external::{Declared, DeclaredFeature, ENVIRONMENT_PROTOCOL};

/// Maximum number of features, of numbers of the state, and of characters of a name and a text.
const MOST_FEATURES: usize = 1000;
const MOST_STATE: usize = 100;
const LONGEST_NAME: usize = 64;
const LONGEST_TEXT: usize = 200;
/// The permitted numbers of actions.
const ACTIONS: std::ops::RangeInclusive<usize> = 2..=256;
/// The largest horizon.
const LONGEST_EPISODE: u64 = 10_000_000;

/// An environment as its program describes it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Description {
    /// The features of a complete observation, in their order.
    pub features: Vec<DescribedFeature>,
    /// The names of the actions.
    pub actions: Vec<String>,
    /// The number of the action that does nothing, if there is one.
    pub nothing: Option<usize>,
    /// Maximum number of steps of an episode.
    pub horizon: u32,
    /// The smallest reward of a step; `None` is unbounded.
    pub lowest_reward: Option<f64>,
    /// The largest reward of a step; `None` is unbounded.
    pub highest_reward: Option<f64>,
    /// The unit of rewards and returns.
    pub unit: Option<String>,
    /// The names of the numbers that the recorded state consists of.
    pub state: Vec<String>,
    /// Whether there are steps in which only the first action is possible.
    pub availability: bool,
    /// Whether the parameters may differ between the participants of a job.
    pub participants: bool,
}

/// A feature of an observation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DescribedFeature {
    /// Its name.
    pub name: String,
    /// Its smallest value; `None` is unbounded.
    pub low: Option<f32>,
    /// Its largest value; `None` is unbounded.
    pub high: Option<f32>,
    /// Its unit.
    pub unit: Option<String>,
    /// What it is.
    pub meaning: Option<String>,
}

impl Description {
    /// Reads the answer of a program.
    ///
    /// **Errors**: a description of the first fault, with the field.
    pub(super) fn of(declared: Declared) -> Result<Description, String> {
        if declared.protocol != ENVIRONMENT_PROTOCOL {
            return Err(format!(
                "expected protocol {ENVIRONMENT_PROTOCOL}, found {}; use versions of the program and of \
                 jitai with the same protocol",
                declared.protocol
            ));
        }
        let Declared { features, actions, nothing, horizon, reward, unit, state, .. } = declared;
        counted("features", features.len(), 1..=MOST_FEATURES)?;
        names("features", features.iter().map(|feature| &feature.name))?;
        counted("actions", actions.len(), ACTIONS)?;
        names("actions", actions.iter())?;
        counted("state", state.len(), 0..=MOST_STATE)?;
        names("state", state.iter())?;
        let nothing = nothing.map(|name| numbered(&actions, &name)).transpose()?;
        if let Some(index) = nothing.filter(|index| *index != 0) {
            return Err(format!(
                "`nothing`: expected the first action, `{}`, found `{}`; list the action that does nothing first",
                actions[0], actions[index],
            ));
        }
        if declared.availability && nothing.is_none() {
            return Err("`availability` needs `nothing`, the name of the first action".to_owned());
        }
        if !(1..=LONGEST_EPISODE).contains(&horizon) {
            return Err(format!(
                "`horizon`: expected a number of steps from 1 to {LONGEST_EPISODE}, found {horizon}"
            ));
        }
        let [lowest_reward, highest_reward] = reward.unwrap_or_default();
        if lowest_reward.zip(highest_reward).is_some_and(|(low, high)| low > high) {
            return Err("`reward`: the smallest reward is above the largest".to_owned());
        }
        Ok(Description {
            features: features.into_iter().map(feature).collect::<Result<_, _>>()?,
            actions,
            nothing,
            horizon: horizon as u32,
            lowest_reward,
            highest_reward,
            unit: unit.map(|unit| text("unit", unit)).transpose()?,
            state,
            availability: declared.availability,
            participants: declared.participants,
        })
    }

    /// The numbers of the features that a scenario shows.
    ///
    /// **Errors**: a description, if there is no feature of a name.
    pub fn shown(&self, scenario: &Scenario) -> Result<Vec<usize>, String> {
        let Some(names) = scenario.names() else { return Ok((0..self.features.len()).collect()) };
        let number = |name| {
            let found = self.features.iter().position(|feature| feature.name == name);
            found.ok_or_else(|| {
                let all: Vec<&str> = self.features.iter().map(|one| one.name.as_str()).collect();
                format!(
                    "scenario `{scenario}`: the environment has no feature `{name}`; its features are {}",
                    all.join(", ")
                )
            })
        };
        names.map(number).collect()
    }

    /// The specification of observations that show these features, by their numbers.
    pub fn observation_spec(&self, shown: &[usize]) -> ObservationSpec {
        let feature = |number: &usize| {
            let DescribedFeature { name, low, high, .. } = &self.features[*number];
            let (low, high) = (low.unwrap_or(f32::NEG_INFINITY), high.unwrap_or(f32::INFINITY));
            FeatureSpec { name: name.clone(), low, high }
        };
        ObservationSpec { features: shown.iter().map(feature).collect(), one_hot: 0 }
    }
}

fn counted(
    field: &str,
    found: usize,
    permitted: std::ops::RangeInclusive<usize>,
) -> Result<(), String> {
    if permitted.contains(&found) {
        return Ok(());
    }
    let (least, most) = permitted.into_inner();
    Err(format!("`{field}`: expected {least} to {most} entries, found {found}"))
}

/// Checks that names are words, and that no name occurs twice.
fn names<'n>(field: &str, names: impl Iterator<Item = &'n String>) -> Result<(), String> {
    let mut seen = BTreeSet::new();
    for name in names {
        let is_word = |c: char| c.is_ascii_alphanumeric() || c == '_';
        if name.is_empty() || name.len() > LONGEST_NAME || !name.chars().all(is_word) {
            return Err(format!(
                "`{field}`: expected names of 1 to {LONGEST_NAME} letters, digits and underscores, \
                 found {name:?}"
            ));
        }
        if !seen.insert(name) {
            return Err(format!("`{field}`: the name `{name}` occurs twice"));
        }
    }
    Ok(())
}

fn numbered(actions: &[String], name: &str) -> Result<usize, String> {
    let found = actions.iter().position(|action| action == name);
    found.ok_or_else(|| format!("`nothing`: expected the name of an action, found {name:?}"))
}

fn text(field: &str, text: String) -> Result<String, String> {
    match text.chars().count() <= LONGEST_TEXT && !text.chars().any(char::is_control) {
        true => Ok(text),
        false => Err(format!("`{field}`: expected one line of at most {LONGEST_TEXT} characters")),
    }
}

fn feature(declared: DeclaredFeature) -> Result<DescribedFeature, String> {
    let DeclaredFeature { name, low, high, unit, meaning } = declared;
    let single = |bound: Option<f64>| match bound.map(|bound| bound as f32) {
        Some(bound) if !bound.is_finite() => Err(format!(
            "`features`: a bound of `{name}` is too large; leave it out if the feature is unbounded"
        )),
        bound => Ok(bound),
    };
    let (low, high) = (single(low)?, single(high)?);
    if low.zip(high).is_some_and(|(low, high)| low >= high) {
        return Err(format!("`features`: expected `low` below `high` for `{name}`"));
    }
    let unit = unit.map(|unit| text("unit", unit)).transpose()?;
    let meaning = meaning.map(|meaning| text("meaning", meaning)).transpose()?;
    Ok(DescribedFeature { name, low, high, unit, meaning })
}
