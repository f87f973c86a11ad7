//! A scene as PNG.

use tiny_skia::{
    FillRule, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, Stroke as Pen, StrokeDash,
    Transform,
};
use ttf_parser::OutlineBuilder;

use super::font::{advance, glyph};
use super::{Anchor, Color, Direction, Fill, Point, Scene, Shape, Stroke, Weight, width};

/// Dots a unit: about 380 dots an inch at the width of a column.
const DOTS: f32 = 4.0;

/// The scene as the bytes of a PNG file; `None` for a scene without area.
pub fn png(scene: &Scene) -> Option<Vec<u8>> {
    let dots = |length: f64| (length as f32 * DOTS).ceil() as u32;
    let mut canvas = Pixmap::new(dots(scene.width), dots(scene.height))?;
    canvas.fill(tiny_skia::Color::WHITE);
    for mark in &scene.marks {
        match &mark.shape {
            Shape::Line { points, stroke } => {
                draw(&mut canvas, path(points, false), None, Some(stroke))
            }
            Shape::Area { points, fill, stroke } => {
                draw(&mut canvas, path(points, true), Some(fill), stroke.as_ref());
            }
            Shape::Circle { centre, radius, fill, stroke } => {
                let circle =
                    PathBuilder::from_circle(centre.0 as f32, centre.1 as f32, *radius as f32);
                draw(&mut canvas, circle, Some(fill), stroke.as_ref());
            }
            Shape::Text { at, text, size, weight, color, anchor, direction, rim } => {
                let written = letters(text, *size, *weight, *anchor);
                let (x, y) = (at.0 as f32, at.1 as f32);
                let turn = match direction {
                    Direction::Right => Transform::from_translate(x, y),
                    Direction::Up => Transform::from_rotate(-90.0).post_translate(x, y),
                };
                let written = written.and_then(|path| path.transform(turn));
                draw(&mut canvas, written.clone(), None, rim.as_ref());
                draw(&mut canvas, written, Some(&Fill { color: *color, opacity: 1.0 }), None);
            }
        }
    }
    canvas.encode_png().ok()
}

fn draw(canvas: &mut Pixmap, path: Option<Path>, fill: Option<&Fill>, stroke: Option<&Stroke>) {
    let Some(path) = path else { return };
    let scale = Transform::from_scale(DOTS, DOTS);
    if let Some(Fill { color, opacity }) = fill {
        canvas.fill_path(&path, &paint(*color, *opacity), FillRule::Winding, scale, None);
    }
    if let Some(Stroke { color, width, dash, opacity }) = stroke {
        let pen = Pen {
            width: *width as f32,
            line_cap: LineCap::Butt,
            line_join: LineJoin::Round,
            dash: dash.and_then(|(dash, gap)| StrokeDash::new(vec![dash as f32, gap as f32], 0.0)),
            ..Pen::default()
        };
        canvas.stroke_path(&path, &paint(*color, *opacity), &pen, scale, None);
    }
}

fn paint(Color(red, green, blue): Color, opacity: f64) -> Paint<'static> {
    let mut paint = Paint::default();
    paint.set_color_rgba8(red, green, blue, (opacity.clamp(0.0, 1.0) * 255.0).round() as u8);
    paint.anti_alias = true;
    paint
}

fn path(points: &[Point], closed: bool) -> Option<Path> {
    let mut builder = PathBuilder::new();
    for (at, (x, y)) in points.iter().enumerate() {
        match at {
            0 => builder.move_to(*x as f32, *y as f32),
            _ => builder.line_to(*x as f32, *y as f32),
        }
    }
    if closed {
        builder.close();
    }
    builder.finish()
}

/// The outlines of a text whose anchor stands at the origin.
fn letters(text: &str, size: f64, weight: Weight, anchor: Anchor) -> Option<Path> {
    let face = weight.face();
    let mut pen = match anchor {
        Anchor::Start => 0.0,
        Anchor::Middle => -width(text, size, weight) / 2.0,
        Anchor::End => -width(text, size, weight),
    };
    let scale = size / f64::from(face.units_per_em());
    let mut builder = PathBuilder::new();
    for character in text.chars() {
        let glyph = glyph(face, character);
        let mut outline = Outline { builder: &mut builder, left: pen as f32, scale: scale as f32 };
        face.outline_glyph(glyph, &mut outline);
        pen += advance(face, glyph) * size;
    }
    builder.finish()
}

/// Puts the outline of a glyph, whose y grows upwards, at its place.
struct Outline<'b> {
    builder: &'b mut PathBuilder,
    left: f32,
    scale: f32,
}

impl Outline<'_> {
    fn at(&self, x: f32, y: f32) -> (f32, f32) {
        (self.left + x * self.scale, -y * self.scale)
    }
}

impl OutlineBuilder for Outline<'_> {
    fn move_to(&mut self, x: f32, y: f32) {
        let (x, y) = self.at(x, y);
        self.builder.move_to(x, y);
    }

    fn line_to(&mut self, x: f32, y: f32) {
        let (x, y) = self.at(x, y);
        self.builder.line_to(x, y);
    }

    fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
        let ((x1, y1), (x, y)) = (self.at(x1, y1), self.at(x, y));
        self.builder.quad_to(x1, y1, x, y);
    }

    fn curve_to(&mut self, x1: f32, y1: f32, x2: f32, y2: f32, x: f32, y: f32) {
        let ((x1, y1), (x2, y2), (x, y)) = (self.at(x1, y1), self.at(x2, y2), self.at(x, y));
        self.builder.cubic_to(x1, y1, x2, y2, x, y);
    }

    fn close(&mut self) {
        self.builder.close();
    }
}
