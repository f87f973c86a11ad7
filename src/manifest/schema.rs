//! The JSON Schema of manifests, with which editors complete and check them.

use serde_json::{Map, Value as Json, json};

use crate::agent::Algorithm;
use crate::env::recorded::{self, DATA};
use crate::env::{Family, Feature};
use crate::key::{Key, Kind, SectionName};
use crate::manifest::analysis::kind::KINDS;
use crate::manifest::limits::MOST_JOBS;
use crate::manifest::parameter::{named, parameters};
use crate::manifest::preset;
use crate::manifest::read::{FORMAT, LONGEST_NAME, LONGEST_TIME_LIMIT, MOST_ENTRIES};
use crate::manifest::search::draw::DrawForm;
use crate::manifest::section::Section;
use crate::manifest::table::table_schema;
use crate::manifest::value::free::{FAMILY, PARAMETERS};
use crate::manifest::value::range::MOST_VALUES;
use crate::manifest::value::schema::{list, value, values};
use crate::manifest::{estimate, search};

/// The schema, in draft 2020-12. It states types, ranges and words of single keys; [`super::parse`] checks
/// the rules between keys.
pub fn schema() -> Json {
    let mut schema = json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "jitai manifest",
        "description": "An experiment: environment, scenarios, agents and seeds.",
        "type": "object",
        "additionalProperties": false,
        "required": ["format", "name"],
        "properties": top(),
        // The first family has letters.
        "if": {
            "anyOf": [
                { "required": [DATA] },
                {
                    "required": ["environment"],
                    "properties": {
                        "environment": {
                            "required": [FAMILY],
                            "properties": { FAMILY: { "not": { "const": Family::first().name } } },
                        },
                    },
                },
            ],
        },
        "else": { "properties": { "scenarios": one_or_more("#/$defs/letters") } },
        "$defs": {
            "name": {
                "type": "string",
                "minLength": 1,
                "maxLength": LONGEST_NAME,
                "description": "visible characters; no control, text-direction or zero-width characters",
            },
            "scenario": { "anyOf": [letters(), names(), list(names())] },
            "letters": letters(),
            "seed": { "type": "integer", "minimum": 0, "maximum": i64::MAX },
            "parameter": { "anyOf": [
                { "enum": parameters().into_iter().map(|p| p.to_string()).collect::<Vec<_>>() },
                {
                    "type": "string",
                    "pattern": format!("^(agent|environment)\\.parameters\\.{FREE_NAME}$"),
                },
            ] },
            "zip": {
                "type": "array",
                "minItems": 2,
                "uniqueItems": true,
                "items": { "$ref": "#/$defs/parameter" },
            },
            "search": search::declared::schema(),
            "exclude": exclude(),
            "estimate": table_schema(&estimate::keys::keys()),
            "analysis": analysis(),
        },
    });
    for algorithm in Algorithm::all() {
        schema["$defs"][algorithm.name()] = agent(algorithm);
    }
    for section_of in others() {
        let own = match section_of {
            Section::Trial(_) => trial(section_of),
            _ => section(section_of, Map::new()),
        };
        schema["$defs"][section_of.name()] = own;
        let reference = format!("#/$defs/{}", section_of.name());
        schema["properties"][section_of.name()] = json!({ "$ref": reference });
    }
    for family in Family::all() {
        schema["$defs"][Section::Environment(family).title()] = environment(family);
    }
    schema
}

/// The sections that agents share besides the environment.
fn others() -> impl Iterator<Item = Section> {
    let names = SectionName::ALL.into_iter().filter(|name| *name != SectionName::Environment);
    names.filter_map(|name| Section::opened(name, Family::first()))
}

/// Environments of a family.
fn environment(family: &'static Family) -> Json {
    let mut properties = Map::new();
    let named = described("the family of the environment", json!({ "const": family.name }));
    properties.insert(FAMILY.to_owned(), named);
    if family.with_parameters.is_some() {
        properties.insert(PARAMETERS.to_owned(), free_parameters());
    }
    let mut schema = section(Section::Environment(family), properties);
    if family != Family::first() {
        schema["required"] = json!([FAMILY]);
    }
    schema
}

