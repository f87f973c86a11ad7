//! Forest plots: one row per number, with its interval; those of contrasts are around zero.

use super::{Sheet, gap_ends, gap_title, is_rate, related, test_name};
use crate::analyse::Interval;
use crate::analyse::declared::{ArmId, ContrastRow, TestFamily};
use crate::job::Measure;
use crate::report::data_table::shown;
use crate::report::figure::{
    Axis, AxisScale, FAINT, GRID, INK, Look, Marker, NOTE, PUBLISHED, Panel, Panels, Style, TEXT,
    facets, fitting, marker, note_lines, round_range, seeds, text,
};
use crate::report::names::Names;
use crate::report::scene::{Anchor, Facets, Mark, Scene, SceneShape, Stroke, Weight, width};
use crate::report::words::{NumberFormat, unit_numbers};

const TOP: f64 = 24.0;
/// [`TOP`] of a figure without a heading.
const UNTITLED: f64 = 8.0;
const ROW: f64 = 15.0;
/// Maximum number of rows of a figure, which is then as high as a page.
pub(super) const MOST_ROWS: usize = 50;
/// Number of rows from which on the axis also has numbers at the top.
const MANY_ROWS: usize = 21;
/// Space below the rows for numbers and title.
const BOTTOM: f64 = 39.0;
/// Minimum width of the axis.
const LEAST_PLOT: f64 = 120.0;

/// A row: a number with its interval, and what stands beside it.
pub(super) struct ForestRow {
    pub label: String,
    /// The words at the end of the line.
    pub words: String,
    pub value: Option<f64>,
    pub interval: Option<Interval>,
    pub marker: Marker,
    pub tip: String,
    /// The published number, with the tip of its mark.
    pub published: Option<(f64, String)>,
    pub facets: Facets,
}

impl ForestRow {
    /// The numbers that an axis shows.
    fn numbers(&self) -> impl Iterator<Item = f64> {
        let ends = self.interval.map(|ends| [ends.low, ends.high]);
        let published = self.published.as_ref().map(|(number, _)| *number);
        self.value.into_iter().chain(published).chain(ends.into_iter().flatten())
    }
}

/// The words around the rows of a forest plot; a heading and a note may be empty.
pub(super) struct ForestWords {
    pub heading: String,
    pub note: String,
    pub description: String,
}

/// The horizontal layout, the same in all panels.
pub(super) struct Across {
    axis: Axis,
    left: f64,
    right: f64,
    whole: f64,
}

impl Across {
    /// The layout of rows in a figure of this style.
    pub(super) fn of(axis: Axis, rows: &[ForestRow], style: &Style) -> Across {
        let widest = |text: fn(&ForestRow) -> &String, size: f64| {
            let widths = rows.iter().map(|row| width(text(row), size, Weight::Regular));
            widths.fold(0.0, f64::max)
        };
        let left = (widest(|row| &row.label, TEXT) + 12.0).max(44.0);
        let beside = widest(|row| &row.words, NOTE) + 12.0;
        let right = (style.width() - beside).max(left + LEAST_PLOT);
        Across { axis, left, right, whole: right + beside }
    }

    fn position(&self, value: f64) -> f64 {
        self.left + self.axis.share(value).clamp(0.0, 1.0) * (self.right - self.left)
    }
}

/// The rows of a contrast, with one figure per panel.
pub(super) fn forest_figures(rows: &[ContrastRow], sheet: &Sheet<'_>) -> Vec<(String, Scene)> {
    let arms = sheet.names.arms(rows.iter().map(|row| &row.name));
    let names: Vec<&ArmId> = arms.iter().collect();
    let panels = match sheet.style.panel {
        Some(_) => Panels::of(&names, sheet.style.panel, None),
        None => Panels::whole(&names),
    };
    let drawn: Vec<ForestRow> = rows
        .iter()
        .zip(&panels.labels)
        .map(|(row, label)| forest_row(row, label, (sheet.metric, sheet.names)))
        .collect();
    let across = Across::of(axis(&drawn, sheet.metric), &drawn, sheet.style);
    let figures = |(stem, panel): (String, &Panel)| -> Vec<(String, Scene)> {
        let parts = panel.members.chunks(MOST_ROWS).enumerate();
        let part = |(part, members): (usize, &[usize])| {
            let of_part: Vec<&ContrastRow> = members.iter().map(|at| &rows[*at]).collect();
            let shown: Vec<&ForestRow> = members.iter().map(|at| &drawn[*at]).collect();
            let heading = match of_part.first() {
                Some(row) if sheet.style.has_titles() || !panel.heading.is_empty() => {
                    let sides = sides(row, sheet.names).join(" − ");
                    match panel.heading.as_str() {
                        "" => sides,
                        heading => format!("{heading}: {sides}"),
                    }
                }
                _ => String::new(),
            };
            let words = ForestWords {
                heading,
                note: note(&of_part),
                description: format!("differences in {}", sheet.metric.title()),
            };
            let stem = if part == 0 { stem.clone() } else { format!("{stem}-part-{}", part + 1) };
            (stem, forest(&shown, &words, &across, sheet.style))
        };
        parts.map(part).collect()
    };
    panels.stems(sheet.stem).into_iter().zip(&panels.panels).flat_map(figures).collect()
}

