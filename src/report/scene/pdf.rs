//! A scene as PDF (ISO 32000, version 1.4), for inclusion in LaTeX.
//!
//! The file has no date and no identifier, so that equal scenes make equal files. Letters are text
//! in an embedded font, which can be searched and copied.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

use miniz_oxide::deflate::compress_to_vec_zlib;

use super::font::{Face, Letter};
use super::script::runs;
use super::svg::number;
use super::{
    Anchor, Color, Direction, Fill, Mark, Point, Scene, SceneShape, Stroke, Weight,
    width as width_of,
};

/// Points per unit, which is a CSS pixel.
const POINTS: f64 = 72.0 / 96.0;

const WEIGHTS: [Weight; 2] = [Weight::Regular, Weight::SemiBold];

/// The scene as the bytes of a PDF file.
pub fn pdf(scene: &Scene) -> Vec<u8> {
    let mut page = Page::default();
    let height = number(scene.height * POINTS);
    // Coordinates of scenes start at the upper left corner.
    let _ = writeln!(page.content, "{POINTS} 0 0 -{POINTS} 0 {height} cm 1 j");
    scene.marks.iter().for_each(|mark| page.draw(mark));

    let mut file = File::new();
    let fonts = page.fonts(&mut file);
    let states: String = page
        .opacities
        .iter()
        .map(|thousandths| {
            let opacity = number(f64::from(*thousandths) / 1000.0);
            format!("/G{thousandths} << /ca {opacity} /CA {opacity} >> ")
        })
        .collect();
    let content = file.stream("", page.content.as_bytes());
    let (pages, own) = (file.next() + 1, file.next());
    file.add(&format!(
        "<< /Type /Page /Parent {pages} 0 R /MediaBox [0 0 {} {height}] /Contents {content} 0 R \
         /Resources << /Font << {fonts}>> /ExtGState << {states}>> >> >>",
        number(scene.width * POINTS),
    ));
    file.add(&format!("<< /Type /Pages /Kids [{own} 0 R] /Count 1 >>"));
    let root = file.add(&format!("<< /Type /Catalog /Pages {pages} 0 R >>"));
    let title: String =
        scene.description.encode_utf16().map(|unit| format!("{unit:04X}")).collect();
    let info = file.add(&format!("<< /Title <FEFF{title}> /Producer (jitai) >>"));
    file.end(root, info)
}

/// The drawing operators of the page, and the resources that they need.
#[derive(Default)]
struct Page {
    content: String,
    /// Opacities, in thousandths.
    opacities: BTreeSet<u16>,
    /// The characters written in each font, by glyph. Blocks of letters follow each other, each in every weight.
    letters: BTreeMap<usize, BTreeMap<u16, char>>,
}

impl Page {
    fn draw(&mut self, mark: &Mark) {
        self.content.push_str("q ");
        match &mark.shape {
            SceneShape::Line { points, stroke } => {
                self.stroke(stroke);
                self.path(points);
                self.content.push_str("S ");
            }
            SceneShape::Area { points, fill, stroke } => {
                self.paint(fill, stroke.as_ref(), |page| {
                    page.path(points);
                    page.content.push_str("h ");
                });
            }
            SceneShape::Circle { centre, radius, fill, stroke } => {
                self.paint(fill, stroke.as_ref(), |page| page.circle(*centre, *radius));
            }
            SceneShape::Text { rim, .. } => {
                if let Some(rim) = rim {
                    self.stroke(rim);
                    self.text(&mark.shape, 1);
                }
                self.text(&mark.shape, 0);
            }
        }
        self.content.push_str("Q\n");
    }

    fn fill(&mut self, fill: &Fill) {
        self.opacity(fill.opacity);
        let _ = write!(self.content, "{} rg ", shares(fill.color));
    }

    fn stroke(&mut self, stroke: &Stroke) {
        self.opacity(stroke.opacity);
        let _ = write!(self.content, "{} RG {} w ", shares(stroke.color), number(stroke.width));
        if let Some((dash, gap)) = stroke.dash {
            let _ = write!(self.content, "[{} {}] 0 d ", number(dash), number(gap));
        }
    }

    fn opacity(&mut self, opacity: f64) {
        let thousandths = (opacity.clamp(0.0, 1.0) * 1000.0).round() as u16;
        self.opacities.insert(thousandths);
        let _ = write!(self.content, "/G{thousandths} gs ");
    }

