//! Constraints between the keys of the family: the people must suit the test bed.

use std::sync::Arc;

use crate::env::oralytics::parameters::Oralytics;
use crate::env::oralytics::table::Table;
use crate::key::{Constraint, Keyed, Parameter, Violation};

const PEOPLE: Parameter = Parameter::Environment("people");
const TEST_BED: Parameter = Parameter::Environment("test_bed");

/// Every parameter of the environment, in the order of its keys.
const ALL: [Parameter; Oralytics::KEYS.len()] = {
    let mut all = [PEOPLE; Oralytics::KEYS.len()];
    let mut place = 0;
    while place < all.len() {
        all[place] = Parameter::Environment(Oralytics::KEYS[place].name);
        place += 1;
    }
    all
};

/// Constraints on every environment beyond the ranges of single keys.
pub(super) static CONSTRAINTS: [Constraint; 2] = [
    Constraint {
        parameters: &[PEOPLE, TEST_BED],
        violation: |assignment| {
            let none = assignment.shown(PEOPLE) == "\"none\"";
            none.then(|| Violation::Impossible {
                says: "`people` is missing: the parameters of people come from a CSV file"
                    .to_owned(),
                help: "docs/oralytics.md says how to make it from the published repositories; \
                       experiments/oralytics/synthetic_v2.csv has invented people"
                    .to_owned(),
            })
        },
    },
    Constraint {
        parameters: &ALL,
        violation: |assignment| {
            let parameters: Oralytics =
                assignment.keyed(|parameter| matches!(parameter, Parameter::Environment(_)))?;
            let table: Arc<Table> = parameters.people.parsed()?;
            let unsuitable = table.people(&parameters).err()?;
            Some(Violation::Impossible {
                says: format!("`people` does not suit the environment: {unsuitable}"),
                help: "docs/oralytics.md lists the columns of every test bed".to_owned(),
            })
        },
    },
];
