//! Lines along an axis, with intervals, labelled where they end.

use super::Numbers;
use super::axis::{Axis, AxisScale, Frame, round_range};
use super::look::{Look, Looks, Marker, labels};
use super::room::{free_height, spread_out};
use super::{FAINT, INK, NOTE, TEXT, WIDTH, fitting, text};
use crate::analyse::declared::ArmId;
use crate::report::data_table::shown;
use crate::report::scene::{
    Anchor, Color, Fill, Mark, Point, Scene, Shape, Stroke, Weight, rectangle, width,
};
use crate::report::words::metric_title;

const HEIGHT: f64 = 236.0;
const TOP: f64 = 12.0;
const HEADING: f64 = 14.0;
const LEFT: f64 = 48.0;
/// Room below the frame: numbers, title, note.
const BOTTOM: f64 = 46.0;
/// Width of the frame, at least; long labels make a figure wider.
const LEAST_PLOT: f64 = 160.0;
/// From label to label, at least; many make a figure higher.
const GAP: f64 = TEXT + 1.5;
/// Labels that find room above the ends of lines that end early; more stand beside the frame.
const MOST_INSIDE: usize = 3;
/// Room of a sample of a line, before its label.
const SAMPLE: f64 = 20.0;

/// A chart before it is drawn.
pub struct Chart {
    pub heading: Option<String>,
    pub description: String,
    pub axes: (Axis, Axis),
    pub lines: Vec<Line>,
    pub note: String,
}

/// A line of a chart.
pub struct Line {
    pub label: String,
    pub look: Look,
    pub points: Vec<Place>,
    /// The same published, as x and y.
    pub reference: Vec<(f64, f64)>,
    pub spread: Spread,
}

/// How a line shows its intervals.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Spread {
    /// As bars at marked points.
    Bars,
    /// As a band.
    Band,
    /// Marked points without a line, which have none.
    Points,
    /// A line without marks, which is exact.
    Exact,
}

/// A point of a line.
pub struct Place {
    pub x: f64,
    pub y: f64,
    pub interval: Option<(f64, f64)>,
    pub tip: String,
}

/// Lines of the best mean return that any policy can reach, none twice; where there are several,
/// their labels say of what.
pub fn optimum_lines<'n>(
    optima: impl Iterator<Item = (&'n ArmId, Vec<(f64, f64)>)>,
    looks: &Looks,
) -> Vec<Line> {
    // Whatever the agent is, the optimum is the same; agents may have it at different places.
    let (mut names, mut of_names): (Vec<ArmId>, Vec<Optimum>) = (Vec::new(), Vec::new());
    for (name, points) in optima.filter(|(_, points)| !points.is_empty()) {
        let mut of = ArmId { agent: String::new(), ..name.clone() };
        of.settings.retain(|(key, _)| !key.starts_with("agent."));
        if let Some(at) = names.iter().position(|known| *known == of) {
            of_names[at].points.extend(points);
            continue;
        }
        names.push(of);
        of_names.push(Optimum { labels: Vec::new(), look: looks.of_optimum(name), points });
    }
    // Names whose optimum is the same share a line.
    let mut distinct: Vec<Optimum> = Vec::new();
    for (mut one, label) in of_names.into_iter().zip(labels(&names.iter().collect::<Vec<_>>())) {
        one.points.sort_by(|one, other| one.0.total_cmp(&other.0));
        one.points.dedup_by_key(|(x, _)| *x);
        match distinct.iter_mut().find(|known| known.points == one.points) {
            Some(known) => known.labels.push(label),
            None => distinct.push(Optimum { labels: vec![label], ..one }),
        }
    }
    let is_alone = distinct.len() == 1;
    distinct.into_iter().map(|optimum| optimum.line(is_alone)).collect()
}

/// A line of the optimum, before it is drawn.
struct Optimum {
    /// Of what it is the optimum.
    labels: Vec<String>,
    look: Look,
    points: Vec<(f64, f64)>,
}

impl Optimum {
    fn line(self, is_alone: bool) -> Line {
        let label = match self.labels.as_slice() {
            [one] if !is_alone => format!("optimum {one}"),
            [one, other] if !is_alone => format!("optimum {one}, {other}"),
            [one, others @ ..] if !is_alone => format!("optimum {one} and {} more", others.len()),
            _ => "optimum".to_owned(),
        };
        let of = self.labels.join(", ");
        let place = |(x, y): &(f64, f64)| {
            let tip = format!("optimum {of}: {}", shown(*y, 0));
            Place { x: *x, y: *y, interval: None, tip }
        };
        Line {
            label,
            look: self.look,
            points: self.points.iter().map(place).collect(),
            reference: Vec::new(),
            spread: Spread::Exact,
        }
    }
}