/// A comparison as a row.
fn forest_row(row: &ContrastRow, label: &str, (metric, names): (Measure, &Names)) -> ForestRow {
    let words = words(row, metric);
    let interval = row.contrast.test.ok().map(|test| test.interval);
    let spread = interval.map_or_else(String::new, |interval| {
        format!(", 95 % interval {}", gap_ends(interval, metric))
    });
    let (first, second) = row.contrast.seeds;
    let n = seeds([first, second].into_iter());
    let tip = format!("{label}: {words}{spread}, {n} per side");
    let published = row.published.map(|(effect, p)| {
        let p = p.map_or_else(String::new, |p| format!(" (p = {p})"));
        (effect, format!("{label}: published {}{p}", shown(effect, 0)))
    });
    ForestRow {
        label: label.to_owned(),
        words,
        value: row.contrast.difference.ok(),
        interval,
        // A difference of single seeds is an open circle.
        marker: if first.min(second) > 1 { Marker::Disc } else { Marker::Ring },
        tip,
        published,
        facets: facets(&names.arm(&row.name)),
    }
}

/// The difference of a row with its corrected p value, for the end of its line.
fn words(row: &ContrastRow, metric: Measure) -> String {
    let Ok(difference) = row.contrast.difference else { return "–".to_owned() };
    let difference = match unit_numbers(metric) {
        (NumberFormat::Percent, decimals) => format!("{} pp", shown(difference * 100.0, decimals)),
        (NumberFormat::Plain, decimals) => shown(difference, decimals),
    };
    match row.corrected {
        Ok(p) => format!("{difference}, p {}", related(p.holm)),
        Err(_) => match row.contrast.seeds.0.min(row.contrast.seeds.1) {
            1 => format!("{difference}, n = 1"),
            _ => format!("{difference}, no p"),
        },
    }
}

/// The family of a row: ", Holm-corrected p (family f of 24 tests)"; without a number for a family of one test.
fn family(row: &ContrastRow) -> String {
    let TestFamily { name, members } = &row.family;
    match members {
        0 | 1 => ", p".to_owned(),
        _ => format!(", Holm-corrected p (family {name} of {members} tests)"),
    }
}

fn note(rows: &[&ContrastRow]) -> String {
    let compared = rows.iter().flat_map(|row| <[usize; 2]>::from(row.contrast.seeds));
    let is_published = rows.iter().any(|row| row.published.is_some());
    format!(
        "Difference, uncorrected 95 % interval{}{}, {} per side.{}",
        rows.first().map_or_else(String::new, |row| family(row)),
        test_name(rows.iter().map(|row| row.contrast.design))
            .map_or_else(String::new, |test| format!(", {test}")),
        seeds(compared.filter(|n| *n > 0)),
        if is_published { " Diamonds: published." } else { "" }
    )
}

