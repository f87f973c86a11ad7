//! Curves: a metric along a parameter, one line per arm.

use super::{Drawn, Sheet, amount, gap as difference, metric_words, parameter, spread, test_name};
use crate::analyse::Sample;
use crate::analyse::declared::{
    ALPHA, Apart, ArmId, CurveFigure, CurveLine, Ends, LinePoint, Trends,
};
use crate::job::Measure;
use crate::report::arm_tables::{optimum, share};
use crate::report::data_table::{DataTable, TableEntry, shown};
use crate::report::figure::{
    AxisScale, Chart, Line, NumberFormat, Panel, Panels, PlottedPoint, Spread, arm_label, axes,
    draw, facets, optimum_lines, seeds,
};
use crate::report::names::Names;
use crate::report::scene::Scene;
use crate::report::symbols;
use crate::report::tables::{arm, between, high, in_unit, low};

impl Drawn for CurveFigure {
    fn figures(&self, sheet: &Sheet<'_>) -> Vec<(String, Scene)> {
        curve_figures(self, sheet)
    }

    fn split(&self) -> Option<Panels> {
        Some(Panels::of(&self.arms(), None, None))
    }

    fn table(&self, title: &str, metric: Measure, names: &Names) -> DataTable {
        table(title, self, metric, names)
    }

    fn shows(&self, metric: Measure, _: &Names) -> String {
        let axis = match self.is_error() {
            true => "context inference error",
            false => &symbols::quantity(&self.axis),
        };
        let seeds = seeds(self.lines.iter().flat_map(CurveLine::seeds));
        let across = match self.lines.iter().any(|line| line.across.is_some()) {
            true => format!("; arms without {} are lines across", symbols::short(&self.axis)),
            false => String::new(),
        };
        format!(
            "{} of {} against {axis}, {seeds} per point{across}",
            if self.lines.iter().flat_map(CurveLine::seeds).any(|n| n > 1) {
                "Mean and its 95 % interval"
            } else {
                "Values of single seeds"
            },
            metric_words(metric)
        )
    }

    fn finds(&self, metric: Measure, names: &Names) -> Option<String> {
        match self.lines.as_slice() {
            [first, second] => {
                let sides = [first, second].map(|line| names.label(&line.name));
                self.gap(sides, metric).or_else(|| self.trend_counts())
            }
            [line] => self.trend(line, names.label(&line.name), metric),
            _ => self.trend_counts(),
        }
    }

    fn arms(&self) -> Vec<&ArmId> {
        self.lines.iter().map(|line| &line.name).collect()
    }
}

impl CurveFigure {
    /// The x of a point in words.
    fn at(&self, point: &LinePoint) -> String {
        match self.is_error() {
            true => format!("{} % error", shown(point.x * 100.0, 0)),
            false => format!("{} = {}", symbols::short(&self.axis), parameter(point.x)),
        }
    }

    /// Whether two lines differ at any point; `None` if no point can be tested.
    fn gap(&self, [one, other]: [String; 2], metric: Measure) -> Option<String> {
        let (point, gap, apart, design) = self.widest_gap()?;
        let test = test_name([design]).unwrap_or_default();
        match apart {
            Apart::Surely => Some(format!(
                "{one} and {other} are furthest apart at {}, by {} ({test}, Bonferroni-corrected p < \
                 {ALPHA})",
                self.at(point),
                difference(gap.abs(), metric)
            )),
            Apart::Perhaps => Some(format!(
                "{one} and {other} do not differ significantly at any {}point ({test}, \
                 Bonferroni-corrected p ≥ {ALPHA})",
                if self.are_gaps_tested() { "" } else { "tested " }
            )),
            Apart::Untested => None,
        }
    }

