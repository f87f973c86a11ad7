//! Lines before they are drawn, and the marks of their points.

use super::TEXT;
use super::look::{Look, Marker};
use crate::report::scene::{Color, Facets, Fill, Point, SceneShape, Stroke, rectangle};

/// Space left of the frame for numbers and title.
pub(super) const LEFT: f64 = 48.0;
/// Minimum width of the frame. Long labels widen the figure, or stand below it.
pub(super) const LEAST_PLOT: f64 = 160.0;
/// Minimum distance between labels. Many labels make a figure higher.
pub(super) const GAP: f64 = TEXT + 1.5;

/// A chart before it is drawn.
pub struct Chart {
    pub heading: Option<String>,
    pub description: String,
    pub lines: Vec<Line>,
    pub note: String,
}

impl Chart {
    /// The lines that have a label, with their numbers.
    pub(super) fn labelled(&self) -> impl Iterator<Item = (usize, &Line)> {
        self.lines.iter().enumerate().filter(|(_, line)| !line.label.is_empty())
    }
}

/// A line of a chart.
pub struct Line {
    /// Its label; empty for one of many lines that a note describes together.
    pub label: String,
    pub look: Look,
    pub points: Vec<PlottedPoint>,
    /// The published line, as x and y.
    pub reference: Vec<(f64, f64)>,
    pub spread: Spread,
    /// The facets of its arm.
    pub facets: Facets,
}

#[cfg(test)]
impl Line {
    /// A line through these points.
    pub fn through(points: impl IntoIterator<Item = (f64, f64)>, spread: Spread) -> Line {
        Line {
            label: "arm".to_owned(),
            look: Look { color: super::INK, dash: None, marker: Marker::Disc },
            points: points
                .into_iter()
                .map(|(x, y)| PlottedPoint { x, y, ..PlottedPoint::default() })
                .collect(),
            reference: Vec::new(),
            spread,
            facets: Facets::new(),
        }
    }
}

/// The display of a line and its intervals.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Spread {
    /// Marked points with intervals as bars.
    Bars,
    /// A line with intervals as a band.
    Band,
    /// Marked points without line or intervals.
    Points,
    /// A line without marks or intervals, for exact values.
    Exact,
    /// A thin line across to compare with, which may be close to other lines: it has no stripes.
    Level,
}

/// A point of a line.
#[derive(Default)]
pub struct PlottedPoint {
    pub x: f64,
    pub y: f64,
    pub interval: Option<(f64, f64)>,
    /// Whether it has the value of a single seed.
    pub is_single: bool,
    pub tip: String,
}

/// Half the length of the dash that stands for a line with a single point.
pub(super) const ALONE: f64 = 7.0;

/// The mark of a single seed: the outline of the arm's mark, larger and without fill.
pub(super) fn single(at: Point, look: &Look) -> SceneShape {
    let look = match look.marker {
        Marker::Disc | Marker::Ring => Look { marker: Marker::Ring, ..*look },
        Marker::Square | Marker::Diamond => Look { marker: Marker::Diamond, ..*look },
    };
    marker(at, &look, 3.4)
}

/// The mark of a point.
pub fn marker(at: Point, look: &Look, radius: f64) -> SceneShape {
    let solid = Fill { color: look.color, opacity: 1.0 };
    let white = Fill { color: Color::WHITE, opacity: 1.0 };
    let rim = Some(Stroke::solid(look.color, 1.3));
    let (x, y) = at;
    match look.marker {
        Marker::Disc => SceneShape::Circle { centre: at, radius, fill: solid, stroke: None },
        Marker::Ring => SceneShape::Circle { centre: at, radius, fill: white, stroke: rim },
        Marker::Square => SceneShape::Area {
            points: rectangle(x - radius, y - radius, 2.0 * radius, 2.0 * radius),
            fill: solid,
            stroke: None,
        },
        Marker::Diamond => SceneShape::Area {
            points: vec![(x, y - radius), (x + radius, y), (x, y + radius), (x - radius, y)],
            fill: white,
            stroke: rim,
        },
    }
}
