//! A scene as PNG.

use skrifa::outline::OutlinePen;
use tiny_skia::{
    FillRule, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, Stroke as Pen, StrokeDash,
    Transform,
};

use super::font::Letter;
use super::script::runs;
use super::{Anchor, Color, Direction, Fill, Point, Scene, SceneShape, Stroke, Weight, width};

/// Dots per unit: 384 dots per inch.
const DOTS: f32 = 4.0;

/// The scene as the bytes of a PNG file; `None` for a scene without area.
pub fn png(scene: &Scene) -> Option<Vec<u8>> {
    let dots = |length: f64| (length as f32 * DOTS).ceil() as u32;
    let mut canvas = Pixmap::new(dots(scene.width), dots(scene.height))?;
    canvas.fill(tiny_skia::Color::WHITE);
    for mark in &scene.marks {
        match &mark.shape {
            SceneShape::Line { points, stroke } => {
                draw(&mut canvas, path(points, false), None, Some(stroke))
            }
            SceneShape::Area { points, fill, stroke } => {
                draw(&mut canvas, path(points, true), Some(fill), stroke.as_ref());
            }
            SceneShape::Circle { centre, radius, fill, stroke } => {
                let circle =
                    PathBuilder::from_circle(centre.0 as f32, centre.1 as f32, *radius as f32);
                draw(&mut canvas, circle, Some(fill), stroke.as_ref());
            }
            SceneShape::Text { at, text, size, weight, color, anchor, direction, rim } => {
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
    canvas.encode_png().ok().map(with_resolution)
}

/// The chunk that sets the physical size of the picture, with its checksum: DOTS dots per unit of
/// 1/96 inch are 15118 dots per metre in both directions (PNG, third edition, 11.3.4.3).
const RESOLUTION: [u8; 21] = [
    0, 0, 0, 9, b'p', b'H', b'Y', b's', 0, 0, 0x3b, 0x0e, 0, 0, 0x3b, 0x0e, 1, 0xcc, 0xb6, 0xa1,
    0x83,
];

/// A PNG file with its resolution after the signature and the header, which is always first.
fn with_resolution(mut bytes: Vec<u8>) -> Vec<u8> {
    const HEADER_END: usize = 8 + 4 + 4 + 13 + 4;
    bytes.splice(HEADER_END..HEADER_END, RESOLUTION);
    bytes
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
    let mut pen = match anchor {
        Anchor::Start => 0.0,
        Anchor::Middle => -width(text, size, weight) / 2.0,
        Anchor::End => -width(text, size, weight),
    };
    let mut builder = PathBuilder::new();
    for run in runs(text) {
        let (size, drop) = run.level.size_and_drop(size);
        for character in run.text.chars() {
            let Letter { block, glyph, advance } = weight.letter(character);
            let face = weight.face(block);
            let scale = (size / face.units_per_em) as f32;
            let (left, base) = (pen as f32, drop as f32);
            face.draw(glyph, &mut Outline { builder: &mut builder, left, base, scale });
            pen += advance * size;
        }
    }
    builder.finish()
}

/// Places the outline of a glyph, whose y axis points up.
struct Outline<'b> {
    builder: &'b mut PathBuilder,
    left: f32,
    base: f32,
    scale: f32,
}

impl Outline<'_> {
    fn at(&self, x: f32, y: f32) -> (f32, f32) {
        (self.left + x * self.scale, self.base - y * self.scale)
    }
}

impl OutlinePen for Outline<'_> {
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

#[cfg(test)]
mod tests {
    use super::*;

    /// The checksum of a chunk's name and data, bit by bit.
    fn crc(bytes: &[u8]) -> u32 {
        let step = |sum: u32, _| if sum & 1 == 1 { 0xedb8_8320 ^ (sum >> 1) } else { sum >> 1 };
        let byte = |sum: u32, byte: &u8| (0..8).fold(sum ^ u32::from(*byte), step);
        !bytes.iter().fold(u32::MAX, byte)
    }

    #[test]
    fn a_picture_knows_its_resolution() {
        // The standard check value of CRC-32.
        assert_eq!(crc(b"123456789"), 0xcbf4_3926);
        let dots_a_metre = (f64::from(DOTS) * 96.0 / 0.0254).round() as u32;
        let (description, marks, series) = (String::new(), Vec::new(), Vec::new());
        let scene = Scene { width: 4.0, height: 2.0, description, marks, series };
        let bytes = png(&scene).unwrap();
        assert_eq!(&bytes[37..41], b"pHYs");
        assert_eq!(bytes[41..45], dots_a_metre.to_be_bytes());
        assert_eq!(bytes[50..54], crc(&bytes[37..50]).to_be_bytes());
        assert!(tiny_skia::Pixmap::decode_png(&bytes).is_ok_and(|one| one.width() == 16));
    }
}