    /// The ends of a line, and whether they differ.
    fn trend(&self, line: &CurveLine, name: String, metric: Measure) -> Option<String> {
        let Ends { first: (first, start), last: (last, end), apart, design } = line.ends(1)?;
        let test = test_name([design]).unwrap_or_default();
        let (from, to) = (amount(start, metric), amount(end, metric));
        if first.x == last.x {
            return Some(format!("{name} is at {from} at {}", self.at(first)));
        }
        let verb = if end < start { "falls" } else { "rises" };
        let (first, last) = (self.at(first), self.at(last));
        Some(match apart {
            _ if from == to => format!("{name} is at {from} both at {first} and at {last}"),
            Apart::Surely => format!(
                "{name} {verb} from {from} at {first} to {to} at {last} ({test}, p < {ALPHA})"
            ),
            Apart::Perhaps => format!(
                "{name} is at {from} at {first} and at {to} at {last}; the difference is not \
                 significant ({test}, p ≥ {ALPHA})"
            ),
            Apart::Untested => format!(
                "{name} is at {from} at {first} and at {to} at {last}, with too few seeds for a test"
            ),
        })
    }

    /// The numbers of lines that fall and rise; `None` if no line can be tested.
    fn trend_counts(&self) -> Option<String> {
        let Trends { lines, falls, rises } = self.trends()?;
        let swept = self.lines.iter().filter(|line| line.across.is_none()).count();
        let noun = if lines == 1 { "line" } else { "lines" };
        let tested = match lines < swept {
            true => format!("{noun} that can be tested"),
            false => noun.to_owned(),
        };
        let change = match (falls, rises) {
            (0, 0) => "none falls or rises".to_owned(),
            (falls, rises) => format!(
                "{falls} {} and {rises} {}",
                if falls == 1 { "falls" } else { "fall" },
                if rises == 1 { "rises" } else { "rise" }
            ),
        };
        let relation = if (falls, rises) == (0, 0) { "≥" } else { "<" };
        let ends = self.lines.iter().filter_map(|line| line.ends(swept));
        let with_test = ends.filter(|ends| ends.apart != Apart::Untested && ends.are_apart());
        let test = test_name(with_test.map(|ends| ends.design)).unwrap_or_default();
        Some(format!(
            "Of {lines} {tested}, {change} significantly from the first to the last point ({test}, \
             Bonferroni-corrected p {relation} {ALPHA})"
        ))
    }
}

/// Means over seeds with their intervals, and the published lines, with one figure per panel.
fn curve_figures(figure: &CurveFigure, sheet: &Sheet<'_>) -> Vec<(String, Scene)> {
    let (metric, style) = (sheet.metric, sheet.style);
    let arms = sheet.names.arms(figure.arms());
    let names: Vec<&ArmId> = arms.iter().collect();
    let panels = Panels::of(&names, style.panel, None);
    let looks = panels.looks(sheet.looks, &names);
    let is_error = figure.is_error();
    let (x_title, x_numbers) = match is_error {
        true => ("context inference error, %".to_owned(), NumberFormat::Percent),
        false => (symbols::quantity(&figure.axis), NumberFormat::Plain),
    };
    let extent = extent(figure);
    let line = |at: usize| {
        let (line, label) = (&figure.lines[at], panels.labels[at].clone());
        let seen = line.points.iter().filter(|point| point.sample.n() > 0);
        let name = arm_label(&arms[at]);
        let points = seen.map(|point| curve_point(point, &name, (metric, figure)));
        let across = line.across.iter().filter(|sample| sample.n() > 0);
        let across =
            across.flat_map(|sample| across_points(sample, &name, extent, (metric, figure)));
        let is_single = line.seeds().all(|n| n == 1) && line.seeds().next().is_some();
        let label = if is_single { format!("{label} (n = 1)") } else { label };
        Line {
            label,
            look: looks.look(&panels.arms[at]),
            points: points.chain(across).collect(),
            reference: line.published.clone(),
            spread: if line.across.is_some() { Spread::Band } else { Spread::Bars },
            facets: facets(&arms[at]),
        }
    };
    let chart = |panel: &Panel| {
        let members = || panel.members.iter().map(|at| &figure.lines[*at]);
        let mut lines: Vec<Line> = panel.members.iter().map(|at| line(*at)).collect();
        let optima = panel.members.iter().map(|at| (&arms[*at], figure.lines[*at].optimum.clone()));
        lines.extend(optimum_lines(optima, &looks));
        let has_reference = lines.iter().any(|line| !line.reference.is_empty());
        let note = note(members().flat_map(CurveLine::seeds).collect(), has_reference);
        let heading = match panels.is_one() && panel.heading.is_empty() {
            true => shared_word(&names),
            false => Some(panel.heading.clone()),
        };
        let description = format!("{} against {x_title}", metric.title());
        Chart { heading, description, lines, note }
    };
    let charts: Vec<Chart> = panels.panels.iter().map(chart).collect();
    let usual = match is_error {
        true => AxisScale::Linear,
        false => scale_of(charts.iter().flat_map(|chart| &chart.lines)),
    };
    let scale = style.x_scale(usual);
    let x_title = match scale {
        AxisScale::Log => format!("{x_title} (logarithmic)"),
        AxisScale::Linear => x_title.clone(),
    };
    let axes = axes(&charts, (x_title, x_numbers, scale), metric, style);
    panels.stems(sheet.stem).into_iter().zip(draw(&charts, &axes, style)).collect()
}

