//! The axes of analyses: parameters with numeric values.

use serde_json::{Value as Json, json};

use crate::key::{Kind, Parameter, free_key};
use crate::manifest::parameter::{meant, named};
use crate::manifest::section::Section;
use crate::manifest::table::{Field, Need, TableReader};
use crate::manifest::text::written::quoted;
use crate::manifest::value::sweep::{Node, Reader};
use crate::text::Fault;

/// The horizontal axis of a curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CurveAxis {
    /// Phi(-1 / (2 sigma)), the exact rate at which the most likely context is wrong.
    ContextInferenceError,
    /// A swept parameter with numeric values.
    Swept(Parameter),
}

/// The word for the axis that is not a parameter.
pub const ERROR_AXIS: &str = "context_inference_error";

impl Field for CurveAxis {
    type Value = CurveAxis;

    fn schema(_: Option<Kind>) -> Json {
        json!({ "anyOf": [{ "const": ERROR_AXIS }, { "$ref": "#/$defs/parameter" }] })
    }

    fn read(table: &mut TableReader<'_, '_>, key: &str, kind: Option<Kind>) -> Option<CurveAxis> {
        let node = table.node(key);
        if node.is_none_or(|node| node.get_ref().as_str() == Some(ERROR_AXIS)) {
            table.need(table.span_of(key), Need::Numbers(Parameter::Environment("sigma")));
            return Some(CurveAxis::ContextInferenceError);
        }
        Parameter::read(table, key, kind).map(CurveAxis::Swept)
    }

    fn written(value: &CurveAxis, key: &'static str) -> Vec<(&'static str, String)> {
        match value {
            CurveAxis::ContextInferenceError => vec![(key, quoted(&ERROR_AXIS))],
            CurveAxis::Swept(parameter) => Parameter::written(parameter, key),
        }
    }
}

/// A parameter with numeric values.
impl Field for Parameter {
    type Value = Parameter;

    fn schema(_: Option<Kind>) -> Json {
        json!({ "$ref": "#/$defs/parameter" })
    }

    fn read(table: &mut TableReader<'_, '_>, key: &str, _: Option<Kind>) -> Option<Parameter> {
        let node = table.node(key)?;
        let numeric = Parameter::of_numbers(table.reader, key, node)?;
        table.need(node.span().into(), Need::Numbers(numeric));
        Some(numeric)
    }

    fn written(value: &Parameter, key: &'static str) -> Vec<(&'static str, String)> {
        vec![(key, quoted(value))]
    }
}

impl Parameter {
    /// The parameter with numeric values that a node names.
    pub(super) fn of_numbers(reader: &mut Reader<'_>, key: &str, node: &Node) -> Option<Parameter> {
        let named = node.get_ref().as_str().and_then(|name| named(reader.family, name));
        let numeric = named.filter(|parameter| {
            matches!(
                kind_of(*parameter).map(Kind::of_numbers),
                Some(
                    Kind::Real { .. }
                        | Kind::PositiveReal { .. }
                        | Kind::Integer { .. }
                        | Kind::Scalar
                )
            )
        });
        if numeric.is_none() {
            reader.unknown_parameter(key, node, &[ERROR_AXIS]);
        }
        numeric
    }
}

impl Reader<'_> {
    /// Reports a value that is neither the dotted name of a parameter nor one of `others`.
    pub(in crate::manifest) fn unknown_parameter(
        &mut self,
        key: &str,
        node: &Node,
        others: &[&str],
    ) {
        let found = self.found(node);
        let message = format!("`{key}`: expected the dotted name of a parameter, found {found}");
        let dotted = node.get_ref().as_str().unwrap_or_default();
        let fault = Fault::at(node.span().into(), message);
        // The section alone means its only name among the others.
        let section = others.iter().copied().find(|name| name.split('.').next() == Some(dotted));
        let meant = section.map(str::to_owned).or_else(|| meant(dotted, others));
        self.faults.add(match meant.filter(|name| name != dotted) {
            Some(name) => fault.help(format!("did you mean `{name}`?")),
            None => fault,
        });
    }
}

/// The type of a parameter's values; `None` for scenario and seed, which no table declares.
pub(in crate::manifest) fn kind_of(parameter: Parameter) -> Option<Kind> {
    let sections = Section::all().into_iter();
    let kind = |section: Section| {
        let (_, key) = section.find(parameter.key())?;
        (section.parameter(key.name) == parameter).then_some(key.kind)
    };
    sections.filter_map(kind).next().or_else(|| free_key(parameter.key()).map(|key| key.kind))
}
