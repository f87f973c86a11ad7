//! Lines along an axis, with intervals: one chart per panel, all with the same axes.

use super::Numbers;
use super::axis::{Axis, AxisScale, Frame, round_range};
use super::label::{Placing, below, beside, end_labels, placing};
use super::line::{Chart, GAP, LEAST_PLOT, LEFT, Line, Place, Spread, marker};
use super::style::Style;
use super::{FAINT, INK, NOTE, TEXT, fitting, text};
use crate::report::scene::{Anchor, Fill, Mark, Point, Scene, Shape, Stroke, Weight};
use crate::report::words::metric_title;

const HEIGHT: f64 = 236.0;
const TOP: f64 = 12.0;
const HEADING: f64 = 14.0;
/// Space below the frame for numbers and title.
const BOTTOM: f64 = 35.0;
/// Minimum height of the frame.
const LEAST_HEIGHT: f64 = 60.0;

/// The axes for all lines of a metric. The horizontal axis has the given title and reaches from the
/// first to the last point. The vertical axis has round ends, unless the style declares others.
pub fn axes(
    charts: &[Chart],
    (x_title, x_numbers, scale): (String, Numbers, AxisScale),
    (metric, y_numbers): (&str, Numbers),
    style: &Style,
) -> (Axis, Axis) {
    let lines = || charts.iter().flat_map(|chart| &chart.lines);
    let points = || lines().flat_map(|line| &line.points);
    let references = || lines().flat_map(|line| &line.reference);
    let xs = points().map(|point| point.x).chain(references().map(|at| at.0));
    let (left, right) =
        xs.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, r), x| (l.min(x), r.max(x)));
    let ys = points()
        .flat_map(|point| [point.y, point.interval.map_or(point.y, |(_, high)| high)])
        .chain(references().map(|at| at.1));
    let high = ys.fold(f64::NEG_INFINITY, f64::max);
    let low = points().map(|point| point.y).fold(0.0, f64::min);
    let (left, right) = if left < right { (left, right) } else { around(left, scale) };
    let (low, high) = round_range(low, if high.is_finite() { high } else { 1.0 });
    let cap = if y_numbers == Numbers::Percent { 1.0 } else { f64::INFINITY };
    let low = style.limits.0.unwrap_or(low);
    let high = style.limits.1.unwrap_or(high.min(cap));
    let y = Axis {
        title: metric_title(metric),
        // A declared end may lie beyond the other end.
        range: (low, if high > low { high } else { low + high.abs().max(low.abs()).max(1.0) }),
        scale: AxisScale::Linear,
        numbers: y_numbers,
    };
    let has_marks = lines().any(|line| line.spread == Spread::Bars);
    let range = if has_marks { padded((left, right), scale) } else { (left, right) };
    (Axis { title: x_title, range, scale, numbers: x_numbers }, y)
}

/// The range of an axis whose points are all at one place, or which has no points.
fn around(place: f64, scale: AxisScale) -> (f64, f64) {
    match scale {
        _ if !place.is_finite() => (0.0, 1.0),
        AxisScale::Log => (place / 2.0, place * 2.0),
        AxisScale::Linear => {
            let half = (place.abs() / 2.0).max(f64::MIN_POSITIVE.sqrt());
            (place - half, place + half)
        }
    }
}

/// The range of an axis, extended slightly beyond the first and the last point so that their marks
/// do not cover numbers.
fn padded((low, high): (f64, f64), scale: AxisScale) -> (f64, f64) {
    const PART: f64 = 0.03;
    match scale {
        AxisScale::Linear => (low - PART * (high - low), high + PART * (high - low)),
        AxisScale::Log => (low / (high / low).powf(PART), high * (high / low).powf(PART)),
    }
}

