//! Differences with their intervals, a line a comparison.

use super::axis::{Axis, AxisScale, round_range};
use super::chart::marker;
use super::look::{Look, Marker, arm_label};
use super::{FAINT, GRID, INK, NOTE, PUBLISHED, TEXT, WIDTH, fitting, seeds, text};
use crate::analyse::declared::ContrastRow;
use crate::report::data_table::shown;
use crate::report::scene::{Anchor, Mark, Scene, Shape, Stroke, Weight, width};
use crate::report::words::{metric_title, unit_numbers};

const TOP: f64 = 24.0;
const ROW: f64 = 15.0;
const BOTTOM: f64 = 50.0;
/// Width of the axis, at least.
const LEAST_PLOT: f64 = 150.0;

/// The rows of a contrast.
pub fn forest_figure(rows: &[ContrastRow], metric: &str) -> Scene {
    let labels: Vec<String> = rows.iter().map(|row| arm_label(&row.name)).collect();
    let widest = labels.iter().map(|label| width(label, TEXT, Weight::Regular));
    let left = widest.fold(40.0, f64::max) + 12.0;
    let right = (WIDTH - 14.0).max(left + LEAST_PLOT);
    let whole = right + 14.0;
    let axis = axis(rows, metric);
    let height = TOP + ROW * rows.len() as f64 + BOTTOM;
    let bottom = TOP + ROW * rows.len() as f64;
    let across = |value: f64| left + axis.share(value).clamp(0.0, 1.0) * (right - left);
    let mut marks = ruler(&axis, (left, right), bottom);
    if let Some(row) = rows.first() {
        let heading = format!("{} − {}", row.sides.0, row.sides.1);
        let weight = (TEXT + 1.0, Weight::SemiBold);
        marks.push(text((left, 15.0), heading, weight, INK, Anchor::Start).into());
    }
    for (at, (row, label)) in rows.iter().zip(&labels).enumerate() {
        let middle = TOP + ROW * (at as f64 + 0.5);
        let place = (left - 6.0, middle + TEXT * 0.35);
        let plain = (TEXT, Weight::Regular);
        marks.push(text(place, label, plain, INK, Anchor::End).into());
        marks.extend(row_marks(row, label, middle, across));
    }
    let counts = rows.iter().map(|row| row.contrast.seeds.0.min(row.contrast.seeds.1));
    let is_compared = rows.iter().any(|row| row.published.is_some());
    let note = format!(
        "Difference and 95 % interval{}, {} a side.{}",
        if rows.iter().any(ContrastRow::is_paired) { ", paired by seed" } else { "" },
        seeds(counts.filter(|n| *n > 0)),
        if is_compared { " Diamonds: published." } else { "" }
    );
    let at = (whole / 2.0, height - 5.0);
    marks.push(fitting(at, note, (NOTE, whole - 8.0), FAINT).into());
    let description = format!("differences in {}", metric_title(metric));
    Scene { width: whole, height, description, marks }
}

fn axis(rows: &[ContrastRow], metric: &str) -> Axis {
    let mut numbers = vec![0.0];
    for row in rows {
        numbers.extend(row.contrast.difference.ok());
        numbers.extend(row.published.map(|(effect, _)| effect));
        let interval = row.contrast.test().map(|test| test.interval);
        numbers.extend(interval.iter().flat_map(|interval| [interval.low, interval.high]));
    }
    let low = numbers.iter().copied().fold(f64::INFINITY, f64::min);
    let high = numbers.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    Axis {
        title: format!("difference in {}", metric_title(metric)),
        range: round_range(low, high.max(low + 1e-9)),
        scale: AxisScale::Linear,
        numbers: unit_numbers(metric).0,
    }
}

fn ruler(axis: &Axis, (left, right): (f64, f64), bottom: f64) -> Vec<Mark> {
    let mut marks = Vec::new();
    let ticks = axis.ticks(5);
    let step = ticks.get(1).map_or(1.0, |second| second - ticks[0]);
    for tick in &ticks {
        let x = left + axis.share(*tick) * (right - left);
        let stroke =
            if *tick == 0.0 { Stroke::solid(FAINT, 1.0) } else { Stroke::solid(GRID, 0.6) };
        marks.push(Shape::Line { points: vec![(x, TOP), (x, bottom)], stroke }.into());
        let at = (x, bottom + 4.0 + TEXT);
        let words = axis.written(*tick, step);
        marks.push(text(at, words, (TEXT, Weight::Regular), FAINT, Anchor::Middle).into());
    }
    // Under the axis, as far as the figure's edges let it.
    let half = width(&axis.title, TEXT, Weight::Regular) / 2.0;
    let middle = ((left + right) / 2.0).min(right + 10.0 - half).max(half + 4.0);
    let at = (middle, bottom + 7.0 + 2.0 * TEXT);
    marks.push(fitting(at, &axis.title, (TEXT, right + 6.0), INK).into());
    marks
}

fn row_marks(
    row: &ContrastRow,
    label: &str,
    middle: f64,
    across: impl Fn(f64) -> f64,
) -> Vec<Mark> {
    let mut marks = Vec::new();
    let interval = row.contrast.test().ok().map(|test| test.interval);
    if let Some(interval) = interval {
        let points = vec![(across(interval.low), middle), (across(interval.high), middle)];
        marks.push(Shape::Line { points, stroke: Stroke::solid(INK, 1.5) }.into());
    }
    if let Ok(difference) = row.contrast.difference {
        // Rates are below 1, returns in the hundreds.
        let decimals = if difference.abs() >= 10.0 { 0 } else { 3 };
        let spread = interval.map_or_else(String::new, |interval| {
            format!(
                ", 95 % interval {} to {}",
                shown(interval.low, decimals),
                shown(interval.high, decimals)
            )
        });
        let tip = format!("{label}: {}{spread}", shown(difference, decimals));
        let look = Look { color: INK, dash: None, marker: Marker::Disc };
        marks.push(Mark::from(marker((across(difference), middle), &look, 3.0)).saying(tip));
    }
    // Above ours, whose rim shows around it where both are the same.
    if let Some((effect, p)) = row.published {
        let look = Look { color: PUBLISHED, dash: None, marker: Marker::Diamond };
        let tip = format!("{label}: published {} (p = {p})", shown(effect, 0));
        marks.push(Mark::from(marker((across(effect), middle), &look, 3.2)).saying(tip));
    }
    marks
}
