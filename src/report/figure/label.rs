//! The labels of lines: at their ends, beside the frame, or below the axis.

use super::axis::{Axis, Frame};
use super::line::{ALONE, Chart, GAP, LEAST_PLOT, Line, Spread, marker};
use super::look::Look;
use super::room::{free_height, is_free, spread_out};
use super::style::Style;
use super::{INK, TEXT, text};
use crate::report::scene::{Anchor, Color, Mark, Point, SceneShape, Stroke, Weight, width};

/// Maximum number of labels at the ends of lines that end early; with more such lines, all labels
/// stand beside the frame.
const MOST_INSIDE: usize = 3;
/// Distance from the frame's right edge beyond which a line ends early.
const FAR: f64 = 40.0;
/// Width of the sample of a line before its label.
const SAMPLE: f64 = 20.0;

/// Left end of the first label of a row below the axis.
const FIRST: f64 = 6.0;

/// The placement of line labels, the same in all panels.
pub(super) enum Placing {
    /// Right of the frame. Where many lines end early, each label has a sample of its line.
    Beside {
        /// Width of the labels.
        room: f64,
        /// Whether labels have samples.
        is_crowded: bool,
    },
    /// Below the axis, in rows.
    Below {
        /// Number of rows.
        rows: usize,
        /// Size of the letters of all labels.
        size: f64,
    },
}

/// The placement of the labels of these charts: beside the frame if there is room.
pub(super) fn placing(charts: &[Chart], (style, left): (&Style, f64)) -> Placing {
    /// Maximum width of a figure that is widened for its labels: 105 mm.
    const WIDEST: f64 = 397.0;
    let is_crowded = charts.iter().any(is_crowded);
    let lines = charts.iter().flat_map(Chart::labelled);
    let widest =
        lines.map(|(_, line)| width(&line.label, TEXT, Weight::SemiBold)).fold(0.0, f64::max);
    let room = widest + 12.0 + if is_crowded { SAMPLE } else { 0.0 };
    let most = if style.has_width() { style.width() } else { WIDEST };
    match left + LEAST_PLOT + room <= most {
        true => Placing::Beside { room, is_crowded },
        false => {
            let rows = charts.iter().map(|chart| rows(chart, style).len());
            // A label wider than the figure stands alone in its row.
            let alone = style.width() - FIRST - SAMPLE - 7.0;
            let size = TEXT * (alone / widest).min(1.0);
            Placing::Below { rows: rows.max().unwrap_or(0), size }
        }
    }
}

/// The lines of a chart in rows of labels, with the left end of each label.
fn rows(chart: &Chart, style: &Style) -> Vec<Vec<(usize, f64)>> {
    const BETWEEN: f64 = 12.0;
    let mut rows: Vec<Vec<(usize, f64)>> = Vec::new();
    let mut left = f64::INFINITY;
    for (series, line) in chart.labelled() {
        let wide = SAMPLE + 3.0 + width(&line.label, TEXT, Weight::SemiBold);
        if left + wide > style.width() - 4.0 {
            rows.push(Vec::new());
            left = FIRST;
        }
        rows.iter_mut().last().into_iter().for_each(|row| row.push((series, left)));
        left += wide + BETWEEN;
    }
    rows
}

/// The labels below the axis, each with a sample of its line; the first row stands at `first`.
pub(super) fn below(chart: &Chart, style: &Style, (first, size): (f64, f64)) -> Vec<Mark> {
    let rows = rows(chart, style);
    let mut marks = Vec::new();
    for (at, row) in rows.iter().enumerate() {
        let base = first + at as f64 * GAP;
        for (series, left) in row {
            marks.extend(sample(chart, *series, (*left, base - TEXT * 0.35)));
            marks.push(letters(chart, *series, (left + SAMPLE + 3.0, base), (size, None)));
        }
    }
    marks
}

/// A sample of a line, with its marker if it has one.
fn sample(chart: &Chart, series: usize, (left, height): Point) -> Vec<Mark> {
    let line = &chart.lines[series];
    let Look { color, dash, .. } = line.look;
    let points = vec![(left, height), (left + SAMPLE - 4.0, height)];
    let stroke = Stroke { color, width: 1.3, dash, opacity: 1.0 };
    let of_line = (line.spread != Spread::Points)
        .then(|| Mark::from(SceneShape::Line { points, stroke }).of(series));
    let is_marked = matches!(line.spread, Spread::Bars | Spread::Points);
    let at = (left + (SAMPLE - 4.0) / 2.0, height);
    let point = is_marked.then(|| Mark::from(marker(at, &line.look, 2.2)).of(series));
    of_line.into_iter().chain(point).collect()
}

/// The text of a line's label.
fn letters(chart: &Chart, series: usize, at: Point, (size, rim): (f64, Option<Stroke>)) -> Mark {
    let line = &chart.lines[series];
    // Text in light colours is hard to read.
    let darker = if line.look.color.lightness() > 0.5 { 0.35 } else { 0.0 };
    let color = line.look.color.towards(INK, darker);
    let mut letters = text(at, &line.label, (size, Weight::SemiBold), color, Anchor::Start);
    if let SceneShape::Text { rim: of_letters, .. } = &mut letters {
        *of_letters = rim;
    }
    Mark::from(letters).of(series)
}

