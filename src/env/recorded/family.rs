//! The declaration of the family, and its environments as jobs hold them.

use std::any::Any;
use std::sync::Arc;

use crate::env::family::{Environment, Family, Meaning, Model};
use crate::env::recorded::constraints::CONSTRAINTS;
use crate::env::recorded::description::{LogDescription, shown};
use crate::env::recorded::log::{REACHED, RECORDED_PROBABILITY, RecordedLog};
use crate::env::recorded::numbered::numbered;
use crate::env::recorded::parameters::LogParameters;
use crate::env::recorded::reading::{known, parts};
use crate::env::recorded::world::{RecordedWorld, spec};
use crate::env::scenario::Scenario;
use crate::env::simulation::Simulated;
use crate::env::vector::Interface;
use crate::key::{Content, Keyed, Value, interned};

/// The family `recorded`.
pub static FAMILY: Family = Family {
    name: "recorded",
    keys: LogParameters::KEYS,
    people: &[],
    constraints: &[CONSTRAINTS],
    return_unit: "outcome",
    termination_metric: "termination_rate",
    has_optimum: false,
    has_contexts: false,
    headline: None,
    has_letters: false,
    with_parameters: None,
    check_scenario: |_| Ok(()),
    expected_scenario: || "\"all\", or a list of names of the state".to_owned(),
    example_scenarios: &["all"],
    read: |_, values, _| {
        let parameters = LogParameters::from_values(values)?;
        let known = known(&parameters).and_then(|read| Result::as_ref(&*read).ok().cloned());
        let (log, description) = known.map(|known| (known.log, known.description)).unzip();
        Some(Environment::of(RecordedModel { parameters, log, description }))
    },
};

/// The number of actions and of features, and the horizon, of a trial of which only the digest is known.
const USUAL: (usize, usize, u32) = (2, 4, 100);

/// A recorded trial, as a job holds it.
#[derive(Clone, Debug)]
pub struct RecordedModel {
    parameters: LogParameters,
    /// `None` if the text of the file is not known, or has faults.
    log: Option<Arc<RecordedLog>>,
    /// `None` without a log and the description of an earlier run.
    description: Option<Arc<LogDescription>>,
}

impl RecordedModel {
    /// The decisions; `None` if the text of the file is not known, or has faults.
    pub fn log(&self) -> Option<&Arc<RecordedLog>> {
        self.log.as_ref()
    }

    /// Whether the file says on which days people entered.
    pub fn has_calendar(&self) -> bool {
        !parts(&self.parameters.calendar_day).is_empty()
    }

    /// The file by which jobs know the trial: the columns that are read, and numbers in the place of people's names unless
    /// these are to be kept. `None` if the file is not known, or has faults.
    pub fn numbered(&self) -> Option<Content> {
        self.log.as_ref()?;
        let text = numbered(self.parameters.file.text()?, &self.parameters)?;
        Some(self.parameters.file.known_by(text))
    }

    fn simulation(&self, scenario: &Scenario, lanes: usize) -> Simulated {
        const CHECKED: &str = "the manifest has checked the file and the scenario";
        let log = self.log.as_ref().expect(CHECKED);
        let shown = shown(&log.names, scenario).expect(CHECKED);
        Box::new(RecordedWorld::new(Arc::clone(log), shown, lanes))
    }
}

impl Model for RecordedModel {
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
        let other: Option<&RecordedModel> = (other as &dyn Any).downcast_ref();
        other.is_some_and(|other| self.parameters == other.parameters)
    }

    fn interface(&self, scenario: &Scenario) -> Interface {
        let of = self.description.as_ref().and_then(|of| Some((of, of.shown(scenario).ok()?)));
        let Some((description, shown)) = of else {
            return Interface::unknown(scenario, USUAL.0, USUAL.1);
        };
        let observations = spec(shown.iter().map(|index| description.state[*index].as_str()));
        Interface { observations, actions: description.actions }
    }

    fn return_unit(&self) -> &'static str {
        interned(&self.parameters.unit)
    }

    fn actions(&self) -> Vec<String> {
        let count = self.description.as_ref().map_or(USUAL.0, |description| description.actions);
        let messages = (1..count).map(|number| format!("action {number}"));
        std::iter::once("nothing".to_owned()).chain(messages).collect()
    }

    fn meanings(&self, scenario: &Scenario) -> Vec<Meaning> {
        let features = self.interface(scenario).observations.features.into_iter();
        let meaning = |name| Meaning { meaning: name, unit: String::new(), scale: 1.0 };
        features.map(|feature| meaning(feature.name)).collect()
    }

    fn description(&self) -> Option<String> {
        self.description.as_ref().and_then(|description| serde_json::to_string(&**description).ok())
    }

    fn described(&self, text: &str) -> Option<Environment> {
        let description = Some(Arc::new(serde_json::from_str(text).ok()?));
        Some(Environment::of(RecordedModel { description, ..self.clone() }))
    }

    fn longest_episode(&self) -> u32 {
        self.description.as_ref().map_or(USUAL.2, |description| description.horizon)
    }

    fn decisions_per_day(&self) -> Option<u32> {
        Some(self.parameters.decisions_per_day)
    }

    /// A person may have fewer decisions than others.
    fn can_end_early(&self) -> bool {
        true
    }

    fn can_withhold(&self) -> bool {
        self.description.as_ref().is_some_and(|description| description.availability)
    }

    fn training(&self, scenario: &Scenario, _: usize, lanes: usize) -> Simulated {
        self.simulation(scenario, lanes)
    }

    fn testing(&self, scenario: &Scenario, _: usize, lanes: usize) -> Simulated {
        self.simulation(scenario, lanes)
    }

    fn has_exact_features(&self) -> bool {
        true
    }

    fn state_names(&self) -> Vec<String> {
        let Some(description) = &self.description else { return Vec::new() };
        let mut names = description.state.clone();
        names.extend(description.missing.then(|| REACHED.to_owned()));
        names.push(RECORDED_PROBABILITY.to_owned());
        names
    }

    /// The probability of the action that was taken follows from the action, as does what reached an agent.
    fn late_state(&self) -> usize {
        self.description.as_ref().map_or(0, |description| 1 + usize::from(description.missing))
    }
}
