//! The font of figures: Inter in two weights, reduced to the characters that figures need.

use std::sync::LazyLock;

use data_encoding::BASE64;
use skrifa::charmap::Charmap;
use skrifa::instance::{LocationRef, Size};
use skrifa::metrics::GlyphMetrics;
use skrifa::outline::{DrawSettings, OutlineGlyphCollection, OutlinePen};
use skrifa::raw::types::Tag;
use skrifa::{FontRef, GlyphId, MetadataProvider};

use super::script::{Run, runs};

static REGULAR: &[u8] = include_bytes!("../fonts/Inter-Regular.otf");
static SEMIBOLD: &[u8] = include_bytes!("../fonts/Inter-SemiBold.otf");

static FACES: LazyLock<[Face; 2]> = LazyLock::new(|| [REGULAR, SEMIBOLD].map(Face::new));

/// One weight of the font, measured in its own units.
pub(super) struct Face {
    /// Its glyph outlines in the Compact Font Format.
    pub(super) compact: &'static [u8],
    characters: Charmap<'static>,
    metrics: GlyphMetrics<'static>,
    outlines: OutlineGlyphCollection<'static>,
    /// Font units per unit of letter size.
    pub(super) units_per_em: f64,
}

impl Face {
    fn new(bytes: &'static [u8]) -> Face {
        let font = FontRef::new(bytes).expect("the font is compiled in");
        let units = font.metrics(Size::unscaled(), LocationRef::default()).units_per_em;
        let compact = font.table_data(Tag::new(b"CFF ")).expect("the font is OpenType with CFF");
        Face {
            compact: compact.as_bytes(),
            characters: font.charmap(),
            metrics: font.glyph_metrics(Size::unscaled(), LocationRef::default()),
            outlines: font.outline_glyphs(),
            units_per_em: f64::from(units),
        }
    }

    /// The glyph of a character, or the box for missing glyphs.
    pub(super) fn glyph(&self, character: char) -> GlyphId {
        self.characters.map(character).unwrap_or(GlyphId::NOTDEF)
    }

    /// The advance width of a glyph, for letters of height 1.
    pub(super) fn advance(&self, glyph: GlyphId) -> f64 {
        f64::from(self.metrics.advance_width(glyph).unwrap_or(0.0)) / self.units_per_em
    }

    /// Draws the outline of a glyph, whose y axis points up.
    pub(super) fn draw(&self, glyph: GlyphId, pen: &mut impl OutlinePen) {
        let outline = self.outlines.get(glyph).expect("the font has an outline for each glyph");
        let settings = DrawSettings::unhinted(Size::unscaled(), LocationRef::default());
        outline.draw(settings, pen).expect("the font is compiled in");
    }
}

/// The weight of a text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Weight {
    /// For text.
    Regular,
    /// For headings.
    SemiBold,
}

impl Weight {
    pub(super) fn face(self) -> &'static Face {
        match self {
            Weight::Regular => &FACES[0],
            Weight::SemiBold => &FACES[1],
        }
    }

    /// The name of the font of this weight.
    pub(super) fn font_name(self) -> &'static str {
        match self {
            Weight::Regular => "Inter-Regular",
            Weight::SemiBold => "Inter-SemiBold",
        }
    }

    /// The weight as a number in CSS.
    pub(super) fn number(self) -> u16 {
        match self {
            Weight::Regular => 400,
            Weight::SemiBold => 600,
        }
    }
}

/// Width of a text.
pub fn width(text: &str, size: f64, weight: Weight) -> f64 {
    let face = weight.face();
    let advance = |character| face.advance(face.glyph(character));
    let of_run = |run: Run| {
        let (size, _) = run.level.size_and_drop(size);
        run.text.chars().map(|character| advance(character) * size).sum::<f64>()
    };
    runs(text).into_iter().map(of_run).sum()
}

/// CSS with the font embedded, for viewing files where the font is not installed.
pub fn web_font() -> String {
    let face = |weight: Weight, bytes: &[u8]| {
        format!(
            "@font-face{{font-family:\"Jitai Figures\";font-weight:{};\
             src:url(data:font/otf;base64,{})}}",
            weight.number(),
            BASE64.encode(bytes)
        )
    };
    face(Weight::Regular, REGULAR) + &face(Weight::SemiBold, SEMIBOLD)
}

#[cfg(test)]
mod tests {
    use skrifa::outline::pen::NullPen;

    use super::*;

    #[test]
    fn the_font_has_what_figures_write() {
        let face = Weight::Regular.face();
        let needed = "P-H-D reinforce σεδρμγ ± − × % ≥ ≤ … – 0123456789 (95 %), Φ";
        for character in needed.chars() {
            assert_ne!(face.glyph(character), GlyphId::NOTDEF, "{character}");
        }
        assert!(width("mm", 10.0, Weight::Regular) > width("ii", 10.0, Weight::Regular));
    }

    #[test]
    fn every_glyph_has_an_outline() {
        for face in [Weight::Regular, Weight::SemiBold].map(Weight::face) {
            let glyphs = face.metrics.glyph_count();
            assert!(glyphs > 100);
            (0..glyphs).for_each(|glyph| face.draw(glyph.into(), &mut NullPen));
        }
    }
}