/// The labels beside the frame, each with a sample of its line.
pub(super) fn beside(chart: &Chart, axes: (&Axis, &Axis), frame: &Frame) -> Vec<Mark> {
    let right = frame.left + frame.width;
    let ends = chart.labelled().filter_map(|(series, line)| {
        let last = line.points.last()?;
        let end = frame.position(axes, (last.x, last.y));
        Some((series, end, end.1))
    });
    let mut ends: Vec<(usize, Point, f64)> = ends.collect();
    ends.sort_by(|one, other| one.2.total_cmp(&other.2));
    spread_out(&mut ends, GAP, (frame.top, frame.top + frame.height));
    let marks = ends.into_iter().flat_map(|(series, _, height)| {
        let at = (right + 6.0 + SAMPLE, height + TEXT * 0.35);
        let mut marks = sample(chart, series, (right + 6.0, height));
        marks.push(letters(chart, series, at, (TEXT, None)));
        marks
    });
    marks.collect()
}

/// Whether more lines end early than can be labelled at their ends.
fn is_crowded(chart: &Chart) -> bool {
    chart.labelled().filter(|(_, line)| ends_early(chart, line)).count() > MOST_INSIDE
}

/// Whether a line ends before another line of the chart.
fn ends_early(chart: &Chart, line: &Line) -> bool {
    let last = |line: &Line| line.points.last().map(|point| point.x);
    let farthest = chart.lines.iter().filter_map(last).fold(f64::NEG_INFINITY, f64::max);
    last(line).is_some_and(|x| x < farthest)
}

/// The labels of the lines at their ends, moved apart so that they do not overlap. They stand
/// beside the frame, with a thin connecting line if moved far; labels of lines that end early stand
/// above or below their ends.
pub(super) fn end_labels(
    chart: &Chart,
    axes: (&Axis, &Axis),
    (frame, dodges): (&Frame, &[f64]),
) -> Vec<Mark> {
    let right = frame.left + frame.width;
    let mut ends: Vec<(usize, Point, f64)> = Vec::new();
    let mut inside: Vec<(usize, Point, f64)> = Vec::new();
    for (series, line) in chart.labelled() {
        if let Some(last) = line.points.last() {
            let end = frame.position(axes, (last.x, last.y));
            match ends_early(chart, line) && end.0 < right - FAR {
                true => {
                    let (end, height) = inside_position(chart, axes, frame, (series, end));
                    inside.push((series, end, height));
                }
                false => ends.push((series, end, end.1)),
            }
        }
    }
    for list in [&mut ends, &mut inside] {
        list.sort_by(|one, other| one.2.total_cmp(&other.2));
        spread_out(list, GAP, (frame.top, frame.top + frame.height));
    }
    // A white rim separates the text from lines and bands beneath it.
    let white = Some(Stroke::solid(Color::WHITE, 2.5));
    let mut marks: Vec<Mark> = Vec::new();
    for (series, end, height) in inside {
        let (left, behind) = inside_label(&chart.lines[series], frame, end);
        let apart = height - end.1;
        if apart.abs() > 2.0 * TEXT {
            // A label far from the end of its line would seem to belong to another line.
            let stroke = Stroke::solid(chart.lines[series].look.color, 0.5);
            let foot = (end.0.clamp(left, behind), height - apart.signum() * TEXT / 2.0);
            marks.push(Mark::from(SceneShape::Line { points: vec![end, foot], stroke }).of(series));
        }
        marks.push(letters(chart, series, (left, height + TEXT * 0.35), (TEXT, white)));
    }
    for (series, end, height) in ends {
        if (height - end.1).abs() > TEXT || end.0 < right - FAR {
            let color = chart.lines[series].look.color;
            let stroke = Stroke { color, width: 0.5, dash: None, opacity: 0.6 };
            let points = vec![(end.0 + dodges[series] + 3.0, end.1), (right + 5.0, height)];
            marks.push(Mark::from(SceneShape::Line { points, stroke }).of(series));
        }
        marks.push(letters(chart, series, (right + 6.0, height + TEXT * 0.35), (TEXT, None)));
    }
    marks
}

/// The left and right end of the label of a line that ends early. The label ends where the line
/// does, unless it would cross the left edge of the frame.
fn inside_label(line: &Line, frame: &Frame, end: Point) -> (f64, f64) {
    let wide = width(&line.label, TEXT, Weight::SemiBold);
    let left = (end.0 - wide).max(frame.left + 3.0);
    (left, left + wide)
}

/// Where the label of a line that ends early overlaps no other line: the end that it belongs to, and its height. A
/// line of one point, which is drawn as a dash, has its label behind the dash if there is room.
fn inside_position(
    chart: &Chart,
    axes: (&Axis, &Axis),
    frame: &Frame,
    (series, end): (usize, Point),
) -> (Point, f64) {
    let others = chart.lines.iter().enumerate().filter(|(other, _)| *other != series);
    let points = |line: &Line| -> Vec<Point> {
        let points = line.points.iter().map(|point| frame.position(axes, (point.x, point.y)));
        match points.clone().collect::<Vec<_>>().as_slice() {
            [(x, y)] => vec![(x - ALONE, *y), (x + ALONE, *y)],
            _ => points.collect(),
        }
    };
    let others: Vec<Vec<Point>> = others.map(|(_, line)| points(line)).collect();
    let line = &chart.lines[series];
    if line.points.len() == 1 && line.spread == Spread::Exact {
        let left = end.0 + ALONE + 4.0;
        let behind = left + width(&line.label, TEXT, Weight::SemiBold);
        if behind < frame.left + frame.width && is_free(&others, (left, behind), end.1) {
            return ((behind, end.1), end.1);
        }
    }
    let limits = (frame.top + TEXT / 2.0, frame.top + frame.height - TEXT / 2.0);
    (end, free_height(&others, inside_label(line, frame, end), end.1, limits))
}
