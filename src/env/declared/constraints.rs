//! Constraints between a model and what a manifest gives beside it.

use std::collections::HashSet;
use std::sync::Arc;

use crate::env::declared::description::WorldDescription;
use crate::env::declared::model::{
    Definition, ModelFile, ModelParameter, NeededColumn, Referent, SHIPPED,
};
use crate::env::declared::numbers::range_in_words;
use crate::env::declared::program::impossible_draws;
use crate::env::declared::rows::{ColumnFault, Numbers};
use crate::env::scenario::Scenario;
use crate::key::{Assignment, Constraint, Content, Key, KeyType, Parameter, Value, Violation};
use crate::text::{Fault, FaultList, Span, nearest, shortened};

const MODEL: Parameter = Parameter::Environment("model");
const PEOPLE: Parameter = Parameter::Environment("people");
const REPLAY: Parameter = Parameter::Environment("replay");

/// The constraints on every world.
pub(super) const CONSTRAINTS: &[Constraint] = &[EXISTS, COLUMNS, ROWS, FEATURES];

/// The constraint on the parameters that are set, by the keys of the environment.
pub(super) fn of_parameters(keys: &[&'static Key]) -> Constraint {
    let set = keys.iter().map(|key| Parameter::Environment(key.name));
    let parameters: Vec<Parameter> = [MODEL].into_iter().chain(set).collect();
    Constraint { parameters: parameters.leak(), violation: unknown_parameter }
}

/// The constraint on worlds of which no parameter is set.
pub(super) const OF_DEFAULTS: &[Constraint] =
    &[Constraint { parameters: &[MODEL], violation: unknown_parameter }];

/// Reports draws that values of the parameters make impossible.
fn draws(assignment: &Assignment<'_>, model: &ModelFile, parameters: &[f64]) -> Option<Violation> {
    let mut faults = FaultList::default();
    for (index, parameter, value) in impossible_draws(model, parameters) {
        let quantity = &model.quantities[index];
        let Definition::DrawInstruction(law, formulas) = &quantity.definition else { continue };
        let (least, most) = law.range(parameter);
        let keys = law.form().keys;
        let key = keys[parameter.min(keys.len() - 1)];
        let expected = range_in_words(least, most);
        let named = formulas[parameter].targets.iter().filter_map(|target| match target {
            Referent::ModelParameter(index) => Some(*index),
            _ => None,
        });
        let given =
            named.map(|one| format!("{} = {}", model.parameters[one].name, parameters[one]));
        let mut given: Vec<String> = given.collect();
        given.dedup();
        let whole = formulas[parameter].position.whole;
        let says = format!(
            "`{}`: {key} is {expected}, found {value} with {}",
            quantity.name,
            given.join(", ")
        );
        let fault = Fault::at(Span { start: whole.0, end: whole.1 }, says);
        faults.add(fault.help(
            "give the parameter another value, or cut the expression to the range with clip",
        ));
    }
    let content = content(assignment, MODEL)?;
    (!faults.is_empty()).then_some(Violation::InFile { parameter: MODEL, content, faults })
}

fn content(assignment: &Assignment<'_>, parameter: Parameter) -> Option<Content> {
    Content::from_value(assignment.value(parameter)?)
}

fn model(assignment: &Assignment<'_>) -> Option<Arc<ModelFile>> {
    content(assignment, MODEL)?.parsed()
}

fn impossible(says: impl Into<String>, help: impl Into<String>) -> Option<Violation> {
    Some(Violation::Impossible { says: says.into(), help: help.into() })
}

const EXISTS: Constraint = Constraint {
    parameters: &[MODEL],
    violation: |assignment| {
        content(assignment, MODEL)?.is_none().then_some(())?;
        impossible(
            "`model` = \"none\": a world is declared in a file",
            "experiments/models/ten_lines.toml is a small one",
        )
    },
};

/// The file of people has the columns that the model needs, with numbers.
const COLUMNS: Constraint = Constraint {
    parameters: &[MODEL, PEOPLE],
    violation: |assignment| {
        let model = model(assignment)?;
        let people = content(assignment, PEOPLE)?;
        let table: Option<Arc<Numbers>> = people.parsed();
        let of_model = content(assignment, MODEL)?;
        let lacking = columns_of_a_shipped_model(&of_model, &model, table.as_deref());
        if lacking.is_some() {
            return lacking;
        }
        let mut faults = FaultList::default();
        let known = model.names();
        for needed in &model.columns {
            let name = &needed.name;
            let found = match &table {
                None => Err(ColumnFault::Missing),
                Some(table) => needed.find(table),
            };
            let fault = match (found, &table) {
                (Ok(_), _) => continue,
                (Err(ColumnFault::Text(line, text)), _) => Fault::at(
                    needed.span,
                    format!(
                        "`{name}` is a column of the people, whose line {line} has `{text}` instead of a number"
                    ),
                ),
                (Err(ColumnFault::Missing), Some(table)) => {
                    let fault = Fault::at(
                        needed.span,
                        format!("`{name}` is neither declared here nor a column of the people"),
                    );
                    let columns = table.columns().iter().map(String::as_str);
                    match (nearest(name, known.iter().copied().chain(columns)), table.columns()) {
                        (Some(near), _) => fault.help(format!("did you mean `{near}`?")),
                        (None, [only]) if only.contains(';') || only.contains('\t') => {
                            let help = "separate the fields of the file of people by commas: its only column is";
                            fault.help(format!("{help} `{}`", shortened(only)))
                        }
                        (None, columns) => {
                            let columns = shortened(&columns.join(", "));
                            fault.help(format!("the columns of the people are {columns}"))
                        }
                    }
                }
                (Err(ColumnFault::Missing), None) => {
                    let fault = Fault::at(needed.span, format!("`{name}` is not declared"));
                    match nearest(name, known.iter().copied()) {
                        Some(near) => fault.help(format!("did you mean `{near}`?")),
                        None => fault.help("if it is a column of people, name their file: people = \"people.csv\" in [environment]"),
                    }
                }
            };
            faults.add(fault);
        }
        if faults.is_empty() {
            for (name, span) in &model.unused {
                let says = format!("`{name}` is used by no role, and by nothing that a role needs");
                faults.add(Fault::at(*span, says).help("delete it, or use it"));
            }
        }
        if faults.is_empty() {
            return None;
        }
        Some(Violation::InFile { parameter: MODEL, content: of_model, faults })
    },
};

/// One violation for all columns that a model lacks which comes with the program, because its text is not the user's;
/// `None` if it lacks none.
fn columns_of_a_shipped_model(
    content: &Content,
    model: &ModelFile,
    people: Option<&Numbers>,
) -> Option<Violation> {
    let is_shipped = || SHIPPED.iter().any(|(_, text)| content.text() == Some(*text));
    let is_missing = |needed: &&NeededColumn| {
        people.is_none_or(|people| matches!(needed.find(people), Err(ColumnFault::Missing)))
    };
    let mut lacking = model.columns.iter().filter(is_missing);
    let first = &lacking.next().filter(|_| is_shipped())?.name;
    let more = match lacking.count() {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    let says = match people {
        None => {
            format!("`people` names no file, and the model has columns of people: `{first}`{more}")
        }
        Some(_) => format!("`people`: the file lacks columns of the model: `{first}`{more}"),
    };
    impossible(
        says,
        "experiments/oralytics has invented people, synthetic_*.csv; docs/oralytics.md says how to make the published ones",
    )
}

/// Rows that are replayed are of the people, and have the model's columns.
const ROWS: Constraint = Constraint {
    parameters: &[MODEL, PEOPLE, REPLAY],
    violation: |assignment| {
        let model = model(assignment)?;
        let rows = content(assignment, REPLAY)?;
        let (Some(_), false) = (model.replay, rows.is_none()) else {
            return match (model.replay, rows.is_none()) {
                (Some(_), true) => impossible(
                    "the model has [replay], and `replay` names no file of rows",
                    "name a CSV file, as in replay = \"rows.csv\" in [environment]",
                ),
                (None, false) => impossible(
                    "`replay` names rows, and the model has no [replay]",
                    "leave `replay` out, or add [replay] with its `columns` to the model",
                ),
                _ => None,
            };
        };
        let rows: Arc<Numbers> = rows.parsed()?;
        for name in &model.replayed {
            match rows.column(name) {
                Ok(_) => {}
                Err(ColumnFault::Missing) => {
                    return impossible(
                        format!(
                            "`replay` has no column `{name}`, which the model's [replay] lists"
                        ),
                        format!("its columns are {}", rows.columns().join(", ")),
                    );
                }
                Err(ColumnFault::Text(line, text)) => {
                    return impossible(
                        format!("`replay`: line {line} has `{text}` in column `{name}`"),
                        "write a number, or leave the field empty for a missing value",
                    );
                }
            }
        }
        let people: Option<Arc<Numbers>> = content(assignment, PEOPLE)?.parsed();
        let own: HashSet<&str> = rows.by_person().iter().map(|(name, _)| name.as_str()).collect();
        let without = people.and_then(|people| {
            let names = (0..people.rows()).map(|row| people.person(row));
            { names }.find(|name| !own.contains(name.as_str()))
        });
        let name = without?;
        impossible(
            format!("`replay` has no row of person {name}, who is one of the people"),
            "give every person at least one row; the column `person` of both files has their names",
        )
    },
};

/// Scenarios show features of the model.
const FEATURES: Constraint = Constraint {
    parameters: &[MODEL, Parameter::SCENARIO],
    violation: |assignment| {
        let model = model(assignment)?;
        let scenario: Scenario = assignment.text(Parameter::SCENARIO).parse().ok()?;
        let description = WorldDescription::of(&model, 0);
        let fault = description.shown(&scenario).err()?;
        let names: Vec<&str> =
            description.features.iter().map(|feature| feature.name.as_str()).collect();
        Some(Violation::ImpossibleAt {
            parameter: Parameter::SCENARIO,
            says: format!("{fault} of the model"),
            help: format!("its features are {}", names.join(", ")),
        })
    },
};

/// Parameters that a manifest sets are numbers of the model.
fn unknown_parameter(assignment: &Assignment<'_>) -> Option<Violation> {
    let model = model(assignment)?;
    for (parameter, value) in &assignment.0 {
        let Some(name) = parameter.key().strip_prefix("parameters.") else { continue };
        let known = model.parameters.iter().map(|one| one.name.as_str());
        if { known.clone() }.all(|one| one != name) {
            let all: Vec<&str> = known.clone().collect();
            let help = match nearest(name, known) {
                Some(near) => format!("did you mean `{near}`?"),
                None if all.is_empty() => "the model has no [parameters]".to_owned(),
                None => format!("its parameters are {}", all.join(", ")),
            };
            return impossible(format!("the model has no parameter `{name}`"), help);
        }
        if number(value).is_none() {
            return impossible(
                format!("parameter `{name}`: expected a number, found {value}"),
                "parameters of a model are numbers",
            );
        }
    }
    let value = |one: &ModelParameter| {
        let mut given = assignment.0.iter();
        let given = given.find(|(key, _)| key.key().strip_prefix("parameters.") == Some(&one.name));
        given.and_then(|(_, value)| number(value)).unwrap_or(one.default)
    };
    let parameters: Vec<f64> = model.parameters.iter().map(value).collect();
    draws(assignment, &model, &parameters)
}

/// The number that a value of a parameter is; true is 1.
pub(super) fn number(value: &Value) -> Option<f64> {
    match value {
        Value::Real(real) => Some(*real),
        Value::Integer(whole) => Some(*whole as f64),
        Value::Flag(flag) => Some(f64::from(u8::from(*flag))),
        _ => None,
    }
}
