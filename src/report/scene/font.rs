//! The font of figures: Inter in two weights, in blocks of letters. A figure embeds the blocks that it needs.

use std::fmt::Write as _;
use std::sync::LazyLock;

use data_encoding::BASE64;
use skrifa::charmap::Charmap;
use skrifa::instance::{LocationRef, Size};
use skrifa::metrics::GlyphMetrics;
use skrifa::outline::{DrawSettings, OutlineGlyphCollection, OutlinePen};
use skrifa::raw::types::Tag;
use skrifa::{FontRef, GlyphId, MetadataProvider};
use unicode_width::UnicodeWidthChar;

use super::script::{Run, runs};

/// The number of blocks. The first has the letters of every figure, and `fonts/subset.py` says what the others have.
const BLOCKS: usize = 5;

/// What follows the name of a weight in the name of a block's font.
const ENDINGS: [&str; BLOCKS] = ["", "-Latin", "-Vietnamese", "-Greek", "-Cyrillic"];

static REGULAR: [&[u8]; BLOCKS] = [
    include_bytes!("../fonts/Inter-Regular.otf"),
    include_bytes!("../fonts/Inter-Regular-Latin.otf"),
    include_bytes!("../fonts/Inter-Regular-Vietnamese.otf"),
    include_bytes!("../fonts/Inter-Regular-Greek.otf"),
    include_bytes!("../fonts/Inter-Regular-Cyrillic.otf"),
];
static SEMIBOLD: [&[u8]; BLOCKS] = [
    include_bytes!("../fonts/Inter-SemiBold.otf"),
    include_bytes!("../fonts/Inter-SemiBold-Latin.otf"),
    include_bytes!("../fonts/Inter-SemiBold-Vietnamese.otf"),
    include_bytes!("../fonts/Inter-SemiBold-Greek.otf"),
    include_bytes!("../fonts/Inter-SemiBold-Cyrillic.otf"),
];

static FACES: LazyLock<[[Face; BLOCKS]; 2]> =
    LazyLock::new(|| [REGULAR, SEMIBOLD].map(|blocks| blocks.map(Face::new)));

/// One block of one weight of the font, measured in its own units.
pub(super) struct Face {
    /// Its glyph outlines in the Compact Font Format.
    pub(super) compact: &'static [u8],
    characters: Charmap<'static>,
    metrics: GlyphMetrics<'static>,
    outlines: OutlineGlyphCollection<'static>,
    /// Font units per unit of letter size.
    pub(super) units_per_em: f64,
}

/// A character as it is drawn.
pub(super) struct Letter {
    /// The block of its glyph.
    pub(super) block: usize,
    /// The glyph; [`GlyphId::NOTDEF`] for a character that the font lacks.
    pub(super) glyph: GlyphId,
    /// The advance width, for letters of height 1.
    pub(super) advance: f64,
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

    /// Its characters, as CSS writes ranges.
    fn ranges(&self) -> String {
        let mut characters: Vec<u32> = self.characters.mappings().map(|(code, _)| code).collect();
        characters.sort_unstable();
        let mut out = String::new();
        for range in characters.chunk_by(|one, next| one + 1 == *next) {
            let comma = if out.is_empty() { "" } else { "," };
            let (first, last) = (range[0], range[range.len() - 1]);
            let _ = match first == last {
                true => write!(out, "{comma}U+{first:X}"),
                false => write!(out, "{comma}U+{first:X}-{last:X}"),
            };
        }
        out
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
    pub(super) fn face(self, block: usize) -> &'static Face {
        match self {
            Weight::Regular => &FACES[0][block],
            Weight::SemiBold => &FACES[1][block],
        }
    }

    /// A character in this weight. A character that the font lacks is a box as wide as a browser's letter from another
    /// font, or nothing if it is a mark on the letter before it.
    pub(super) fn letter(self, character: char) -> Letter {
        let known = block(character);
        let block = known.unwrap_or(1);
        let face = self.face(block);
        let glyph = face.characters.map(character).unwrap_or(GlyphId::NOTDEF);
        match known.map_or(character.width(), |_| Some(1)) {
            Some(0) | None => Letter { block: 0, glyph: GlyphId::NOTDEF, advance: 0.0 },
            Some(2) => Letter { block, glyph, advance: 1.0 },
            Some(_) => Letter { block, glyph, advance: face.advance(glyph) },
        }
    }

