//! What figures are drawn with: axes, charts of lines, the looks of arms, letters.
//!
//! Scenes have the width of a journal's column, or more where labels need it. It does not know any
//! kind of analysis and does not compute statistics.

mod axis;
mod chart;
mod look;
mod room;

pub use axis::{Axis, AxisScale, round_range};
pub use chart::{Chart, Line, Place, Spread, axes, draw, marker, optimum_lines};
pub use look::{Look, Looks, Marker, arm_label, labels, settings_label};

use super::scene::{Anchor, Color, Direction, Point, Shape, Weight, width};
pub use super::words::Numbers;

/// Width of a figure: 85 mm, the column of a journal, at 96 units an inch. What needs more room for
/// its words is wider, not smaller.
pub(super) const WIDTH: f64 = 321.0;

/// Height of letters at axes and lines.
pub(super) const TEXT: f64 = 9.5;

/// Height of letters of notes.
pub(super) const NOTE: f64 = 8.0;

/// Of text and axes.
pub(super) const INK: Color = Color(34, 34, 34);

/// Of notes and grids.
pub(super) const FAINT: Color = Color(105, 105, 105);

/// Of published numbers beside ours: no arm has it.
pub(super) const PUBLISHED: Color = Color(150, 150, 150);

/// Of grid lines.
pub(super) const GRID: Color = Color(229, 229, 229);

/// A line of text that runs to the right.
pub(super) fn text(
    at: Point,
    words: impl Into<String>,
    (size, weight): (f64, Weight),
    color: Color,
    anchor: Anchor,
) -> Shape {
    let direction = Direction::Right;
    Shape::Text { at, text: words.into(), size, weight, color, anchor, direction, rim: None }
}

/// A line of text about a middle, smaller where it would not fit its room.
pub(super) fn fitting(
    at: Point,
    words: impl Into<String>,
    (size, room): (f64, f64),
    color: Color,
) -> Shape {
    let words = words.into();
    let size = fitted(&words, size, room);
    text(at, words, (size, Weight::Regular), color, Anchor::Middle)
}

fn fitted(words: &str, size: f64, room: f64) -> f64 {
    size * (room / width(words, size, Weight::Regular)).min(1.0)
}

/// The title of a vertical axis, upwards, with its middle at a point, in so much room.
pub(super) fn rising_title(at: Point, words: String, room: f64) -> Shape {
    let (weight, color, anchor) = (Weight::Regular, INK, Anchor::Middle);
    let size = fitted(&words, TEXT, room);
    let direction = Direction::Up;
    Shape::Text { at, text: words, size, weight, color, anchor, direction, rim: None }
}

/// How many seeds, in words: `n = 3 seeds`, or `n = 2–3 seeds` where they differ.
pub(super) fn seeds(counts: impl Iterator<Item = usize>) -> String {
    let counts: Vec<usize> = counts.collect();
    match (counts.iter().min(), counts.iter().max()) {
        (Some(1), Some(1)) => "n = 1 seed".to_owned(),
        (Some(least), Some(most)) if least == most => format!("n = {most} seeds"),
        (Some(least), Some(most)) => format!("n = {least}–{most} seeds"),
        _ => "no seeds".to_owned(),
    }
}
