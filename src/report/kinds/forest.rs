//! The figures of contrasts: forest plots around zero, with one row per comparison.

use super::{Sheet, gap_ends, gap_title, is_rate, related, test_name};
use crate::analyse::declared::{ArmId, ContrastRow, TestFamily};
use crate::job::Measure;
use crate::report::data_table::shown;
use crate::report::figure::{
    Axis, AxisScale, FAINT, GRID, INK, Look, Marker, NOTE, PUBLISHED, Panel, Panels, TEXT, facets,
    fitting, marker, note_lines, round_range, seeds, text,
};
use crate::report::names::Names;
use crate::report::scene::{Anchor, Mark, Scene, SceneShape, Stroke, Weight, width};
use crate::report::words::{NumberFormat, unit_numbers};

const TOP: f64 = 24.0;
const ROW: f64 = 15.0;
/// Maximum number of rows of a figure, which is then as high as a page.
pub(super) const MOST_ROWS: usize = 50;
/// Number of rows from which on the axis also has numbers at the top.
const MANY_ROWS: usize = 21;
/// Space below the rows for numbers and title.
const BOTTOM: f64 = 39.0;
/// Minimum width of the axis.
const LEAST_PLOT: f64 = 120.0;

/// The horizontal layout, the same in all panels.
struct Across {
    axis: Axis,
    left: f64,
    right: f64,
    whole: f64,
}

