//! Learning curves: the moving mean of the return in training, one panel per scenario.

use super::{Drawn, Sheet, ends, spread, test_name};
use crate::analyse::declared::{
    Apart, ArmId, HighestEnd, LearningFigure, LearningLine, LearningPanel,
};
use crate::job::{Measure, MetricUnit, counted};
use crate::manifest::PanelKey;
use crate::report::data_table::{DataTable, TableEntry, shown};
use crate::report::figure::{
    AxisScale, Chart, Line, Look, NumberFormat, Panel, Panels, PlottedPoint, Spread, arm_label,
    axes, draw, facets, optimum_lines, seeds,
};
use crate::report::names::Names;
use crate::report::scene::Scene;
use crate::report::tables::{arm, between, high, low, no_interval};

impl Drawn for LearningFigure {
    fn figures(&self, sheet: &Sheet<'_>) -> Vec<(String, Scene)> {
        learning_figures(self, sheet)
    }

    fn split(&self) -> Option<Panels> {
        Some(Panels::of(&self.arms(), None, Some(PanelKey::Scenario)))
    }

    fn table(&self, title: &str, _: Measure, names: &Names) -> DataTable {
        table(title, &self.panels, names)
    }

    fn shows(&self, _: Measure, _: &Names) -> String {
        let counts = self.lines().map(|line| line.seeds.0).filter(|n| *n > 0);
        format!(
            "Return in training: moving mean over {}{}, {}",
            counted(self.window, "episode"),
            if self.lines().any(|line| line.seeds.0 > 1) {
                " and its 95 % interval over seeds"
            } else {
                ""
            },
            seeds(counts)
        )
    }

    fn finds(&self, _: Measure, names: &Names) -> Option<String> {
        let HighestEnd { line, mean, interval, others } = self.highest_end()?;
        let interval = interval.map_or_else(String::new, |interval| {
            format!(" (95 % interval {})", ends(interval, MetricUnit::Return))
        });
        let name = names.label(&line.name);
        let at = format!("{name} ends at {}{interval}", shown(mean, 0));
        if others.is_empty() {
            return Some(at);
        }
        let tested = || others.iter().filter(|(apart, _)| *apart != Apart::Untested);
        let Some(test) = test_name(tested().map(|(_, design)| *design)) else {
            return Some(format!("{at}, the highest mean, with too few seeds for a test"));
        };
        let above = tested().filter(|(apart, _)| *apart == Apart::Surely).count();
        let all = tested().count();
        let above = match above {
            0 => "not significantly above any other line".to_owned(),
            above if above == all => "significantly above every other tested line".to_owned(),
            above => {
                format!("significantly above {above} of {}", counted(all, "other tested line"))
            }
        };
        let scenario = match line.name.scenario.as_str() {
            "" => String::new(),
            scenario => format!(" on {scenario}"),
        };
        Some(format!(
            "{at}, the highest mean, {above}{scenario} ({test}, Bonferroni-corrected, 5 %)"
        ))
    }

    fn lacks(&self) -> Option<String> {
        let short = self.lines().filter(|line| line.points.is_empty() && line.seeds.0 > 0).count();
        (short > 0).then(|| {
            format!("{}, whose training is shorter than the window", counted(short, "line"))
        })
    }

    fn arms(&self) -> Vec<&ArmId> {
        self.lines().map(|line| &line.name).collect()
    }
}

