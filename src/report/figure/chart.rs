//! Lines along an axis, with intervals: one chart per panel, all with the same axes.

use super::NumberFormat;
use super::axis::{Axis, AxisScale, Frame, HEIGHT_TICKS, round_range, tick_width};
use super::label::{Placing, below, beside, end_labels, placing};
use super::line::{
    ALONE, Chart, GAP, LEAST_PLOT, LEFT, Line, PlottedPoint, Spread, marker, single,
};
use super::overlap::{dodges, widenings};
use super::style::Style;
use super::{FAINT, INK, LINE, NOTE, TEXT, fitting, heading_lines, text};
use crate::job::Measure;
use crate::report::scene::{
    Anchor, Color, Fill, Mark, Point, Scene, SceneShape, Stroke, Weight, width,
};
use crate::report::words::unit_numbers;

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
    (x_title, x_numbers, scale): (String, NumberFormat, AxisScale),
    metric: Measure,
    style: &Style,
) -> (Axis, Axis) {
    axes_of(charts, (x_title, x_numbers, scale), (metric.title(), unit_numbers(metric).0), style)
}

/// [`axes`] of lines that show something else than a metric: with the title and the numbers of the vertical axis.
pub fn axes_of(
    charts: &[Chart],
    (x_title, x_numbers, scale): (String, NumberFormat, AxisScale),
    (y_title, y_numbers): (String, NumberFormat),
    style: &Style,
) -> (Axis, Axis) {
    let lines = || charts.iter().flat_map(|chart| &chart.lines);
    let points = || lines().flat_map(|line| &line.points);
    let references = || lines().flat_map(|line| &line.reference);
    let xs = points().map(|point| point.x).chain(references().map(|at| at.0));
    let xs: Vec<f64> = xs.filter(|x| x.is_finite()).collect();
    let ys = points()
        .flat_map(|point| [point.y, point.interval.map_or(point.y, |(_, high)| high)])
        .chain(references().map(|at| at.1));
    let high = ys.filter(|y| y.is_finite()).fold(f64::NEG_INFINITY, f64::max);
    let lows = points().map(|point| point.interval.map_or(point.y, |(low, _)| low.min(point.y)));
    let low = lows.filter(|y| y.is_finite()).fold(0.0, f64::min);
    let (low, high) = round_range(low, if high.is_finite() { high } else { 1.0 });
    let cap = if y_numbers == NumberFormat::Percent { 1.0 } else { f64::INFINITY };
    let low = style.limits.0.unwrap_or(low);
    let high = style.limits.1.unwrap_or(high.min(cap));
    // A declared end may lie beyond the other end.
    let high = if high > low { high } else { low + high.abs().max(low.abs()).max(1.0) };
    let y = Axis::new(y_title, (low, high), AxisScale::Linear, y_numbers);
    let x = match scale {
        AxisScale::Log => Axis::logarithmic(x_title, &xs, x_numbers),
        AxisScale::Linear => Axis::new(x_title, ends(&xs), AxisScale::Linear, x_numbers),
    };
    let has_marks = lines().any(|line| line.spread == Spread::Bars);
    (if has_marks { x.padded().with_marked(xs) } else { x }, y)
}

/// The smallest and the largest number; infinite if there are none.
fn ends(numbers: &[f64]) -> (f64, f64) {
    let ends = (f64::INFINITY, f64::NEG_INFINITY);
    numbers.iter().fold(ends, |(low, high), number| (low.min(*number), high.max(*number)))
}

