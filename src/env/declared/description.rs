//! What a store keeps of a world, whose model it does not keep.

use serde::{Deserialize, Serialize};

use crate::env::declared::model::ModelFile;
use crate::env::scenario::{Scenario, ScenarioError};

/// What agents and readers know of a world.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct WorldDescription {
    pub title: String,
    pub unit: Option<String>,
    pub actions: Vec<String>,
    pub features: Vec<ObservableFeature>,
    /// The names of the recorded state.
    pub state: Vec<String>,
    /// How many of them, the last ones, follow the choice of the action.
    pub late_state: usize,
    /// Whether agents learn from another number than the outcome.
    pub costs: bool,
    pub horizon: u32,
    pub decisions_per_day: u32,
    pub availability: bool,
    pub ends: bool,
    /// The number of rows of people; 0 if people do not differ by a file.
    pub people: usize,
}

/// A feature of an observation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct ObservableFeature {
    pub name: String,
    /// `None` for a feature without a bound.
    pub low: Option<f64>,
    pub high: Option<f64>,
    pub unit: String,
    pub meaning: String,
}

impl WorldDescription {
    /// The description of a model with this number of people.
    pub fn of(model: &ModelFile, people: usize) -> WorldDescription {
        let name = |quantity: &usize| model.quantities[*quantity].name.clone();
        let features = model.roles.features.iter().map(|feature| ObservableFeature {
            name: feature.name.clone(),
            low: Some(feature.low).filter(|low| low.is_finite()),
            high: Some(feature.high).filter(|high| high.is_finite()),
            unit: feature.unit.clone(),
            meaning: feature.meaning.clone(),
        });
        WorldDescription {
            title: model.title.clone(),
            unit: model.unit.clone(),
            actions: model.actions.clone(),
            features: features.collect(),
            state: model.roles.state.iter().map(name).collect(),
            late_state: model.late_state(),
            costs: model.roles.reward != model.roles.outcome,
            horizon: model.horizon(),
            decisions_per_day: model.decisions_per_day,
            availability: model.roles.available.is_some(),
            ends: model.roles.ends.is_some(),
            people,
        }
    }

    /// The indices of the features that a scenario shows.
    ///
    /// **Errors**: the world has no such feature.
    pub fn shown(&self, scenario: &Scenario) -> Result<Vec<usize>, ScenarioError> {
        let Some(names) = scenario.names() else { return Ok((0..self.features.len()).collect()) };
        let index = |name: &str| self.features.iter().position(|feature| feature.name == name);
        names.map(|name| index(name).ok_or_else(|| ScenarioError::Unknown(name.into()))).collect()
    }
}
