//! Means, or differences of means, over two parameters.

use std::cmp::Ordering;

use super::arm::{arms, by_value, decided_by, implied};
use super::pairs::{Pair, pairs};
use super::published;
use super::{Arm, ArmId};
use crate::analyse::{Contrast, Interval, Sample, SeedPairing, Undefined};
use crate::job::{Condition, MetricName, short_beside};
use crate::manifest::kind::HeatMap;
use crate::manifest::{Published, PublishedRow, Sides};
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
    /// How far the largest mean is ahead of the tiles around it; `None` for differences.
    pub lead: Option<PeakLead>,
}

/// The lead of the tile with the largest mean over its neighbours, those at most one column and one row away.
#[derive(Clone, Debug, PartialEq)]
pub struct PeakLead {
    /// The index of the tile and of its closest neighbour, that with the smallest difference, among the tiles.
    pub tiles: [usize; 2],
    /// Their difference, its interval, and whether that is paired by seed.
    pub difference: f64,
    pub interval: Result<Interval, Undefined>,
    pub is_paired: bool,
    /// The number of neighbours with a mean, of those with an interval, and of those whose interval is above 0.
    pub neighbours: usize,
    pub tested: usize,
    pub behind: usize,
}

impl PeakLead {
    /// Whether the intervals of the differences to all neighbours exclude 0.
    pub fn is_clear(&self) -> bool {
        self.behind == self.neighbours
    }
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
    // Published numbers need not state what follows from what they state, such as a zipped key.
    let implied = published.map_or_else(Vec::new, |all| implied(jobs, &all.stated()));
    let figure = |(name, ours): (ArmId, Vec<&JobRecord>)| {
        let mut stated = name.clone();
        stated.settings.retain(|(key, _)| !implied.contains(key));
        figure((name, &stated), &axes, (sides, metric), &ours, published)
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
    (name, stated): (ArmId, &ArmId),
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
    let mut samples = Vec::new();
    for (row, jobs) in &rows {
        let row = *row;
        let mut filled = by_value(x, jobs).into_iter().peekable();
        for &column in &columns {
            let here = filled.next_if(|(at, _)| *at == column).map(|(_, jobs)| jobs);
            let here = here.unwrap_or_default();
            let value = |name: &str| here.first()?.setting(name);
            let of = (&*name.agent, contrast.as_str());
            // Numbers that state one axis only are not about a tile.
            let known = published::rows(published, metric, of, stated, &[x, y], &value);
            let is_here = |published: &&&PublishedRow| {
                [(x, column), (y, row)].iter().all(|(axis, value)| {
                    let mut stated = published.parameters.iter();
                    stated.any(|(name, stated)| {
                        name.to_string() == **axis && stated.number() == Some(*value)
                    })
                })
            };
            let published = known.iter().find(is_here).map(|row| row.value);
            let (value, interval, seeds) = match sides {
                None => {
                    let all = sample(here, metric);
                    let shown = (all.mean(), all.interval(), all.n());
                    samples.push(all);
                    shown
                }
                Some(sides) => difference(&here, sides, metric),
            };
            tiles.push(HeatTile { x: column, y: row, value, interval, seeds, published });
        }
    }
    let names: Vec<&String> = name.settings.iter().map(|(key, _)| key).chain([x, y]).collect();
    let short = |key: &str| short_beside(key, &names).to_owned();
    let settings = name.settings.iter().map(|(key, value)| format!(" {}={value}", short(key)));
    HeatFigure {
        scale: if sides.is_some() { Scale::Difference } else { Scale::Mean },
        x: (x.clone(), columns),
        y: (y.clone(), rows.into_iter().map(|(row, _)| row).collect()),
        subject: contrast + &settings.collect::<String>(),
        agent: name.agent.clone(),
        lead: lead(&tiles, &samples),
        name,
        tiles,
    }
}

/// The lead of the largest mean; `samples` has one per tile. `None` without a neighbour or a test.
fn lead(tiles: &[HeatTile], samples: &[Sample]) -> Option<PeakLead> {
    let value = |index: &usize| tiles[*index].value.ok();
    let known = (0..samples.len()).filter(|index| value(index).is_some());
    let best = known.max_by(|one, other| {
        let values = value(one).zip(value(other));
        values.map_or(Ordering::Equal, |(one, other)| one.total_cmp(&other))
    })?;
    let width = tiles.iter().take_while(|tile| tile.y == tiles[0].y).count();
    let is_near = |index: &usize| {
        let away = |coordinate: fn(usize, usize) -> usize| {
            coordinate(*index, width).abs_diff(coordinate(best, width))
        };
        *index != best
            && away(|index, width| index / width) < 2
            && away(|index, width| index % width) < 2
    };
    let near: Vec<(usize, Contrast)> = (0..samples.len())
        .filter(is_near)
        .filter(|index| value(index).is_some())
        .map(|index| {
            let design = SeedPairing::of(&samples[best], &samples[index]);
            (index, Contrast::new(&samples[best], &samples[index], design))
        })
        .collect();
    let by_difference =
        near.iter().filter_map(|(index, of)| Some((*index, of, of.difference.ok()?)));
    let (closest, contrast, difference) =
        by_difference.min_by(|(.., one), (.., other)| one.total_cmp(other))?;
    let tests = near.iter().filter_map(|(_, contrast)| contrast.test.ok());
    Some(PeakLead {
        tiles: [best, closest],
        difference,
        interval: contrast.test.map(|test| test.interval),
        is_paired: contrast.design == SeedPairing::Matched,
        neighbours: near.len(),
        tested: tests.clone().count(),
        behind: tests.filter(|test| test.interval.low > 0.0).count(),
    })
}

/// The results of the jobs of one tile.
fn sample(jobs: Vec<&JobRecord>, metric: MetricName) -> Sample {
    Arm { name: ArmId::default(), jobs }.sample(metric)
}

/// The difference of means of two sides, its interval, and the seeds of the smaller side.
fn difference(
    jobs: &[&JobRecord],
    sides: &Sides,
    metric: MetricName,
) -> (Result<f64, Undefined>, Result<Interval, Undefined>, usize) {
    let side = |condition: &Condition| {
        sample(jobs.iter().filter(|job| condition.is_met_by(job)).copied().collect(), metric)
    };
    let (first, second) = (side(&sides.first), side(&sides.second));
    let contrast = Contrast::new(&first, &second, SeedPairing::of(&first, &second));
    let interval = contrast.test.map(|test| test.interval);
    (contrast.difference, interval, contrast.seeds.0.min(contrast.seeds.1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lead_is_over_the_tiles_around_the_largest_mean() {
        // Two rows of four columns; the mean of the last tile is the second largest, and it is no neighbour.
        let means = [1.0, 2.0, 4.0, 8.0, 30.0, 20.0, 9.0, 29.0];
        let tiles: Vec<HeatTile> = (0..8)
            .map(|index| HeatTile {
                x: (index % 4) as f64,
                y: (index / 4) as f64,
                value: Ok(means[index]),
                interval: Err(Undefined::NoSeeds),
                seeds: 3,
                published: None,
            })
            .collect();
        // The seeds shift all tiles, those around the largest by other amounts.
        let factors = [1.2, 1.3, 1.0, 1.0, 1.01, 0.5, 1.0, 1.0];
        let sample = |index: usize, more: f64| {
            let of =
                |(seed, shift): (u64, f64)| (seed, means[index] + more + factors[index] * shift);
            Sample::new([(1, -9.0), (2, 0.0), (3, 9.0)].map(of), 0, 0).unwrap()
        };
        let samples: Vec<Sample> = (0..8).map(|index| sample(index, 0.0)).collect();
        let found = lead(&tiles, &samples).unwrap();
        assert_eq!((found.tiles, found.is_paired, found.neighbours), ([4, 5], true, 3));
        // Differences of 10 and -4.59, 0, 4.59, with two degrees of freedom: 4.3027 standard errors of 2.65.
        assert!((found.difference - 10.0).abs() < 1e-12);
        let half = 4.302_652_73 * 4.59 / 3_f64.sqrt();
        let interval = found.interval.unwrap();
        assert!((interval.low - (10.0 - half)).abs() < 1e-6, "{interval:?}");
        assert_eq!((found.tested, found.behind), (3, 2));
        assert_eq!(lead(&tiles, &[]), None);
        // A neighbour that is behind by the same amount for every seed is the closest, without an interval.
        let make_sample = |index: usize| match index {
            5 => sample(4, -10.0),
            _ => sample(index, 0.0),
        };
        let found = lead(&tiles, &(0..8).map(make_sample).collect::<Vec<_>>()).unwrap();
        assert_eq!((found.tiles[1], found.interval), (5, Err(Undefined::NoVariance)));
        assert_eq!((found.neighbours, found.tested, found.behind), (3, 2, 2));
        assert!(!found.is_clear());
    }
}
