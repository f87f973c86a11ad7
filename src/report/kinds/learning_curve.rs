//! Learning curves: the moving mean of the return in training, a panel a scenario.

use super::Drawn;
use crate::analyse::Interval;
use crate::analyse::declared::{ArmId, LearningFigure, LearningLine, LearningPanel};
use crate::report::data_table::{DataTable, Entry, shown};
use crate::report::escape::file_stem;
use crate::report::figure::{
    AxisScale, Chart, Line, Looks, Numbers, Place, Spread, arm_label, axes, draw, labels,
    optimum_lines, seeds,
};
use crate::report::scene::Scene;
use crate::report::tables::{between, high, low, no_interval};

impl Drawn for LearningFigure {
    fn figures(&self, stem: &str, _: &str, looks: &Looks) -> Vec<(String, Scene)> {
        let figure = |panel: &LearningPanel| {
            let stem = format!("{stem}-{}", file_stem(&panel.scenario));
            (stem, learning_figure(panel, self.window, looks))
        };
        self.panels.iter().map(figure).collect()
    }

    fn table(&self, title: &str, _: &str) -> DataTable {
        table(title, &self.panels)
    }

    fn shows(&self, _: &str) -> String {
        let counts = self.lines().map(|line| line.seeds.0).filter(|n| *n > 0);
        format!(
            "Return in training: moving mean over {} episodes and its 95 % interval over seeds, {}",
            self.window,
            seeds(counts)
        )
    }

    fn finds(&self, _: &str) -> Option<String> {
        let (line, mean, interval) = self.highest_end()?;
        let interval = interval.map_or_else(String::new, |Interval { low, high }| {
            format!(" (95 % interval {} to {})", shown(low, 0), shown(high, 0))
        });
        Some(format!("{} ends highest, at {}{interval}", arm_label(&line.name), shown(mean, 0)))
    }

    fn lacks(&self) -> Option<String> {
        let short = self.lines().filter(|line| line.points.is_empty() && line.seeds.0 > 0).count();
        (short > 0).then(|| format!("{short} lines, whose training is shorter than the window"))
    }

    fn arms(&self) -> Vec<&ArmId> {
        self.lines().map(|line| &line.name).collect()
    }

    fn series(&self) -> Vec<String> {
        let first = self.panels.first().map_or(&[][..], |panel| &panel.lines[..]);
        labels(&first.iter().map(|line| &line.name).collect::<Vec<_>>())
    }
}

/// Learning curves of a scenario.
fn learning_figure(panel: &LearningPanel, window: u32, looks: &Looks) -> Scene {
    const TIPS: usize = 60;
    let names: Vec<&ArmId> = panel.lines.iter().map(|line| &line.name).collect();
    let line = |(line, label): (&LearningLine, String)| {
        let every = line.points.len().div_ceil(TIPS).max(1);
        let last = line.points.len().saturating_sub(1);
        let place = |(at, (episode, mean, interval)): (usize, &(u32, f64, Option<_>))| {
            let interval: Option<Interval> = *interval;
            let spread = interval.map_or_else(String::new, |interval| {
                format!(", 95 % interval {:.0} to {:.0}", interval.low, interval.high)
            });
            let tip = match at % every == 0 || at == last {
                true => format!(
                    "{}, episode {episode}: {}{spread}",
                    arm_label(&line.name),
                    shown(*mean, 0)
                ),
                false => String::new(),
            };
            let interval = interval.map(|interval| (interval.low, interval.high));
            Place { x: f64::from(*episode), y: *mean, interval, tip }
        };
        Line {
            label,
            look: looks.look(&line.name),
            points: thinned(&line.points)
                .into_iter()
                .map(|at| place((at, &line.points[at])))
                .collect(),
            reference: Vec::new(),
            spread: Spread::Band,
        }
    };
    let mut lines: Vec<Line> = panel.lines.iter().zip(labels(&names)).map(line).collect();
    let longest = |line: &Line| line.points.last().map_or(0.0, |point| point.x);
    let most = lines.iter().map(longest).fold(0.0, f64::max);
    let least = lines.iter().map(longest).fold(f64::INFINITY, f64::min);
    let first = |line: &Line| line.points.first().map_or(f64::INFINITY, |point| point.x);
    let start = lines.iter().map(first).fold(most, f64::min);
    let level = |line: &LearningLine| {
        line.optimum.map_or_else(Vec::new, |best| vec![(start, best), (most, best)])
    };
    lines.extend(optimum_lines(panel.lines.iter().map(|l| (&l.name, level(l))), looks));
    let scale = if most > 4.0 * least { AxisScale::Log } else { AxisScale::Linear };
    let title = match scale {
        AxisScale::Log => "training episodes (logarithmic)".to_owned(),
        AxisScale::Linear => "training episodes".to_owned(),
    };
    let note = format!(
        "Moving mean over {window} episodes; mean and 95 % interval, {}.",
        seeds(panel.lines.iter().map(|line| line.seeds.0).filter(|n| *n > 0))
    );
    let axes = axes(&lines, (title, Numbers::Plain, scale), ("mean_return", Numbers::Plain));
    let description = format!("learning curves in scenario {}", panel.scenario);
    draw(&Chart { heading: Some(panel.scenario.clone()), description, axes, lines, note })
}

/// Places of at most some hundred points, evenly along the logarithm of their number: what a line
/// of a printed figure can show.
fn thinned<T>(points: &[T]) -> Vec<usize> {
    const MOST: usize = 240;
    if points.len() <= MOST {
        return (0..points.len()).collect();
    }
    let top = (points.len() as f64).ln();
    let mut places: Vec<usize> = (0..MOST)
        .map(|at| ((top * at as f64 / (MOST - 1) as f64).exp() as usize - 1).min(points.len() - 1))
        .chain((0..MOST).map(|at| at * (points.len() - 1) / (MOST - 1)))
        .collect();
    places.sort_unstable();
    places.dedup();
    places
}

fn table(title: &str, panels: &[LearningPanel]) -> DataTable {
    let columns = [
        ("arm", "Arm"),
        ("seeds", "n"),
        ("episode", "Episode"),
        ("mean", "Moving mean of the return"),
        ("interval", "95 % interval"),
        (".low", ""),
        (".high", ""),
    ];
    let mut table = DataTable::new(title, &columns);
    for line in panels.iter().flat_map(|panel| &panel.lines) {
        for (episode, mean, interval) in &line.points {
            let interval = interval.ok_or(no_interval(line.seeds.0));
            table.rows.push(vec![
                Entry::text(arm_label(&line.name)),
                Entry::number(line.seeds.0 as f64, 0),
                Entry::number(f64::from(*episode), 0),
                Entry::number(*mean, 1),
                between(interval, "mean_return"),
                low(interval),
                high(interval),
            ]);
        }
    }
    table
}
