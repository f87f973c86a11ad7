//! The rate of context inference error along the feature noise.

use super::{Drawn, Sheet, parameter};
use crate::analyse::declared::ErrorFigure;
use crate::env::inference_error;
use crate::job::{Measure, counted};
use crate::report::data_table::{DataTable, TableEntry, shown};
use crate::report::figure::{
    Axis, AxisScale, Chart, INK, Line, Look, Marker, NumberFormat, PUBLISHED, PlottedPoint, Spread,
    Style, draw,
};
use crate::report::names::Names;
use crate::report::scene::Scene;

impl Drawn for ErrorFigure {
    fn figures(&self, sheet: &Sheet<'_>) -> Vec<(String, Scene)> {
        let stem = std::iter::once(sheet.stem.to_owned());
        stem.zip(error_figure(self, sheet.style)).collect()
    }

    fn table(&self, title: &str, _: Measure, _: &Names) -> DataTable {
        table(title, self)
    }

    fn shows(&self, _: Measure, _: &Names) -> String {
        let runs: usize = self.points.iter().map(|point| point.runs).sum();
        format!(
            "Rate at which the most likely context is wrong, exact and over the test steps of n = {}, \
             without first steps whose context is fixed",
            counted(runs, "run")
        )
    }

    fn finds(&self, _: Measure, _: &Names) -> Option<String> {
        if let Some((sigma, gap)) = self.furthest_published() {
            return Some(format!(
                "The published rates are counts of 1000 draws; the largest difference is {} \
                 percentage points, at σ = {}",
                shown(gap * 100.0, 1),
                parameter(sigma)
            ));
        }
        let last = self.points.last()?;
        let seen = last.seen.map_or_else(String::new, |seen| {
            format!(
                " and {} % were seen in {}",
                shown(seen * 100.0, 1),
                counted(last.steps, "step")
            )
        });
        let exact = shown(last.exact * 100.0, 1);
        Some(format!("At σ = {} it is {exact} %{seen}", parameter(last.sigma)))
    }
}

/// The error of context inference along sigma.
fn error_figure(figure: &ErrorFigure, style: &Style) -> Vec<Scene> {
    const STEPS: usize = 80;
    let most = figure.points.iter().map(|point| point.sigma).fold(0.0, f64::max);
    let most = if most > 0.0 { most } else { 1.0 };
    let look = |color, marker| Look { color, dash: None, marker };
    let exact = (0..=STEPS).map(|at| {
        let x = most * at as f64 / STEPS as f64;
        PlottedPoint {
            x,
            y: inference_error(x),
            interval: None,
            is_single: false,
            tip: String::new(),
        }
    });
    let seen = figure.points.iter().filter_map(|point| {
        let y = point.seen?;
        let tip = format!(
            "σ = {}: {} % seen in {} of {}; exact {} %",
            parameter(point.sigma),
            shown(y * 100.0, 1),
            counted(point.steps, "test step"),
            counted(point.runs, "run"),
            shown(point.exact * 100.0, 1)
        );
        Some(PlottedPoint { x: point.sigma, y, interval: None, is_single: false, tip })
    });
    let reported = figure.published.iter().map(|(sigma, rate)| {
        let tip = format!("σ = {}: {} % published", parameter(*sigma), shown(rate * 100.0, 1));
        PlottedPoint { x: *sigma, y: *rate, interval: None, is_single: false, tip }
    });
    let line = |label: &str, look, points: Vec<PlottedPoint>, spread| Line {
        label: label.to_owned(),
        look,
        points,
        reference: Vec::new(),
        spread,
        facets: Vec::new(),
    };
    let mut lines = vec![
        line("Φ(−1/(2σ))", look(INK, Marker::Disc), exact.collect(), Spread::Band),
        line("seen in tests", look(INK, Marker::Disc), seen.collect(), Spread::Points),
        line("published", look(PUBLISHED, Marker::Diamond), reported.collect(), Spread::Points),
    ];
    lines.retain(|line| !line.points.is_empty());
    let runs: usize = figure.points.iter().map(|point| point.runs).sum();
    let drawn = if figure.published.is_empty() { "" } else { "; published: 1000 draws each" };
    let note = format!("Line: exact. Points: test steps of n = {}{drawn}.", counted(runs, "run"));
    let description = "context inference error against feature noise".to_owned();
    let sigmas = figure.points.iter().map(|point| point.sigma).chain([0.0]).collect();
    let (x, y) = error_axes(most);
    let axes = (x.with_marked(sigmas), y);
    draw(&[Chart { heading: None, description, lines, note }], &axes, style)
}

fn error_axes(most: f64) -> (Axis, Axis) {
    let axis = |title: &str, most, numbers| {
        Axis::new(title.to_owned(), (0.0, most), AxisScale::Linear, numbers)
    };
    (
        axis("feature noise σ", most, NumberFormat::Plain),
        axis("context inference error, %", 0.5, NumberFormat::Percent),
    )
}

fn table(title: &str, figure: &ErrorFigure) -> DataTable {
    let columns = [
        ("sigma", "σ"),
        ("exact", "Exact, %"),
        ("seen", "Seen in tests, %"),
        ("published", "Published, %"),
        ("runs", "Runs"),
        ("steps", "Test steps"),
    ];
    let mut table = DataTable::new(title, &columns);
    let percent = |value: f64| TableEntry::Number { value, shown: shown(value * 100.0, 1) };
    for point in &figure.points {
        let published = figure.published.iter().find(|(sigma, _)| *sigma == point.sigma);
        table.rows.push(vec![
            TableEntry::Number { value: point.sigma, shown: parameter(point.sigma) },
            percent(point.exact),
            point.seen.map_or_else(|| TableEntry::Missing("no completed run".to_owned()), percent),
            TableEntry::published(published.map(|(_, rate)| percent(*rate))),
            TableEntry::number(point.runs as f64, 0),
            TableEntry::number(point.steps as f64, 0),
        ]);
    }
    table
}
