//! Curves: a metric along a parameter, one line per arm.

use super::{Drawn, Sheet, amount};
use crate::analyse::declared::{ALPHA, Apart, ArmId, CurveFigure, CurvePoint, Ends};
use crate::manifest::short_name;
use crate::report::arm_tables::{optimum, share};
use crate::report::data_table::{DataTable, Entry, shown};
use crate::report::figure::{
    AxisScale, Chart, Line, Numbers, Panel, Panels, Place, Spread, arm_label, axes, draw, facets,
    optimum_lines, seeds,
};
use crate::report::scene::Scene;
use crate::report::tables::{between, high, in_unit, low};
use crate::report::words::{metric_title, unit_numbers};

impl Drawn for CurveFigure {
    fn figures(&self, sheet: &Sheet<'_>) -> Vec<(String, Scene)> {
        curve_figures(self, sheet)
    }

    fn split(&self) -> Option<Panels> {
        Some(Panels::of(&self.arms(), None, None))
    }

    fn table(&self, title: &str, metric: &str) -> DataTable {
        table(title, self, metric)
    }

    fn shows(&self, metric: &str) -> String {
        let axis = match self.is_error() {
            true => "context inference error",
            false => short_name(&self.axis),
        };
        let counts = self.lines.iter().flat_map(|line| &line.points).map(|point| point.sample.n());
        let seeds = seeds(counts.filter(|n| *n > 0));
        format!(
            "Mean and its 95 % interval of {} against {axis}, {seeds} per point",
            metric_title(metric)
        )
    }

    fn finds(&self, metric: &str) -> Option<String> {
        let at = |point: &CurvePoint| match self.is_error() {
            true => format!("{} % error", shown(point.x * 100.0, 0)),
            false => format!("{} = {}", short_name(&self.axis), point.x),
        };
        if let [first, second] = self.lines.as_slice() {
            let (one, other) = (arm_label(&first.name), arm_label(&second.name));
            match self.widest_gap() {
                Some((point, gap, Apart::Surely)) => {
                    return Some(format!(
                        "{one} and {other} are furthest apart at {}, by {} (Welch’s t, \
                         Bonferroni-corrected p < {ALPHA})",
                        at(point),
                        amount(gap.abs(), metric)
                    ));
                }
                Some((_, _, Apart::Perhaps)) => {
                    return Some(format!(
                        "{one} and {other} do not differ significantly at any point (Welch’s t, \
                         Bonferroni-corrected p < {ALPHA})"
                    ));
                }
                Some((_, _, Apart::Untested)) | None => {}
            }
        }
        if let [line] = self.lines.as_slice() {
            let name = arm_label(&line.name);
            let Ends { first: (first, start), last: (last, end), apart } = line.ends(1)?;
            let (from, to) = (amount(start, metric), amount(end, metric));
            if first.x == last.x {
                return Some(format!("{name} is at {from} at {}", at(first)));
            }
            let verb = if end < start { "falls" } else { "rises" };
            let (first, last) = (at(first), at(last));
            return Some(match apart {
                _ if from == to => format!("{name} is at {from} both at {first} and at {last}"),
                Apart::Surely => format!(
                    "{name} {verb} from {from} at {first} to {to} at {last} (Welch’s t, p < {ALPHA})"
                ),
                Apart::Perhaps => format!(
                    "{name} is at {from} at {first} and at {to} at {last}, not a significant \
                     difference (Welch’s t, p < {ALPHA})"
                ),
                Apart::Untested => format!(
                    "{name} is at {from} at {first} and at {to} at {last}, with too few seeds for a \
                     test"
                ),
            });
        }
        let trends = self.trends()?;
        let tested = match trends.lines < self.lines.len() {
            true => "lines with several points and enough seeds",
            false => "lines",
        };
        Some(format!(
            "Of {} {tested}, {} fall and {} rise significantly from their first to their last point \
             (Welch’s t, Bonferroni-corrected p < {ALPHA})",
            trends.lines, trends.falls, trends.rises
        ))
    }

    fn arms(&self) -> Vec<&ArmId> {
        self.lines.iter().map(|line| &line.name).collect()
    }
}

/// Means over seeds with their intervals, and the published lines, with one figure per panel.
fn curve_figures(figure: &CurveFigure, sheet: &Sheet<'_>) -> Vec<(String, Scene)> {
    let (metric, style) = (sheet.metric, sheet.style);
    let names: Vec<&ArmId> = figure.lines.iter().map(|line| &line.name).collect();
    let panels = Panels::of(&names, style.panel, None);
    let numbers = unit_numbers(metric).0;
    let is_error = figure.is_error();
    let (x_title, x_numbers) = match is_error {
        true => ("context inference error, %".to_owned(), Numbers::Percent),
        false => (short_name(&figure.axis).to_owned(), Numbers::Plain),
    };
    let line = |at: usize| {
        let (line, label) = (&figure.lines[at], panels.labels[at].clone());
        let seen = line.points.iter().filter(|point| point.sample.n() > 0);
        Line {
            label,
            look: sheet.looks.look(&line.name),
            points: seen.map(|point| curve_place(point, &line.name, (metric, figure))).collect(),
            reference: line.published.clone(),
            spread: Spread::Bars,
            facets: facets(&line.name),
        }
    };
    let chart = |panel: &Panel| {
        let members = || panel.members.iter().map(|at| &figure.lines[*at]);
        let mut lines: Vec<Line> = panel.members.iter().map(|at| line(*at)).collect();
        let optima = members().map(|line| (&line.name, line.optimum.clone()));
        lines.extend(optimum_lines(optima, sheet.looks));
        let counts = members().flat_map(|line| line.points.iter().map(|p| p.sample.n()));
        let has_reference = lines.iter().any(|line| !line.reference.is_empty());
        let note = format!(
            "Mean and 95 % interval, {}.{}",
            seeds(counts.filter(|n| *n > 0)),
            if has_reference { " Thin: published." } else { "" }
        );
        let heading = match panels.is_one() && panel.heading.is_empty() {
            true => shared_word(&names),
            false => Some(panel.heading.clone()),
        };
        let description = format!("{} against {x_title}", metric_title(metric));
        Chart { heading, description, lines, note }
    };
    let charts: Vec<Chart> = panels.panels.iter().map(chart).collect();
    let scale = match is_error {
        true => AxisScale::Linear,
        false => scale_of(charts.iter().flat_map(|chart| &chart.lines)),
    };
    let x_title = match scale {
        AxisScale::Log => format!("{x_title} (logarithmic)"),
        AxisScale::Linear => x_title.clone(),
    };
    let axes = axes(&charts, (x_title, x_numbers, scale), (metric, numbers), style);
    panels.stems(sheet.stem).into_iter().zip(draw(&charts, &axes, style)).collect()
}