/// A trial. Keys that begin with `entry_` or `update_` may stand in a table.
fn trial(section_of: Section) -> Json {
    let table = |prefix: &str| {
        let keys = section_of.keys().iter().filter_map(|key| {
            Some((key.name.strip_prefix(prefix)?.strip_prefix('_')?.to_owned(), swept(key)))
        });
        json!({
            "type": "object",
            "additionalProperties": false,
            "properties": keys.collect::<Map<_, _>>(),
        })
    };
    let mut schema = section(section_of, Map::new());
    let file = schema["properties"]["entry"].take();
    schema["properties"]["entry"] = json!({ "anyOf": [file, table("entry")] });
    schema["properties"]["update"] = table("update");
    schema
}

/// A recorded trial, in the place of an environment.
fn data() -> Json {
    let recorded = Section::Environment(&recorded::FAMILY);
    let mut schema = section(recorded, Map::new());
    let texts = list(json!({ "type": "string" }));
    let by_name = json!({ "type": "object", "additionalProperties": { "type": "string" } });
    for (key, form) in [("order", texts.clone()), ("probability", texts), ("state", by_name)] {
        if let Some(forms) = schema["properties"][key]["anyOf"].as_array_mut() {
            forms.push(form);
        }
    }
    let required = recorded.keys().iter().filter(|key| key.default.is_none());
    schema["required"] = required.map(|key| key.name).collect();
    described("a trial that happened, in the place of an environment", schema)
}

/// The environment of every family.
fn environments() -> Json {
    let each = Family::all().iter().map(|family| {
        let title = Section::Environment(family).title();
        json!({ "$ref": format!("#/$defs/{title}") })
    });
    json!({ "anyOf": each.collect::<Vec<_>>() })
}

fn top() -> Json {
    json!({
        "format": { "const": FORMAT, "description": "version of the manifest's format" },
        "name": described("the experiment's name", json!({ "$ref": "#/$defs/name" })),
        "extends": {
            "enum": preset::names(),
            "description": "a built-in preset; this manifest overrides it key by key",
        },
        "question": { "type": "string", "description": "the question of the experiment" },
        "hypothesis": { "type": "string", "description": "the expected result" },
        "published": {
            "type": "string",
            "description": "file of published numbers to compare with, relative to this one",
        },
        "time_limit_seconds": {
            "type": "integer",
            "minimum": 1,
            "maximum": LONGEST_TIME_LIMIT,
            "description": "time limit of a job, after which it fails; not part of its content",
        },
        "scenarios": described("the scenarios that agents observe", one_or_more("#/$defs/scenario")),
        "seeds": {
            "description": "a count n, for the seeds 1 to n, or a list",
            "anyOf": [
                { "type": "integer", "minimum": 1, "maximum": MOST_JOBS },
                list(json!({ "$ref": "#/$defs/seed" })),
            ],
        },
        "zip": {
            "description": "swept parameters that advance together",
            "type": "array",
            "minItems": 1,
            "maxItems": MOST_ENTRIES,
            "items": { "$ref": "#/$defs/zip" },
        },
        "environment": environments(),
        DATA: data(),
        "agent": {
            "type": "array",
            "maxItems": MOST_ENTRIES,
            "items": {
                "anyOf": Algorithm::all()
                    .into_iter()
                    .map(|algorithm| json!({ "$ref": format!("#/$defs/{}", algorithm.name()) }))
                    .collect::<Vec<_>>(),
            },
        },
        "search": described(
            "a search for the best of drawn settings, by a race over seeds",
            json!({ "$ref": "#/$defs/search" }),
        ),
        "exclude": {
            "description": "cells to leave out",
            "type": "array",
            "maxItems": MOST_ENTRIES,
            "items": { "$ref": "#/$defs/exclude" },
        },
        "estimate": {
            "description": "causal effects that are estimated from the decisions of jobs; not part of any job",
            "type": "array",
            "maxItems": MOST_ENTRIES,
            "items": { "$ref": "#/$defs/estimate" },
        },
        "analysis": {
            "description": "figures and tables of the report; not part of any job",
            "type": "array",
            "maxItems": MOST_ENTRIES,
            "items": { "$ref": "#/$defs/analysis" },
        },
    })
}

