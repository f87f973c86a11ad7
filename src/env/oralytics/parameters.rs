//! The keys of the family.

use crate::env::oralytics::table::PEOPLE;
use crate::key::{Content, Keyed, Kind, Value, choices, keys};

keys! {
    /// Parameters of the test beds of Oralytics. Symbols follow Trella et al., arXiv 2406.13127.
    pub struct Oralytics {
        /// test bed: "v2", which designed the trial, "v3", fitted to its pilot, or "v4", fitted to the trial
        test_bed: TestBed = TestBed::V2;
        /// parameters of people: the name of a CSV file with one row per person
        people: Content, in Kind::Content(&PEOPLE);
        /// whether outcomes do not depend on the day in the study; false needs people with weights of the day
        stationary: bool = true;
        /// effects of a prompt in "v2": "small" or "smaller"
        effect_size: EffectSize = EffectSize::Small;
        /// factor of a person's responsiveness after a week with too many prompts (E); 1 for people who do not
        /// habituate
        habituation_factor: f64 = 1.0, in Kind::PROBABILITY;
        /// days of each person, with two decisions each
        days: u32 = 70, in Kind::Integer { min: 1, max: 1000 };
        /// cost of a prompt to a person who brushes well and was prompted often (xi_1), in seconds
        cost_of_good_brushing: f64 = 100.0, in Kind::NON_NEGATIVE;
        /// cost of a prompt to a person who was prompted very often (xi_2), in seconds
        cost_of_frequent_prompts: f64 = 100.0, in Kind::NON_NEGATIVE;
        /// scale of the averages that the cost compares with its thresholds: "raw" (the text), or "normalised" (the
        /// official code of V4)
        cost_scale: CostScale = CostScale::Raw;
        /// how seconds of brushing become whole: to the "nearest" (the text), or "down" (the official code)
        rounding: Rounding = Rounding::Nearest;
        /// whether the algorithm sees the average of brushing as of the last day on which the person opened the app
        stale_state: bool = false;
        /// factor of the effects of a prompt on the outcome; 0 removes them
        effect_factor: f64 = 1.0, before 1.0, in Kind::NON_NEGATIVE;
        /// state at which a prompt has no effect on anybody, in "v3" and "v4": the values of time_of_day, brushing,
        /// dosage and app; empty for none
        no_effect_at: Vec<f64> = Vec::new(), before Vec::new(), in Kind::Reals { least: 0, most: 4, min: -2.0, max: 2.0 };
    }
}

choices! {
    /// A test bed.
    pub enum TestBed {
        /// Of the final design: 31 people of an earlier study.
        V2 = "v2",
        /// Fitted to the nine people of the pilot.
        V3 = "v3",
        /// Fitted to the 72 people of the trial.
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
    /// The scale of the averages that the cost compares with its thresholds.
    pub enum CostScale {
        /// Seconds of brushing, and the share of prompts.
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

/// Decisions per day: in the morning and in the evening.
pub(super) const PER_DAY: u32 = 2;

/// The version of the simulation and its random streams. It is raised whenever a change makes the same job produce
/// different results.
pub(super) const VERSION: u32 = 1;

impl Oralytics {
    /// The test bed V2 with these people.
    pub fn of_people(people: Content) -> Oralytics {
        Oralytics::with_required(&[Value::Content(people)])
    }

    /// What decides which columns of the people's file are read.
    pub(super) fn model(&self) -> (TestBed, bool, EffectSize) {
        (self.test_bed, self.stationary, self.effect_size)
    }

    /// Decisions of a person.
    pub fn horizon(&self) -> u32 {
        self.days * PER_DAY
    }
}
