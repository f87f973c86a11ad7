//! The declaration of the family, and its environments as jobs hold them.

use std::any::Any;
use std::sync::Arc;

use crate::env::family::{Environment, Family, Meaning, Model};
use crate::env::oralytics::brushing::{ACTIONS, Brushing, SEEN, STATE, spec};
use crate::env::oralytics::constraints::CONSTRAINTS;
use crate::env::oralytics::parameters::{Oralytics, VERSION};
use crate::env::oralytics::table::Table;
use crate::env::scenario::{Scenario, ScenarioError};
use crate::env::simulation::Simulated;
use crate::env::vector::Interface;
use crate::key::{Keyed, Value};

/// The family `oralytics`.
pub static FAMILY: Family = Family {
    name: "oralytics",
    keys: Oralytics::KEYS,
    people: &[],
    constraints: &[&CONSTRAINTS],
    return_unit: "seconds of brushing",
    termination_metric: "termination_rate",
    has_optimum: false,
    has_contexts: false,
    headline: None,
    has_letters: false,
    with_parameters: None,
    check_scenario: |scenario| shown(scenario).map(|_| ()),
    expected_scenario: || {
        let names: Vec<String> = SEEN.iter().map(|(name, ..)| format!("\"{name}\"")).collect();
        format!("\"all\", or a list of {}", names.join(", "))
    },
    example_scenarios: &["time_of_day-brushing-dosage-app"],
    read: |_, values, _| {
        let parameters = Oralytics::from_values(values)?;
        Some(Environment::of(OralyticsModel { parameters }))
    },
};

/// The indices of a scenario's features among all features.
fn shown(scenario: &Scenario) -> Result<Vec<usize>, ScenarioError> {
    let Some(names) = scenario.names() else { return Ok((0..SEEN.len()).collect()) };
    let index = |name: &str| SEEN.iter().position(|(known, ..)| *known == name);
    names.map(|name| index(name).ok_or_else(|| ScenarioError::Unknown(name.into()))).collect()
}

/// The parameters of a test bed.
#[derive(Clone, Debug, PartialEq)]
pub struct OralyticsModel {
    /// The parameters.
    pub parameters: Oralytics,
}

impl OralyticsModel {
    /// The simulation, with this number of lanes and of observations at a time.
    ///
    /// # Panics
    /// If the people are not known or do not suit the test bed; a manifest checks both.
    pub fn simulation(&self, scenario: &Scenario, history: usize, lanes: usize) -> Brushing {
        let table: Option<Arc<Table>> = self.parameters.people.parsed();
        let people =
            table.expect("the manifest has read the people").people(self.parameters.model());
        let mut people = people.expect("the manifest has checked the people");
        if let Some(state) = self.parameters.no_effect_at.first_chunk() {
            let has_day = !self.parameters.stationary;
            people.iter_mut().for_each(|person| person.remove_effect_at(state, has_day));
        }
        let shown = shown(scenario).expect("the manifest has checked the scenario");
        Brushing::new(&self.parameters, Arc::new(people), shown, (history, lanes))
    }
}

impl Model for OralyticsModel {
    fn family(&self) -> &'static Family {
        &FAMILY
    }

    fn values(&self) -> Vec<Value> {
        self.parameters.to_values()
    }

    fn people_values(&self) -> Vec<Value> {
        Vec::new()
    }

    fn equals(&self, other: &dyn Model) -> bool {
        (other as &dyn Any).downcast_ref() == Some(self)
    }

    fn version(&self, _: &Scenario) -> u32 {
        VERSION
    }

    fn interface(&self, scenario: &Scenario) -> Interface {
        let observations = spec(&self.parameters, &shown(scenario).unwrap_or_default());
        Interface { observations, actions: ACTIONS.len() }
    }

    fn actions(&self) -> Vec<String> {
        ACTIONS.map(str::to_owned).into()
    }

    fn meanings(&self, scenario: &Scenario) -> Vec<Meaning> {
        let meaning = |index: usize| {
            let (meaning, unit) = MEANINGS[index];
            Meaning { meaning: meaning.to_owned(), unit: unit.to_owned(), scale: 1.0 }
        };
        shown(scenario).unwrap_or_default().into_iter().map(meaning).collect()
    }

    fn longest_episode(&self) -> u32 {
        self.parameters.horizon()
    }

    fn can_end_early(&self) -> bool {
        false
    }

    fn training(&self, scenario: &Scenario, history: usize, lanes: usize) -> Simulated {
        Box::new(self.simulation(scenario, history, lanes))
    }

    fn testing(&self, scenario: &Scenario, history: usize, lanes: usize) -> Simulated {
        Box::new(self.simulation(scenario, history, lanes))
    }

    fn message_cost(&self) -> Option<f64> {
        let Oralytics { cost_of_good_brushing, cost_of_frequent_prompts, .. } = self.parameters;
        Some(cost_of_good_brushing + cost_of_frequent_prompts).filter(|cost| *cost > 0.0)
    }

    fn costs_vary(&self) -> bool {
        true
    }

    fn has_exact_features(&self) -> bool {
        true
    }

    fn people_to_draw(&self) -> Option<usize> {
        self.parameters.people.parsed::<Table>().map(|table| table.len())
    }

    fn state_names(&self) -> Vec<String> {
        STATE.map(str::to_owned).into()
    }
}

/// Meanings and units of the features, in their order.
const MEANINGS: [(&str, &str); SEEN.len()] = [
    ("time of day", "0 in the morning, 1 in the evening"),
    ("average of the last 14 brushings, minus 90.5 s, divided by 89.5 s", ""),
    ("share of the last 14 decisions with a prompt, from -1 to 1", ""),
    ("whether the app was opened on the day before", "0 or 1"),
    ("weekend", "0 or 1"),
    ("day in the study, minus 35.5, divided by 34.5", ""),
];