/// Learning curves, with one figure per panel; panels are scenarios unless another key is declared.
fn learning_figures(figure: &LearningFigure, sheet: &Sheet<'_>) -> Vec<(String, Scene)> {
    let all: Vec<&LearningLine> = figure.lines().collect();
    if all.is_empty() {
        return Vec::new();
    }
    let arms = sheet.names.arms(figure.arms());
    let names: Vec<&ArmId> = arms.iter().collect();
    let panels = Panels::of(&names, sheet.style.panel, Some(PanelKey::Scenario));
    let looks = panels.looks(sheet.looks, &names);
    let ends = || all.iter().filter_map(|line| line.points.last()).map(|last| f64::from(last.0));
    let starts = all.iter().filter_map(|line| line.points.first()).map(|first| f64::from(first.0));
    let (most, least) = (ends().fold(0.0, f64::max), ends().fold(f64::INFINITY, f64::min));
    let start = starts.fold(most, f64::min);
    let level = |line: &LearningLine| {
        line.optimum.map_or_else(Vec::new, |best| vec![(start, best), (most, best)])
    };
    let chart = |panel: &Panel| {
        let members = || panel.members.iter().map(|at| all[*at]);
        let line = |at: &usize| {
            let look = looks.look(&panels.arms[*at]);
            drawn_line((all[*at], &arms[*at]), panels.labels[*at].clone(), look)
        };
        let mut lines: Vec<Line> = panel.members.iter().map(line).collect();
        let is_empty = members().all(|line| line.points.is_empty());
        let is_short = is_empty && members().any(|line| line.seeds.0 > 0);
        if !is_empty {
            let optima = panel.members.iter().map(|at| (&arms[*at], level(all[*at])));
            lines.extend(optimum_lines(optima, &looks));
        }
        let note = format!(
            "Moving mean over {}; mean and 95 % interval, {}.",
            counted(figure.window, "episode"),
            seeds(members().map(|line| line.seeds.0).filter(|n| *n > 0))
        );
        let heading = match is_short {
            true => format!("{}: training shorter than the window", panel.heading),
            false => panel.heading.clone(),
        };
        let description = format!("learning curves, {heading}");
        Chart { heading: Some(heading), description, lines, note }
    };
    let charts: Vec<Chart> = panels.panels.iter().map(chart).collect();
    let usual = if most > 4.0 * least { AxisScale::Log } else { AxisScale::Linear };
    let scale = sheet.style.x_scale(usual);
    let title = match scale {
        AxisScale::Log => "training episodes (logarithmic)".to_owned(),
        AxisScale::Linear => "training episodes".to_owned(),
    };
    let axes = axes(&charts, (title, NumberFormat::Plain, scale), sheet.metric, sheet.style);
    panels.stems(sheet.stem).into_iter().zip(draw(&charts, &axes, sheet.style)).collect()
}

/// A learning curve, with tooltips at some of its points.
fn drawn_line((line, arm): (&LearningLine, &ArmId), label: String, look: Look) -> Line {
    const TIPS: usize = 60;
    let every = line.points.len().div_ceil(TIPS).max(1);
    let last = line.points.len().saturating_sub(1);
    let n = seeds(std::iter::once(line.seeds.0));
    let point = |at: usize| {
        let (episode, mean, interval) = &line.points[at];
        let spread = spread(interval.ok_or(()), MetricUnit::Return);
        let tip = match at.is_multiple_of(every) || at == last {
            true => {
                let name = arm_label(arm);
                format!("{name}, episode {episode}: {}{spread}, {n}", shown(*mean, 0))
            }
            false => String::new(),
        };
        let interval = interval.map(|interval| (interval.low, interval.high));
        PlottedPoint { x: f64::from(*episode), y: *mean, interval, is_single: false, tip }
    };
    let label = if line.seeds.0 == 1 { format!("{label} (n = 1)") } else { label };
    Line {
        label,
        look,
        points: thinned(&line.points).into_iter().map(point).collect(),
        reference: Vec::new(),
        spread: Spread::Band,
        facets: facets(arm),
    }
}

/// Positions of at most a few hundred points, which are enough for a printed line. Half of them are
/// spaced evenly on a logarithmic scale, half on a linear scale.
fn thinned<T>(points: &[T]) -> Vec<usize> {
    const MOST: usize = 240;
    if points.len() <= MOST {
        return (0..points.len()).collect();
    }
    let top = (points.len() as f64).ln();
    let mut indices: Vec<usize> = (0..MOST)
        .map(|at| ((top * at as f64 / (MOST - 1) as f64).exp() as usize - 1).min(points.len() - 1))
        .chain((0..MOST).map(|at| at * (points.len() - 1) / (MOST - 1)))
        .collect();
    indices.sort_unstable();
    indices.dedup();
    indices
}

fn table(title: &str, panels: &[LearningPanel], names: &Names) -> DataTable {
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
                arm(&line.name, names),
                TableEntry::number(line.seeds.0 as f64, 0),
                TableEntry::number(f64::from(*episode), 0),
                TableEntry::number(*mean, 1),
                between(interval, MetricUnit::Return),
                low(interval),
                high(interval),
            ]);
        }
    }
    table
}