    /// The name of the font of a block of this weight.
    pub(super) fn font_name(self, block: usize) -> String {
        let weight = match self {
            Weight::Regular => "Inter-Regular",
            Weight::SemiBold => "Inter-SemiBold",
        };
        format!("{weight}{}", ENDINGS[block])
    }

    /// The weight as a number in CSS.
    pub(super) fn number(self) -> u16 {
        match self {
            Weight::Regular => 400,
            Weight::SemiBold => 600,
        }
    }
}

/// The block that has a character; `None` for a character that the font lacks.
fn block(character: char) -> Option<usize> {
    FACES[0].iter().position(|face| face.characters.map(character).is_some())
}

/// Whether figures can draw a character.
pub fn is_drawn(character: char) -> bool {
    block(character).is_some()
}

/// Width of a text.
pub fn width(text: &str, size: f64, weight: Weight) -> f64 {
    let of_run = |run: Run| {
        let (size, _) = run.level.size_and_drop(size);
        run.text.chars().map(|character| weight.letter(character).advance * size).sum::<f64>()
    };
    runs(text).into_iter().map(of_run).sum()
}

/// CSS with the font embedded, for viewing files where the font is not installed: the first block, and the blocks of
/// the characters of a text.
pub fn web_font(text: &str) -> String {
    let mut is_used = [true, false, false, false, false];
    for character in text.chars().filter(|character| !character.is_ascii()) {
        block(character).into_iter().for_each(|block| is_used[block] = true);
    }
    let mut out = String::new();
    for block in (0..BLOCKS).filter(|block| is_used[*block]) {
        for (weight, files) in [(Weight::Regular, REGULAR), (Weight::SemiBold, SEMIBOLD)] {
            let range = match block {
                0 => String::new(),
                _ => format!("unicode-range:{};", weight.face(block).ranges()),
            };
            let _ = write!(
                out,
                "@font-face{{font-family:\"Jitai Figures\";font-weight:{};{range}\
                 src:url(data:font/otf;base64,{})}}",
                weight.number(),
                BASE64.encode(files[block])
            );
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use skrifa::outline::pen::NullPen;

    use super::*;

    #[test]
    fn the_font_has_what_figures_write() {
        let needed = "P-H-D reinforce σεδρμγ ± − × % ≥ ≤ … – 0123456789 (95 %), Φ";
        assert!(needed.chars().all(|character| block(character) == Some(0)));
        assert!(width("mm", 10.0, Weight::Regular) > width("ii", 10.0, Weight::Regular));
    }

    #[test]
    fn the_font_has_latin_greek_and_cyrillic_and_a_box_for_other_letters() {
        for word in
            ["Señal", "règle", "žluťoučký", "ığüşöç", "łąka", "Bộ đếm", "Ηλίας", "агент", "Ґанок"]
        {
            for character in word.chars() {
                assert!(is_drawn(character), "{character}");
                for weight in [Weight::Regular, Weight::SemiBold] {
                    assert_ne!(weight.letter(character).glyph, GlyphId::NOTDEF, "{character}");
                }
            }
        }
        assert!(!is_drawn('日') && !is_drawn('\u{301}') && !is_drawn('😀'));
        let wide = |text| width(text, 10.0, Weight::Regular);
        assert_eq!(wide("日本"), 20.0);
        assert_eq!(wide("e\u{301}"), wide("e"));
    }

    #[test]
    fn a_file_embeds_the_blocks_of_its_letters() {
        let faces = |text| web_font(text).matches("@font-face").count();
        assert_eq!(["dqn δ_d", "Señal", "агент λ ñ", "日本"].map(faces), [2, 4, 6, 2]);
        assert!(web_font("ñ").contains("unicode-range:U+A1-A6,"), "{:.400}", web_font("ñ"));
    }

    #[test]
    fn every_glyph_has_an_outline() {
        for face in FACES.iter().flatten() {
            let glyphs = face.metrics.glyph_count();
            assert!(glyphs > 40);
            (0..glyphs).for_each(|glyph| face.draw(glyph.into(), &mut NullPen));
        }
    }
}
