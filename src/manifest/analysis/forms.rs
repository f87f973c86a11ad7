//! How the keys of analyses that are more than one value of a kind are read and written.

use serde_json::{Value as Json, json};
use toml::Spanned;
use toml::de::DeString;

use crate::job::Condition;
use crate::key::{Kind, Parameter, Value};
use crate::manifest::table::{Field, Need, TableReader};
use crate::manifest::text::written::{condition, quoted};
use crate::manifest::value::sweep::{Node, number, whole};
use crate::text::Span;

/// A family of contrasts whose p values are corrected together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FamilyName(pub String);

impl Field for FamilyName {
    type Value = FamilyName;

    fn schema(_: Option<Kind>) -> Json {
        json!({ "$ref": "#/$defs/name" })
    }

    fn read(table: &mut TableReader<'_, '_>, key: &str, _: Option<Kind>) -> Option<FamilyName> {
        Some(FamilyName(match table.node(key) {
            Some(node) => table.reader.name(key, node).value,
            None => table.name.to_owned(),
        }))
    }

    fn written(value: &FamilyName, key: &'static str) -> Vec<(&'static str, String)> {
        vec![(key, quoted(&value.0))]
    }
}

/// A number of bins into which the ten bins of the store can be merged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bins(pub u8);

impl Bins {
    const ALL: [u8; 4] = [1, 2, 5, 10];
}

impl Field for Bins {
    type Value = Bins;

    fn schema(_: Option<Kind>) -> Json {
        json!({ "enum": Bins::ALL })
    }

    fn read(table: &mut TableReader<'_, '_>, key: &str, _: Option<Kind>) -> Option<Bins> {
        let node = table.node(key)?;
        let bins = whole(node).and_then(|bins| u8::try_from(bins).ok());
        let bins = bins.filter(|bins| Bins::ALL.contains(bins));
        if bins.is_none() {
            table.reader.expected(key, "1, 2, 5 or 10", node);
        }
        bins.map(Bins)
    }

    fn written(value: &Bins, key: &'static str) -> Vec<(&'static str, String)> {
        vec![(key, value.0.to_string())]
    }
}

/// Conditions on the arms of a recovery.
impl Field for Vec<Condition> {
    type Value = Vec<Condition>;

    fn schema(_: Option<Kind>) -> Json {
        json!({ "$ref": "#/$defs/exclude" })
    }

    fn read(table: &mut TableReader<'_, '_>, key: &str, _: Option<Kind>) -> Option<Self> {
        let node = table.node(key)?;
        let keys = table.reader.table(key, node)?;
        if keys.is_empty() {
            let expected = "at least one condition, as in { agent.name = \"ppo\" }";
            table.reader.expected(key, expected, node);
        }
        let conditions = table.reader.conditions(keys, &format!("`{key}`"));
        let conditions: Vec<Condition> = conditions.into_iter().map(|one| one.value).collect();
        table.need_jobs(node.span().into(), &conditions);
        (!conditions.is_empty()).then_some(conditions)
    }

    fn written(value: &Vec<Condition>, key: &'static str) -> Vec<(&'static str, String)> {
        let written: Vec<String> = value.iter().map(condition).collect();
        vec![(key, format!("{{ {} }}", written.join(", ")))]
    }
}

/// Names of what is declared elsewhere; none for all of them.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct NameList(pub Vec<String>);

impl Field for NameList {
    type Value = NameList;

    fn schema(_: Option<Kind>) -> Json {
        json!({ "type": "array", "minItems": 1, "uniqueItems": true, "items": { "$ref": "#/$defs/name" } })
    }

    fn read(table: &mut TableReader<'_, '_>, key: &str, _: Option<Kind>) -> Option<Self> {
        let Some(node) = table.node(key) else { return Some(NameList::default()) };
        let items = table.reader.items(key, node);
        let names = items.into_iter().map(|item| table.reader.name(key, item).value);
        Some(NameList(names.collect()))
    }

    fn written(value: &NameList, key: &'static str) -> Vec<(&'static str, String)> {
        let names: Vec<String> = value.0.iter().map(quoted).collect();
        if names.is_empty() { Vec::new() } else { vec![(key, format!("[{}]", names.join(", ")))] }
    }
}

/// Parameters with numeric values.
#[derive(Clone, Debug, PartialEq)]
pub struct ParameterList(pub Vec<Parameter>);

impl Field for ParameterList {
    type Value = ParameterList;

    fn schema(_: Option<Kind>) -> Json {
        json!({ "type": "array", "minItems": 1, "uniqueItems": true, "items": { "$ref": "#/$defs/parameter" } })
    }

    fn read(table: &mut TableReader<'_, '_>, key: &str, _: Option<Kind>) -> Option<Self> {
        let node = table.node(key)?;
        let items = table.reader.items(key, node);
        let all = items.into_iter().map(|item| Parameter::of_numbers(table.reader, key, item));
        all.collect::<Option<Vec<_>>>().map(ParameterList)
    }

    fn written(value: &ParameterList, key: &'static str) -> Vec<(&'static str, String)> {
        let names: Vec<String> = value.0.iter().map(quoted).collect();
        vec![(key, format!("[{}]", names.join(", ")))]
    }
}

/// States of which each is a list of the values of the features that an agent sees.
#[derive(Clone, Debug, PartialEq)]
pub struct States(pub Vec<Vec<f64>>);

impl Field for States {
    type Value = States;

    fn schema(_: Option<Kind>) -> Json {
        let state = json!({ "type": "array", "minItems": 1, "items": { "type": "number" } });
        json!({ "type": "array", "minItems": 1, "uniqueItems": true, "items": state })
    }