    /// An outline, filled and then stroked; either may be transparent.
    fn paint(&mut self, fill: &Fill, stroke: Option<&Stroke>, outline: impl Fn(&mut Page)) {
        if fill.opacity > 0.0 {
            self.fill(fill);
            outline(self);
            self.content.push_str("f ");
        }
        if let Some(stroke) = stroke {
            self.stroke(stroke);
            outline(self);
            self.content.push_str("S ");
        }
    }

    fn path(&mut self, points: &[Point]) {
        for (at, (x, y)) in points.iter().enumerate() {
            let operator = if at == 0 { 'm' } else { 'l' };
            let _ = write!(self.content, "{} {} {operator} ", number(*x), number(*y));
        }
    }

    fn circle(&mut self, (x, y): Point, radius: f64) {
        /// Distance of the control points of a quarter circle from its ends, for a radius of 1.
        const HANDLE: f64 = 0.552_285;
        let handle = radius * HANDLE;
        let _ = write!(self.content, "{} {} m ", number(x + radius), number(y));
        for (cos, sin) in [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)] {
            // From the point at an angle to the point a quarter turn further.
            let points = [
                (x + radius * cos - handle * sin, y + radius * sin + handle * cos),
                (x - radius * sin + handle * cos, y + radius * cos + handle * sin),
                (x - radius * sin, y + radius * cos),
            ];
            for (x, y) in points {
                let _ = write!(self.content, "{} {} ", number(x), number(y));
            }
            self.content.push_str("c ");
        }
        self.content.push_str("h ");
    }

    /// A text with its letters filled (mode 0) or stroked (mode 1).
    fn text(&mut self, shape: &SceneShape, mode: u8) {
        let SceneShape::Text { at, text, size, weight, color, anchor, direction, .. } = shape
        else {
            return;
        };
        if mode == 0 {
            self.fill(&Fill { color: *color, opacity: 1.0 });
        }
        let index = WEIGHTS.iter().position(|known| known == weight).unwrap_or(0);
        let mut pen = match anchor {
            Anchor::Start => 0.0,
            Anchor::Middle => -width_of(text, *size, *weight) / 2.0,
            Anchor::End => -width_of(text, *size, *weight),
        };
        let _ = write!(self.content, "BT {mode} Tr ");
        for run in runs(text) {
            let (size, drop) = run.level.size_and_drop(*size);
            // The font of the letter before, unless it is a box, which may be wider than the font says.
            let (mut open, mut is_first) = (None, true);
            for character in run.text.chars() {
                let Letter { block, glyph, advance } = weight.letter(character);
                let font = index + WEIGHTS.len() * block;
                if open != Some(font) {
                    // The page's y axis points down, the y axis of letters points up.
                    let matrix = match direction {
                        Direction::Right => {
                            format!("1 0 0 -1 {} {}", number(at.0 + pen), number(at.1 + drop))
                        }
                        Direction::Up => {
                            format!("0 -1 -1 0 {} {}", number(at.0 + drop), number(at.1 - pen))
                        }
                    };
                    let end = if is_first { "" } else { "> Tj " };
                    let _ = write!(self.content, "{end}/F{font} {} Tf {matrix} Tm <", number(size));
                }
                let number = u16::try_from(glyph.to_u32()).unwrap_or(0);
                self.letters.entry(font).or_default().insert(number, character);
                let _ = write!(self.content, "{number:04X}");
                pen += advance * size;
                (open, is_first) = ((number > 0).then_some(font), false);
            }
            self.content.push_str("> Tj ");
        }
        self.content.push_str("ET ");
    }

    /// Adds the used fonts, and returns their names with their objects.
    fn fonts(&self, file: &mut File) -> String {
        let mut names = String::new();
        for (number, letters) in &self.letters {
            let (block, weight) = (number / WEIGHTS.len(), WEIGHTS[number % WEIGHTS.len()]);
            let font = add_font(file, (weight, block), letters);
            let _ = write!(names, "/F{number} {font} 0 R ");
        }
        names
    }
}

fn shares(Color(red, green, blue): Color) -> String {
    let share = |part: u8| {
        let text = format!("{:.3}", f64::from(part) / 255.0);
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    };
    [red, green, blue].map(share).join(" ")
}

