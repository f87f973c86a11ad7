//! Elements of figures: axes, charts of lines, the looks of arms, text.
//!
//! Scenes have the width of a journal column, or more if labels need it. The module depends on no
//! kind of analysis and computes no statistics.

mod axis;
mod chart;
mod label;
mod line;
mod look;
mod optimum;
mod overlap;
mod panel;
mod room;
mod style;
mod ticks;

pub use axis::{Axis, AxisScale, round_range};
pub use chart::{axes, axes_of, draw};
pub use line::{Chart, Line, PlottedPoint, Spread, marker};
pub use look::{
    COLORS, DASHES, Look, Looks, Marker, arm_key, arm_label, facets, labels, settings_key,
    settings_label,
};
pub use optimum::optimum_lines;
pub use panel::{MOST_ARMS, Panel, Panels};
pub use style::Style;

use super::scene::{Anchor, Color, Direction, Point, SceneShape, Weight, width};
pub use super::words::NumberFormat;

/// Width of a figure: 85 mm, the column of a journal, at 96 units per inch. Figures whose text
/// needs more space are wider; their text is not smaller.
pub(super) const WIDTH: f64 = 321.0;

/// Height of letters at axes and lines.
pub(super) const TEXT: f64 = 9.5;

/// Height of letters of notes.
pub(super) const NOTE: f64 = 8.0;

/// Height of each further line of a heading.
pub(super) const LINE: f64 = 12.0;

/// Colour of text and axes.
pub(super) const INK: Color = Color(34, 34, 34);

/// Colour of notes and grids.
pub(super) const FAINT: Color = Color(105, 105, 105);

/// Colour reserved for published numbers.
pub(super) const PUBLISHED: Color = Color(150, 150, 150);

/// Colour of grid lines.
pub(super) const GRID: Color = Color(229, 229, 229);

/// A horizontal line of text.
pub(super) fn text(
    at: Point,
    words: impl Into<String>,
    (size, weight): (f64, Weight),
    color: Color,
    anchor: Anchor,
) -> SceneShape {
    let direction = Direction::Right;
    SceneShape::Text { at, text: words.into(), size, weight, color, anchor, direction, rim: None }
}

/// A centred line of text, in smaller letters if it would not fit its space.
pub(super) fn fitting(
    at: Point,
    words: impl Into<String>,
    (size, room): (f64, f64),
    color: Color,
) -> SceneShape {
    let words = words.into();
    let size = fitted(&words, size, room);
    text(at, words, (size, Weight::Regular), color, Anchor::Middle)
}

/// The lines of a note, broken between its clauses where it would not fit its space.
pub(super) fn note_lines(note: &str, room: f64) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for clause in note.split_inclusive(", ") {
        let longer = lines.last().map(|line| format!("{line}{clause}"));
        match longer.filter(|line| width(line.trim_end(), NOTE, Weight::Regular) <= room) {
            Some(longer) => *lines.last_mut().expect("it was made longer") = longer,
            None => lines.push(clause.to_owned()),
        }
    }
    lines
}

/// The lines of a heading, none wider than `room` unless it has a single word.
pub(super) fn heading_lines(heading: &str, room: f64) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in heading.split(' ') {
        let longer = lines.last().map(|line| format!("{line} {word}"));
        let fits = |line: &String| width(line, TEXT + 1.0, Weight::SemiBold) <= room;
        match (lines.last_mut(), longer.filter(fits)) {
            (Some(line), Some(longer)) => *line = longer,
            (_, _) => lines.push(word.to_owned()),
        }
    }
    lines
}

fn fitted(words: &str, size: f64, room: f64) -> f64 {
    size * (room / width(words, size, Weight::Regular)).min(1.0)
}

/// The title of a vertical axis, running upwards, centred at a point, in a space of length `room`.
pub(super) fn rising_title(at: Point, words: String, room: f64) -> SceneShape {
    let (weight, color, anchor) = (Weight::Regular, INK, Anchor::Middle);
    let size = fitted(&words, TEXT, room);
    let direction = Direction::Up;
    SceneShape::Text { at, text: words, size, weight, color, anchor, direction, rim: None }
}

/// The number of seeds in words: `n = 3 seeds`, or `n = 2–3 seeds` if counts differ.
pub(super) fn seeds(counts: impl Iterator<Item = usize>) -> String {
    let counts: Vec<usize> = counts.collect();
    match (counts.iter().min(), counts.iter().max()) {
        (Some(1), Some(1)) => "n = 1 seed".to_owned(),
        (Some(least), Some(most)) if least == most => format!("n = {most} seeds"),
        (Some(least), Some(most)) => format!("n = {least}–{most} seeds"),
        _ => "no seeds".to_owned(),
    }
}