/// The axes of lines of a metric: the horizontal one as it is named, both with round ends.
pub fn axes(
    lines: &[Line],
    (x_title, x_numbers, scale): (String, Numbers, AxisScale),
    (metric, y_numbers): (&str, Numbers),
) -> (Axis, Axis) {
    let points = || lines.iter().flat_map(|line| &line.points);
    let references = || lines.iter().flat_map(|line| &line.reference);
    let xs = points().map(|point| point.x).chain(references().map(|at| at.0));
    let (left, right) =
        xs.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, r), x| (l.min(x), r.max(x)));
    let ys = points()
        .flat_map(|point| [point.y, point.interval.map_or(point.y, |(_, high)| high)])
        .chain(references().map(|at| at.1));
    let high = ys.fold(f64::NEG_INFINITY, f64::max);
    let low = points().map(|point| point.y).fold(0.0, f64::min);
    let (left, right) = if left < right { (left, right) } else { (0.0, 1.0) };
    let low_x =
        if scale == AxisScale::Linear && left > 0.0 && left < right / 2.0 { 0.0 } else { left };
    let (low, high) = round_range(low, if high.is_finite() { high } else { 1.0 });
    let cap = if y_numbers == Numbers::Percent { 1.0 } else { f64::INFINITY };
    let y = Axis {
        title: metric_title(metric),
        range: (low, high.min(cap).max(low + 1e-9)),
        scale: AxisScale::Linear,
        numbers: y_numbers,
    };
    let has_marks = lines.iter().any(|line| line.spread == Spread::Bars);
    let range = if has_marks { padded((low_x, right), scale) } else { (low_x, right) };
    (Axis { title: x_title, range, scale, numbers: x_numbers }, y)
}

/// Ends of an axis a little beyond the first and the last point, whose marks would lie on numbers.
fn padded((low, high): (f64, f64), scale: AxisScale) -> (f64, f64) {
    const PART: f64 = 0.03;
    match scale {
        AxisScale::Linear => (low - PART * (high - low), high + PART * (high - low)),
        AxisScale::Log => (low / (high / low).powf(PART), high * (high / low).powf(PART)),
    }
}

/// The chart, drawn.
pub fn draw(chart: &Chart) -> Scene {
    let (x, y) = (&chart.axes.0, &chart.axes.1);
    let wide = |line: &Line| width(&line.label, TEXT, Weight::SemiBold);
    let room = chart.lines.iter().map(wide).fold(0.0, f64::max) + 12.0;
    let room = room + if is_crowded(chart) { SAMPLE } else { 0.0 };
    let top = TOP + if chart.heading.is_some() { HEADING } else { 0.0 };
    let of_labels = GAP * chart.lines.len() as f64;
    let frame = Frame {
        left: LEFT,
        top,
        width: (WIDTH - LEFT - room).max(LEAST_PLOT),
        height: (HEIGHT - top - BOTTOM).max(of_labels),
    };
    let whole = (LEFT + frame.width + room, top + frame.height + BOTTOM);
    let mut marks = frame.axes((x, y));
    if let Some(heading) = &chart.heading {
        let at = (LEFT, TOP + 6.0);
        marks.push(text(at, heading, (TEXT + 1.0, Weight::SemiBold), INK, Anchor::Start).into());
    }
    if chart.lines.iter().all(|line| line.points.is_empty()) {
        let at = (frame.left + frame.width / 2.0, frame.top + frame.height / 2.0);
        let words = "no completed jobs yet";
        marks.push(text(at, words, (TEXT, Weight::Regular), FAINT, Anchor::Middle).into());
    }
    // Points lie on the lines of all, hollow ones below filled ones, which are smaller: where one of
    // each meet, both are seen.
    let of_each = chart.lines.iter().enumerate();
    let dodges = dodges(&chart.lines);
    marks.extend(of_each.clone().flat_map(|(series, line)| {
        line_marks(line, (x, y), &frame, dodges[series])
            .into_iter()
            .map(move |mark| mark.of(series))
    }));
    for hollow in [true, false] {
        let of_kind = of_each.clone().filter(|(_, line)| line.look.marker.is_hollow() == hollow);
        marks.extend(of_kind.flat_map(|(series, line)| {
            point_marks(line, (x, y), &frame, dodges[series])
                .into_iter()
                .map(move |mark| mark.of(series))
        }));
    }
    marks.extend(end_labels(chart, &frame));
    let at = (whole.0 / 2.0, whole.1 - 5.0);
    marks.push(fitting(at, &chart.note, (NOTE, whole.0 - 8.0), FAINT).into());
    let (width, height) = whole;
    Scene { width, height, description: chart.description.clone(), marks }
}

