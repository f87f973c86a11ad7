//! The declaration of the family, and its environments as jobs hold them.

use std::any::Any;
use std::collections::HashMap;
use std::sync::{Arc, OnceLock};

use crate::env::declared::constraints;
use crate::env::declared::description::WorldDescription;
use crate::env::declared::model::{MOST_DAYS, ModelFile, SHIPPED};
use crate::env::declared::program::compile;
use crate::env::declared::read;
use crate::env::declared::rows::{Numbers, PEOPLE, REPLAY};
use crate::env::declared::world::{World, WorldParts};
use crate::env::family::{Environment, Family, Meaning, Model};
use crate::env::observation::{FeatureSpec, ObservationSpec};
use crate::env::scenario::Scenario;
use crate::env::simulation::Simulated;
use crate::env::vector::Interface;
use crate::key::{
    Content, ContentFault, ContentForm, Keyed, Kind, MOST_BYTES, Value, WithFreeKeys, free_keys,
    free_values, interned, keys,
};

/// The form of a model.
pub(super) static MODEL: ContentForm = ContentForm {
    what: "a model file",
    parse: |text| match read::read(text) {
        Ok(model) => Ok(Arc::new(model)),
        Err(faults) => Err(ContentFault::Listed(faults)),
    },
    canonical: None,
    shipped: &SHIPPED,
    help: Some(
        "`oralytics_v1`, `oralytics_v2` and `oralytics_v4` (V3 too, with people of V3) come with jitai; docs/models.md \
         begins with a model of ten lines",
    ),
    most_bytes: MOST_BYTES,
};

keys! {
    /// A world that a file declares; `docs/models.md` describes the file.
    pub struct DeclaredParameters {
        /// the model: the name of a TOML file, or "oralytics_v1", "oralytics_v2" or "oralytics_v4"
        model: Content, in Kind::Content(&MODEL);
        /// the people of the model: the name of a CSV file with one row per person, or "none"
        people: Content = Content::default(), in Kind::Content(&PEOPLE);
        /// rows that the model replays: the name of a CSV file with rows by person, or "none"
        replay: Content = Content::default(), in Kind::Content(&REPLAY);
        /// days of each person; 0 for the number that the model gives
        days: u32 = 0, before 0, in Kind::Integer { min: 0, max: MOST_DAYS as u64 };
    }
}

/// The version of the simulation and its random streams. It is raised whenever a change makes the same job produce
/// different results.
const VERSION: u32 = 1;

/// The family `declared`, of models whose parameters have their defaults.
pub static FAMILY: Family = Family {
    name: "declared",
    keys: DeclaredParameters::KEYS,
    people: &[],
    constraints: &[constraints::CONSTRAINTS, constraints::OF_DEFAULTS],
    return_unit: "outcome",
    termination_metric: "termination_rate",
    has_optimum: false,
    has_contexts: false,
    headline: None,
    has_letters: false,
    with_parameters: Some(with_parameters),
    check_scenario: |_| Ok(()),
    expected_scenario: || "\"all\", or a list of features of the model".to_owned(),
    example_scenarios: &["all"],
    read: |family, values, _| {
        DeclaredParameters::from_values(values.get(..DeclaredParameters::KEYS.len())?)?;
        Some(Environment::of(DeclaredModel::new(family, values.to_vec())))
    },
};

/// The families of models, by the names of the parameters that are set.
static FAMILIES: WithFreeKeys<Family> = WithFreeKeys::none();

/// The family of models with these parameters set.
fn with_parameters(keys: &[&str]) -> Option<&'static Family> {
    let free = free_keys(keys.iter().copied())?;
    if free.is_empty() {
        return Some(&FAMILY);
    }
    Some(FAMILIES.of(FAMILY.keys, &free, |keys| {
        // As the keys, they stay in memory until the process ends.
        let of_parameters = vec![constraints::of_parameters(&free)].leak();
        let constraints = vec![constraints::CONSTRAINTS, of_parameters].leak();
        Family { keys, constraints, ..FAMILY }
    }))
}