/// The names of features.
fn names() -> Json {
    json!({ "type": "string", "pattern": "^[A-Za-z0-9_]+(-[A-Za-z0-9_]+)*$" })
}

/// A scenario of letters.
fn letters() -> Json {
    let letters: String = Feature::ALL.iter().map(|feature| feature.letter()).collect();
    json!({
        "type": "string",
        "pattern": format!("^[{letters}](-[{letters}])*$"),
        "examples": ["C-H-D", "L-H-D", "P-H-D", "C-T", "L-T", "P-T"],
    })
}

fn agent(algorithm: &'static Algorithm) -> Json {
    let mut properties = Map::new();
    let name =
        described("the agent's name in tables and figures", json!({ "$ref": "#/$defs/name" }));
    properties.insert("name".to_owned(), name);
    let label = described(
        "the agent's label in figures and tables; its name by default",
        json!({ "$ref": "#/$defs/name" }),
    );
    properties.insert("label".to_owned(), label);
    properties.insert("algorithm".to_owned(), json!({ "const": algorithm.name() }));
    if algorithm.is_external() {
        properties.insert(PARAMETERS.to_owned(), free_parameters());
    }
    let mut schema = section(Section::Agent(algorithm), properties);
    for key in Section::Agent(algorithm).keys() {
        if let Some(forms) = schema["properties"][key.name]["anyOf"].as_array_mut() {
            forms.extend(draws(key.kind));
        }
    }
    schema["required"] = json!(["name"]);
    schema
}

/// The pattern of the names of outside programs' parameters.
const FREE_NAME: &str = "[A-Za-z_][A-Za-z0-9_]{0,63}";

/// The schema of an outside program's parameters.
fn free_parameters() -> Json {
    let one = value(Kind::Scalar);
    let number = json!({ "type": "number" });
    let step = json!({ "type": "number", "exclusiveMinimum": 0 });
    let forms = [one.clone(), values(one), range(number, step)];
    let forms: Vec<Json> = forms.into_iter().chain(draws(Kind::Scalar)).collect();
    json!({
        "description": "the program's own parameters; swept like any key",
        "type": "object",
        "maxProperties": 100,
        "propertyNames": { "pattern": format!("^{FREE_NAME}$") },
        "additionalProperties": { "anyOf": forms },
    })
}

fn section(section: Section, mut properties: Map<String, Json>) -> Json {
    for key in section.keys() {
        let mut property = swept(key);
        if let Some(default) = key.default() {
            property["default"] = json!(default);
        }
        properties.insert(key.name.to_owned(), property);
    }
    json!({ "type": "object", "additionalProperties": false, "properties": properties })
}

/// The schema of a key: a value, a list of values or a range.
fn swept(key: &Key) -> Json {
    let mut forms = vec![value(key.kind), values(value(key.kind))];
    match key.kind.of_numbers() {
        number @ (Kind::Real { .. } | Kind::PositiveReal { .. }) => {
            forms.push(range(value(number), json!({ "type": "number", "exclusiveMinimum": 0 })));
        }
        number @ Kind::Integer { .. } => {
            forms.push(range(value(number), json!({ "type": "integer", "minimum": 1 })));
        }
        Kind::Flag
        | Kind::Choice(_)
        | Kind::RealPair { .. }
        | Kind::Reals { .. }
        | Kind::Counts { .. }
        | Kind::Widths { .. }
        | Kind::Text { .. }
        | Kind::Words { .. }
        | Kind::Scalar
        | Kind::Distribution(_)
        | Kind::Rows(_)
        | Kind::Content(_)
        | Kind::AnyOf(_) => {}
    }
    described(key.doc(), json!({ "anyOf": forms }))
}

