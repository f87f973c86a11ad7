//! The keys of `[search]` that are more than one value of a kind.

use serde_json::{Value as Json, json};

use crate::job::MetricName;
use crate::key::{KeyType, Kind, Value};
use crate::manifest::parameter::seed_of;
use crate::manifest::table::{Field, TableKey, TableReader};
use crate::manifest::text::written::list;
use crate::manifest::value::schema;
use crate::manifest::value::sweep::{self, Node};
use crate::text::Fault;

const RUNGS: Kind = Kind::Counts { most: 20, max: 10_000 };
const FRESH: Kind = Kind::Integer { min: 1, max: 10_000 };
const SHARE: Kind = Kind::Real { min: 0.001, max: 0.999 };
const EVIDENCE: Kind = Kind::Real { min: 1e-6, max: 0.5 };
const METRIC: Kind = Kind::Choice(&["mean_return", "mean_net_return"]);

pub(super) const KEEP: TableKey = TableKey {
    name: "keep",
    doc: "share of the arms of a rung that go on, the best",
    schema: || schema::value(SHARE),
    is_required: false,
};

pub(super) const LEVEL: TableKey = TableKey {
    name: "level",
    doc: "level of the race: an arm leaves when its paired difference to the best is not 0 at this level, divided by the \
          number of comparisons",
    schema: || schema::value(EVIDENCE),
    is_required: false,
};

/// The seeds on which winners and agents without draws are compared; no arm races with them.
#[derive(Clone, Debug, PartialEq)]
pub enum Fresh {
    /// As many seeds, behind those of the race.
    Count(u64),
    /// These seeds.
    Seeds(Vec<u64>),
}

/// Which arms leave a race at the end of a rung.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Leaving {
    /// All but this share of the arms, the best.
    Share(f64),
    /// Arms whose paired difference to the best is not 0 with certainty. The level, between 0 and 1, is divided by the
    /// number of comparisons of the race.
    Evidence(f64),
}

/// The seeds of an arm at the end of each rung, as far as they can be read.
fn rungs(table: &TableReader<'_, '_>) -> Vec<u32> {
    let value = table.node("rungs").and_then(|node| sweep::read(RUNGS, node));
    value.and_then(|value| KeyType::from_value(&value)).unwrap_or_default()
}

/// The seeds of an arm at the end of each rung, at least one.
pub(super) struct Rungs;

impl Field for Rungs {
    type Value = Vec<usize>;

    fn schema(_: Option<Kind>) -> Json {
        let mut schema = schema::value(RUNGS);
        schema["minItems"] = json!(1);
        schema
    }

    fn read(table: &mut TableReader<'_, '_>, key: &str, _: Option<Kind>) -> Option<Vec<usize>> {
        let node = table.node(key)?;
        let rungs: Vec<u32> = KeyType::from_value(&table.reader.value(key, RUNGS, node)?)?;
        if rungs.is_empty() {
            let expected = "at least one number of seeds per arm, as in [2, 4, 8]";
            table.reader.expected(key, expected, node);
        }
        Some(rungs.into_iter().map(|seeds| seeds as usize).collect())
    }

    fn written(value: &Vec<usize>, key: &'static str) -> Vec<(&'static str, String)> {
        vec![(key, list(value))]
    }
}

impl Field for Leaving {
    type Value = Leaving;

    const KEYS: Option<&'static [TableKey]> = Some(&[KEEP, LEVEL]);

    fn schema(_: Option<Kind>) -> Json {
        (KEEP.schema)()
    }

    fn read(table: &mut TableReader<'_, '_>, _: &str, _: Option<Kind>) -> Option<Leaving> {
        let mut real = |name: &str, kind: Kind, node: &Node| {
            f64::from_value(&table.reader.value(name, kind, node)?)
        };
        let message = match (table.table.get(KEEP.name), table.table.get(LEVEL.name)) {
            (Some(keep), None) => return real(KEEP.name, SHARE, keep).map(Leaving::Share),
            (None, Some(level)) => {
                let read = real(LEVEL.name, EVIDENCE, level).map(Leaving::Evidence);
                if rungs(table).first() == Some(&1) {
                    let message =
                        "`level`: one seed per arm gives no interval, and the first rung has one";
                    let fault = Fault::at(level.span().into(), message);
                    let help = "begin `rungs` with 2 or more, or write keep = 0.5";
                    table.reader.faults.add(fault.help(help));
                }
                return read;
            }
            (Some(keep), Some(_)) => {
                real(KEEP.name, SHARE, keep);
                "[search] takes `keep` or `level`, not both"
            }
            (None, None) => "[search] needs `keep` or `level`, which say when an arm leaves",
        };
        table.reader.faults.add(Fault::at(table.span, message).help(
            "write keep = 0.5 for the better half of a rung, or level = 0.05 for the arms that are not shown to be worse \
             than the best",
        ));
        None
    }

    fn written(value: &Leaving, _: &'static str) -> Vec<(&'static str, String)> {
        match value {
            Leaving::Share(keep) => vec![(KEEP.name, format!("{keep:?}"))],
            Leaving::Evidence(level) => vec![(LEVEL.name, format!("{level:?}"))],
        }
    }
}

impl Field for Fresh {
    type Value = Fresh;

    fn schema(_: Option<Kind>) -> Json {
        let seeds = schema::list(json!({ "$ref": "#/$defs/seed" }));
        json!({ "anyOf": [schema::value(FRESH), seeds] })
    }

    fn read(table: &mut TableReader<'_, '_>, key: &str, _: Option<Kind>) -> Option<Fresh> {
        let node = table.node(key)?;
        if !node.get_ref().is_array() {
            return u64::from_value(&table.reader.value(key, FRESH, node)?).map(Fresh::Count);
        }
        let seeds: Vec<u64> = table.reader.seed_list(key, node).iter().map(seed_of).collect();
        let race = rungs(table).last().copied().unwrap_or(0).into();
        if let Some(raced) = seeds.iter().find(|seed| (1..=race).contains(*seed)) {
            let message = format!(
                "`{key}`: the arms race with the seeds 1 to {race}, and {raced} is one of them"
            );
            let help = "on a seed that selected the winner, its return would be too high";
            table.reader.faults.add(Fault::at(node.span().into(), message).help(help));
        }
        Some(Fresh::Seeds(seeds))
    }

    fn written(value: &Fresh, key: &'static str) -> Vec<(&'static str, String)> {
        let text = match value {
            Fresh::Count(count) => count.to_string(),
            Fresh::Seeds(seeds) => list(seeds),
        };
        vec![(key, text)]
    }
}

/// A metric of which the highest value is the best.
pub(super) struct RacedMetric;

impl Field for RacedMetric {
    type Value = MetricName;

    fn schema(_: Option<Kind>) -> Json {
        schema::value(METRIC)
    }

    fn read(table: &mut TableReader<'_, '_>, key: &str, _: Option<Kind>) -> Option<MetricName> {
        match table.reader.value(key, METRIC, table.node(key)?)? {
            Value::Choice(word) => MetricName::named(word),
            _ => None,
        }
    }

    fn written(value: &MetricName, key: &'static str) -> Vec<(&'static str, String)> {
        vec![(key, format!("\"{value}\""))]
    }
}