/// Adds a font whose character codes are glyph numbers, and returns the number of its object.
fn add_font(
    file: &mut File,
    (weight, block): (Weight, usize),
    letters: &BTreeMap<u16, char>,
) -> usize {
    let face: &Face = weight.face(block);
    // Letters with two marks are higher than others.
    let top = if block == 0 { 1100 } else { 1500 };
    // The tag marks a font with a subset of its glyphs.
    let name = format!("JITAIF+{}", weight.font_name(block));
    let program = file.stream("/Subtype /CIDFontType0C ", face.compact);
    let descriptor = file.add(&format!(
        "<< /Type /FontDescriptor /FontName /{name} /Flags 4 /FontBBox [-200 -300 1400 {top}] \
         /ItalicAngle 0 /Ascent 970 /Descent -240 /CapHeight 727 /StemV {} /FontFile3 {program} 0 R >>",
        weight.number() / 5,
    ));
    let widths: String = letters
        .keys()
        .map(|glyph| {
            let advance = face.advance((*glyph).into()) * 1000.0;
            format!("{glyph} [{}] ", number(advance))
        })
        .collect();
    let own = file.add(&format!(
        "<< /Type /Font /Subtype /CIDFontType0 /BaseFont /{name} /CIDSystemInfo << /Registry (Adobe) \
         /Ordering (Identity) /Supplement 0 >> /FontDescriptor {descriptor} 0 R /DW 1000 /W [{widths}] >>"
    ));
    let map = file.stream("", to_unicode(letters).as_bytes());
    file.add(&format!(
        "<< /Type /Font /Subtype /Type0 /BaseFont /{name} /Encoding /Identity-H \
         /DescendantFonts [{own} 0 R] /ToUnicode {map} 0 R >>"
    ))
}

/// The map from glyphs to characters, for searching and copying.
fn to_unicode(letters: &BTreeMap<u16, char>) -> String {
    /// Maximum number of lines of a block.
    const BLOCK: usize = 100;
    let mut out = "/CIDInit /ProcSet findresource begin 12 dict begin begincmap\n\
                   /CMapName /Letters def /CMapType 2 def\n\
                   1 begincodespacerange <0000> <FFFF> endcodespacerange\n"
        .to_owned();
    let lines: Vec<String> = letters
        .iter()
        .filter(|(glyph, _)| **glyph > 0)
        .map(|(glyph, character)| {
            let mut units = [0; 2];
            let units = character.encode_utf16(&mut units).iter();
            let code: String = units.map(|unit| format!("{unit:04X}")).collect();
            format!("<{glyph:04X}> <{code}>\n")
        })
        .collect();
    for block in lines.chunks(BLOCK) {
        let _ = write!(out, "{} beginbfchar\n{}endbfchar\n", block.len(), block.concat());
    }
    out + "endcmap CMapName currentdict /CMap defineresource pop end end\n"
}

/// A file of numbered objects.
struct File {
    bytes: Vec<u8>,
    /// The byte offset of each object.
    offsets: Vec<usize>,
}

impl File {
    fn new() -> File {
        // Four bytes above 127 mark the file as binary.
        File { bytes: b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n".to_vec(), offsets: Vec::new() }
    }

    /// The number of the next object.
    fn next(&self) -> usize {
        self.offsets.len() + 1
    }

    /// Adds an object and returns its number.
    fn add(&mut self, object: &str) -> usize {
        self.add_bytes(object.as_bytes())
    }

    fn add_bytes(&mut self, object: &[u8]) -> usize {
        let number = self.next();
        self.offsets.push(self.bytes.len());
        self.bytes.extend(format!("{number} 0 obj\n").bytes());
        self.bytes.extend(object);
        self.bytes.extend(b"\nendobj\n");
        number
    }

    /// Adds a compressed stream with further entries in its dictionary, and returns its number.
    fn stream(&mut self, entries: &str, content: &[u8]) -> usize {
        const LEVEL: u8 = 6;
        let compressed = compress_to_vec_zlib(content, LEVEL);
        let length = compressed.len();
        let mut object =
            format!("<< {entries}/Filter /FlateDecode /Length {length} >>\nstream\n").into_bytes();
        object.extend(compressed);
        object.extend(b"\nendstream");
        self.add_bytes(&object)
    }

    /// The whole file.
    fn end(mut self, root: usize, info: usize) -> Vec<u8> {
        let (table, count) = (self.bytes.len(), self.next());
        let mut out = format!("xref\n0 {count}\n0000000000 65535 f \n");
        for offset in &self.offsets {
            let _ = writeln!(out, "{offset:010} 00000 n ");
        }
        let _ = write!(
            out,
            "trailer\n<< /Size {count} /Root {root} 0 R /Info {info} 0 R >>\nstartxref\n{table}\n%%EOF\n"
        );
        self.bytes.extend(out.bytes());
        self.bytes
    }
}

#[cfg(test)]
mod tests {
    use miniz_oxide::inflate::decompress_to_vec_zlib;