/// The scale of a parameter's axis: logarithmic if the largest value is many times the smallest.
fn scale_of<'l>(lines: impl Iterator<Item = &'l Line> + Clone) -> AxisScale {
    const MANY_TIMES: f64 = 30.0;
    let points = || lines.clone().flat_map(|line| &line.points).map(|point| point.x);
    let published = || lines.clone().flat_map(|line| &line.reference).map(|(x, _)| *x);
    let values = || points().chain(published());
    let (least, most) = (values().fold(f64::INFINITY, f64::min), values().fold(0.0, f64::max));
    if least > 0.0 && most >= MANY_TIMES * least { AxisScale::Log } else { AxisScale::Linear }
}

/// A point of a curve with its tooltip. The axis shows the context inference error or a parameter.
fn curve_place(point: &CurvePoint, name: &ArmId, (metric, of): (&str, &CurveFigure)) -> Place {
    let scaled = |value: f64| match unit_numbers(metric) {
        (Numbers::Percent, decimals) => format!("{} %", shown(value * 100.0, decimals)),
        (Numbers::Plain, decimals) => shown(value, decimals),
    };
    let interval = point.sample.interval().ok();
    let y = point.sample.mean().unwrap_or(f64::NAN);
    let spread = interval.map_or_else(String::new, |interval| {
        format!(", 95 % interval {} to {}", scaled(interval.low), scaled(interval.high))
    });
    let at = match of.is_error() {
        true => format!("σ = {}, error {} %", point.parameter, shown(point.x * 100.0, 1)),
        false => format!("{} = {}", short_name(&of.axis), point.parameter),
    };
    let n = seeds(std::iter::once(point.sample.n()));
    let tip = format!("{}, {at}: {}{spread}, {n}", arm_label(name), scaled(y));
    Place { x: point.x, y, interval: interval.map(|i| (i.low, i.high)), tip }
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

fn table(title: &str, figure: &CurveFigure, metric: &str) -> DataTable {
    let (axis, is_error) = (short_name(&figure.axis), figure.is_error());
    let name = metric_title(metric);
    let has_optimum = figure.lines.iter().any(|line| !line.optimum.is_empty());
    let columns = [
        ("arm", "Arm"),
        ("parameter", if is_error { "σ" } else { axis }),
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
        for point in &line.points {
            let (mean, interval) = (point.sample.mean(), point.sample.interval());
            let published = line.published.iter().find(|(x, _)| *x == point.x);
            let best = line.optimum_at(point.x);
            let x = if is_error { shown(point.x * 100.0, 1) } else { point.x.to_string() };
            table.rows.push(vec![
                Entry::text(arm_label(&line.name)),
                Entry::Number { value: point.parameter, shown: point.parameter.to_string() },
                Entry::Number { value: point.x, shown: x },
                Entry::number(point.sample.n() as f64, 0),
                in_unit(mean, metric),
                between(interval, metric),
                low(interval),
                high(interval),
                in_unit(point.sample.sd(), metric),
                optimum(best),
                share(mean, best),
                Entry::published(published.map(|(_, value)| Entry::number(*value, 0))),
            ]);
        }
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::figure::{INK, Look, Marker};

    #[test]
    fn values_many_times_each_other_stand_by_powers_of_ten() {
        let line = |xs: &[f64]| Line {
            label: String::new(),
            look: Look { color: INK, dash: None, marker: Marker::Disc },
            points: xs
                .iter()
                .map(|x| Place { x: *x, y: 0.0, interval: None, tip: String::new() })
                .collect(),
            reference: Vec::new(),
            spread: Spread::Bars,
            facets: Vec::new(),
        };
        let of = |lines: &[Line]| scale_of(lines.iter());
        assert_eq!(of(&[line(&[1e-5, 1e-3])]), AxisScale::Log);
        assert_eq!(of(&[line(&[1e-5]), line(&[1e-3])]), AxisScale::Log);
        assert_eq!(of(&[line(&[0.4, 2.0])]), AxisScale::Linear);
        assert_eq!(of(&[line(&[0.0, 2.0])]), AxisScale::Linear);
        let published = Line { reference: vec![(0.0, 1.0)], ..line(&[1e-5, 1e-3]) };
        assert_eq!(of(&[published]), AxisScale::Linear);
        assert_eq!(of(&[]), AxisScale::Linear);
    }
}
