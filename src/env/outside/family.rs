//! The declaration of the family `external`, and its environments as jobs hold them.

use std::any::Any;
use std::path::Path;

use serde_json::{Map, json};

use crate::env::family::{Environment, Family, Meaning, Model};
use crate::env::outside::client::OutsideEnvironment;
use crate::env::outside::description::Description;
use crate::env::outside::program::{EnvironmentProgram, EpisodePhase, Launch};
use crate::env::scenario::Scenario;
use crate::env::simulation::Simulated;
use crate::env::vector::Interface;
use crate::external::{ProgramError, StopRequested};
use crate::key::{Keyed, Kind, Value, WithFreeKeys, free_keys, free_values, interned, keys};

keys! {
    /// A program of the author's that simulates an environment; `docs/outside-environments.md` has its protocol.
    pub struct OutsideParameters {
        /// the program and its arguments, started without a shell in the folder of the manifest
        command: Vec<String>, in Kind::Words { most: 1000, longest: 10_000 };
        /// version of the program, a text; another version makes other jobs
        version: String, in Kind::Text { most: 100 };
    }
}

/// The family `external`, of programs without parameters.
pub static FAMILY: Family = Family {
    name: "external",
    keys: OutsideParameters::KEYS,
    people: &[],
    constraints: &[],
    return_unit: "reward",
    termination_metric: "termination_rate",
    has_optimum: false,
    has_contexts: false,
    headline: None,
    has_letters: false,
    with_parameters: Some(with_parameters),
    check_scenario: |_| Ok(()),
    expected_scenario: || {
        "\"all\", or a list of names of features, as in [\"position\", \"velocity\"]".to_owned()
    },
    example_scenarios: &["all"],
    read: |family, values, _| {
        OutsideParameters::from_values(values.get(..OutsideParameters::KEYS.len())?)?;
        let values = values.to_vec();
        Some(Environment::of(OutsideModel { family, values, description: None, program: None }))
    },
};

/// The families of programs, by the names of their parameters.
static FAMILIES: WithFreeKeys<Family> = WithFreeKeys::none();

impl Family {
    /// Whether its environments are outside programs.
    pub fn is_external(&self) -> bool {
        self.name == FAMILY.name
    }
}

/// The family of outside programs whose parameters have these keys.
fn with_parameters(keys: &[&str]) -> Option<&'static Family> {
    let free = free_keys(keys.iter().copied())?;
    if free.is_empty() {
        return Some(&FAMILY);
    }
    Some(FAMILIES.of(FAMILY.keys, &free, |keys| Family { keys, ..FAMILY }))
}

/// An environment that a program simulates. What it consists of is known once the program has started.
#[derive(Clone, Debug)]
pub struct OutsideModel {
    family: &'static Family,
    values: Vec<Value>,
    /// `None` before the program has described itself.
    description: Option<Description>,
    program: Option<EnvironmentProgram>,
}

/// The number of actions and of features, and the horizon, on which estimates of work rest before the program has
/// described itself.
const USUAL: (usize, usize, u32) = (2, 8, 100);

impl OutsideModel {
    /// The declaration.
    fn parameters(&self) -> OutsideParameters {
        let own = &self.values[..OutsideParameters::KEYS.len()];
        OutsideParameters::from_values(own).expect("the values have been read")
    }

    /// How the program is started in a folder.
    pub fn launch(&self, folder: &Path) -> Launch {
        let OutsideParameters { command, version } = self.parameters();
        let free = free_values(self.family.keys, &self.values);
        let parameters: Map<_, _> = free.map(|(name, value)| (name.into(), json!(value))).collect();
        Launch { command, folder: folder.to_owned(), version, parameters }
    }