/// The charts, drawn with these axes. All charts have the same size, and all frames have the same size.
pub fn draw(charts: &[Chart], axes: &(Axis, Axis), style: &Style) -> Vec<Scene> {
    let placing = placing(charts, style);
    let has_heading = |chart: &Chart| chart.heading.is_some();
    let headings = charts.iter().any(has_heading) && (charts.len() > 1 || style.has_titles());
    let top = TOP + if headings { HEADING } else { 0.0 };
    let (room, beneath) = match placing {
        Placing::Beside { room, .. } => (room, 0.0),
        Placing::Below { rows } => (14.0, rows as f64 * GAP + 2.0),
    };
    let bottom = BOTTOM + style.note() + beneath;
    let of_labels = match placing {
        Placing::Beside { .. } => {
            GAP * charts.iter().map(|chart| chart.lines.len()).max().unwrap_or(0) as f64
        }
        Placing::Below { .. } => LEAST_HEIGHT,
    };
    let beneath_grows = style.height(HEIGHT + beneath);
    let frame = Frame {
        left: LEFT,
        top,
        width: (style.width() - LEFT - room).max(LEAST_PLOT.min(style.width() - LEFT - 10.0)),
        height: (beneath_grows - top - bottom).max(of_labels).max(LEAST_HEIGHT),
    };
    let size = (LEFT + frame.width + room, top + frame.height + bottom);
    let chart = |chart: &Chart| draw_one(chart, axes, (&frame, size), (&placing, style, headings));
    charts.iter().map(chart).collect()
}

fn draw_one(
    chart: &Chart,
    (x, y): &(Axis, Axis),
    (frame, whole): (&Frame, (f64, f64)),
    (placing, style, has_heading): (&Placing, &Style, bool),
) -> Scene {
    let mut marks = frame.axes((x, y));
    if let Some(heading) = chart.heading.as_ref().filter(|_| has_heading) {
        let at = (LEFT, TOP + 6.0);
        marks.push(text(at, heading, (TEXT + 1.0, Weight::SemiBold), INK, Anchor::Start).into());
    }
    if chart.lines.iter().all(|line| line.points.is_empty()) {
        let at = (frame.left + frame.width / 2.0, frame.top + frame.height / 2.0);
        let words = "no completed jobs yet";
        marks.push(text(at, words, (TEXT, Weight::Regular), FAINT, Anchor::Middle).into());
    }
    // Points are drawn above all lines. Filled points are drawn above hollow points, which are
    // larger, so that both are visible where they coincide.
    let of_each = chart.lines.iter().enumerate();
    let dodges = dodges(&chart.lines);
    marks.extend(of_each.clone().flat_map(|(series, line)| {
        line_marks(line, (x, y), frame, dodges[series]).into_iter().map(move |mark| mark.of(series))
    }));
    for hollow in [true, false] {
        let of_kind = of_each.clone().filter(|(_, line)| line.look.marker.is_hollow() == hollow);
        marks.extend(of_kind.flat_map(|(series, line)| {
            point_marks(line, (x, y), frame, dodges[series])
                .into_iter()
                .map(move |mark| mark.of(series))
        }));
    }
    marks.extend(match placing {
        Placing::Beside { is_crowded: true, .. } => beside(chart, (x, y), frame),
        Placing::Beside { is_crowded: false, .. } => end_labels(chart, (x, y), frame),
        Placing::Below { .. } => below(chart, style, frame.top + frame.height + BOTTOM + GAP - 3.0),
    });
    if style.has_titles() {
        let at = (whole.0 / 2.0, whole.1 - 5.0);
        marks.push(fitting(at, &chart.note, (NOTE, whole.0 - 8.0), FAINT).into());
    }
    let series = chart.lines.iter().map(|line| line.facets.clone()).collect();
    let ((width, height), description) = (whole, chart.description.clone());
    Scene { width, height, description, marks, series }
}

