//! Constraints between the keys of the family: the people must suit the test bed.

use std::sync::Arc;

use crate::env::oralytics::parameters::{EffectSize, TestBed};
use crate::env::oralytics::table::Table;
use crate::key::{Constraint, Content, KeyType, Parameter, Violation};

const PEOPLE: Parameter = Parameter::Environment("people");
const TEST_BED: Parameter = Parameter::Environment("test_bed");
const STATIONARY: Parameter = Parameter::Environment("stationary");
const EFFECT_SIZE: Parameter = Parameter::Environment("effect_size");

/// Constraints on every environment beyond the ranges of single keys.
pub(super) static CONSTRAINTS: [Constraint; 1] = [Constraint {
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
}];
