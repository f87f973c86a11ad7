//! Means, or differences of means, over two parameters.

use super::arm::{arms, by_value, decided_by};
use super::pairs::{Pair, pairs};
use super::published;
use super::{Arm, ArmId};
use crate::analyse::{Contrast, Design, Interval, Sample, Undefined};
use crate::job::{Condition, MetricName};
use crate::manifest::{HeatMap, Published, PublishedRow, Sides};
use crate::record::JobRecord;

/// A map of one arm.
#[derive(Clone, Debug, PartialEq)]
pub struct HeatFigure {
    /// The name that distinguishes it from the other maps.
    pub name: ArmId,
    /// The agent; empty where agents are the sides.
    pub agent: String,
    /// The scenario, or both sides as `first - second`, and the settings that distinguish the map.
    pub subject: String,
    /// Whether its values are means or differences.
    pub scale: Scale,
    /// Dotted name and values of the columns, ascending.
    pub x: (String, Vec<f64>),
    /// Dotted name and values of the rows, ascending.
    pub y: (String, Vec<f64>),
    /// The tiles, row by row.
    pub tiles: Vec<HeatTile>,
}

/// The kind of values in a map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Means.
    Mean,
    /// Differences, centred at 0.
    Difference,
}

/// A tile of a map.
#[derive(Clone, Debug, PartialEq)]
pub struct HeatTile {
    /// The value of its column.
    pub x: f64,
    /// The value of its row.
    pub y: f64,
    /// The mean or difference.
    pub value: Result<f64, Undefined>,
    /// Its interval.
    pub interval: Result<Interval, Undefined>,
    /// Seeds of the smaller side.
    pub seeds: usize,
    /// The published value.
    pub published: Option<f64>,
}

impl HeatTile {
    /// Whether its interval excludes 0.
    pub fn is_beyond_zero(&self) -> bool {
        self.interval.is_ok_and(|interval| interval.low > 0.0 || interval.high < 0.0)
    }
}

/// The colour range shared by all maps of an analysis: their smallest and largest value.
pub fn heat_range(figures: &[HeatFigure]) -> (f64, f64) {
    let values = figures.iter().flat_map(|figure| &figure.tiles);
    let values = values.filter_map(|tile| tile.value.ok());
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, m), v| (l.min(v), m.max(v)))
}

/// One map per arm; parameters other than axes and sides distinguish maps.
pub fn figures(
    HeatMap { x, y, sides }: &HeatMap,
    metric: MetricName,
    jobs: &[&JobRecord],
    published: Option<&Published>,
) -> Vec<HeatFigure> {
    let sides = sides.as_ref();
    let by = sides.map_or_else(String::new, Sides::key);
    let axes = (x.to_string(), y.to_string());
    // Parameters zipped with an axis vary along it.
    let zipped = [&axes.0, &axes.1].map(|axis| decided_by(axis, jobs)).concat();
    let along: Vec<&str> =
        [&axes.0, &axes.1, &by].into_iter().chain(&zipped).map(String::as_str).collect();
    let figure = |(name, ours): (ArmId, Vec<&JobRecord>)| {
        figure(name, &axes, (sides, metric), &ours, published)
    };
    let mut maps: Vec<HeatFigure> = match sides {
        Some(sides) => pairs(sides, jobs, &along)
            .into_iter()
            .map(|Pair { name, first, second }| figure((name, [first, second].concat())))
            .collect(),
        None => arms(jobs, &along).into_iter().map(|arm| figure((arm.name, arm.jobs))).collect(),
    };
    // Arms that lack a parameter of the axes have no place in a map.
    maps.retain(|map| !map.tiles.is_empty());
    maps
}

fn figure(
    name: ArmId,
    (x, y): &(String, String),
    (sides, metric): (Option<&Sides>, MetricName),
    jobs: &[&JobRecord],
    published: Option<&Published>,
) -> HeatFigure {
    let contrast = match sides {
        Some(sides) => format!("{} - {}", sides.first.scalars()[0], sides.second.scalars()[0]),
        None => name.scenario.clone(),
    };
    let rows = by_value(y, jobs);
    let columns: Vec<f64> = by_value(x, jobs).into_iter().map(|(column, _)| column).collect();
    let mut tiles = Vec::new();
    for (row, jobs) in &rows {
        let row = *row;
        let mut filled = by_value(x, jobs).into_iter().peekable();
        for &column in &columns {
            let here = filled.next_if(|(at, _)| *at == column).map(|(_, jobs)| jobs);
            let here = here.unwrap_or_default();
            let number = |name: &str| here.first()?.number(name);
            let of = (&*name.agent, contrast.as_str());
            // Numbers that state one axis only are not about a tile.
            let known = published::rows(published, metric, of, &name, &[x, y], &number);
            let is_here = |published: &&&PublishedRow| {
                [(x, column), (y, row)].iter().all(|(axis, value)| {
                    let mut stated = published.parameters.iter();
                    stated.any(|(name, number)| name.to_string() == **axis && number == value)
                })
            };
            let published = known.iter().find(is_here).map(|row| row.value);
            tiles.push(HeatTile { x: column, y: row, published, ..tile(&here, sides, metric) });
        }
    }
    let settings = name
        .settings
        .iter()
        .map(|(key, value)| format!(" {}={value}", key.rsplit('.').next().unwrap_or(key)));
    HeatFigure {
        scale: if sides.is_some() { Scale::Difference } else { Scale::Mean },
        x: (x.clone(), columns),
        y: (y.clone(), rows.into_iter().map(|(row, _)| row).collect()),
        subject: contrast + &settings.collect::<String>(),
        agent: name.agent.clone(),
        name,
        tiles,
    }
}

fn tile(jobs: &[&JobRecord], sides: Option<&Sides>, metric: MetricName) -> HeatTile {
    let sample = |jobs: Vec<&JobRecord>| -> Sample {
        let name = ArmId { agent: String::new(), scenario: String::new(), settings: Vec::new() };
        Arm { name, jobs }.sample(metric)
    };
    let (value, interval, seeds) = match sides {
        None => {
            let all = sample(jobs.to_vec());
            (all.mean(), all.interval(), all.n())
        }
        Some(sides) => {
            let side = |condition: &Condition| {
                sample(jobs.iter().filter(|job| condition.is_met_by(job)).copied().collect())
            };
            let (first, second) = (side(&sides.first), side(&sides.second));
            let contrast = Contrast::new(&first, &second, Design::of(&first, &second));
            let interval = contrast.test.map(|test| test.interval);
            (contrast.difference, interval, contrast.seeds.0.min(contrast.seeds.1))
        }
    };
    HeatTile { x: 0.0, y: 0.0, value, interval, seeds, published: None }
}
