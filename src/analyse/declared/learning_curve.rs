//! Learning curves: a moving mean over training episodes, over the seeds.

use super::arm::{ArmId, arms};
use super::curve::Apart;
use crate::analyse::{Interval, Sample, SeedPairing, grouped, mean_interval, moving_mean};
use crate::job::metric::MEAN_RETURN;
use crate::record::JobRecord;

/// Learning curves, one panel per scenario.
#[derive(Clone, Debug, PartialEq)]
pub struct LearningFigure {
    /// Window of the moving mean, in training episodes.
    pub window: u32,
    /// The panels, in the manifest's order.
    pub panels: Vec<LearningPanel>,
}

impl LearningFigure {
    /// The lines of all panels.
    pub fn lines(&self) -> impl Iterator<Item = &LearningLine> {
        self.panels.iter().flat_map(|panel| &panel.lines)
    }

    /// The line whose last point is highest, with its mean and interval there, and the comparisons of its last
    /// point with those of the other lines of its panel. They are corrected for all pairs of lines of the panel,
    /// because the highest one is chosen by its value.
    pub fn highest_end(&self) -> Option<HighestEnd<'_>> {
        let end = |line: &LearningLine| line.points.last().map(|last| last.1);
        let highest = |panel: &LearningPanel| panel.lines.iter().filter_map(end).reduce(f64::max);
        let panels = self.panels.iter().filter_map(|panel| Some((panel, highest(panel)?)));
        let (panel, mean) = panels.max_by(|one, other| one.1.total_cmp(&other.1))?;
        let line = panel.lines.iter().find(|line| end(line) == Some(mean))?;
        let drawn: Vec<&LearningLine> =
            panel.lines.iter().filter(|line| end(line).is_some()).collect();
        let pairs = drawn.len() * drawn.len().saturating_sub(1) / 2;
        let others = drawn.into_iter().filter(|other| !std::ptr::eq(*other, line));
        let compared = others.map(|other| {
            let design = SeedPairing::of(&line.end, &other.end);
            (Apart::of((&line.end, &other.end), design, pairs), design)
        });
        Some(HighestEnd { line, mean, interval: line.points.last()?.2, others: compared.collect() })
    }
}

/// The line that ends highest.
#[derive(Clone, Debug)]
pub struct HighestEnd<'l> {
    /// The line.
    pub line: &'l LearningLine,
    /// The mean of its last point.
    pub mean: f64,
    /// The interval of this mean.
    pub interval: Option<Interval>,
    /// Whether its end differs from that of each other line of its panel, and how seeds are paired in the test.
    pub others: Vec<(Apart, SeedPairing)>,
}

/// The learning curves of one scenario.
#[derive(Clone, Debug, PartialEq)]
pub struct LearningPanel {
    /// The scenario.
    pub scenario: String,
    /// One line per arm.
    pub lines: Vec<LearningLine>,
}

/// The learning curve of an arm.
#[derive(Clone, Debug, PartialEq)]
pub struct LearningLine {
    /// The arm.
    pub name: ArmId,
    /// Numbers of completed seeds and of all seeds.
    pub seeds: (usize, usize),
    /// The best mean return that any policy can reach, where it is known.
    pub optimum: Option<f64>,
    /// The moving means of its seeds at its last point.
    pub end: Sample,
    /// Training episodes finished, mean over seeds, and its interval where one is defined.
    pub points: Vec<(u32, f64, Option<Interval>)>,
}

/// The learning curves of the jobs. A line ends at the last point that all of its completed seeds
/// have. Agents that do not learn have no line.
pub fn figure(window: u32, jobs: &[&JobRecord]) -> LearningFigure {
    let learners: Vec<&JobRecord> = jobs.iter().filter(|job| job.learns).copied().collect();
    let lines = arms(&learners, &[]).into_iter().map(|arm| {
        let (seeds, curves): (Vec<u64>, Vec<Vec<(u32, f64)>>) = arm
            .jobs
            .iter()
            .filter_map(|job| {
                let stride = job.number("evaluation.curve_stride")? as u32;
                Some((job.seed, moving_mean(&job.completed()?.curve, stride, window)))
            })
            .unzip();
        let shortest = curves.iter().map(Vec::len).min().unwrap_or(0);
        let last = curves.iter().filter_map(|curve| Some(curve.get(shortest.checked_sub(1)?)?.1));
        let lost = arm.sample(MEAN_RETURN).lost();
        let end = Sample::new(seeds.into_iter().zip(last), lost.failed, lost.open);
        let end = end.map(|end| end.with_given(arm.jobs.iter().map(|job| job.seed)));
        let line = LearningLine {
            seeds: (curves.len(), arm.jobs.len()),
            optimum: arm.optimum_of(MEAN_RETURN),
            end: end.expect("an arm has every seed once"),
            points: over_seeds(&curves),
            name: arm.name,
        };
        (line.name.scenario.clone(), line)
    });
    let panel = |(scenario, lines)| LearningPanel { scenario, lines };
    let panels = grouped(lines).into_iter().map(panel).collect();
    LearningFigure { window, panels }
}

fn over_seeds(curves: &[Vec<(u32, f64)>]) -> Vec<(u32, f64, Option<Interval>)> {
    let shortest = curves.iter().map(Vec::len).min().unwrap_or(0);
    let point = |index: usize| {
        let values: Vec<f64> = curves.iter().map(|curve| curve[index].1).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        (curves[0][index].0, mean, mean_interval(&values).ok())
    };
    (0..shortest).map(point).collect()
}