/// A figure of rows.
pub(super) fn forest(
    rows: &[&ForestRow],
    words: &ForestWords,
    across: &Across,
    style: &Style,
) -> Scene {
    let Across { left, right, whole, .. } = *across;
    let has_upper = rows.len() >= MANY_ROWS;
    let top = if words.heading.is_empty() { UNTITLED } else { TOP };
    let top = if has_upper { top + TEXT + 3.0 } else { top };
    let note = match style.has_titles() {
        true => note_lines(&words.note, whole - 8.0),
        false => Vec::new(),
    };
    let beside = top + BOTTOM + note.len() as f64 * style.note();
    let high = style.row(ROW, rows.len(), beside);
    let bottom = top + high * rows.len() as f64;
    let height = beside - top + bottom;
    let mut marks = ruler(across, (top, bottom), has_upper);
    if !words.heading.is_empty() {
        let heading = words.heading.as_str();
        let (size, weight) = (TEXT + 1.0, Weight::SemiBold);
        let room = width(heading, size, weight);
        // Above the axis, moved left or made smaller if it would cross the edge.
        let from = left.min(whole - room - 4.0).max(4.0);
        let size = size * ((whole - from - 4.0) / room).min(1.0);
        marks.push(text((from, 15.0), heading, (size, weight), INK, Anchor::Start).into());
    }
    for (at, row) in rows.iter().enumerate() {
        let middle = top + high * (at as f64 + 0.5);
        let plain = (TEXT, Weight::Regular);
        let point = (left - 6.0, middle + TEXT * 0.35);
        let mut of_row: Vec<Mark> =
            vec![text(point, row.label.as_str(), plain, INK, Anchor::End).into()];
        let point = (whole - 4.0, middle + NOTE * 0.35);
        let plain = (NOTE, Weight::Regular);
        of_row.push(text(point, row.words.as_str(), plain, INK, Anchor::End).into());
        of_row.extend(row_marks(row, middle, across));
        marks.extend(of_row.into_iter().map(|mark| mark.of(at)));
    }
    for (at, line) in note.iter().rev().enumerate() {
        let point = (whole / 2.0, height - 5.0 - at as f64 * style.note());
        marks.push(fitting(point, line.trim_end(), (NOTE, whole - 8.0), FAINT).into());
    }
    let series = rows.iter().map(|row| row.facets.clone()).collect();
    debug_assert!(right < whole);
    Scene { width: whole, height, description: words.description.clone(), marks, series }
}

/// The axis of differences.
fn axis(rows: &[ForestRow], metric: Measure) -> Axis {
    let title = match is_rate(metric) {
        true => gap_title(metric),
        false => format!("difference in {}", metric.title()),
    };
    axis_around_zero(rows, title, unit_numbers(metric).0)
}

/// An axis of rows with at least one tick on each side of zero.
pub(super) fn axis_around_zero(rows: &[ForestRow], title: String, numbers: NumberFormat) -> Axis {
    // All numbers may be 0.
    let range = ends(rows, Some(0.0)).filter(|(low, high)| low < high).unwrap_or((-1.0, 1.0));
    let mut axis = Axis::new(title, round_range(range.0, range.1), AxisScale::Linear, numbers);
    // A wider range may have wider steps.
    for _ in 0..3 {
        let (low, high) = axis.range();
        let step = axis.step(TICKS);
        axis = axis.with_range((low.min(-step), high.max(step)));
    }
    axis
}

/// The smallest and the largest number of the rows and of `more`, finite ones alone; `None` if there is none.
pub(super) fn ends(rows: &[ForestRow], more: Option<f64>) -> Option<(f64, f64)> {
    let numbers = rows.iter().flat_map(ForestRow::numbers).chain(more);
    let finite = numbers.filter(|number| number.is_finite());
    finite.fold(None, |ends, number| {
        let (low, high) = ends.unwrap_or((number, number));
        Some((number.min(low), number.max(high)))
    })
}

/// Maximum number of ticks.
const TICKS: usize = 4;

fn ruler(across: &Across, (top, bottom): (f64, f64), has_upper: bool) -> Vec<Mark> {
    let Across { axis, left, right, whole } = across;
    let mut marks = Vec::new();
    for tick in axis.ticks_along(right - left, TICKS) {
        let x = left + tick.share * (right - left);
        let stroke =
            if tick.is_zero { Stroke::solid(FAINT, 1.0) } else { Stroke::solid(GRID, 0.6) };
        marks.push(SceneShape::Line { points: vec![(x, top), (x, bottom)], stroke }.into());
        if has_upper {
            let at = (x, top - 4.0);
            let label = text(at, &tick.label, (TEXT, Weight::Regular), FAINT, Anchor::Middle);
            marks.push(label.into());
        }
        let at = (x, bottom + 4.0 + TEXT);
        marks.push(text(at, tick.label, (TEXT, Weight::Regular), FAINT, Anchor::Middle).into());
    }
    // Centred under the axis, moved if it would cross an edge of the figure.
    let title = axis.title();
    let half = width(&title, TEXT, Weight::Regular) / 2.0;
    let middle = ((left + right) / 2.0).min(whole - 4.0 - half).max(half + 4.0);
    let at = (middle, bottom + 7.0 + 2.0 * TEXT);
    marks.push(fitting(at, title, (TEXT, whole - 8.0), INK).into());
    marks
}

