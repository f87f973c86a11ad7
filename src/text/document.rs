//! Reads a TOML text as far as possible: its tree, and the faults of its notation in our words.

use toml::Spanned;
use toml::de::DeTable;

use crate::text::fault::{Fault, FaultList, shortened};
use crate::text::source::{Source, Span};

/// A TOML text, as far as the parser could read it.
pub(crate) struct Document<'t> {
    pub(crate) root: Spanned<DeTable<'t>>,
    /// Keys that are set a second time; the rest of the document remains readable.
    pub(crate) repeats: FaultList,
    pub(crate) syntax: FaultList,
    /// The offset from which lines may belong to an unclosed list or table.
    pub(crate) broken_at: usize,
}

/// Reads a TOML text, and continues after syntax faults.
pub(crate) fn document(text: &str) -> Document<'_> {
    let (root, errors) = DeTable::parse_recoverable(text);
    let (mut repeats, mut syntax) = (FaultList::default(), FaultList::default());
    let mut broken_at = usize::MAX;
    for broken in broken(text, &errors) {
        if broken.is_repeat {
            repeats.add(broken.fault);
            continue;
        }
        syntax.add(broken.fault);
        if broken.breaks_structure {
            broken_at = broken.span.start;
            break;
        }
    }
    Document { root, repeats, syntax, broken_at }
}

/// A fault that the parser found.
struct Broken {
    span: Span,
    fault: Fault,
    /// Whether a key is set a second time.
    is_repeat: bool,
    /// Whether the parser loses the structure of the document after the fault.
    breaks_structure: bool,
}

/// The faults that the parser found in a text, by position; at most one per line.
fn broken(text: &str, errors: &[toml::de::Error]) -> Vec<Broken> {
    let span = |error: &toml::de::Error| error.span().map_or(Span { start: 0, end: 0 }, Span::from);
    let mut errors: Vec<(Span, &str)> =
        errors.iter().map(|error| (span(error), error.message())).collect();
    errors.sort_by_key(|(span, _)| *span);
    let source = Source::new(text);
    let (mut last_line, mut repeated_until) = (0, 0);
    let mut all = Vec::new();
    for (span, message) in errors {
        let line = source.position(span.start).line;
        let is_repeat = message == "duplicate key";
        if line == last_line || (is_repeat && span.start < repeated_until) {
            continue;
        }
        last_line = line;
        let written = text.get(span.start..span.end).unwrap_or("");
        let breaks_structure = breaks_structure(message);
        let fault = match is_repeat {
            true => Fault::at(span, format!("`{}` is set twice", shortened(written))),
            false => Fault::at(span, in_our_words(message, written)),
        };
        // Keys of a table that is opened twice are set twice because of the table.
        if is_repeat && text[..span.start].trim_end_matches([' ', '\t']).ends_with('[') {
            let next = text[span.start..].find("\n[").map_or(text.len(), |next| span.start + next);
            repeated_until = next;
        }
        let fault = match breaks_structure {
            true => fault.help("check that every earlier list and table is closed"),
            false => fault,
        };
        all.push(Broken { span, fault, is_repeat, breaks_structure });
    }
    all
}

fn in_our_words(message: &str, written: &str) -> String {
    match (message.starts_with("string values must be quoted"), written) {
        (true, "") => "a value is missing".to_owned(),
        (true, word) if word.starts_with(['“', '”', '„', '«', '‘', '’']) => {
            format!(
                "`{}` has curly quotes; text needs straight ones, as in \"text\"",
                shortened(word)
            )
        }
        (true, flag @ ("yes" | "no" | "on" | "off")) => {
            format!("`{flag}` is not a value: a flag is true or false, and text needs quotes")
        }
        (true, word) => format!("`{}` is not a value: text needs quotes", shortened(word)),
        (false, _) => format!("not valid TOML: {message}"),
    }
}

/// Whether the parser loses the structure of the document after this syntax fault.
fn breaks_structure(message: &str) -> bool {
    ["array", "inline table", "recurse"].iter().any(|word| message.contains(word))
}