/// What the lines of a panel show.
fn note(numbers: Vec<usize>, has_reference: bool) -> String {
    let shown = if numbers.iter().any(|n| *n > 1) { "Mean and 95 % interval, " } else { "" };
    let published = if has_reference { " Thin: published." } else { "" };
    format!("{shown}{}.{published}", seeds(numbers.into_iter()))
}

/// The x of the first and of the last point of all lines; of all declared points if none has a mean.
fn extent(figure: &CurveFigure) -> Option<(f64, f64)> {
    let points = || figure.lines.iter().flat_map(|line| &line.points);
    let seen: Vec<f64> = points().filter(|one| one.sample.n() > 0).map(|one| one.x).collect();
    let all = if seen.is_empty() { points().map(|one| one.x).collect() } else { seen };
    let least = all.iter().copied().reduce(f64::min)?;
    Some((least, all.into_iter().fold(least, f64::max)))
}

/// The ends of the line of an arm that lacks the parameter of the axis.
fn across_points(
    sample: &Sample,
    name: &str,
    extent: Option<(f64, f64)>,
    (metric, of): (Measure, &CurveFigure),
) -> Vec<PlottedPoint> {
    let axis = symbols::short(&of.axis);
    let tip = format!("{name}, which lacks {axis}: {}", measured(sample, metric));
    let interval = sample.interval().ok().map(|interval| (interval.low, interval.high));
    let y = sample.mean().unwrap_or(f64::NAN);
    let is_single = sample.n() == 1;
    let point = |x| PlottedPoint { x, y, interval, is_single, tip: tip.clone() };
    extent.map_or_else(Vec::new, |(left, right)| vec![point(left), point(right)])
}

/// The scale of a parameter's axis: logarithmic if the largest value is many times the smallest above 0, and
/// none is below 0.
fn scale_of<'l>(lines: impl Iterator<Item = &'l Line> + Clone) -> AxisScale {
    const MANY_TIMES: f64 = 30.0;
    let points = || lines.clone().flat_map(|line| &line.points).map(|point| point.x);
    let published = || lines.clone().flat_map(|line| &line.reference).map(|(x, _)| *x);
    let values = || points().chain(published());
    let least = values().filter(|value| *value > 0.0).fold(f64::INFINITY, f64::min);
    let most = values().fold(0.0, f64::max);
    let is_below = values().any(|value| value < 0.0);
    if !is_below && most / MANY_TIMES >= least { AxisScale::Log } else { AxisScale::Linear }
}

/// A point of a curve with its tooltip. The axis shows the context inference error or a parameter.
fn curve_point(
    point: &LinePoint,
    name: &str,
    (metric, of): (Measure, &CurveFigure),
) -> PlottedPoint {
    let at = match of.is_error() {
        true => {
            let error = shown(point.x * 100.0, 1);
            format!("σ = {}, error {error} %", parameter(point.parameter))
        }
        false => format!("{} = {}", symbols::short(&of.axis), parameter(point.parameter)),
    };
    let tip = format!("{name}, {at}: {}", measured(&point.sample, metric));
    let interval = point.sample.interval().ok().map(|interval| (interval.low, interval.high));
    let y = point.sample.mean().unwrap_or(f64::NAN);
    PlottedPoint { x: point.x, y, interval, is_single: point.sample.n() == 1, tip }
}