/// The horizontal shift of each line, so that intervals of several arms at one position stand side by side.
fn dodges(lines: &[Line]) -> Vec<f64> {
    /// Maximum distance between neighbouring lines, and between the first and the last line.
    const STEP: f64 = 2.4;
    const WHOLE: f64 = 8.0;
    let with_bars: Vec<usize> =
        (0..lines.len()).filter(|at| lines[*at].spread == Spread::Bars).collect();
    let mut places: Vec<f64> =
        with_bars.iter().flat_map(|at| &lines[*at].points).map(|point| point.x).collect();
    places.sort_by(f64::total_cmp);
    let mut dodges = vec![0.0; lines.len()];
    if places.windows(2).any(|pair| pair[0] == pair[1]) && with_bars.len() > 1 {
        let last = (with_bars.len() - 1) as f64;
        let step = STEP.min(WHOLE / last);
        for (rank, at) in with_bars.iter().enumerate() {
            dodges[*at] = (rank as f64 - last / 2.0) * step;
        }
    }
    dodges
}

fn line_marks(line: &Line, axes: (&Axis, &Axis), frame: &Frame, dodge: f64) -> Vec<Mark> {
    let mut marks = Vec::new();
    let color = line.look.color;
    let place = |x, y| frame.place(axes, (x, y));
    let reference: Vec<Point> = line.reference.iter().map(|(x, y)| place(*x, *y)).collect();
    if reference.len() > 1 {
        let stroke = Stroke { color, width: 0.8, dash: None, opacity: 0.65 };
        marks.push(Shape::Line { points: reference, stroke }.into());
    }
    if line.spread == Spread::Band {
        let banded = line.points.iter().filter_map(|point| Some((point.x, point.interval?)));
        let (mut upper, mut lower): (Vec<Point>, Vec<Point>) =
            banded.map(|(x, (low, high))| (place(x, high), place(x, low))).unzip();
        lower.reverse();
        upper.extend(lower);
        if upper.len() > 3 {
            let fill = Fill { color, opacity: 0.16 };
            marks.push(Shape::Area { points: upper, fill, stroke: None }.into());
        }
    }
    let moved = |(x, y): Point| (x + dodge, y);
    let points: Vec<(f64, f64)> = line.points.iter().map(|point| (point.x, point.y)).collect();
    if line.spread != Spread::Points {
        let width = match line.spread {
            Spread::Bars => 1.6,
            Spread::Band => 1.3,
            Spread::Points | Spread::Exact => 1.0,
        };
        let stroke = Stroke { color, width, dash: line.look.dash, opacity: 1.0 };
        for part in clipped(&points, axes.1.range) {
            let points = part.into_iter().map(|(x, y)| moved(place(x, y))).collect();
            marks.push(Shape::Line { points, stroke }.into());
        }
    }
    marks
}

/// The parts of a line between two heights; each part has at least two points.
fn clipped(points: &[(f64, f64)], (low, high): (f64, f64)) -> Vec<Vec<(f64, f64)>> {
    let mut parts: Vec<Vec<(f64, f64)>> = vec![Vec::new()];
    for pair in points.windows(2) {
        let ((x, y), (next_x, next_y)) = (pair[0], pair[1]);
        // The shares of the segment at which the line enters and leaves.
        let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
        let rise = next_y - y;
        for (wall, is_upper) in [(low, false), (high, true)] {
            let beyond = if is_upper { y - wall } else { wall - y };
            let towards = if is_upper { rise } else { -rise };
            match towards {
                0.0 if beyond > 0.0 => leave = -1.0,
                0.0 => {}
                towards if towards > 0.0 => leave = leave.min(-beyond / towards),
                towards => enter = enter.max(-beyond / towards),
            }
        }
        if enter > leave {
            parts.push(Vec::new());
            continue;
        }
        let at = |share: f64| match share {
            0.0 => (x, y),
            1.0 => (next_x, next_y),
            share => (x + share * (next_x - x), y + share * rise),
        };
        if let Some(part) = parts.last_mut() {
            if part.is_empty() {
                part.push(at(enter));
            }
            part.push(at(leave));
        }
        if leave < 1.0 {
            parts.push(Vec::new());
        }
    }
    parts.retain(|part| part.len() > 1);
    parts
}