/// The schemas of the draws that a key of this kind takes.
fn draws(kind: Kind) -> impl Iterator<Item = Json> {
    DrawForm::WORDS.iter().filter_map(|word| DrawForm::named(word)).filter_map(move |form| {
        let (of, most) = match (form, form.ends(kind)) {
            (DrawForm::Choices, _) => (value(kind), None),
            (_, Some(ends)) => (value(ends), Some(2)),
            (_, None) => return None,
        };
        let mut listed = list(of);
        listed["minItems"] = json!(2);
        most.iter().for_each(|most| listed["maxItems"] = json!(most));
        Some(json!({
            "type": "object",
            "additionalProperties": false,
            "required": [form.word()],
            "properties": { form.word(): listed },
        }))
    })
}

fn range(end: Json, step: Json) -> Json {
    let count = json!({ "type": "integer", "minimum": 2, "maximum": MOST_VALUES });
    json!({
        "type": "object",
        "additionalProperties": false,
        "required": ["from", "to"],
        "oneOf": [{ "required": ["step"] }, { "required": ["count"] }],
        "properties": {
            "from": end,
            "to": end,
            "step": step,
            "count": count,
            "scale": { "enum": ["linear", "log"], "default": "linear" },
        },
    })
}

fn exclude() -> Json {
    let keys = |section: Section| {
        let path = format!("#/$defs/{}/properties", section.title());
        let property =
            |key: &Key| (key.name.to_owned(), json!({ "$ref": format!("{path}/{}", key.name) }));
        section.keys().iter().map(property).collect::<Map<String, Json>>()
    };
    let mut of_agents = Map::new();
    for algorithm in Algorithm::all() {
        of_agents.extend(keys(Section::Agent(algorithm)));
    }
    of_agents.insert("name".to_owned(), one_or_more("#/$defs/name"));
    of_agents.insert(PARAMETERS.to_owned(), free_parameters());
    let table = |properties| json!({ "type": "object", "additionalProperties": false, "properties": properties });
    // A key that only one section has may be written without the section.
    let environments = || Family::all().iter().map(|family| Section::Environment(family));
    let mut of_environments: Map<String, Json> = environments().flat_map(keys).collect();
    of_environments.insert(PARAMETERS.to_owned(), free_parameters());
    let short = environments().chain(others()).flat_map(keys).chain(of_agents.clone());
    let short: Map<String, Json> = short
        .filter(|(key, _)| Family::all().iter().any(|family| named(family, key).is_some()))
        .collect();
    let mut properties = short;
    properties.extend([
        ("scenario".to_owned(), one_or_more("#/$defs/scenario")),
        ("seed".to_owned(), one_or_more("#/$defs/seed")),
        ("environment".to_owned(), table(of_environments)),
        ("agent".to_owned(), table(of_agents)),
    ]);
    properties.extend(others().map(|section| (section.name().to_owned(), table(keys(section)))));
    let mut schema = table(properties);
    schema["minProperties"] = json!(1);
    schema
}

fn analysis() -> Json {
    let kinds = KINDS.iter().map(|kind| {
        let mut schema = table_schema(&kind.keys());
        schema["properties"]["kind"] = json!({ "const": kind.word });
        if let Some(required) = schema["required"].as_array_mut() {
            required.insert(1, json!("kind"));
        }
        schema
    });
    json!({ "anyOf": kinds.collect::<Vec<_>>() })
}

fn one_or_more(reference: &str) -> Json {
    let one = json!({ "$ref": reference });
    json!({ "anyOf": [one, list(one.clone())] })
}

fn described(text: &str, mut schema: Json) -> Json {
    schema["description"] = text.into();
    schema
}