/// How far each line is moved to the right, so that intervals of several arms at one place stand
/// beside each other.
fn dodges(lines: &[Line]) -> Vec<f64> {
    /// From line to line, and from the first to the last of many.
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
    let points: Vec<Point> =
        line.points.iter().map(|point| moved(place(point.x, point.y))).collect();
    if points.len() > 1 && line.spread != Spread::Points {
        let width = match line.spread {
            Spread::Bars => 1.6,
            Spread::Band => 1.3,
            Spread::Points | Spread::Exact => 1.0,
        };
        let stroke = Stroke { color, width, dash: line.look.dash, opacity: 1.0 };
        marks.push(Shape::Line { points, stroke }.into());
    }
    marks
}

/// The points of a line: where they are marked, and where they say something. Intervals lie above
/// what fills a hollow mark, which would hide short ones.
fn point_marks(line: &Line, axes: (&Axis, &Axis), frame: &Frame, dodge: f64) -> Vec<Mark> {
    let is_marked = matches!(line.spread, Spread::Bars | Spread::Points);
    let said = line.points.iter().filter(|point| is_marked || !point.tip.is_empty());
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

/// The mark of a point.
pub fn marker(at: Point, look: &Look, radius: f64) -> Shape {
    let solid = Fill { color: look.color, opacity: 1.0 };
    let white = Fill { color: Color::WHITE, opacity: 1.0 };
    let rim = Some(Stroke::solid(look.color, 1.3));
    let (x, y) = at;
    match look.marker {
        Marker::Disc => Shape::Circle { centre: at, radius, fill: solid, stroke: None },
        Marker::Ring => Shape::Circle { centre: at, radius, fill: white, stroke: rim },
        Marker::Square => Shape::Area {
            points: rectangle(x - radius, y - radius, 2.0 * radius, 2.0 * radius),
            fill: solid,
            stroke: None,
        },
        Marker::Diamond => Shape::Area {
            points: vec![(x, y - radius), (x + radius, y), (x, y + radius), (x - radius, y)],
            fill: white,
            stroke: rim,
        },
    }
}

/// Whether more lines end early than can be labelled there.
fn is_crowded(chart: &Chart) -> bool {
    let last = |line: &Line| line.points.last().map(|point| point.x);
    let farthest = chart.lines.iter().filter_map(last).fold(f64::NEG_INFINITY, f64::max);
    let early = chart.lines.iter().filter_map(last).filter(|x| *x < farthest);
    early.count() > MOST_INSIDE
}

/// The labels of the lines at their ends, moved apart where they would overlap: beside the frame,
/// with a hair to their line where they were moved far; above or below the end of a line that ends
/// early. If many do, all stand beside the frame, each with a sample of its line.
fn end_labels(chart: &Chart, frame: &Frame) -> Vec<Mark> {
    let axes = (&chart.axes.0, &chart.axes.1);
    let right = frame.left + frame.width;
    let is_crowded = is_crowded(chart);
    let mut ends: Vec<(usize, Point, f64)> = Vec::new();
    let mut inside: Vec<(usize, Point, f64)> = Vec::new();
    for (series, line) in chart.lines.iter().enumerate() {
        if let Some(last) = line.points.last() {
            let end = frame.place(axes, (last.x, last.y));
            match end.0 < right - 40.0 && !is_crowded {
                true => inside.push((series, end, inside_height(chart, frame, series, end))),
                false => ends.push((series, end, end.1)),
            }
        }
    }
    for list in [&mut ends, &mut inside] {
        list.sort_by(|one, other| one.2.total_cmp(&other.2));
        spread_out(list, GAP, (frame.top, frame.top + frame.height));
    }
    let label = |series: usize, at: Point, rim: Option<Stroke>| {
        let line = &chart.lines[series];
        // Light colours are hard to read as letters.
        let darker = if line.look.color.lightness() > 0.5 { 0.35 } else { 0.0 };
        let color = line.look.color.towards(INK, darker);
        let looks = (TEXT, Weight::SemiBold);
        let mut letters = text(at, &line.label, looks, color, Anchor::Start);
        if let Shape::Text { rim: of_letters, .. } = &mut letters {
            *of_letters = rim;
        }
        Mark::from(letters).of(series)
    };
    // Letters stand out from the lines and bands that they lie on.
    let white = Some(Stroke::solid(Color::WHITE, 2.5));
    let mut marks: Vec<Mark> = inside
        .into_iter()
        .map(|(series, end, height)| {
            let (left, _) = inside_label(&chart.lines[series], frame, end);
            label(series, (left, height + TEXT * 0.35), white)
        })
        .collect();
    for (series, end, height) in ends {
        if is_crowded {
            let Look { color, dash, .. } = chart.lines[series].look;
            let points = vec![(right + 6.0, height), (right + SAMPLE, height)];
            let stroke = Stroke { color, width: 1.3, dash, opacity: 1.0 };
            marks.push(Mark::from(Shape::Line { points, stroke }).of(series));
            marks.push(label(series, (right + 6.0 + SAMPLE, height + TEXT * 0.35), None));
            continue;
        }
        if (height - end.1).abs() > TEXT {
            let color = chart.lines[series].look.color;
            let stroke = Stroke { color, width: 0.5, dash: None, opacity: 0.6 };
            let points = vec![(end.0 + 3.0, end.1), (right + 5.0, height)];
            marks.push(Mark::from(Shape::Line { points, stroke }).of(series));
        }
        marks.push(label(series, (right + 6.0, height + TEXT * 0.35), None));
    }
    marks
}

/// The left and right end of the label of a line that ends early, which stands before its end.
fn inside_label(line: &Line, frame: &Frame, end: Point) -> (f64, f64) {
    let wide = width(&line.label, TEXT, Weight::SemiBold);
    let left = (end.0 - wide).max(frame.left + 3.0);
    (left, left + wide)
}

/// The height at which the label of a line that ends early lies on no other line.
fn inside_height(chart: &Chart, frame: &Frame, series: usize, end: Point) -> f64 {
    let axes = (&chart.axes.0, &chart.axes.1);
    let others = chart.lines.iter().enumerate().filter(|(other, _)| *other != series);
    let place = |line: &Line| -> Vec<Point> {
        line.points.iter().map(|point| frame.place(axes, (point.x, point.y))).collect()
    };
    let others: Vec<Vec<Point>> = others.map(|(_, line)| place(line)).collect();
    let limits = (frame.top + TEXT / 2.0, frame.top + frame.height - TEXT / 2.0);
    free_height(&others, inside_label(&chart.lines[series], frame, end), end.1, limits)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::manifest::Setting;

    #[test]
    fn optima_that_are_the_same_share_a_line_and_names_have_one() {
        let name = |agent: &str, scenario: &str, sigma: f64| ArmId {
            agent: agent.into(),
            scenario: scenario.into(),
            settings: vec![
                ("agent.layers".into(), Setting::Text("[64]".into())),
                ("environment.sigma".into(), Setting::Number(sigma)),
            ],
        };
        let (dqn, reinforce) = (name("dqn", "P-H-D", 0.6), name("reinforce", "P-H-D", 0.6));
        let (blind, noisier) = (name("dqn", "H-D", 0.6), name("dqn", "H-D", 1.0));
        let optima = [
            // Two agents at different places.
            (&dqn, vec![(2.0, 90.0), (3.0, 80.0)]),
            (&reinforce, vec![(1.0, 95.0), (3.0, 80.0)]),
            // Who sees no context is as well off whatever sigma is.
            (&blind, vec![(1.0, 40.0)]),
            (&noisier, vec![(1.0, 40.0)]),
        ];
        let looks = Looks::of(optima.iter().map(|(name, _)| *name));
        let lines = optimum_lines(optima.clone().into_iter(), &looks);
        let labels: Vec<&str> = lines.iter().map(|line| line.label.as_str()).collect();
        assert_eq!(labels, ["optimum P-H-D sigma=0.6", "optimum H-D sigma=0.6, H-D sigma=1"]);
        let places: Vec<(f64, f64)> = lines[0].points.iter().map(|p| (p.x, p.y)).collect();
        assert_eq!(places, [(1.0, 95.0), (2.0, 90.0), (3.0, 80.0)]);
        let alone = optimum_lines(optima.into_iter().take(2), &looks);
        assert_eq!(alone.len(), 1);
        assert_eq!(alone[0].label, "optimum");
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
