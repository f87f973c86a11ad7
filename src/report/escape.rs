//! Escaping for CSV, LaTeX, Markdown and file names. Names come from manifests, which are untrusted
//! input. The templates for HTML and SVG escape their text themselves.

use std::borrow::Cow;

use super::letters::{Tex, greek_name, tex};
use super::scene::{Level, runs};

/// An entry of CSV (RFC 4180), [`defused`].
pub fn csv(text: &str) -> String {
    let text = defused(text);
    match text.contains([',', '"', '\n', '\r']) {
        true => format!("\"{}\"", text.replace('"', "\"\"")),
        false => text.into_owned(),
    }
}

/// The text, with a leading apostrophe if a spreadsheet would evaluate it as a formula.
pub fn defused(text: &str) -> Cow<'_, str> {
    let is_formula = text.starts_with(['=', '+', '-', '@', '\t', '\r']);
    match is_formula && text.parse::<f64>().is_err() {
        true => Cow::Owned(format!("'{text}")),
        false => Cow::Borrowed(text),
    }
}

/// Text for LaTeX, outside of mathematics.
pub fn latex(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for run in runs(text) {
        match run.level {
            Level::Base => latex_letters(run.text, &mut out),
            // Joins the subscript to the symbol before it, so that `$\delta$` becomes
            // `$\delta_{\mathrm{d}}$`.
            Level::Subscript => {
                let is_math = out.ends_with('$');
                if is_math {
                    out.pop();
                }
                let below = match run.text.is_ascii() {
                    true => format!("\\mathrm{{{}}}", run.text),
                    false => format!("\\mbox{{\\scriptsize {}}}", latex(run.text)),
                };
                let opening = if is_math { "" } else { "$" };
                out.push_str(&format!("{opening}_{{{below}}}$"));
            }
        }
    }
    out
}

fn latex_letters(text: &str, out: &mut String) {
    let mut encoding = "";
    for character in text.chars() {
        let tex = tex(character);
        let next = if let Tex::Encoded(next) = tex { next } else { "" };
        if next != encoding {
            out.push_str(if encoding.is_empty() { "" } else { "}" });
            if !next.is_empty() {
                out.push_str(&format!("{{\\fontencoding{{{next}}}\\selectfont "));
            }
            encoding = next;
        }
        match tex {
            Tex::Text(text) => out.push_str(text),
            Tex::Math(math) => out.push_str(&format!("${math}$")),
            Tex::Same if character.is_control() => out.push(' '),
            Tex::Same | Tex::Encoded(_) => out.push(character),
        }
    }
    out.push_str(if encoding.is_empty() { "" } else { "}" });
}

/// An entry of a Markdown table.
pub fn markdown(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '|' | '\\' | '*' | '_' | '`' | '[' | ']' | '#' => {
                out.push('\\');
                out.push(character);
            }
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '&' => out.push_str("&amp;"),
            other if other.is_control() => out.push(' '),
            other => out.push(other),
        }
    }
    out
}

/// A name as part of a file name: at most sixty letters, digits and hyphens. Greek letters are spelt.
pub fn file_stem(name: &str) -> String {
    const LONGEST: usize = 60;
    let mut out = String::new();
    let spelt = |letter: char| greek_name(letter).map_or_else(|| letter.to_string(), str::to_owned);
    for character in name.chars().map(spelt).collect::<String>().chars() {
        match character {
            'a'..='z' | '0'..='9' => out.push(character),
            'A'..='Z' => out.push(character.to_ascii_lowercase()),
            _ if out.is_empty() || out.ends_with('-') => {}
            _ => out.push('-'),
        }
        if out.len() == LONGEST {
            break;
        }
    }
    let stem = out.trim_end_matches('-');
    if stem.is_empty() { "unnamed".to_owned() } else { stem.to_owned() }
}

/// A name as part of a file name, numbered if it is taken.
pub fn unused_stem(taken: &[String], name: &str) -> String {
    unused(taken, &file_stem(name))
}

/// A stem, numbered if it is taken.
pub fn unused(taken: &[String], stem: &str) -> String {
    let numbered = (2..).map(|number| format!("{stem}-{number}"));
    let mut candidates = std::iter::once(stem.to_owned()).chain(numbered);
    candidates.find(|candidate| !taken.contains(candidate)).unwrap_or_else(|| stem.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hostile_name_is_harmless() {
        assert_eq!(csv("=HYPERLINK(\"x\"),1"), "\"'=HYPERLINK(\"\"x\"\"),1\"");
        assert_eq!(csv("@SUM(A1)"), "'@SUM(A1)");
        assert_eq!(csv("-12.5"), "-12.5");
        assert_eq!(latex("\\input{/etc} 50% a_b"), "\\textbackslash{}input\\{/etc\\} 50\\% a\\_b");
        assert_eq!(
            latex("κ_h ≈ δ_h → 0"),
            "$\\kappa_{\\mathrm{h}}$ $\\approx$ $\\delta_{\\mathrm{h}}$ $\\rightarrow$ 0"
        );
        assert_eq!(latex("σ_β"), "$\\sigma_{\\mbox{\\scriptsize $\\beta$}}$");
        assert_eq!(
            latex("règle да ą"),
            "règle {\\fontencoding{T2A}\\selectfont да} {\\fontencoding{T1}\\selectfont ą}"
        );
        assert_eq!(markdown("a|b<i>"), "a\\|b&lt;i&gt;");
        assert_eq!(file_stem("../../etc/passwd"), "etc-passwd");
        assert_eq!(file_stem("Figure 2 (a)"), "figure-2-a");
        assert_eq!(file_stem("…/.."), "unnamed");
        assert_eq!(file_stem("δ_d=0.1"), "delta-d-0-1");
    }
}
