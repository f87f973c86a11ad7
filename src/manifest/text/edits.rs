//! Changes of a text, through which positions in the changed text are traced back to the original.

use crate::text::Span;

/// Changes that were made one after the other.
#[derive(Clone, Debug, Default)]
pub(crate) struct Edits(Vec<Edit>);

/// A stretch of the text that another stretch replaced, in bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Edit {
    /// Where both stretches start, in the text that the earlier changes left.
    start: usize,
    old: usize,
    new: usize,
}

impl Edits {
    /// Adds the change from `before` to `after`, as the shortest stretch that covers all differences.
    pub fn add(&mut self, before: &str, after: &str) {
        let same = |(one, other): &(u8, u8)| one == other;
        let start = before.bytes().zip(after.bytes()).take_while(same).count();
        let (old, new) = (&before.as_bytes()[start..], &after.as_bytes()[start..]);
        let pairs = old.iter().rev().copied().zip(new.iter().rev().copied());
        let end = pairs.take_while(same).count();
        self.0.push(Edit { start, old: old.len() - end, new: new.len() - end });
    }

    /// The span in the original text, and the index of the last change that the span touches.
    pub fn original(&self, mut span: Span) -> (Span, Option<usize>) {
        let mut touched = None;
        for (index, edit) in self.0.iter().enumerate().rev() {
            let end = edit.start + edit.new;
            // A change that leaves nothing touches the span around its place.
            let touches = match edit.new {
                0 => span.start <= end && edit.start <= span.end,
                _ => span.start < end && edit.start < span.end,
            };
            if touched.is_none() && touches {
                touched = Some(index);
            }
            let back = |offset: usize, within: usize| match offset {
                _ if offset >= end => offset - edit.new + edit.old,
                _ if offset > edit.start => within,
                _ => offset,
            };
            let (start, end) =
                (back(span.start, edit.start), back(span.end, edit.start + edit.old));
            span = Span { start, end: end.max(start) };
        }
        (span, touched)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn span_of(text: &str, part: &str) -> Span {
        let start = text.find(part).unwrap();
        Span { start, end: start + part.len() }
    }

    #[test]
    fn a_change_is_found_by_comparison_and_touches_what_it_changed() {
        let texts = ["a = [1, 2]\nb = 2\n", "a = 1\nb = 2\n", "a = 1\nx = 5\nb = 2\n"];
        let mut edits = Edits::default();
        edits.add(texts[0], texts[1]);
        edits.add(texts[1], texts[2]);
        let original = |part| edits.original(span_of(texts[2], part));
        assert_eq!(original("b"), (span_of(texts[0], "b"), None));
        assert_eq!(original("1"), (span_of(texts[0], "[1, 2]"), Some(0)));
        assert_eq!(original("x = 5").1, Some(1));
    }
}
