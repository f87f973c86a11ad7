//! The font that figures are lettered with: Inter, cut down to what figures need, in two weights.

use std::sync::LazyLock;

use ttf_parser::{Face, GlyphId};

static REGULAR: &[u8] = include_bytes!("../fonts/Inter-Regular.otf");
static SEMIBOLD: &[u8] = include_bytes!("../fonts/Inter-SemiBold.otf");

static FACES: LazyLock<[Face<'static>; 2]> = LazyLock::new(|| {
    [REGULAR, SEMIBOLD].map(|bytes| Face::parse(bytes, 0).expect("the font is compiled in"))
});

/// How bold a text is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Weight {
    /// As text.
    Regular,
    /// As a heading.
    SemiBold,
}

impl Weight {
    pub(super) fn face(self) -> &'static Face<'static> {
        match self {
            Weight::Regular => &FACES[0],
            Weight::SemiBold => &FACES[1],
        }
    }

    /// As CSS counts it.
    pub(super) fn number(self) -> u16 {
        match self {
            Weight::Regular => 400,
            Weight::SemiBold => 600,
        }
    }
}

/// The glyph of a character; that of a box where the font has none.
pub(super) fn glyph(face: &Face<'_>, character: char) -> GlyphId {
    face.glyph_index(character).unwrap_or(GlyphId(0))
}

/// How far a character moves the pen, for letters of height 1.
pub(super) fn advance(face: &Face<'_>, glyph: GlyphId) -> f64 {
    f64::from(face.glyph_hor_advance(glyph).unwrap_or(0)) / f64::from(face.units_per_em())
}

/// Width of a text.
pub fn width(text: &str, size: f64, weight: Weight) -> f64 {
    let face = weight.face();
    text.chars().map(|character| advance(face, glyph(face, character)) * size).sum()
}

/// CSS that brings the font along, for files that are looked at where it is not installed.
pub fn web_font() -> String {
    let face = |weight: Weight, bytes: &[u8]| {
        format!(
            "@font-face{{font-family:\"Jitai Figures\";font-weight:{};\
             src:url(data:font/otf;base64,{})}}",
            weight.number(),
            base64(bytes)
        )
    };
    face(Weight::Regular, REGULAR) + &face(Weight::SemiBold, SEMIBOLD)
}

/// Bytes in the alphabet of RFC 4648.
fn base64(bytes: &[u8]) -> String {
    const ALPHABET: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let all = group.iter().enumerate().map(|(at, byte)| u32::from(*byte) << (16 - 8 * at));
        let all: u32 = all.sum();
        for place in 0..4 {
            let sextet = (all >> (18 - 6 * place)) & 63;
            let is_filled = place <= group.len();
            out.push(if is_filled { char::from(ALPHABET[sextet as usize]) } else { '=' });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_as_in_rfc_4648() {
        let pairs =
            [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")];
        for (text, expected) in pairs {
            assert_eq!(base64(text.as_bytes()), expected);
        }
    }

    #[test]
    fn the_font_has_what_figures_write() {
        let face = Weight::Regular.face();
        let needed = "P-H-D reinforce σεδρμ ± − × % ≥ ≤ … – 0123456789 (95 %), Φ";
        for character in needed.chars() {
            assert_ne!(glyph(face, character), GlyphId(0), "{character}");
        }
        assert!(width("mm", 10.0, Weight::Regular) > width("ii", 10.0, Weight::Regular));
    }
}