/// A world: a model, with values of its parameters.
#[derive(Clone, Debug)]
pub struct DeclaredModel {
    family: &'static Family,
    values: Vec<Value>,
    /// `None` if only the digest of the model is known, and no description of an earlier run.
    description: Option<WorldDescription>,
    /// Why a simulation could not go on.
    failure: Arc<OnceLock<String>>,
}

/// The number of actions and of features, and the horizon, of a model of which only the digest is known.
const USUAL: (usize, usize, u32) = (2, 4, 100);

impl DeclaredModel {
    fn new(family: &'static Family, values: Vec<Value>) -> DeclaredModel {
        let mut world =
            DeclaredModel { family, values, description: None, failure: Arc::default() };
        let people = world.people().unwrap_or(0);
        world.description = world.file().map(|model| WorldDescription::of(&model, people));
        world
    }

    fn parameters(&self) -> DeclaredParameters {
        let own = &self.values[..DeclaredParameters::KEYS.len()];
        DeclaredParameters::from_values(own).expect("the values have been read")
    }

    /// The model, with the days that are set.
    fn file(&self) -> Option<Arc<ModelFile>> {
        let DeclaredParameters { model, days, .. } = self.parameters();
        let mut model: Arc<ModelFile> = model.parsed()?;
        if days > 0 && days != model.days {
            Arc::make_mut(&mut model).days = days;
        }
        Some(model)
    }

    /// The parameters that are set, with their values.
    pub fn given(&self) -> impl Iterator<Item = (&'static str, &Value)> {
        free_values(self.family.keys, &self.values)
    }

    /// The number of people among whom those of a trial are drawn.
    fn people(&self) -> Option<usize> {
        let DeclaredParameters { people, replay, .. } = self.parameters();
        match people.parsed::<Numbers>() {
            Some(people) => Some(people.rows()),
            None => Some(replay.parsed::<Numbers>()?.by_person().len()),
        }
    }

    /// The simulation of a scenario.
    ///
    /// # Panics
    /// If the texts of the files are unknown, or do not suit one another; a manifest checks them.
    pub fn simulation(&self, scenario: &Scenario, history: usize, lanes: usize) -> World {
        World::new(Arc::new(self.parts(scenario)), history, lanes)
    }

    fn parts(&self, scenario: &Scenario) -> WorldParts {
        const CHECKED: &str = "the manifest has checked the model and its files";
        let model = self.file().expect(CHECKED);
        let DeclaredParameters { people, replay, .. } = self.parameters();
        let (people, replay): (Option<Arc<Numbers>>, Option<Arc<Numbers>>) =
            (people.parsed(), replay.parsed());
        let given: Vec<(&str, &Value)> = self.given().collect();
        let value = |name: &str| given.iter().find(|(given, _)| *given == name);
        let parameters: Vec<f64> = model
            .parameters
            .iter()
            .map(|one| {
                let given = value(&one.name).and_then(|(_, value)| constraints::number(value));
                given.unwrap_or(one.default)
            })
            .collect();
        let columns = model.columns.iter().map(|needed| {
            let people = people.as_ref().expect(CHECKED);
            needed.find(people).expect(CHECKED)
        });
        let columns = columns.collect();
        let runs = replay.as_ref().map_or(&[][..], |replay| replay.by_person());
        let rows = match &people {
            // In the order of the people.
            Some(people) if !runs.is_empty() => {
                let by_name: HashMap<&str, _> =
                    runs.iter().map(|(name, rows)| (name.as_str(), rows)).collect();
                let own = |row| by_name.get(&*people.person(row)).expect(CHECKED);
                (0..people.rows()).map(|row| (*own(row)).clone()).collect()
            }
            _ => runs.iter().map(|(_, rows)| rows.clone()).collect(),
        };
        let replayed = replay.iter().flat_map(|replay| {
            model.replayed.iter().map(|name| replay.column(name).expect(CHECKED))
        });
        WorldParts {
            program: Arc::new(compile(&model, &parameters)),
            parameters,
            columns,
            replayed: replayed.collect(),
            rows,
            shown: WorldDescription::of(&model, 0).shown(scenario).expect(CHECKED),
            failure: Arc::clone(&self.failure),
            model,
            people,
            replay,
        }
    }
}

