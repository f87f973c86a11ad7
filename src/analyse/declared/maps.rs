//! Means, or differences of means, over two parameters.

use super::arm::{distinct, meets, wanted};
use super::{Group, Name};
use crate::analyse::{Contrast, Design, Interval, Moments, Sample, Undefined, mean_interval};
use crate::manifest::{Parameter, Published, Sides};
use crate::record::JobRecord;

/// A map of one agent.
#[derive(Clone, Debug, PartialEq)]
pub struct HeatFigure {
    /// The agent.
    pub agent: String,
    /// The scenario, or both sides as `first - second`.
    pub subject: String,
    /// Whether its values are differences.
    pub scale: Scale,
    /// Dotted name and values of the columns, ascending.
    pub x: (String, Vec<f64>),
    /// Dotted name and values of the rows, ascending.
    pub y: (String, Vec<f64>),
    /// The cells, row by row.
    pub cells: Vec<HeatCell>,
}

/// What the values of a map mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Means.
    Mean,
    /// Differences, for which 0 is nothing.
    Difference,
}

/// A cell of a map.
#[derive(Clone, Debug, PartialEq)]
pub struct HeatCell {
    /// Of its column.
    pub x: f64,
    /// Of its row.
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

/// A map an agent, or an agent and scenario where no difference is shown.
pub fn figures(
    (x, y): (Parameter, Parameter),
    sides: Option<&Sides>,
    metric: &str,
    jobs: &[&JobRecord],
    published: Option<&Published>,
) -> Vec<HeatFigure> {
    let subject = |job: &JobRecord| match sides {
        Some(sides) => format!("{} - {}", wanted(&sides.first), wanted(&sides.second)),
        None => job.scenario.clone(),
    };
    let mut names: Vec<(String, String)> = Vec::new();
    for job in jobs {
        let name = (job.agent.clone(), subject(job));
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let (x, y) = (x.to_string(), y.to_string());
    let figure = |(agent, subject_here): (String, String)| {
        let ours = |job: &&&JobRecord| job.agent == agent && subject(job) == subject_here;
        let ours: Vec<&JobRecord> = jobs.iter().filter(ours).copied().collect();
        let along = |name: &str| distinct(ours.iter().filter_map(|job| job.number(name)).collect());
        let (columns, rows) = (along(&x), along(&y));
        let map = published
            .into_iter()
            .filter(|_| metric == "mean_return")
            .filter(|_| {
                (x.as_str(), y.as_str()) == ("environment.epsilon_d", "environment.delta_d")
            })
            .flat_map(|published| &published.heat_maps)
            .find(|map| map.agent == agent && map.contrast == subject_here);
        let mut cells = Vec::new();
        for &row in &rows {
            for &column in &columns {
                let here = |job: &&&JobRecord| {
                    job.number(&x) == Some(column) && job.number(&y) == Some(row)
                };
                let here: Vec<&JobRecord> = ours.iter().filter(here).copied().collect();
                let mut cell = cell(&here, sides, metric);
                (cell.x, cell.y) = (column, row);
                cell.published = map.and_then(|map| {
                    let row = map.delta_d.iter().position(|one| *one == row)?;
                    let column = map.epsilon_d.iter().position(|one| *one == column)?;
                    Some(map.effect[row][column])
                });
                cells.push(cell);
            }
        }
        HeatFigure {
            scale: if sides.is_some() { Scale::Difference } else { Scale::Mean },
            x: (x.clone(), columns),
            y: (y.clone(), rows),
            subject: subject_here,
            agent,
            cells,
        }
    };
    names.into_iter().map(figure).collect()
}

fn cell(jobs: &[&JobRecord], sides: Option<&Sides>, metric: &str) -> HeatCell {
    let sample = |jobs: Vec<&JobRecord>| -> Sample {
        let name = Name { agent: String::new(), scenario: String::new(), settings: Vec::new() };
        Group { name, jobs }.sample(metric)
    };
    let (value, interval, seeds) = match sides {
        None => {
            let all = sample(jobs.to_vec());
            let mean = Moments::of(all.values()).map(|moments| moments.mean);
            (mean, mean_interval(all.values()), all.n())
        }
        Some(sides) => {
            let side = |condition| {
                sample(jobs.iter().filter(|job| meets(job, condition)).copied().collect())
            };
            let (first, second) = (side(&sides.first), side(&sides.second));
            let contrast = Contrast::new(&first, &second, Design::Independent);
            let interval = contrast.test().map(|test| test.interval);
            (contrast.difference, interval, first.n().min(second.n()))
        }
    };
    HeatCell { x: 0.0, y: 0.0, value, interval, seeds, published: None }
}