    fn read(table: &mut TableReader<'_, '_>, key: &str, _: Option<Kind>) -> Option<States> {
        let Some(node) = table.node(key) else {
            table.missing(key, "list states: [[1, -0.7, -0.1, 0], [0, -0.7, -0.1, 0]]");
            return None;
        };
        let state = |node: &Node| {
            let items = node.get_ref().as_array().filter(|items| !items.is_empty())?;
            let numbers: Option<Vec<f64>> = items.iter().map(number).collect();
            numbers.filter(|numbers| numbers.iter().all(|number| number.is_finite()))
        };
        let items = node.get_ref().as_array().filter(|items| !items.is_empty());
        let states: Option<Vec<Vec<f64>>> = items.and_then(|all| all.iter().map(state).collect());
        if states.is_none() {
            let expected = "a list of states, each a list of numbers, as in [[1, -0.7, -0.1, 0]]";
            table.reader.expected(key, expected, node);
        }
        states.map(States)
    }

    fn written(value: &States, key: &'static str) -> Vec<(&'static str, String)> {
        let states: Vec<String> =
            value.0.iter().map(|state| Value::Reals(state.clone()).to_string()).collect();
        vec![(key, format!("[{}]", states.join(", ")))]
    }
}

/// Expressions of SQL over the rows of the view `estimate`, each with its name; their place in the manifest.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Diagnosands {
    /// The names with their expressions.
    pub all: Vec<(String, String)>,
    /// Where they stand; `None` without any.
    pub(crate) span: Option<Span>,
}

impl Field for Diagnosands {
    type Value = Diagnosands;

    fn schema(_: Option<Kind>) -> Json {
        json!({ "type": "object", "minProperties": 1, "additionalProperties": { "type": "string", "minLength": 1 } })
    }

    fn read(table: &mut TableReader<'_, '_>, key: &str, _: Option<Kind>) -> Option<Diagnosands> {
        let Some(node) = table.node(key) else { return Some(Diagnosands::default()) };
        let keys = node.get_ref().as_table().filter(|keys| !keys.is_empty());
        let read = |(name, expression): (&Spanned<DeString<'_>>, &Node)| {
            let name: &str = name.get_ref();
            let is_name = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
            let is_short = !name.is_empty() && name.len() <= 40 && name.chars().all(is_name);
            let expression = expression.get_ref().as_str().filter(|text| text.len() <= 2000);
            Some((name.to_owned(), expression?.to_owned())).filter(|_| is_short)
        };
        let all = keys.and_then(|keys| keys.iter().map(read).collect::<Option<Vec<_>>>());
        let Some(all) = all else {
            let expected = "names of lower-case letters, each with an expression of SQL over the rows of the view \
                            `estimate`, as in { largest = \"max(estimate)\" }";
            table.reader.expected(key, expected, node);
            return None;
        };
        Some(Diagnosands { all, span: Some(node.span().into()) })
    }

    fn written(value: &Diagnosands, key: &'static str) -> Vec<(&'static str, String)> {
        let all = value.all.iter().map(|(name, sql)| format!("{name} = {}", quoted(sql)));
        let all = all.collect::<Vec<_>>().join(", ");
        if all.is_empty() { Vec::new() } else { vec![(key, format!("{{ {all} }}"))] }
    }
}

/// What is sought: the smallest number of people, or the smallest value of a parameter, with a power.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Find {
    /// The parameter on which the effect depends; `None` for the number of people.
    pub effect: Option<Parameter>,
    /// The power, between 0 and 1.
    pub power: f64,
}

impl Find {
    /// The parameter along which it is sought.
    pub fn along(&self) -> Parameter {
        self.effect.unwrap_or(Parameter::Trial("people"))
    }
}

impl Field for Find {
    type Value = Find;

    fn schema(_: Option<Kind>) -> Json {
        let power = json!({ "type": "number", "exclusiveMinimum": 0, "exclusiveMaximum": 1 });
        json!({
            "type": "object",
            "properties": { "effect": { "$ref": "#/$defs/parameter" }, "power": power },
            "required": ["power"],
            "additionalProperties": false,
        })
    }

    fn read(table: &mut TableReader<'_, '_>, key: &str, _: Option<Kind>) -> Option<Find> {
        let node = table.node(key)?;
        let keys = node.get_ref().as_table();
        let is_known = |name: &str| ["effect", "power"].contains(&name);
        let keys = keys.filter(|keys| keys.keys().all(|name| is_known(name.get_ref())));
        let power = keys.and_then(|keys| keys.get("power")).and_then(number);
        let power = power.filter(|power| *power > 0.0 && *power < 1.0);
        let Some(power) = power else {
            let expected = "{ power = 0.8 } or another number between 0 and 1, and perhaps the parameter of an effect, as \
                            in { effect = \"environment.parameters.effect\", power = 0.8 }";
            table.reader.expected(key, expected, node);
            return None;
        };
        let effect = match keys.and_then(|keys| keys.get("effect")) {
            None => None,
            Some(name) => Some(Parameter::of_numbers(table.reader, key, name)?),
        };
        let find = Find { effect, power };
        table.need(node.span().into(), Need::Numbers(find.along()));
        Some(find)
    }

    fn written(value: &Find, key: &'static str) -> Vec<(&'static str, String)> {
        let effect =
            value.effect.map_or_else(String::new, |one| format!("effect = {}, ", quoted(&one)));
        vec![(key, format!("{{ {effect}power = {} }}", Value::Real(value.power)))]
    }
}
