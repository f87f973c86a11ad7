//! The JSON Schema of single values.

use serde_json::{Map, Value as Json, json};

use crate::key::{Column, Kind, MOST_ROWS, NumberRange};

/// The schema of a single value of a kind.
pub(crate) fn value(kind: Kind) -> Json {
    match kind {
        Kind::Real { .. } | Kind::PositiveReal { .. } => number(kind.number_range()),
        Kind::Integer { min, max } => json!({ "type": "integer", "minimum": min, "maximum": max }),
        Kind::Flag => json!({ "type": "boolean" }),
        Kind::Choice(words) => json!({ "enum": words }),
        Kind::RealPair { min, max } => json!({
            "type": "array",
            "minItems": 2,
            "maxItems": 2,
            "items": value(Kind::Real { min, max }),
        }),
        Kind::Reals { least, most, min, max } => json!({
            "type": "array",
            "minItems": least,
            "maxItems": most,
            "items": value(Kind::Real { min, max }),
        }),
        Kind::Counts { most, max } => json!({
            "type": "array",
            "maxItems": most,
            "uniqueItems": true,
            "items": value(Kind::Integer { min: 1, max: max.into() }),
        }),
        Kind::Widths { most, max } => json!({
            "type": "array",
            "minItems": 1,
            "maxItems": most,
            "items": value(Kind::Integer { min: 1, max: max.into() }),
        }),
        Kind::Text { most } => json!({ "type": "string", "minLength": 1, "maxLength": most }),
        Kind::Words { most, longest } => json!({
            "type": "array",
            "minItems": 1,
            "maxItems": most,
            "items": { "type": "string", "maxLength": longest },
        }),
        Kind::Scalar => json!({ "type": ["boolean", "number", "string"] }),
        Kind::Distribution(of) => distribution(&number(of)),
        Kind::Rows(columns) => rows(columns),
        Kind::Content(form) => {
            let description = format!("{}, or its text", form.expectation().replace(", or", ","));
            json!({ "type": "string", "description": description })
        }
        Kind::AnyOf(kinds) => {
            json!({ "anyOf": kinds.iter().copied().map(value).collect::<Vec<_>>() })
        }
    }
}

/// The schema of numbers in a range.
fn number(range: NumberRange) -> Json {
    let NumberRange { min, max } = range;
    match min {
        Some(min) => json!({ "type": "number", "minimum": min, "maximum": max }),
        None => json!({ "type": "number", "exclusiveMinimum": 0, "maximum": max }),
    }
}

/// The schema of a distribution of numbers, which have the schema `number`.
fn distribution(number: &Json) -> Json {
    let positive = json!({ "type": "number", "exclusiveMinimum": 0 });
    let table = |required: [&str; 2], properties: Json| {
        json!({
            "type": "object",
            "additionalProperties": false,
            "required": required.into_iter().filter(|key| !key.is_empty()).collect::<Vec<_>>(),
            "properties": properties,
        })
    };
    let pair = json!({ "type": "array", "minItems": 2, "maxItems": 2, "items": number });
    json!({ "anyOf": [
        number,
        { "const": "fixed" },
        table(["uniform", ""], json!({ "uniform": pair })),
        table(["normal", "sd"], json!({
            "normal": { "type": "number" }, "sd": positive, "from": number, "to": number,
        })),
        table(["log_normal", "log_sd"], json!({
            "log_normal": positive, "log_sd": positive, "from": number, "to": number,
        })),
        table(["values", ""], json!({
            "values": values(number.clone()),
            "weights": { "type": "array", "minItems": 1, "items": positive },
        })),
    ] })
}

/// The schema of rows with these columns.
fn rows(columns: &[Column]) -> Json {
    let mut properties: Map<String, Json> =
        columns.iter().map(|column| (column.name.to_owned(), number(column.of))).collect();
    properties.insert("weight".to_owned(), json!({ "type": "number", "exclusiveMinimum": 0 }));
    json!({ "anyOf": [
        { "type": "string", "description": "\"none\", the name of a CSV file, or its text" },
        {
            "type": "array",
            "minItems": 1,
            "maxItems": MOST_ROWS,
            "items": {
                "type": "object",
                "additionalProperties": false,
                "minProperties": 1,
                "properties": properties,
            },
        },
    ] })
}

/// The schema of a list of values of a sweep, which a zip may repeat.
pub(in crate::manifest) fn values(items: Json) -> Json {
    json!({ "type": "array", "minItems": 1, "items": items })
}

/// The schema of a list of distinct items.
pub(in crate::manifest) fn list(items: Json) -> Json {
    json!({ "type": "array", "minItems": 1, "uniqueItems": true, "items": items })
}