/// The charts, drawn with these axes. All charts have the same size, and all frames have the same size.
pub fn draw(charts: &[Chart], axes: &(Axis, Axis), style: &Style) -> Vec<Scene> {
    // Labels of the vertical axis stand between its title and the frame.
    const TITLE: f64 = 20.0;
    let labels = axes.1.ticks(HEIGHT_TICKS);
    let left = labels.iter().map(|tick| TITLE + tick_width(tick)).fold(LEFT, f64::max);
    let placing = placing(charts, (style, left));
    let has_heading = |chart: &Chart| chart.heading.is_some();
    let headings = charts.iter().any(has_heading) && (charts.len() > 1 || style.has_titles());
    let (room, beneath) = match placing {
        Placing::Beside { room, .. } => (room, 0.0),
        Placing::Below { rows, .. } => (14.0, rows as f64 * GAP + 2.0),
    };
    let bottom = BOTTOM + style.note() + beneath;
    let of_labels = match placing {
        Placing::Beside { .. } => {
            GAP * charts.iter().map(|chart| chart.labelled().count()).max().unwrap_or(0) as f64
        }
        Placing::Below { .. } => LEAST_HEIGHT,
    };
    let across =
        |room: f64| (style.width() - left - room).max(LEAST_PLOT.min(style.width() - left - 10.0));
    // The last label of the horizontal axis may stand half beyond the frame.
    let last = Frame::ticks_across(&axes.0, across(room)).pop();
    let over = last.map_or(0.0, |tick| tick_width(&tick) / 2.0 - (1.0 - tick.share) * across(room));
    let room = room.max(over + 3.0);
    let over = across(room) + room - 4.0;
    let lines = charts.iter().filter_map(|chart| chart.heading.as_ref().filter(|_| headings));
    let further = lines.map(|heading| heading_lines(heading, over).len() - 1).max().unwrap_or(0);
    let further = further as f64 * LINE;
    let top = TOP + further + if headings { HEADING } else { 0.0 };
    let high = style.height(HEIGHT + beneath + further);
    let frame = Frame {
        left,
        top,
        width: across(room),
        height: (high - top - bottom).max(of_labels).max(LEAST_HEIGHT),
    };
    let size = (left + frame.width + room, top + frame.height + bottom);
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
        let (room, weight) = (whole.0 - frame.left - 4.0, Weight::SemiBold);
        for (line, words) in heading_lines(heading, room).into_iter().enumerate() {
            let at = (frame.left, TOP + 6.0 + line as f64 * LINE);
            let size = (TEXT + 1.0) * (room / width(&words, TEXT + 1.0, weight)).min(1.0);
            marks.push(text(at, words, (size, weight), INK, Anchor::Start).into());
        }
    }
    if chart.lines.iter().all(|line| line.points.is_empty()) {
        let at = (frame.left + frame.width / 2.0, frame.top + frame.height / 2.0);
        let words = "nothing to draw yet";
        marks.push(text(at, words, (TEXT, Weight::Regular), FAINT, Anchor::Middle).into());
    }
    // Points are drawn above all lines. Filled points are drawn above hollow points, which are
    // larger, so that both are visible where they coincide.
    let of_each = chart.lines.iter().enumerate();
    let placed: Vec<Vec<Point>> = of_each
        .clone()
        .map(|(_, line)| {
            line.points.iter().map(|at| frame.position((x, y), (at.x, at.y))).collect()
        })
        .collect();
    let (dodges, wider) = (dodges(&chart.lines), widenings(&chart.lines, &placed));
    marks.extend(of_each.clone().flat_map(|(series, line)| {
        let marks = line_marks(line, (x, y), frame, (dodges[series], wider[series]));
        marks.into_iter().map(move |mark| mark.of(series))
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
        Placing::Beside { is_crowded: false, .. } => end_labels(chart, (x, y), (frame, &dodges)),
        Placing::Below { size, .. } => {
            below(chart, style, (frame.top + frame.height + BOTTOM + GAP - 3.0, *size))
        }
    });
    if style.has_titles() {
        let at = (whole.0 / 2.0, whole.1 - 5.0);
        let are_stripes = wider.iter().any(Option::is_some);
        let stripes = if are_stripes { " Lines on one another: stripes." } else { "" };
        let note = format!("{}{stripes}", chart.note);
        marks.push(fitting(at, note, (NOTE, whole.0 - 8.0), FAINT).into());
    }
    let series = chart.lines.iter().map(|line| line.facets.clone()).collect();
    let ((width, height), description) = (whole, chart.description.clone());
    Scene { width, height, description, marks, series }
}

/// How much wider than a line the white below it is.
const CASING: f64 = 1.2;

