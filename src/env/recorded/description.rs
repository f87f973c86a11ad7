//! What a store keeps of a recorded trial, whose file it does not keep.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::env::recorded::drawn::Randomisation;
use crate::env::recorded::log::RecordedLog;
use crate::env::recorded::parameters::LogParameters;
use crate::env::scenario::{Scenario, ScenarioError};

/// What agents and readers know of a recorded trial.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LogDescription {
    /// The unit of outcomes.
    pub unit: String,
    /// The number of actions.
    pub actions: usize,
    /// The names of the state.
    pub state: Vec<String>,
    /// The largest number of decisions of a person, in whole days.
    pub horizon: u32,
    /// Decisions of a person per day.
    pub decisions_per_day: u32,
    /// Whether some decisions admit no action but 0.
    pub availability: bool,
    /// Whether some outcomes did not reach the agent of the trial.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub missing: bool,
    /// The number of people.
    pub people: u32,
    /// What was found in the file that is no fault.
    pub notes: Vec<String>,
    /// Whether actions were drawn as recorded.
    pub randomisation: Randomisation,
    /// The names of the people in the file, if they are kept.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub identifiers: Option<Vec<String>>,
}

impl LogDescription {
    pub(super) fn of(parameters: &LogParameters, log: &RecordedLog) -> LogDescription {
        let names = || log.people.iter().map(|person| person.name.clone()).collect::<Vec<_>>();
        let mut randomisation = Randomisation::of(log);
        if parameters.keep_identifiers {
            randomisation.name_people(&names());
        }
        LogDescription {
            unit: parameters.unit.clone(),
            actions: log.actions,
            state: log.names.clone(),
            horizon: log.horizon(),
            decisions_per_day: log.per_day,
            availability: log.can_withhold(),
            missing: log.can_miss(),
            people: log.people.len() as u32,
            notes: log.notes.clone(),
            randomisation,
            identifiers: parameters.keep_identifiers.then(names),
        }
    }

    /// The indices of the numbers of the state that a scenario shows.
    ///
    /// **Errors**: the state has no such number.
    pub(super) fn shown(&self, scenario: &Scenario) -> Result<Arc<[usize]>, ScenarioError> {
        shown(&self.state, scenario)
    }
}

/// The indices of the names that a scenario shows.
///
/// **Errors**: there is no such name.
pub(super) fn shown(names: &[String], scenario: &Scenario) -> Result<Arc<[usize]>, ScenarioError> {
    let Some(wanted) = scenario.names() else { return Ok((0..names.len()).collect()) };
    let index = |name: &str| names.iter().position(|known| known == name);
    wanted.map(|name| index(name).ok_or_else(|| ScenarioError::Unknown(name.into()))).collect()
}
