//! The two sides of a difference.

use serde_json::{Value as Json, json};

use crate::job::Condition;
use crate::key::{Kind, Parameter};
use crate::manifest::analysis::axis::kind_of;
use crate::manifest::parameter::named;
use crate::manifest::table::{Field, TableKey, TableReader};
use crate::manifest::text::written::quoted;
use crate::manifest::value::sweep::{Node, Reader};
use crate::text::Fault;

/// Two sides of a difference: two conditions on the same parameter, with one value each.
#[derive(Clone, Debug, PartialEq)]
pub struct Sides {
    /// The minuend.
    pub first: Condition,
    /// The subtrahend.
    pub second: Condition,
}

impl Sides {
    /// Both sides.
    pub(in crate::manifest) fn both(&self) -> [&Condition; 2] {
        [&self.first, &self.second]
    }

    /// The dotted name of the key that distinguishes the sides; empty if no key does.
    pub fn key(&self) -> String {
        match self.first.parameter {
            Parameter::Job(_) | Parameter::AGENT_NAME => String::new(),
            parameter => parameter.to_string(),
        }
    }
}

const BY: TableKey = TableKey {
    name: "by",
    doc: "the parameter in which the two sides of a difference differ",
    schema: || json!({ "anyOf": [{ "const": "agent.name" }, { "$ref": "#/$defs/parameter" }] }),
    is_required: false,
};

const BETWEEN: TableKey = TableKey {
    name: "between",
    doc: "the two sides, first minus second",
    schema: || json!({ "type": "array", "minItems": 2, "maxItems": 2 }),
    is_required: false,
};

impl Field for Sides {
    type Value = Sides;

    const KEYS: Option<&'static [TableKey]> = Some(&[BY, BETWEEN]);

    fn schema(_: Option<Kind>) -> Json {
        (BETWEEN.schema)()
    }

    fn read(table: &mut TableReader<'_, '_>, _: &str, _: Option<Kind>) -> Option<Sides> {
        let (Some(by), Some(between)) = (table.node(BY.name), table.node(BETWEEN.name)) else {
            let fault = Fault::at(table.span, "a difference needs `by` and `between`");
            let help = "write by = \"scenario\" and between = [\"P-H-D\", \"L-H-D\"]";
            table.reader.faults.add(fault.help(help));
            return None;
        };
        let sides = table.reader.sides(by, between)?;
        table.need_jobs(between.span().into(), sides.both());
        Some(sides)
    }

    fn written(value: &Sides, _: &'static str) -> Vec<(&'static str, String)> {
        let [first, second] = value.both().map(|side| side.values[0].to_string());
        let between = format!("[{first}, {second}]");
        vec![(BY.name, quoted(&value.first.name())), (BETWEEN.name, between)]
    }
}

impl Reader<'_> {
    /// The two sides, from the values of `by` and `between`.
    fn sides(&mut self, by: &Node, between: &Node) -> Option<Sides> {
        let items = between.get_ref().as_array().map_or(&[][..], |items| &items[..]);
        let [one, other] = items else {
            self.expected("between", "a list of two values, as in [\"P-H-D\", \"L-H-D\"]", between);
            return None;
        };
        let parameter = by.get_ref().as_str().unwrap_or_default();
        let is_known =
            matches!(parameter, "agent" | "agent.name") || named(self.family, parameter).is_some();
        let first = self.side(parameter, by, one);
        // An unknown parameter is reported once.
        let (first, second) = (first, is_known.then(|| self.side(parameter, by, other)).flatten());
        let (first, second) = (first?, second?);
        if first == second {
            self.expected("between", "two different values", other);
            return None;
        }
        Some(Sides { first, second })
    }

    /// The condition that the parameter named in `by` has the value of `node`.
    fn side(&mut self, name: &str, by: &Node, node: &Node) -> Option<Condition> {
        if matches!(name, "agent" | "agent.name") {
            let Some(agent) = node.get_ref().as_str() else {
                self.expected("between", "an agent's name in quotes", node);
                return None;
            };
            return Some(Condition::texts(Parameter::AGENT_NAME, [agent]));
        }
        match named(self.family, name) {
            Some(parameter @ Parameter::SCENARIO) => {
                let values = self.scenarios("between", node);
                (!values.is_empty()).then_some(Condition { parameter, values })
            }
            // Seeds are replications: means are taken over them, so they are no side.
            Some(Parameter::Job(_)) | None => {
                self.unknown_parameter("by", by, &["agent.name"]);
                None
            }
            Some(parameter) => {
                let value = self.value("between", kind_of(parameter)?, node)?;
                Some(Condition { parameter, values: vec![value] })
            }
        }
    }
}