fn line_marks(
    line: &Line,
    axes: (&Axis, &Axis),
    frame: &Frame,
    (right, wider): (f64, Option<f64>),
) -> Vec<Mark> {
    let mut marks = Vec::new();
    let color = line.look.color;
    let position = |x, y| frame.position(axes, (x, y));
    let reference: Vec<Point> = line.reference.iter().map(|(x, y)| position(*x, *y)).collect();
    if reference.len() > 1 {
        let stroke = Stroke { color, width: 0.8, dash: None, opacity: 0.65 };
        marks.push(SceneShape::Line { points: reference, stroke }.into());
    }
    if line.spread == Spread::Band {
        let banded = line.points.iter().filter_map(|point| Some((point.x, point.interval?)));
        let (mut upper, mut lower): (Vec<Point>, Vec<Point>) =
            banded.map(|(x, (low, high))| (position(x, high), position(x, low))).unzip();
        lower.reverse();
        upper.extend(lower);
        if upper.len() > 3 {
            let fill = Fill { color, opacity: 0.16 };
            marks.push(SceneShape::Area { points: upper, fill, stroke: None }.into());
        }
    }
    let moved = |(x, y): Point| (x + right, y);
    let points: Vec<(f64, f64)> = line.points.iter().map(|point| (point.x, point.y)).collect();
    if line.spread != Spread::Points {
        let width = match line.spread {
            Spread::Bars => 1.6,
            Spread::Band => 1.3,
            Spread::Points | Spread::Exact | Spread::Level => 1.0,
        };
        let stroke = Stroke {
            color,
            width: width + wider.unwrap_or(0.0),
            dash: line.look.dash,
            opacity: 1.0,
        };
        // What separates a line from a wider one below it, whatever their colours.
        let casing = wider.map(|_| Stroke::solid(Color::WHITE, stroke.width + CASING));
        for part in clipped(&points, axes.1.range()) {
            let points: Vec<Point> = part.into_iter().map(|(x, y)| moved(position(x, y))).collect();
            let casing =
                casing.map(|stroke| SceneShape::Line { points: points.clone(), stroke }.into());
            marks.extend(casing);
            marks.push(SceneShape::Line { points, stroke }.into());
        }
        // A labelled line with a single point is drawn as a dash. The points of other lines have marks.
        let (low, high) = axes.1.range();
        if let ([(at, height)], Spread::Exact) = (points.as_slice(), line.spread)
            && !line.label.is_empty()
            && (low..=high).contains(height)
        {
            let (x, y) = moved(position(*at, *height));
            let points = vec![(x - ALONE, y), (x + ALONE, y)];
            marks.push(SceneShape::Line { points, stroke }.into());
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
fn point_marks(line: &Line, axes: (&Axis, &Axis), frame: &Frame, right: f64) -> Vec<Mark> {
    let is_marked = matches!(line.spread, Spread::Bars | Spread::Points);
    let (low, high) = axes.1.range();
    let is_inside = |point: &&PlottedPoint| (low..=high).contains(&point.y);
    let said = line.points.iter().filter(|point| is_marked || !point.tip.is_empty());
    let said = said.filter(is_inside);
    let position = |x, y| {
        let at = frame.position(axes, (x, y));
        (at.0 + right, at.1)
    };
    let mark = |point: &PlottedPoint| {
        let at = position(point.x, point.y);
        let shape = if is_marked && point.is_single {
            single(at, &line.look)
        } else if is_marked {
            marker(at, &line.look, if line.look.marker.is_hollow() { 2.6 } else { 2.2 })
        } else {
            let fill = Fill { color: line.look.color, opacity: 0.0 };
            SceneShape::Circle { centre: at, radius: 3.0, fill, stroke: None }
        };
        let mark = Mark::from(shape);
        if point.tip.is_empty() { mark } else { mark.saying(&point.tip) }
    };
    let is_mixed = line.points.iter().any(|point| !point.is_single);
    let number = |point: &PlottedPoint| {
        let is_said = is_marked && point.is_single && is_mixed;
        let (x, y) = position(point.x, point.y);
        is_said.then(|| {
            text((x + 4.5, y - 3.0), "n = 1", (NOTE, Weight::Regular), FAINT, Anchor::Start).into()
        })
    };
    let bar = |point: &PlottedPoint| {
        let (low, high) = point.interval.filter(|_| line.spread == Spread::Bars)?;
        let points = vec![position(point.x, low), position(point.x, high)];
        let stroke = Stroke::solid(line.look.color, 1.0);
        Some(Mark::from(SceneShape::Line { points, stroke }))
    };
    let marks = |point| std::iter::once(mark(point)).chain(bar(point)).chain(number(point));
    said.flat_map(marks).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::metric::MEAN_RETURN;
    use std::slice;

    use crate::manifest::FigureKeys;
    use crate::report::figure::Look;
    use crate::report::scene::Direction;

    #[test]
    fn a_line_is_drawn_between_the_declared_ends_of_its_axis() {
        let line = [(0.0, 5.0), (1.0, 15.0), (2.0, 5.0), (3.0, -5.0)];
        let inside = [vec![(0.0, 5.0), (0.5, 10.0)], vec![(1.5, 10.0), (2.0, 5.0), (2.5, 0.0)]];
        assert_eq!(clipped(&line, (0.0, 10.0)), inside);
        assert_eq!(clipped(&line, (-5.0, 15.0)), [line.to_vec()]);
        assert!(clipped(&line, (20.0, 30.0)).is_empty());
    }

    #[test]
    fn a_long_heading_stays_within_its_panel() {
        let words = "A policy gradient with baseline and entropy bonus, tuned by hand on ten seeds";
        let chart = |heading: &str| Chart {
            heading: Some(heading.to_owned()),
            description: String::new(),
            lines: Vec::new(),
            note: String::new(),
        };
        let charts = [chart(words), chart(&"w".repeat(100)), chart("short")];
        let style = Style::of(&FigureKeys::default());
        let axis = ("x".to_owned(), NumberFormat::Plain, AxisScale::Linear);
        let axes = axes(&charts, axis, MEAN_RETURN.in_unit("points"), &style);
        let scenes = draw(&charts, &axes, &style);
        for scene in &scenes {
            for mark in &scene.marks {
                if let SceneShape::Text { at, text, size, weight: Weight::SemiBold, .. } =
                    &mark.shape
                {
                    let end = at.0 + width(text, *size, Weight::SemiBold);
                    assert!(end <= scene.width, "{text} ends at {end} of {}", scene.width);
                }
            }
        }
        let lines = |scene: &Scene| {
            let headings = scene.marks.iter().filter(|mark| {
                matches!(&mark.shape, SceneShape::Text { weight: Weight::SemiBold, .. })
            });
            headings.count()
        };
        assert!(lines(&scenes[0]) > 1 && lines(&scenes[2]) == 1);
        assert!(scenes.iter().all(|scene| scene.height == scenes[0].height));
    }

    /// A figure of lines with a note.
    fn drawn(lines: Vec<Line>, note: &str) -> Scene {
        let (heading, description, note) = (None, String::new(), note.to_owned());
        let chart = Chart { heading, description, lines, note };
        let style = Style::of(&FigureKeys::default());
        let axis = ("x".to_owned(), NumberFormat::Plain, AxisScale::Linear);
        let axes = axes(slice::from_ref(&chart), axis, MEAN_RETURN.in_unit("points"), &style);
        draw(slice::from_ref(&chart), &axes, &style).remove(0)
    }

    #[test]
    fn identical_lines_of_two_arms_are_both_seen() {
        let line = |dash| {
            let line = Line::through([0.0, 1.0, 2.0].map(|x| (x, 5.0)), Spread::Bars);
            Line { look: Look { dash, ..line.look }, ..line }
        };
        let scene = drawn(vec![line(None), line(Some((5.0, 2.5)))], "n = 3.");
        let lines = |series: usize| -> Vec<(f64, f64)> {
            let of_series = scene.marks.iter().filter(|mark| mark.series == Some(series));
            let lines = of_series.filter_map(|mark| match &mark.shape {
                SceneShape::Line { points, stroke } if points.len() == 3 => {
                    Some((stroke.width, points[0].1))
                }
                _ => None,
            });
            lines.collect()
        };
        // White and line; the second line is within the first one, at the same height.
        let (first, second) = (lines(0), lines(1));
        assert_eq!((first.len(), second.len()), (2, 2));
        assert!(first[1].0 > second[0].0 && second[0].0 > second[1].0, "{first:?} {second:?}");
        assert_eq!(first[1].1, second[1].1);
        let has = |words: &str| {
            scene.marks.iter().any(|mark| match &mark.shape {
                SceneShape::Text { text, .. } => text.contains(words),
                _ => false,
            })
        };
        assert!(has("n = 3. Lines on one another: stripes."));
    }

    #[test]
    fn an_optimum_at_one_point_is_seen() {
        let line = |xs: &[f64], spread| Line::through(xs.iter().map(|x| (*x, 5.0)), spread);
        let lines = vec![line(&[0.0, 1.0], Spread::Bars), line(&[1.0], Spread::Exact)];
        let scene = drawn(lines, "");
        let of_optimum = scene.marks.iter().filter(|mark| mark.series == Some(1));
        let mut shown = of_optimum.filter_map(|mark| match &mark.shape {
            SceneShape::Line { points, .. } => Some(points),
            _ => None,
        });
        let points = shown.next().expect("a short line");
        assert_eq!((points[1].0 - points[0].0, points[1].1), (2.0 * ALONE, points[0].1));
    }

    #[test]
    fn the_label_of_an_optimum_at_one_point_stands_behind_its_dash() {
        let low = || Line::through([0.0, 1.0].map(|x| (x, 1.0)), Spread::Bars);
        let optimum = |y: f64| Line {
            label: "optimum".to_owned(),
            ..Line::through([(0.0, y)], Spread::Exact)
        };
        let drawn_at = |y: f64| {
            let scene = drawn(vec![low(), optimum(y)], "");
            let of_optimum = scene.marks.iter().filter(|mark| mark.series == Some(1));
            let (mut dash, mut label) = (None, None);
            for mark in of_optimum {
                match &mark.shape {
                    SceneShape::Line { points, .. } => dash = Some(points[1]),
                    SceneShape::Text { at, .. } => label = Some(*at),
                    _ => {}
                }
            }
            (dash.unwrap(), label.unwrap())
        };
        let (dash, label) = drawn_at(5.0);
        assert!(label.0 > dash.0 && (label.1 - dash.1).abs() < TEXT, "{dash:?} {label:?}");
        // A line runs there.
        let (dash, label) = drawn_at(1.0);
        assert!((label.1 - dash.1).abs() > TEXT, "{dash:?} {label:?}");
    }

    #[test]
    fn every_label_of_large_numbers_is_inside_the_figure() {
        let line = |scale: f64| {
            let mut line = Line::through([1.0, 2.0].map(|x| (x * scale, -x * scale)), Spread::Bars);
            let interval = Some((-scale, f64::INFINITY));
            line.points.iter_mut().for_each(|point| point.interval = interval);
            line
        };
        for scale in [1e-300, 1e-7, 0.1, 1e5, 333_333.0, 1e6, 1e7, 1e300] {
            let scene = drawn(vec![line(scale)], "");
            let mut numbers = 0;
            for mark in &scene.marks {
                let SceneShape::Text { at, text, size, weight, anchor, direction, .. } =
                    &mark.shape
                else {
                    continue;
                };
                let wide = width(text, *size, *weight);
                let left = match anchor {
                    Anchor::Start => at.0,
                    Anchor::Middle => at.0 - wide / 2.0,
                    Anchor::End => at.0 - wide,
                };
                // The title of the vertical axis reaches from 3 to 14.
                let least = if *anchor == Anchor::End { 15.0 } else { 0.0 };
                numbers += usize::from(*anchor == Anchor::End);
                let is_inside = left >= least && left + wide <= scene.width;
                assert!(*direction == Direction::Up || is_inside, "{scale}: {text}");
            }
            assert!(numbers >= 2, "{scale}");
        }
    }
}