/// The points of a line that are marked or have a tooltip. Intervals are drawn above the fill of
/// hollow marks, which would hide short intervals.
fn point_marks(line: &Line, axes: (&Axis, &Axis), frame: &Frame, dodge: f64) -> Vec<Mark> {
    let is_marked = matches!(line.spread, Spread::Bars | Spread::Points);
    let (low, high) = axes.1.range;
    let is_inside = |point: &&Place| (low..=high).contains(&point.y);
    let said = line.points.iter().filter(|point| is_marked || !point.tip.is_empty());
    let said = said.filter(is_inside);
    let place = |x, y| {
        let (across, down) = frame.place(axes, (x, y));
        (across + dodge, down)
    };
    let mark = |point: &Place| {
        let at = place(point.x, point.y);
        let shape = if is_marked {
            marker(at, &line.look, if line.look.marker.is_hollow() { 2.6 } else { 2.2 })
        } else {
            let fill = Fill { color: line.look.color, opacity: 0.0 };
            Shape::Circle { centre: at, radius: 3.0, fill, stroke: None }
        };
        let mark = Mark::from(shape);
        if point.tip.is_empty() { mark } else { mark.saying(&point.tip) }
    };
    let bar = |point: &Place| {
        let (low, high) = point.interval.filter(|_| line.spread == Spread::Bars)?;
        let points = vec![place(point.x, low), place(point.x, high)];
        let stroke = Stroke::solid(line.look.color, 1.0);
        Some(Mark::from(Shape::Line { points, stroke }))
    };
    said.flat_map(|point| std::iter::once(mark(point)).chain(bar(point))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::figure::{Look, Marker};
    use crate::report::scene::Facets;

    #[test]
    fn a_line_is_drawn_between_the_declared_ends_of_its_axis() {
        let line = [(0.0, 5.0), (1.0, 15.0), (2.0, 5.0), (3.0, -5.0)];
        let inside = [vec![(0.0, 5.0), (0.5, 10.0)], vec![(1.5, 10.0), (2.0, 5.0), (2.5, 0.0)]];
        assert_eq!(clipped(&line, (0.0, 10.0)), inside);
        assert_eq!(clipped(&line, (-5.0, 15.0)), [line.to_vec()]);
        assert!(clipped(&line, (20.0, 30.0)).is_empty());
    }

    #[test]
    fn intervals_of_several_arms_at_one_place_stand_beside_each_other() {
        let line = |xs: &[f64], spread| Line {
            label: String::new(),
            look: Look { color: INK, dash: None, marker: Marker::Ring },
            points: xs
                .iter()
                .map(|x| Place { x: *x, y: 0.0, interval: None, tip: String::new() })
                .collect(),
            reference: Vec::new(),
            spread,
            facets: Facets::new(),
        };
        let arm = |xs| line(xs, Spread::Bars);
        let exact = || line(&[1.0], Spread::Exact);
        assert_eq!(dodges(&[arm(&[1.0]), exact(), arm(&[1.0])]), [-1.2, 0.0, 1.2]);
        assert_eq!(dodges(&[arm(&[1.0]), arm(&[2.0])]), [0.0, 0.0]);
        assert_eq!(dodges(&[arm(&[1.0]), exact()]), [0.0, 0.0]);
        let many: Vec<Line> = (0..9).map(|_| arm(&[1.0])).collect();
        assert_eq!((dodges(&many)[0], dodges(&many)[8]), (-4.0, 4.0));
        assert_eq!(padded((0.0, 1.0), AxisScale::Linear), (-0.03, 1.03));
        let (low, high) = padded((1.0, 100.0), AxisScale::Log);
        assert!(low < 1.0 && low > 0.8 && high > 100.0 && high < 120.0);
    }
}
