//! The text of a manifest for messages about faults: lines, columns and excerpts.
//!
//! In: the text and byte offsets into it. Out: positions in lines and characters, and lines that are safe
//! to print on a terminal. It does not parse TOML.

use unicode_width::UnicodeWidthStr;

use crate::text::printable::hidden;

/// A stretch of the text, in bytes; the end is excluded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Span {
    pub start: usize,
    pub end: usize,
}

impl From<std::ops::Range<usize>> for Span {
    fn from(range: std::ops::Range<usize>) -> Span {
        Span { start: range.start, end: range.end }
    }
}

/// A value and its position in the text.
#[derive(Clone, Debug)]
pub(crate) struct Located<T> {
    pub value: T,
    pub span: Span,
}

/// A place in a manifest, counted from 1; columns count characters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Position {
    /// The line.
    pub line: usize,
    /// The character in the line.
    pub column: usize,
}

/// A text and the offsets of its lines.
#[derive(Clone, Debug)]
pub(crate) struct Source {
    text: String,
    line_starts: Vec<usize>,
}

/// A line ready to print, and the terminal columns that a fault covers in it.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Excerpt {
    pub text: String,
    pub indent: usize,
    pub carets: usize,
}

/// Characters of a long line that are shown before a fault, and after its start.
const BEFORE: usize = 60;
const AFTER: usize = 60;

impl Source {
    pub fn new(text: &str) -> Source {
        let newlines = text.bytes().enumerate().filter(|(_, byte)| *byte == b'\n');
        let line_starts = std::iter::once(0).chain(newlines.map(|(at, _)| at + 1)).collect();
        Source { text: text.to_owned(), line_starts }
    }

    /// The whole text.
    pub(crate) fn text(&self) -> &str {
        &self.text
    }

    fn line_index(&self, offset: usize) -> usize {
        self.line_starts.partition_point(|start| *start <= offset) - 1
    }

    fn line(&self, index: usize) -> &str {
        let start = self.line_starts[index];
        let end = self.line_starts.get(index + 1).map_or(self.text.len(), |next| next - 1);
        self.text[start..end].trim_end_matches('\r')
    }

    /// The position of the byte at `offset`; offsets past the end give the position of the end.
    pub fn position(&self, offset: usize) -> Position {
        let offset = self.text.floor_char_boundary(offset);
        let index = self.line_index(offset);
        let before = &self.text[self.line_starts[index]..offset];
        Position { line: index + 1, column: before.chars().count() + 1 }
    }

    /// The first line of `span`, shortened around the span if long, with the position of its carets.
    pub(crate) fn excerpt(&self, span: Span) -> Excerpt {
        let start = self.text.floor_char_boundary(span.start);
        let index = self.line_index(start);
        let line = self.line(index);
        let first = line[..(start - self.line_starts[index]).min(line.len())].chars().count();
        let end = self.text.floor_char_boundary(span.end.max(start));
        let covered = self.text[start..end].lines().next().map_or(0, |part| part.chars().count());
        let from = if first > BEFORE { first - BEFORE / 2 } else { 0 };
        let shown: Vec<char> = line.chars().skip(from).take(first - from + AFTER).collect();
        let total = line.chars().count();
        let (head, tail) = shown.split_at((first - from).min(shown.len()));
        let (under, rest) = tail.split_at(covered.min(tail.len()));
        let lead = if from > 0 { "…" } else { "" };
        let trail = if from + shown.len() < total { "…" } else { "" };
        let head = format!("{lead}{}", visible(head.iter().copied()));
        let under = visible(under.iter().copied());
        let rest = visible(rest.iter().copied());
        Excerpt {
            indent: head.width(),
            carets: under.width().max(1),
            text: format!("{head}{under}{rest}{trail}"),
        }
    }
}

/// The characters with each tab as one space, and [`hidden`] characters escaped.
pub(crate) fn visible(characters: impl Iterator<Item = char>) -> String {
    let mut shown = String::new();
    for character in characters {
        match character {
            '\t' => shown.push(' '),
            c if hidden(c).is_some() => shown.extend(c.escape_unicode()),
            c => shown.push(c),
        }
    }
    shown
}

#[cfg(test)]
mod tests {
    use super::*;

    fn excerpt_of(text: &str, needle: &str) -> Excerpt {
        let start = text.find(needle).unwrap();
        Source::new(text).excerpt(Span { start, end: start + needle.len() })
    }

    #[test]
    fn columns_count_characters_and_carets_count_terminal_columns() {
        let text = "a = 1\nname = \"学é\" # x\n";
        let source = Source::new(text);
        let hash = text.find('#').unwrap();
        assert_eq!(source.position(hash), Position { line: 2, column: 13 });
        assert_eq!(excerpt_of(text, "# x").indent, 13);
        assert_eq!(excerpt_of(text, "学é").carets, 3);
    }

    #[test]
    fn tabs_take_one_column_and_control_characters_are_escaped() {
        let excerpt = excerpt_of("\tsigma = \"\u{1b}[31m\"\r\n", "sigma");
        assert_eq!(excerpt.text, " sigma = \"\\u{1b}[31m\"");
        assert_eq!((excerpt.indent, excerpt.carets), (1, 5));
    }

    #[test]
    fn letters_of_every_script_are_seen_and_marks_of_layout_are_not() {
        let seen = "P-H-D é ñ 学 한 עברית عربي हिन्दी 🙂 ❤\u{fe0f} e\u{301} σ² ½ —";
        assert_eq!(seen.chars().find(|c| hidden(*c).is_some()), None);
        for c in
            ['\n', '\u{7f}', '\u{9b}', '\u{200b}', '\u{200d}', '\u{202e}', '\u{2066}', '\u{feff}']
        {
            assert!(hidden(c).is_some(), "{}", c.escape_unicode());
        }
    }

    #[test]
    fn a_long_line_is_cut_around_the_fault() {
        let text = format!("{}FAULT{}", "a".repeat(500), "b".repeat(500));
        let excerpt = excerpt_of(&text, "FAULT");
        assert!(excerpt.text.chars().count() < 130, "{}", excerpt.text);
        let carets: String = excerpt.text.chars().skip(excerpt.indent).take(5).collect();
        assert_eq!((carets.as_str(), excerpt.carets), ("FAULT", 5));
        assert!(excerpt.text.starts_with('…') && excerpt.text.ends_with('…'));
    }

    #[test]
    fn the_end_of_the_text_has_a_position_and_a_caret() {
        let source = Source::new("a = ");
        assert_eq!(source.position(99), Position { line: 1, column: 5 });
        assert_eq!(source.excerpt(Span { start: 99, end: 120 }).carets, 1);
        let empty = Source::new("");
        assert_eq!(empty.excerpt(Span { start: 0, end: 0 }).text, "");
    }
}
