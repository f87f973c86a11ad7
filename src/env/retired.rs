//! Families of earlier releases. Their jobs in stores stay readable, and are no longer simulated.

use std::any::Any;

use crate::env::family::{Environment, Family, Meaning, Model};
use crate::env::scenario::Scenario;
use crate::env::simulation::Simulated;
use crate::env::vector::Interface;
use crate::key::{Content, ContentForm, Keyed, Kind, MOST_BYTES, Value, choices, keys};

/// The family `oralytics`, whose test beds are models: experiments/oralytics/v2.toml and v4.toml.
pub(super) static ORALYTICS: Family = Family {
    name: "oralytics",
    keys: OralyticsKeys::KEYS,
    people: &[],
    constraints: &[],
    return_unit: "seconds of brushing",
    termination_metric: "termination_rate",
    has_optimum: false,
    has_contexts: false,
    headline: None,
    has_letters: false,
    with_parameters: None,
    check_scenario: |_| Ok(()),
    expected_scenario: || "\"all\", or a list of features".to_owned(),
    example_scenarios: &["time_of_day-brushing-dosage-app"],
    read: |_, values, _| {
        let keys = OralyticsKeys::from_values(values)?;
        Some(Environment::of(RetiredWorld { keys, values: values.to_vec() }))
    },
};

/// The form of the people of a stored job: no text is of this form, so that the job cannot be run.
static PEOPLE: ContentForm = ContentForm {
    what: "a CSV file of people",
    parse: |_| Err("this release no longer simulates the family oralytics".to_owned().into()),
    canonical: None,
    shipped: &[],
    help: None,
    most_bytes: MOST_BYTES,
};

keys! {
    /// The keys of the family `oralytics`.
    pub struct OralyticsKeys {
        /// test bed
        test_bed: TestBed = TestBed::V2;
        /// people
        people: Content, in Kind::Content(&PEOPLE);
        /// whether outcomes do not depend on the day
        stationary: bool = true;
        /// effects of a prompt in "v2"
        effect_size: EffectSize = EffectSize::Small;
        /// factor of responsiveness after a week with too many prompts
        habituation_factor: f64 = 1.0, in Kind::PROBABILITY;
        /// days of each person
        days: u32 = 70, in Kind::Integer { min: 1, max: 1000 };
        /// cost of a prompt to a person who brushes well and was prompted often
        cost_of_good_brushing: f64 = 100.0, in Kind::NON_NEGATIVE;
        /// cost of a prompt to a person who was prompted very often
        cost_of_frequent_prompts: f64 = 100.0, in Kind::NON_NEGATIVE;
        /// scale of the averages that the cost compares with its thresholds
        cost_scale: CostScale = CostScale::Raw;
        /// how seconds become whole
        rounding: Rounding = Rounding::Nearest;
        /// whether the algorithm sees the state of the last day with an open app
        stale_state: bool = false;
        /// factor of the effects of a prompt
        effect_factor: f64 = 1.0, before 1.0, in Kind::NON_NEGATIVE;
        /// state at which a prompt has no effect
        no_effect_at: Vec<f64> = Vec::new(), before Vec::new(), in Kind::Reals { least: 0, most: 4, min: -2.0, max: 2.0 };
    }
}

choices! {
    /// A test bed.
    pub enum TestBed {
        /// Of the design.
        V2 = "v2",
        /// Fitted to the pilot.
        V3 = "v3",
        /// Fitted to the trial.
        V4 = "v4",
    }
}

choices! {
    /// The effects of a prompt in V2.
    pub enum EffectSize {
        /// Small.
        Small = "small",
        /// Smaller.
        Smaller = "smaller",
    }
}

choices! {
    /// The scale of the averages that the cost compares.
    pub enum CostScale {
        /// Seconds, and the share of prompts.
        Raw = "raw",
        /// As the algorithm sees them.
        Normalised = "normalised",
    }
}

choices! {
    /// How a number of seconds becomes whole.
    pub enum Rounding {
        /// To the nearest whole number.
        Nearest = "nearest",
        /// To the next smaller whole number.
        Down = "down",
    }
}

/// The environment of a stored job.
#[derive(Clone, Debug)]
struct RetiredWorld {
    keys: OralyticsKeys,
    values: Vec<Value>,
}

/// The features of the scenario "all".
const FEATURES: [&str; 6] = ["time_of_day", "brushing", "dosage", "app", "weekend", "day"];

/// The features of a scenario.
fn features(scenario: &Scenario) -> Vec<String> {
    match scenario.names() {
        Some(names) => names.map(str::to_owned).collect(),
        None => FEATURES.map(str::to_owned).into(),
    }
}

impl RetiredWorld {
    /// What a job would run, if the texts of its files could be known.
    fn simulated(&self) -> Simulated {
        panic!("the family {} is no longer simulated", ORALYTICS.name)
    }
}

impl Model for RetiredWorld {
    fn family(&self) -> &'static Family {
        &ORALYTICS
    }

    fn values(&self) -> Vec<Value> {
        self.values.clone()
    }

    fn people_values(&self) -> Vec<Value> {
        Vec::new()
    }

    fn equals(&self, other: &dyn Model) -> bool {
        let other: Option<&RetiredWorld> = (other as &dyn Any).downcast_ref();
        other.is_some_and(|other| self.values == other.values)
    }

    fn interface(&self, scenario: &Scenario) -> Interface {
        let mut interface = Interface::unknown(scenario, 2, FEATURES.len());
        let named = interface.observations.features.iter_mut().zip(features(scenario));
        named.for_each(|(feature, name)| feature.name = name);
        interface
    }

    fn actions(&self) -> Vec<String> {
        ["nothing", "a prompt"].map(str::to_owned).into()
    }

    fn meanings(&self, scenario: &Scenario) -> Vec<Meaning> {
        let meaning = |meaning| Meaning { meaning, unit: String::new(), scale: 1.0 };
        features(scenario).into_iter().map(meaning).collect()
    }

    fn longest_episode(&self) -> u32 {
        2 * self.keys.days
    }

    fn can_end_early(&self) -> bool {
        false
    }

    fn training(&self, _: &Scenario, _: usize, _: usize) -> Simulated {
        self.simulated()
    }

    fn testing(&self, _: &Scenario, _: usize, _: usize) -> Simulated {
        self.simulated()
    }

    fn state_names(&self) -> Vec<String> {
        let names = [
            "average_brushing",
            "average_prompts",
            "responsiveness",
            "app_today",
            "app_before",
            "person",
        ];
        names.map(str::to_owned).into()
    }

    fn message_cost(&self) -> Option<f64> {
        let cost = self.keys.cost_of_good_brushing + self.keys.cost_of_frequent_prompts;
        Some(cost).filter(|cost| *cost > 0.0)
    }

    fn costs_vary(&self) -> bool {
        true
    }

    fn has_exact_features(&self) -> bool {
        true
    }
}