impl Model for DeclaredModel {
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
        let other: Option<&DeclaredModel> = (other as &dyn Any).downcast_ref();
        other.is_some_and(|other| (self.family, &self.values) == (other.family, &other.values))
    }

    fn version(&self, _: &Scenario) -> u32 {
        VERSION
    }

    fn interface(&self, scenario: &Scenario) -> Interface {
        let shown = self.description.as_ref().and_then(|of| Some((of, of.shown(scenario).ok()?)));
        let Some((description, shown)) = shown else {
            return Interface::unknown(scenario, USUAL.0, USUAL.1);
        };
        let feature = |index: usize| {
            let feature = &description.features[index];
            FeatureSpec {
                name: feature.name.clone(),
                low: feature.low.map_or(f32::NEG_INFINITY, |low| low as f32),
                high: feature.high.map_or(f32::INFINITY, |high| high as f32),
            }
        };
        let features = shown.into_iter().map(feature).collect();
        let observations = ObservationSpec { features, one_hot: 0 };
        Interface { observations, actions: description.actions.len() }
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
        let meaning = |index: usize| {
            let feature = &description.features[index];
            let meaning = match feature.meaning.is_empty() {
                true => feature.name.clone(),
                false => feature.meaning.clone(),
            };
            Meaning { meaning, unit: feature.unit.clone(), scale: 1.0 }
        };
        description.shown(scenario).unwrap_or_default().into_iter().map(meaning).collect()
    }

    fn description(&self) -> Option<String> {
        self.description.as_ref().and_then(|description| serde_json::to_string(description).ok())
    }

    fn described(&self, text: &str) -> Option<Environment> {
        let description = Some(serde_json::from_str(text).ok()?);
        Some(Environment::of(DeclaredModel { description, ..self.clone() }))
    }

    fn longest_episode(&self) -> u32 {
        self.description.as_ref().map_or(USUAL.2, |description| description.horizon)
    }

    fn decisions_per_day(&self) -> Option<u32> {
        self.description.as_ref().map(|description| description.decisions_per_day)
    }

    fn can_end_early(&self) -> bool {
        self.description.as_ref().is_none_or(|description| description.ends)
    }

    fn can_withhold(&self) -> bool {
        self.description.as_ref().is_some_and(|description| description.availability)
    }

    fn training(&self, scenario: &Scenario, history: usize, lanes: usize) -> Simulated {
        Box::new(self.simulation(scenario, history, lanes))
    }

    fn testing(&self, scenario: &Scenario, history: usize, lanes: usize) -> Simulated {
        Box::new(self.simulation(scenario, history, lanes))
    }

    fn has_exact_features(&self) -> bool {
        true
    }

    fn people_to_draw(&self) -> Option<usize> {
        self.people()
    }

    fn state_names(&self) -> Vec<String> {
        self.description.as_ref().map_or_else(Vec::new, |description| description.state.clone())
    }

    fn late_state(&self) -> usize {
        self.description.as_ref().map_or(0, |description| description.late_state)
    }

    /// What a message costs is known with each reward alone.
    fn message_cost(&self) -> Option<f64> {
        self.description.as_ref().filter(|description| description.costs).map(|_| 0.0)
    }

    fn costs_vary(&self) -> bool {
        true
    }

    fn fresh(&self) -> Option<Environment> {
        Some(Environment::of(DeclaredModel { failure: Arc::default(), ..self.clone() }))
    }

    fn failure(&self) -> Option<String> {
        self.failure.get().cloned()
    }
}
