//! Constraints between a file of decisions and the expressions of its columns.

use crate::env::recorded::description::shown;
use crate::env::recorded::parameters::LogParameters;
use crate::env::recorded::reading::{LogFaults, known};
use crate::env::scenario::Scenario;
use crate::key::{Assignment, Constraint, Content, Keyed, Parameter, Value, Violation};

const KEYS: usize = LogParameters::KEYS.len();

/// All keys in their order.
const ALL: [Parameter; KEYS] = {
    let mut all = [Parameter::Environment(""); KEYS];
    let mut index = 0;
    while index < KEYS {
        all[index] = Parameter::Environment(LogParameters::KEYS[index].name);
        index += 1;
    }
    all
};

/// All keys, and the scenario.
const ALL_AND_SCENARIO: [Parameter; KEYS + 1] = {
    let mut all = [Parameter::SCENARIO; KEYS + 1];
    let mut index = 0;
    while index < KEYS {
        all[index] = ALL[index];
        index += 1;
    }
    all
};

/// The constraints on every recorded trial.
pub(super) const CONSTRAINTS: &[Constraint] = &[EXISTS, FAULTS, FEATURES];

fn is_key(parameter: &Parameter) -> bool {
    matches!(parameter, Parameter::Environment(_))
}

const EXISTS: Constraint = Constraint {
    parameters: &[Parameter::Environment("file")],
    violation: |assignment| {
        let value = assignment.value(Parameter::Environment("file"))?;
        (*value == Value::Content(Content::default())).then(|| Violation::Impossible {
            says: "`file` = \"none\": a recorded trial is a file".to_owned(),
            help: "write file = \"trial.csv\"".to_owned(),
        })
    },
};

/// The expressions name columns of the file, and the file is a trial.
const FAULTS: Constraint = Constraint {
    parameters: &ALL,
    violation: |assignment: &Assignment<'_>| {
        let parameters: LogParameters = assignment.keyed(is_key)?;
        let read = known(&parameters)?;
        match read.as_ref().as_ref().err()? {
            LogFaults::File(faults) => Some(Violation::InFile {
                parameter: ALL[0],
                content: parameters.file,
                faults: faults.list(),
            }),
            LogFaults::Keys(faults) => {
                let said = faults.iter().map(|(key, fault)| {
                    let help = fault.hint().map(|help| format!(" ({help})")).unwrap_or_default();
                    format!("`{key}`: {}{help}", fault.message())
                });
                Some(Violation::ImpossibleAt {
                    parameter: Parameter::Environment(faults.first()?.0),
                    says: said.collect::<Vec<_>>().join("; "),
                    help: "the keys of [data] are columns of the file, or expressions of them"
                        .to_owned(),
                })
            }
        }
    },
};

/// Agents observe numbers of the state that every decision has.
const FEATURES: Constraint = Constraint {
    parameters: &ALL_AND_SCENARIO,
    violation: |assignment| {
        let parameters: LogParameters = assignment.keyed(is_key)?;
        let read = known(&parameters)?;
        let log = &read.as_ref().as_ref().ok()?.log;
        let scenario: Scenario = assignment.text(Parameter::SCENARIO).parse().ok()?;
        let fault = shown(&log.names, &scenario).err()?;
        Some(Violation::ImpossibleAt {
            parameter: Parameter::SCENARIO,
            says: format!("{fault} of the recorded state"),
            help: format!("its names are {}", log.names.join(", ")),
        })
    },
};
