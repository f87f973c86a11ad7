//! Text as CSV, LaTeX, Markdown and file names need it: names come from manifests, and anybody can
//! write one. HTML and SVG are escaped by the templates that make them.

use std::borrow::Cow;

/// An entry of CSV (RFC 4180), [`defused`].
pub fn csv(text: &str) -> String {
    let text = defused(text);
    match text.contains([',', '"', '\n', '\r']) {
        true => format!("\"{}\"", text.replace('"', "\"\"")),
        false => text.into_owned(),
    }
}

/// The text, with an apostrophe before what a spreadsheet would run as a formula.
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
    for character in text.chars() {
        match character {
            '\\' => out.push_str("\\textbackslash{}"),
            '{' | '}' | '$' | '&' | '#' | '_' | '%' => {
                out.push('\\');
                out.push(character);
            }
            '~' => out.push_str("\\textasciitilde{}"),
            '^' => out.push_str("\\textasciicircum{}"),
            '−' => out.push_str("$-$"),
            '±' => out.push_str("$\\pm$"),
            '×' => out.push_str("$\\times$"),
            'σ' => out.push_str("$\\sigma$"),
            'δ' => out.push_str("$\\delta$"),
            'ε' => out.push_str("$\\varepsilon$"),
            '<' => out.push_str("$<$"),
            '>' => out.push_str("$>$"),
            other if other.is_control() => out.push(' '),
            other => out.push(other),
        }
    }
    out
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

/// A name as part of a file name: letters, digits and hyphens, at most sixty of them.
pub fn file_stem(name: &str) -> String {
    const LONGEST: usize = 60;
    let mut out = String::new();
    for character in name.chars() {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hostile_name_is_harmless() {
        assert_eq!(csv("=HYPERLINK(\"x\"),1"), "\"'=HYPERLINK(\"\"x\"\"),1\"");
        assert_eq!(csv("@SUM(A1)"), "'@SUM(A1)");
        assert_eq!(csv("-12.5"), "-12.5");
        assert_eq!(latex("\\input{/etc} 50% a_b"), "\\textbackslash{}input\\{/etc\\} 50\\% a\\_b");
        assert_eq!(markdown("a|b<i>"), "a\\|b&lt;i&gt;");
        assert_eq!(file_stem("../../etc/passwd"), "etc-passwd");
        assert_eq!(file_stem("Figure 2 (a)"), "figure-2-a");
        assert_eq!(file_stem("…/.."), "unnamed");
    }
}
