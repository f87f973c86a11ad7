//! The declaration of the family, and its environments as jobs hold them.

use super::constraints::{CONSTRAINTS, PEOPLE_CONSTRAINTS};
use super::context::context_error;
use super::filter;
use super::intervention::OPTIONS;
use super::meaning::{self, ACTIONS};
use super::observer::Observer;
use super::parameters::{StepCount, VERSION};
use super::physical_activity::PhysicalActivity;
use super::population::{ParticipantSampler, Population, PopulationPhases};
use super::scenario::{self, Feature};
use super::simulated::{STATE, STRATA};
use crate::env::family::{Environment, Family, Meaning, Model};
use crate::env::scenario::Scenario;
use crate::env::simulation::Simulated;
use crate::env::vector::Interface;
use crate::key::{Keyed, Value};
use crate::rng::Stream;

/// The family `step_count`.
pub static FAMILY: Family = Family {
    name: "step_count",
    keys: StepCount::KEYS,
    people: Population::KEYS,
    constraints: &[CONSTRAINTS, PEOPLE_CONSTRAINTS],
    return_unit: "steps walked",
    termination_metric: "disengagement_rate",
    has_optimum: true,
    has_contexts: true,
    headline: Some("sigma"),
    has_letters: true,
    with_parameters: None,
    check_scenario: scenario::check,
    expected_scenario: scenario::expected,
    example_scenarios: &["P-H-D", "L-H-D"],
    read: |_, values, people| {
        let parameters = StepCount::from_values(values)?;
        let population = Population::from_values(people)?;
        Some(Environment::of(StepCountModel { parameters, population }))
    },
};

/// Parameters of the simulation, and how they differ between participants.
#[derive(Clone, Debug, PartialEq)]
pub struct StepCountModel {
    /// Parameters of the simulation.
    pub parameters: StepCount,
    /// The distributions of parameters over participants.
    pub population: Population,
}

impl StepCountModel {
    /// The environment with the largest noise of any participant; see [`Population::widest`].
    pub fn widest(&self) -> StepCount {
        self.population.widest(&self.parameters)
    }

    /// The simulation that an agent trains in, with this number of lanes and of observations at a time.
    pub fn of_training(
        &self,
        scenario: &Scenario,
        history: usize,
        lanes: usize,
    ) -> PhysicalActivity {
        let simulation = PhysicalActivity::new(&self.parameters, scenario, lanes);
        let simulation = match self.population.phases {
            PopulationPhases::All => simulation.with_population(&self.population),
            PopulationPhases::Test => simulation,
        };
        simulation.with_history(history)
    }

    /// The simulation that an agent is tested in; see [`StepCountModel::of_training`].
    pub fn of_test(&self, scenario: &Scenario, history: usize, lanes: usize) -> PhysicalActivity {
        let simulation = PhysicalActivity::new(&self.parameters, scenario, lanes);
        simulation.with_population(&self.population).with_history(history)
    }
}

impl Model for StepCountModel {
    fn family(&self) -> &'static Family {
        &FAMILY
    }

    fn values(&self) -> Vec<Value> {
        self.parameters.to_values()
    }

    fn people_values(&self) -> Vec<Value> {
        self.population.to_values()
    }

    fn equals(&self, other: &dyn Model) -> bool {
        (other as &dyn std::any::Any).downcast_ref() == Some(self)
    }

    fn version(&self, scenario: &Scenario) -> u32 {
        // The step after the horizon, which pays nothing, is no longer part of the test, and particles stand for
        // disengagement risk; the version is higher in these jobs alone, so that all others keep their keys.
        let widest = self.population.widest(&self.parameters);
        VERSION
            + u32::from(self.parameters.unpaid_last_step)
            + u32::from(filter::has_particles(&widest, scenario))
    }

    fn context_error(&self) -> Option<f64> {
        let differs = |name| name == "sigma" || name == "context_probability";
        let StepCount { sigma, context_probability, .. } = self.parameters;
        let alike = !self.population.names().any(differs);
        alike.then(|| context_error(sigma, context_probability))
    }

    fn interface(&self, scenario: &Scenario) -> Interface {
        let observations = Observer::new(&self.parameters, scenario).spec();
        Interface { observations, actions: OPTIONS }
    }

    fn actions(&self) -> Vec<String> {
        ACTIONS.map(str::to_owned).into()
    }

    fn meanings(&self, scenario: &Scenario) -> Vec<Meaning> {
        meaning::meanings(&self.parameters, scenario)
    }

    fn clock(&self) -> String {
        meaning::clock(&self.parameters)
    }

    fn longest_episode(&self) -> u32 {
        self.parameters.longest_episode()
    }

    fn can_withhold(&self) -> bool {
        self.population.can_withhold(&self.parameters)
    }

    fn training(&self, scenario: &Scenario, history: usize, lanes: usize) -> Simulated {
        Box::new(self.of_training(scenario, history, lanes))
    }

    fn testing(&self, scenario: &Scenario, history: usize, lanes: usize) -> Simulated {
        Box::new(self.of_test(scenario, history, lanes))
    }

    fn state_names(&self) -> Vec<String> {
        STATE.map(str::to_owned).into()
    }

    fn recorded_features(&self, scenario: &Scenario) -> Vec<Option<usize>> {
        let entries = |feature: Feature| {
            let index = match feature {
                Feature::Context => Some(0),
                Feature::Probability => Some(1),
                Feature::Likely => Some(2),
                Feature::Habituation => Some(3),
                Feature::Disengagement => Some(4),
                _ => None,
            };
            vec![index; feature.width()]
        };
        scenario.features().into_iter().flat_map(entries).collect()
    }

    fn strata(&self) -> usize {
        STRATA
    }

    fn message_cost(&self) -> Option<f64> {
        let has_costs = self.widest().message_cost > 0.0;
        has_costs.then_some(self.parameters.message_cost)
    }

    fn differing(&self) -> usize {
        ParticipantSampler::new(&self.population).indices().len()
    }

    fn describe_participants(
        &self,
        stream: &mut Stream,
        count: u32,
        describe: &mut dyn FnMut(u32, u8, f64),
    ) {
        let sampler = ParticipantSampler::new(&self.population);
        for participant in 1..=count {
            let values = sampler.participant(stream);
            let indices = sampler.indices().iter().map(|index| *index as u8);
            indices.zip(values).for_each(|(index, value)| describe(participant, index, value));
        }
    }
}

impl From<StepCount> for Environment {
    fn from(parameters: StepCount) -> Environment {
        Environment::from((parameters, Population::default()))
    }
}

impl From<(StepCount, Population)> for Environment {
    fn from((parameters, population): (StepCount, Population)) -> Environment {
        Environment::of(StepCountModel { parameters, population })
    }
}

impl Environment {
    /// Changes parameters of the simulation.
    ///
    /// # Panics
    /// If the environment is of another family.
    pub fn change(&mut self, change: impl FnOnce(&mut StepCount)) {
        let model: &StepCountModel = self.model().expect("an environment of step_count");
        let StepCountModel { mut parameters, population } = model.clone();
        change(&mut parameters);
        *self = Environment::from((parameters, population));
    }
}