fn row_marks(row: &ForestRow, middle: f64, across: &Across) -> Vec<Mark> {
    /// Half the height of the end marks of an interval, which are visible beside the point even if
    /// the interval is short.
    const END: f64 = 4.0;
    let mut marks = Vec::new();
    if let Some(interval) = row.interval {
        let (low, high) = (across.position(interval.low), across.position(interval.high));
        let mut line = |points, width| {
            marks.push(SceneShape::Line { points, stroke: Stroke::solid(INK, width) }.into());
        };
        line(vec![(low, middle), (high, middle)], 1.4);
        line(vec![(low, middle - END), (low, middle + END)], 0.9);
        line(vec![(high, middle - END), (high, middle + END)], 0.9);
    }
    let mut point = |number: f64, (color, shape), radius, tip: &String| {
        let look = Look { color, dash: None, marker: shape };
        let mark = Mark::from(marker((across.position(number), middle), &look, radius));
        marks.push(mark.saying(tip.clone()));
    };
    if let Some(value) = row.value {
        point(value, (INK, row.marker), 2.4, &row.tip);
    }
    // Above our point, whose rim remains visible if both coincide.
    if let Some((number, tip)) = &row.published {
        point(*number, (PUBLISHED, Marker::Diamond), 3.2, tip);
    }
    marks
}

/// The sides of a row as they are displayed.
pub(super) fn sides(row: &ContrastRow, names: &Names) -> [String; 2] {
    [&row.sides.0, &row.sides.1].map(|side| names.words(side, row.name.agent.is_empty()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analyse::{Corrected, Sample, SeedPairing};
    use crate::job::metric::MEAN_RETURN;

    fn row(first: &[(u64, f64)], second: &[(u64, f64)]) -> ContrastRow {
        let sample = |values: &[(u64, f64)]| Sample::new(values.iter().copied(), 0, 0).unwrap();
        ContrastRow {
            corrected: Ok(Corrected { holm: 0.0001, benjamini_hochberg: 0.1 }),
            ..ContrastRow::between(sample(first), sample(second), SeedPairing::Independent)
        }
    }

    const RETURN: Measure = MEAN_RETURN.in_unit("points");

    fn drawn(rows: &[ContrastRow]) -> Vec<ForestRow> {
        let draw = |row| forest_row(row, "dqn P", (RETURN, &Names::default()));
        rows.iter().map(draw).collect()
    }

    #[test]
    fn a_number_stands_on_both_sides_of_zero() {
        let high = row(&[(1, 900.0), (2, 903.0)], &[(1, 1.0), (2, 2.0)]);
        let low = row(&[(1, 0.0), (2, 0.2)], &[(1, 0.31), (2, 0.5)]);
        for rows in [vec![high.clone()], vec![low.clone()], vec![high, low]] {
            let ticks = axis(&drawn(&rows), RETURN).ticks(TICKS);
            let zero = ticks.iter().position(|tick| tick.is_zero).unwrap();
            assert!(0 < zero && zero + 1 < ticks.len(), "{ticks:?}");
        }
        let equal = row(&[(1, 900.0)], &[(1, 900.0)]);
        assert_eq!(axis(&drawn(&[equal]), RETURN).range(), (-1.0, 1.0));
    }

    #[test]
    fn the_end_of_a_line_has_the_difference_with_its_corrected_p() {
        let row = row(&[(1, 900.0), (2, 903.0)], &[(1, 1.0), (2, 2.0)]);
        assert_eq!(words(&row, RETURN), "900, p = 0.0001");
        let rows = drawn(&[row]);
        let across = Across { axis: axis(&rows, RETURN), left: 50.0, right: 250.0, whole: 321.0 };
        let marks = row_marks(&rows[0], 100.0, &across);
        // An interval of ±20 steps on an axis of more than 1000: its end marks are higher than the point.
        let ends = marks.iter().filter(|mark| match &mark.shape {
            SceneShape::Line { points, .. } => {
                points[0].0 == points[1].0 && points[1].1 - points[0].1 == 8.0
            }
            SceneShape::Area { .. } | SceneShape::Circle { .. } | SceneShape::Text { .. } => false,
        });
        assert_eq!(ends.count(), 2);
        let tip = marks.iter().find_map(|mark| mark.tip.clone()).unwrap();
        assert!(tip.contains("95 % interval 880 to 920, n = 2 seeds per side"), "{tip}");
    }

    #[test]
    fn a_long_note_is_broken_between_clauses_and_keeps_its_size() {
        let note = "Difference, uncorrected 95 % interval, Holm-corrected p (family gain of 4 tests), t test \
                    paired by seed, n = 3 seeds per side.";
        let lines = note_lines(note, 313.0);
        assert_eq!(lines.concat(), note);
        assert_eq!(lines.len(), 2, "{lines:?}");
        for line in &lines {
            assert!(width(line.trim_end(), NOTE, Weight::Regular) <= 313.0, "{line}");
        }
        assert_eq!(note_lines("A clause, another", 10.0), ["A clause, ", "another"]);
    }
}