impl Across {
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
    let written: Vec<String> = rows.iter().map(|row| words(row, sheet.metric)).collect();
    let widest = |texts: &[String], size: f64| {
        texts.iter().map(|text| width(text, size, Weight::Regular)).fold(0.0, f64::max)
    };
    let left = (widest(&panels.labels, TEXT) + 12.0).max(44.0);
    let beside = widest(&written, NOTE) + 12.0;
    let right = (sheet.style.width() - beside).max(left + LEAST_PLOT);
    let across = Across { axis: axis(rows, sheet.metric), left, right, whole: right + beside };
    let figures = |(stem, panel): (String, &Panel)| -> Vec<(String, Scene)> {
        let parts = panel.members.chunks(MOST_ROWS).enumerate();
        let part = |(part, members): (usize, &[usize])| {
            let shown = members.iter();
            let shown =
                shown.map(|at| (&rows[*at], panels.labels[*at].as_str(), written[*at].as_str()));
            let scene = forest(&shown.collect::<Vec<_>>(), &panel.heading, &across, sheet);
            let stem = if part == 0 { stem.clone() } else { format!("{stem}-part-{}", part + 1) };
            (stem, scene)
        };
        parts.map(part).collect()
    };
    panels.stems(sheet.stem).into_iter().zip(&panels.panels).flat_map(figures).collect()
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

fn note(rows: &[(&ContrastRow, &str, &str)]) -> String {
    let compared = rows.iter().flat_map(|(row, ..)| <[usize; 2]>::from(row.contrast.seeds));
    let is_published = rows.iter().any(|(row, ..)| row.published.is_some());
    format!(
        "Difference, uncorrected 95 % interval{}{}, {} per side.{}",
        rows.first().map_or_else(String::new, |(row, ..)| family(row)),
        test_name(rows.iter().map(|(row, ..)| row.contrast.design))
            .map_or_else(String::new, |test| format!(", {test}")),
        seeds(compared.filter(|n| *n > 0)),
        if is_published { " Diamonds: published." } else { "" }
    )
}

fn forest(
    rows: &[(&ContrastRow, &str, &str)],
    heading: &str,
    across: &Across,
    &Sheet { metric, style, names, .. }: &Sheet<'_>,
) -> Scene {
    let Across { left, right, whole, .. } = *across;
    let has_upper = rows.len() >= MANY_ROWS;
    let top = if has_upper { TOP + TEXT + 3.0 } else { TOP };
    let note = match style.has_titles() {
        true => note_lines(&note(rows), whole - 8.0),
        false => Vec::new(),
    };
    let beside = top + BOTTOM + note.len() as f64 * style.note();
    let high = style.row(ROW, rows.len(), beside);
    let bottom = top + high * rows.len() as f64;
    let height = beside - top + bottom;
    let mut marks = ruler(across, (top, bottom), has_upper);
    if let Some((row, ..)) = rows.first().filter(|_| style.has_titles() || !heading.is_empty()) {
        let sides = sides(row, names).join(" − ");
        let heading = if heading.is_empty() { sides } else { format!("{heading}: {sides}") };
        let (size, weight) = (TEXT + 1.0, Weight::SemiBold);
        let room = width(&heading, size, weight);
        // Above the axis, moved left or made smaller if it would cross the edge.
        let from = left.min(whole - room - 4.0).max(4.0);
        let size = size * ((whole - from - 4.0) / room).min(1.0);
        marks.push(text((from, 15.0), heading, (size, weight), INK, Anchor::Start).into());
    }
    for (at, (row, label, words)) in rows.iter().enumerate() {
        let middle = top + high * (at as f64 + 0.5);
        let plain = (TEXT, Weight::Regular);
        let point = (left - 6.0, middle + TEXT * 0.35);
        let mut of_row: Vec<Mark> = vec![text(point, *label, plain, INK, Anchor::End).into()];
        let point = (whole - 4.0, middle + NOTE * 0.35);
        of_row.push(text(point, *words, (NOTE, Weight::Regular), INK, Anchor::End).into());
        of_row.extend(row_marks(row, label, middle, (across, metric)));
        marks.extend(of_row.into_iter().map(|mark| mark.of(at)));
    }
    for (at, line) in note.iter().rev().enumerate() {
        let point = (whole / 2.0, height - 5.0 - at as f64 * style.note());
        marks.push(fitting(point, line.trim_end(), (NOTE, whole - 8.0), FAINT).into());
    }
    let description = format!("differences in {}", metric.title());
    let series = rows.iter().map(|(row, ..)| facets(&names.arm(&row.name))).collect();
    debug_assert!(right < whole);
    Scene { width: whole, height, description, marks, series }
}

/// The axis of differences, with at least one tick on each side of zero.
fn axis(rows: &[ContrastRow], metric: Measure) -> Axis {
    let mut numbers = vec![0.0];
    for row in rows {
        numbers.extend(row.contrast.difference.ok());
        numbers.extend(row.published.map(|(effect, _)| effect));
        let interval = row.contrast.test.map(|test| test.interval);
        numbers.extend(interval.iter().flat_map(|interval| [interval.low, interval.high]));
    }
    numbers.retain(|number| number.is_finite());
    let low = numbers.iter().copied().fold(f64::INFINITY, f64::min);
    let high = numbers.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    // All differences may be 0.
    let (low, high) = if low < high { (low, high) } else { (-1.0, 1.0) };
    let title = match is_rate(metric) {
        true => gap_title(metric),
        false => format!("difference in {}", metric.title()),
    };
    let numbers = unit_numbers(metric).0;
    let mut axis = Axis::new(title, round_range(low, high), AxisScale::Linear, numbers);
    // A wider range may have wider steps.
    for _ in 0..3 {
        let (low, high) = axis.range();
        let step = axis.step(TICKS);
        axis = axis.with_range((low.min(-step), high.max(step)));
    }
    axis
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

fn row_marks(
    row: &ContrastRow,
    label: &str,
    middle: f64,
    (across, metric): (&Across, Measure),
) -> Vec<Mark> {
    /// Half the height of the end marks of an interval, which are visible beside the point even if
    /// the interval is short.
    const END: f64 = 4.0;
    let mut marks = Vec::new();
    let interval = row.contrast.test.ok().map(|test| test.interval);
    if let Some(interval) = interval {
        let (low, high) = (across.position(interval.low), across.position(interval.high));
        let mut line = |points, width| {
            marks.push(SceneShape::Line { points, stroke: Stroke::solid(INK, width) }.into());
        };
        line(vec![(low, middle), (high, middle)], 1.4);
        line(vec![(low, middle - END), (low, middle + END)], 0.9);
        line(vec![(high, middle - END), (high, middle + END)], 0.9);
    }
    if let Ok(difference) = row.contrast.difference {
        let spread = interval.map_or_else(String::new, |interval| {
            format!(", 95 % interval {}", gap_ends(interval, metric))
        });
        let (first, second) = row.contrast.seeds;
        let n = seeds([first, second].into_iter());
        let words = words(row, metric);
        let tip = format!("{label}: {words}{spread}, {n} per side");
        // A difference of single seeds is an open circle.
        let shape = if first.min(second) > 1 { Marker::Disc } else { Marker::Ring };
        let look = Look { color: INK, dash: None, marker: shape };
        marks.push(
            Mark::from(marker((across.position(difference), middle), &look, 2.4)).saying(tip),
        );
    }
    // Above our point, whose rim remains visible if both coincide.
    if let Some((effect, p)) = row.published {
        let look = Look { color: PUBLISHED, dash: None, marker: Marker::Diamond };
        let p = p.map_or_else(String::new, |p| format!(" (p = {p})"));
        let tip = format!("{label}: published {}{p}", shown(effect, 0));
        marks.push(Mark::from(marker((across.position(effect), middle), &look, 3.2)).saying(tip));
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

    #[test]
    fn a_number_stands_on_both_sides_of_zero() {
        let high = row(&[(1, 900.0), (2, 903.0)], &[(1, 1.0), (2, 2.0)]);
        let low = row(&[(1, 0.0), (2, 0.2)], &[(1, 0.31), (2, 0.5)]);
        for rows in [vec![high.clone()], vec![low.clone()], vec![high, low]] {
            let ticks = axis(&rows, RETURN).ticks(TICKS);
            let zero = ticks.iter().position(|tick| tick.is_zero).unwrap();
            assert!(0 < zero && zero + 1 < ticks.len(), "{ticks:?}");
        }
        let equal = row(&[(1, 900.0)], &[(1, 900.0)]);
        assert_eq!(axis(&[equal], RETURN).range(), (-1.0, 1.0));
    }

    #[test]
    fn the_end_of_a_line_has_the_difference_with_its_corrected_p() {
        let row = row(&[(1, 900.0), (2, 903.0)], &[(1, 1.0), (2, 2.0)]);
        assert_eq!(words(&row, RETURN), "900, p = 0.0001");
        let across = Across {
            axis: axis(std::slice::from_ref(&row), RETURN),
            left: 50.0,
            right: 250.0,
            whole: 321.0,
        };
        let marks = row_marks(&row, "dqn P", 100.0, (&across, RETURN));
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
