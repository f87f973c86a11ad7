//! Curves: a metric along a parameter, a line an arm.

use super::{Drawn, amount};
use crate::analyse::declared::{ALPHA, Apart, ArmId, CurveFigure, CurveLine, CurvePoint, Ends};
use crate::manifest::short_name;
use crate::report::arm_tables::{optimum, share};
use crate::report::data_table::{DataTable, Entry, shown};
use crate::report::figure::{
    AxisScale, Chart, Line, Looks, Numbers, Place, Spread, arm_label, axes, draw, labels,
    optimum_lines, seeds,
};
use crate::report::scene::Scene;
use crate::report::tables::{between, high, in_unit, low};
use crate::report::words::{metric_title, unit_numbers};

impl Drawn for CurveFigure {
    fn figures(&self, stem: &str, metric: &str, looks: &Looks) -> Vec<(String, Scene)> {
        vec![(stem.to_owned(), curve_figure(self, metric, looks))]
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
            "Mean and its 95 % interval of {} against {axis}, {seeds} a point",
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
                        "{one} and {other} differ at no point by more than chance (Welch’s t, \
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
                    "{name} is at {from} at {first} and at {to} at {last}, no further apart than \
                     chance makes them (Welch’s t, p < {ALPHA})"
                ),
                Apart::Untested => format!(
                    "{name} is at {from} at {first} and at {to} at {last}, with too few seeds for a \
                     test"
                ),
            });
        }
        let trends = self.trends()?;
        Some(format!(
            "Of {} lines {} fall and {} rise from their first to their last point by more than \
             chance (Welch’s t, Bonferroni-corrected p < {ALPHA})",
            trends.lines, trends.falls, trends.rises
        ))
    }

    fn arms(&self) -> Vec<&ArmId> {
        self.lines.iter().map(|line| &line.name).collect()
    }

    fn series(&self) -> Vec<String> {
        labels(&self.arms())
    }
}

/// A curve: means over seeds with their intervals, and the published line.
fn curve_figure(figure: &CurveFigure, metric: &str, looks: &Looks) -> Scene {
    let names: Vec<&ArmId> = figure.lines.iter().map(|line| &line.name).collect();
    let numbers = unit_numbers(metric).0;
    let is_error = figure.is_error();
    let line = |(line, label): (&CurveLine, String)| {
        let seen = line.points.iter().filter(|point| point.sample.n() > 0);
        Line {
            label,
            look: looks.look(&line.name),
            points: seen.map(|point| curve_place(point, &line.name, (metric, is_error))).collect(),
            reference: line.published.clone(),
            spread: Spread::Bars,
        }
    };
    let mut lines: Vec<Line> = figure.lines.iter().zip(labels(&names)).map(line).collect();
    let optima = figure.lines.iter().map(|line| (&line.name, line.optimum.clone()));
    lines.extend(optimum_lines(optima, looks));
    let counts = figure.lines.iter().flat_map(|line| line.points.iter().map(|p| p.sample.n()));
    let has_reference = lines.iter().any(|line| !line.reference.is_empty());
    let note = format!(
        "Mean and 95 % interval, {}.{}",
        seeds(counts.filter(|n| *n > 0)),
        if has_reference { " Thin: published." } else { "" }
    );
    let (x_title, x_numbers) = match is_error {
        true => ("context inference error, %".to_owned(), Numbers::Percent),
        false => (short_name(&figure.axis).to_owned(), Numbers::Plain),
    };
    let agents = shared_word(&names);
    let scale = if is_error { AxisScale::Linear } else { scale_of(&lines) };
    let x_title = match scale {
        AxisScale::Log => format!("{x_title} (logarithmic)"),
        AxisScale::Linear => x_title,
    };
    let axes = axes(&lines, (x_title, x_numbers, scale), (metric, numbers));
    let description = format!("{} against {}", metric_title(metric), axes.0.title);
    draw(&Chart { heading: agents, description, axes, lines, note })
}

/// The scale along which values of a parameter are told apart: by powers of ten where the largest
/// is many times the smallest.
fn scale_of(lines: &[Line]) -> AxisScale {
    const MANY_TIMES: f64 = 30.0;
    let points = || lines.iter().flat_map(|line| &line.points).map(|point| point.x);
    let published = || lines.iter().flat_map(|line| &line.reference).map(|(x, _)| *x);
    let values = || points().chain(published());
    let (least, most) = (values().fold(f64::INFINITY, f64::min), values().fold(0.0, f64::max));
    if least > 0.0 && most >= MANY_TIMES * least { AxisScale::Log } else { AxisScale::Linear }
}

/// A point of a curve; the axis shows the context inference error, or a parameter.
fn curve_place(point: &CurvePoint, name: &ArmId, (metric, is_error): (&str, bool)) -> Place {
    let scaled = |value: f64| match unit_numbers(metric) {
        (Numbers::Percent, decimals) => format!("{} %", shown(value * 100.0, decimals)),
        (Numbers::Plain, decimals) => shown(value, decimals),
    };
    let interval = point.sample.interval().ok();
    let y = point.sample.mean().unwrap_or(f64::NAN);
    let spread = interval.map_or_else(String::new, |interval| {
        format!(", 95 % interval {} to {}", scaled(interval.low), scaled(interval.high))
    });
    let at = match is_error {
        true => format!("σ = {}, error {} %", point.parameter, shown(point.x * 100.0, 1)),
        false => point.parameter.to_string(),
    };
    let n = seeds(std::iter::once(point.sample.n()));
    let tip = format!("{}, {at}: {}{spread}, {n}", arm_label(name), scaled(y));
    Place { x: point.x, y, interval: interval.map(|i| (i.low, i.high)), tip }
}

/// What all arms of a figure share: an agent or a scenario.
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
        (if has_optimum { "share_of_optimum" } else { ".share_of_optimum" }, "Share of it, %"),
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
        };
        assert_eq!(scale_of(&[line(&[1e-5, 1e-3])]), AxisScale::Log);
        assert_eq!(scale_of(&[line(&[1e-5]), line(&[1e-3])]), AxisScale::Log);
        assert_eq!(scale_of(&[line(&[0.4, 2.0])]), AxisScale::Linear);
        assert_eq!(scale_of(&[line(&[0.0, 2.0])]), AxisScale::Linear);
        let published = Line { reference: vec![(0.0, 1.0)], ..line(&[1e-5, 1e-3]) };
        assert_eq!(scale_of(&[published]), AxisScale::Linear);
        assert_eq!(scale_of(&[]), AxisScale::Linear);
    }
}