/// The mean of a sample with its interval and its number of seeds.
fn measured(sample: &Sample, metric: Measure) -> String {
    let mean = sample.mean().map_or_else(|reason| reason.to_string(), |mean| amount(mean, metric));
    let spread = spread(sample.interval(), metric);
    format!("{mean}{spread}, {}", seeds(std::iter::once(sample.n())))
}

/// The agent or scenario that all arms of a figure share.
fn shared_word(names: &[&ArmId]) -> Option<String> {
    let first = names.first()?;
    let same_agent = names.iter().all(|name| name.agent == first.agent);
    let same_scenario = names.iter().all(|name| name.scenario == first.scenario);
    match (same_agent, same_scenario) {
        (true, false) => Some(first.agent.clone()),
        (false, true) => Some(first.scenario.clone()),
        (true, true) | (false, false) => None,
    }
}

fn table(title: &str, figure: &CurveFigure, metric: Measure, names: &Names) -> DataTable {
    let (axis, is_error) = (symbols::short(&figure.axis), figure.is_error());
    let name = metric.title();
    let has_optimum = figure.lines.iter().any(|line| !line.optimum.is_empty());
    let columns = [
        ("arm", "Arm"),
        ("parameter", if is_error { "σ" } else { &axis }),
        ("x", if is_error { "Error, %" } else { "x" }),
        ("seeds", "n"),
        ("mean", name.as_str()),
        ("interval", "95 % interval"),
        (".low", ""),
        (".high", ""),
        ("sd", "SD over seeds"),
        (if has_optimum { "optimum" } else { ".optimum" }, "Optimum"),
        (if has_optimum { "share_of_optimum" } else { ".share_of_optimum" }, "Share of optimum, %"),
        ("published", "Published"),
    ];
    let mut table = DataTable::new(title, &columns);
    for line in &figure.lines {
        let row = |position: [TableEntry; 2], sample: &Sample, best, published: Option<f64>| {
            let (mean, interval) = (sample.mean(), sample.interval());
            let [parameter, x] = position;
            vec![
                arm(&line.name, names),
                parameter,
                x,
                TableEntry::number(sample.n() as f64, 0),
                in_unit(mean, metric),
                between(interval, metric),
                low(interval),
                high(interval),
                in_unit(sample.sd(), metric),
                optimum(best),
                share(mean, best),
                TableEntry::published(published.map(|value| TableEntry::number(value, 0))),
            ]
        };
        for point in &line.points {
            let published = line.published.iter().find(|(x, _)| *x == point.x);
            let x = match is_error {
                true => shown(point.x * 100.0, 1),
                false => parameter(point.x),
            };
            let position = [
                TableEntry::Number { value: point.parameter, shown: parameter(point.parameter) },
                TableEntry::Number { value: point.x, shown: x },
            ];
            let best = line.optimum_at(point.x);
            table.rows.push(row(position, &point.sample, best, published.map(|(_, value)| *value)));
        }
        if let Some(sample) = &line.across {
            let lacks = || TableEntry::Missing(format!("the arm lacks {axis}"));
            table.rows.push(row([lacks(), lacks()], sample, None, None));
        }
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_many_times_each_other_stand_by_powers_of_ten() {
        let line = |xs: &[f64]| Line::through(xs.iter().map(|x| (*x, 0.0)), Spread::Bars);
        let find_scale = |lines: &[Line]| scale_of(lines.iter());
        assert_eq!(find_scale(&[line(&[1e-5, 1e-3])]), AxisScale::Log);
        assert_eq!(find_scale(&[line(&[1e-5]), line(&[1e-3])]), AxisScale::Log);
        assert_eq!(find_scale(&[line(&[0.4, 2.0])]), AxisScale::Linear);
        assert_eq!(find_scale(&[line(&[0.0, 2.0])]), AxisScale::Linear);
        // 0 stands aside, but numbers below 0 have no place on a logarithmic axis.
        let published = Line { reference: vec![(0.0, 1.0)], ..line(&[1e-5, 1e-3]) };
        assert_eq!(find_scale(&[published]), AxisScale::Log);
        assert_eq!(find_scale(&[line(&[-1.0, 1e-5, 1e-3])]), AxisScale::Linear);
        assert_eq!(find_scale(&[line(&[1e-300, 1e-3])]), AxisScale::Log);
        assert_eq!(find_scale(&[]), AxisScale::Linear);
    }
}
