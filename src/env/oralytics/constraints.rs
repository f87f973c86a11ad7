//! Constraints between the keys of the family: the people must suit the test bed.

use std::sync::Arc;

use crate::env::oralytics::parameters::{EffectSize, TestBed};
use crate::env::oralytics::table::Table;
use crate::key::{Constraint, Content, KeyType, Parameter, Violation};

const PEOPLE: Parameter = Parameter::Environment("people");
const TEST_BED: Parameter = Parameter::Environment("test_bed");
const STATIONARY: Parameter = Parameter::Environment("stationary");
const EFFECT_SIZE: Parameter = Parameter::Environment("effect_size");
const NO_EFFECT_AT: Parameter = Parameter::Environment("no_effect_at");

/// Constraints on every environment beyond the ranges of single keys.
pub(super) static CONSTRAINTS: [Constraint; 2] = [SUITABLE, NO_EFFECT];

/// The state without an effect has a value of every feature that effects and the algorithm share.
const NO_EFFECT: Constraint = Constraint {
    parameters: &[NO_EFFECT_AT, TEST_BED],
    violation: |assignment| {
        let state: Vec<f64> = KeyType::from_value(assignment.value(NO_EFFECT_AT)?)?;
        let test_bed = TestBed::from_value(assignment.value(TEST_BED)?)?;
        let help = "give the values of time_of_day, brushing, dosage and app, such as [0, 0.1, -0.1, 1], or []";
        let says = match state.len() {
            0 => return None,
            4 if test_bed != TestBed::V2 => return None,
            4 => {
                return Some(Violation::Impossible {
                    says: "`no_effect_at`: effects in \"v2\" do not depend on brushing, dosage and app".to_owned(),
                    help: "leave it out, or remove all effects with effect_factor = 0".to_owned(),
                });
            }
            found => format!("`no_effect_at`: expected 4 numbers or none, found {found}"),
        };
        Some(Violation::Impossible { says, help: help.to_owned() })
    },
};

const SUITABLE: Constraint = Constraint {
    parameters: &[PEOPLE, TEST_BED, STATIONARY, EFFECT_SIZE],
    violation: |assignment| {
        let people = Content::from_value(assignment.value(PEOPLE)?)?;
        if people.is_none() {
            return Some(Violation::Impossible {
                says: "`people` = \"none\": the parameters of people come from a CSV file"
                    .to_owned(),
                help: "docs/oralytics.md says how to make it from the published repositories; \
                       experiments/oralytics/synthetic_v2.csv has invented people"
                    .to_owned(),
            });
        }
        let table: Arc<Table> = people.parsed()?;
        let test_bed = TestBed::from_value(assignment.value(TEST_BED)?)?;
        let effect_size = EffectSize::from_value(assignment.value(EFFECT_SIZE)?)?;
        let unsuitable =
            table.people((test_bed, assignment.is_set(STATIONARY), effect_size)).err()?;
        Some(Violation::Impossible {
            says: format!("`people` does not suit the environment: {unsuitable}"),
            help: "docs/oralytics.md lists the columns of every test bed".to_owned(),
        })
    },
};