    /// This environment with its program started. Every wait for the program ends once `stop` returns true.
    ///
    /// **Errors**: see [`EnvironmentProgram::start`].
    pub fn started(
        &self,
        folder: &Path,
        stop: StopRequested,
    ) -> Result<OutsideModel, ProgramError> {
        let program = EnvironmentProgram::start(&self.launch(folder), stop)?;
        let described = self.with(program.description().clone());
        Ok(OutsideModel { program: Some(program), ..described })
    }

    /// This environment as its program has described it, without the program.
    pub fn with(&self, description: Description) -> OutsideModel {
        OutsideModel { description: Some(description), program: None, ..self.clone() }
    }

    /// The program, if it has been started.
    pub fn program(&self) -> Option<&EnvironmentProgram> {
        self.program.as_ref()
    }

    fn lanes(
        &self,
        phase: EpisodePhase,
        scenario: &Scenario,
        history: usize,
        lanes: usize,
    ) -> Simulated {
        let program = self.program.as_ref().expect("a job starts the program first");
        let shown = program.description().shown(scenario).expect("a job checks the scenario first");
        let lanes = OutsideEnvironment::new(program, phase, &shown, true, lanes);
        Box::new(lanes.with_history(history))
    }
}

impl Model for OutsideModel {
    fn family(&self) -> &'static Family {
        self.family
    }

    fn values(&self) -> Vec<Value> {
        self.values.clone()
    }

    fn people_values(&self) -> Vec<Value> {
        Vec::new()
    }

    fn equals(&self, other: &dyn Model) -> bool {
        let other: Option<&OutsideModel> = (other as &dyn Any).downcast_ref();
        other.is_some_and(|other| (self.family, &self.values) == (other.family, &other.values))
    }

    fn interface(&self, scenario: &Scenario) -> Interface {
        let shown = self.description.as_ref().and_then(|of| Some((of, of.shown(scenario).ok()?)));
        match shown {
            Some((description, shown)) => Interface {
                observations: description.observation_spec(&shown),
                actions: description.actions.len(),
            },
            None => Interface::unknown(scenario, USUAL.0, USUAL.1),
        }
    }

    fn return_unit(&self) -> &'static str {
        let unit = self.description.as_ref().and_then(|description| description.unit.as_deref());
        unit.map_or(self.family.return_unit, interned)
    }

    fn actions(&self) -> Vec<String> {
        self.description.as_ref().map_or_else(Vec::new, |description| description.actions.clone())
    }

    fn meanings(&self, scenario: &Scenario) -> Vec<Meaning> {
        let Some(description) = &self.description else { return Vec::new() };
        let meaning = |number: usize| {
            let feature = &description.features[number];
            let meaning = feature.meaning.as_ref().unwrap_or(&feature.name).clone();
            Meaning { meaning, unit: feature.unit.clone().unwrap_or_default(), scale: 1.0 }
        };
        description.shown(scenario).unwrap_or_default().into_iter().map(meaning).collect()
    }

    fn description(&self) -> Option<String> {
        self.description.as_ref().and_then(|description| serde_json::to_string(description).ok())
    }

    fn described(&self, text: &str) -> Option<Environment> {
        Some(Environment::of(self.with(serde_json::from_str(text).ok()?)))
    }

    fn longest_episode(&self) -> u32 {
        self.description.as_ref().map_or(USUAL.2, |description| description.horizon)
    }

    fn can_withhold(&self) -> bool {
        self.description.as_ref().is_some_and(|description| description.availability)
    }

    fn training(&self, scenario: &Scenario, history: usize, lanes: usize) -> Simulated {
        self.lanes(EpisodePhase::Train, scenario, history, lanes)
    }

    fn testing(&self, scenario: &Scenario, history: usize, lanes: usize) -> Simulated {
        self.lanes(EpisodePhase::Test, scenario, history, lanes)
    }

    fn state_names(&self) -> Vec<String> {
        self.description.as_ref().map_or_else(Vec::new, |description| description.state.clone())
    }

    fn has_nothing(&self) -> bool {
        self.description.as_ref().is_some_and(|description| description.nothing == Some(0))
    }
}
