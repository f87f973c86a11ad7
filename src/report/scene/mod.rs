//! A drawing as plain data, and its three forms: SVG, PNG and PDF.
//!
//! In: marks placed in the drawing's own units. Out: text or bytes that depend only on the scene,
//! so that equal scenes make equal files. Text is measured and drawn with a font that is compiled
//! in, because a machine may have no fonts.
//!
//! The module does not depend on axes, arms or statistics.

mod compose;
mod font;
mod pdf;
mod png;
mod script;
mod svg;

pub use font::{Weight, is_drawn, web_font, width};
pub use pdf::pdf;
pub use png::png;
pub(crate) use script::{Level, runs};
pub use svg::{inline_svg, svg};

/// A drawing. Units are CSS pixels at printed size.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// Width.
    pub width: f64,
    /// Height.
    pub height: f64,
    /// Description of the drawing, for screen readers.
    pub description: String,
    /// The marks, later ones above earlier ones.
    pub marks: Vec<Mark>,
    /// The facets of each series of marks.
    pub series: Vec<Facets>,
}

/// Names and values, such as an agent and a scenario, by which a page shows and hides a series.
pub type Facets = Vec<(String, String)>;

/// A colour without transparency.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Color(pub u8, pub u8, pub u8);

/// A point, measured from the upper left corner.
pub type Point = (f64, f64);

/// The style of a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stroke {
    /// Colour.
    pub color: Color,
    /// Width.
    pub width: f64,
    /// Lengths of dash and gap; `None` for a solid line.
    pub dash: Option<(f64, f64)>,
    /// Opacity, from 0 (invisible) to 1.
    pub opacity: f64,
}

impl Stroke {
    /// A solid line.
    pub fn solid(color: Color, width: f64) -> Stroke {
        Stroke { color, width, dash: None, opacity: 1.0 }
    }
}

/// The fill of an area.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fill {
    /// Colour.
    pub color: Color,
    /// Opacity, from 0 (invisible) to 1.
    pub opacity: f64,
}

/// The point of a text to which its position refers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    /// Its beginning.
    Start,
    /// Its middle.
    Middle,
    /// Its end.
    End,
}

/// The direction of a text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// To the right.
    Right,
    /// Upwards.
    Up,
}

/// A drawn element.
#[derive(Clone, Debug, PartialEq)]
pub struct Mark {
    /// The shape.
    pub shape: SceneShape,
    /// The number of the series that it belongs to, by which a page shows and hides it.
    pub series: Option<usize>,
    /// The tooltip on the page.
    pub tip: Option<String>,
}

/// A shape with its style.
#[derive(Clone, Debug, PartialEq)]
pub enum SceneShape {
    /// Straight lines from point to point.
    Line {
        /// The points.
        points: Vec<Point>,
        /// The line.
        stroke: Stroke,
    },
    /// A filled area.
    Area {
        /// Its corners.
        points: Vec<Point>,
        /// The filling.
        fill: Fill,
        /// The line around it, if it has one.
        stroke: Option<Stroke>,
    },
    /// A circle.
    Circle {
        /// Its centre.
        centre: Point,
        /// Its radius.
        radius: f64,
        /// The filling.
        fill: Fill,
        /// The line around it, if it has one.
        stroke: Option<Stroke>,
    },
    /// A line of text.
    Text {
        /// Position of its anchor, on the baseline.
        at: Point,
        /// The text.
        text: String,
        /// Height of the letters with their ascenders and descenders.
        size: f64,
        /// Weight.
        weight: Weight,
        /// Colour.
        color: Color,
        /// The point of the text at `at`.
        anchor: Anchor,
        /// Direction.
        direction: Direction,
        /// The outline beneath its letters, if they have one.
        rim: Option<Stroke>,
    },
}

impl SceneShape {
    /// Its text, if it is one.
    fn written(&self) -> Option<&str> {
        match self {
            SceneShape::Text { text, .. } => Some(text),
            SceneShape::Line { .. } | SceneShape::Area { .. } | SceneShape::Circle { .. } => None,
        }
    }
}

impl From<SceneShape> for Mark {
    fn from(shape: SceneShape) -> Mark {
        Mark { shape, series: None, tip: None }
    }
}

impl Mark {
    /// The mark as part of a series.
    pub fn of(self, series: usize) -> Mark {
        Mark { series: Some(series), ..self }
    }

    /// The mark with a tooltip.
    pub fn saying(self, tip: impl Into<String>) -> Mark {
        Mark { tip: Some(tip.into()), ..self }
    }
}

/// The corners of a rectangle.
pub fn rectangle(left: f64, top: f64, width: f64, height: f64) -> Vec<Point> {
    let (right, bottom) = (left + width, top + height);
    vec![(left, top), (right, top), (right, bottom), (left, bottom)]
}

impl Color {
    /// White.
    pub const WHITE: Color = Color(255, 255, 255);

    /// The mixture of this colour with another, whose share is from 0 to 1.
    pub fn towards(self, other: Color, share: f64) -> Color {
        let share = share.clamp(0.0, 1.0);
        let mix = |from: u8, to: u8| {
            (f64::from(from) + (f64::from(to) - f64::from(from)) * share).round() as u8
        };
        Color(mix(self.0, other.0), mix(self.1, other.1), mix(self.2, other.2))
    }

    /// Perceived lightness, 0 to 1.
    pub fn lightness(self) -> f64 {
        (0.299 * f64::from(self.0) + 0.587 * f64::from(self.1) + 0.114 * f64::from(self.2)) / 255.0
    }
}