    use super::*;

    fn scene() -> Scene {
        let text = |direction| SceneShape::Text {
            at: (10.0, 20.0),
            text: "δ_d ≥ (1)".to_owned(),
            size: 9.5,
            weight: Weight::Regular,
            color: Color(0, 114, 178),
            anchor: Anchor::Middle,
            direction,
            rim: None,
        };
        let circle = SceneShape::Circle {
            centre: (5.0, 5.0),
            radius: 2.0,
            fill: Fill { color: Color::WHITE, opacity: 0.16 },
            stroke: Some(Stroke::solid(Color(1, 2, 3), 1.3)),
        };
        let marks = [text(Direction::Right), text(Direction::Up), circle];
        Scene {
            width: 321.0,
            height: 100.0,
            description: "a (test) of δ".to_owned(),
            marks: marks.into_iter().map(Mark::from).collect(),
            series: Vec::new(),
        }
    }

    /// The content of every stream.
    fn streams(bytes: &[u8]) -> Vec<Vec<u8>> {
        let find = |from: usize, word: &[u8]| {
            bytes[from..].windows(word.len()).position(|found| found == word).map(|at| from + at)
        };
        let (mut from, mut all) = (0, Vec::new());
        while let Some(begin) = find(from, b">>\nstream\n") {
            let begin = begin + b">>\nstream\n".len();
            let end = find(begin, b"\nendstream").unwrap();
            all.push(decompress_to_vec_zlib(&bytes[begin..end]).unwrap());
            from = end;
        }
        all
    }

    #[test]
    fn every_object_stands_where_the_table_says() {
        let bytes = pdf(&scene());
        assert_eq!(bytes, pdf(&scene()));
        let text = String::from_utf8_lossy(&bytes).into_owned();
        let start = text.rsplit("startxref\n").next().unwrap().lines().next().unwrap();
        let start: usize = start.parse().unwrap();
        let table = String::from_utf8(bytes[start..].to_vec()).unwrap();
        let mut lines = table.lines().skip(1);
        let count: usize = lines.next().unwrap()[2..].parse().unwrap();
        // Five objects of the font, then content, page, pages, catalogue and title, after the free entry.
        assert_eq!(count, 11);
        for number in 1..count {
            let entry = lines.by_ref().nth(usize::from(number == 1)).unwrap();
            assert_eq!(entry.len() + 1, 20, "an entry has 20 bytes with its end of line");
            let offset: usize = entry[..10].parse().unwrap();
            let expected = format!("{number} 0 obj\n");
            assert!(bytes[offset..].starts_with(expected.as_bytes()), "object {number}");
        }
        // 321 and 100 units of 1/96 inch.
        assert!(text.contains("/MediaBox [0 0 240.75 75]"));
    }

    #[test]
    fn the_font_is_embedded_and_its_letters_can_be_copied() {
        let streams = streams(&pdf(&scene()));
        let face = Weight::Regular.face(0);
        // The unused weight is left out.
        assert_eq!(streams.len(), 3);
        assert_eq!(streams[0], face.compact);
        let map = String::from_utf8(streams[1].clone()).unwrap();
        let delta = Weight::Regular.letter('δ').glyph.to_u32();
        assert!(map.contains(&format!("<{delta:04X}> <03B4>\n")), "{map}");
        let content = String::from_utf8(streams[2].clone()).unwrap();
        assert!(content.contains("0 -1 -1 0 "), "a text runs upwards: {content}");
        assert!(content.contains("/G160 gs 1 1 1 rg "), "{content}");
    }
}
