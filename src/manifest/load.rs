//! From a file to a validated manifest: bytes, text, TOML, draft, manifest, each with its faults.

use std::fs::{self, File};
use std::io::{self, Read};
use std::path::Path;

use toml::Spanned;
use toml::de::DeTable;

use super::declared::Manifest;
use super::fault::{Fault, FaultList, Faults};
use super::read::{newer_format, shortened};
use super::source::{Source, Span};
use super::sweep::Reader;
use super::{check, complete};

/// Most bytes of a manifest: a grid is swept by ranges, not by typing it out.
const MOST_BYTES: u64 = 10_000_000;

/// Reads and validates the manifest at `path`.
///
/// # Errors
/// Every fault of the file, in the form that authors see.
pub fn load(path: &Path) -> Result<Manifest, Faults> {
    let label = path.display().to_string();
    let bytes = read(path).map_err(|fault| Faults::of_file(&label, fault))?;
    parse(&label, &bytes)
}

fn read(path: &Path) -> Result<Vec<u8>, Fault> {
    let unreadable = |error: io::Error| match error.kind() {
        io::ErrorKind::NotFound => Fault::whole("no such file")
            .help("check the path; the shipped ones are in experiments/"),
        io::ErrorKind::PermissionDenied => {
            Fault::whole("permission denied").help("make the file readable for this user")
        }
        _ => Fault::whole(format!("cannot be read: {error}")),
    };
    let kind = fs::metadata(path).map_err(unreadable)?;
    if kind.is_dir() {
        let fault = Fault::whole("is a directory, not a manifest");
        return Err(fault.help("name the files in it, as in experiments/*.toml"));
    }
    // Opening a pipe may wait for ever for somebody to write into it.
    if !kind.is_file() {
        return Err(Fault::whole("is not a regular file").help("write the manifest to a file"));
    }
    let mut bytes = Vec::new();
    let file = File::open(path).map_err(unreadable)?;
    file.take(MOST_BYTES + 1).read_to_end(&mut bytes).map_err(unreadable)?;
    Ok(bytes)
}

/// Validates a manifest's bytes; `path` is how messages call the file.
///
/// # Errors
/// Every fault of the text, in the form that authors see.
pub fn parse(path: &str, bytes: &[u8]) -> Result<Manifest, Faults> {
    let text = decode(path, bytes)?;
    let Document { root, repeats, syntax, broken_at } = document(text);
    if let Some(fault) = newer_format(root.get_ref()) {
        return Err(Faults::of_text(path, text, fault));
    }
    let mut reader = Reader::new(text);
    let mut draft = reader.draft(root.get_ref());
    let mut faults = reader.faults;
    faults.append(repeats);
    if !syntax.is_empty() {
        // What is missing, or wrong on the same line or after a break, may be an echo of it.
        let source = Source::new(text);
        faults.retain_off_lines_of(&syntax, &source);
        faults.retain_before(broken_at);
        faults.append(syntax);
        return Err(faults.of(path, source));
    }
    let manifest = complete::complete(&draft, path, text, &mut faults);
    // That there is no agent has been noted; no condition on one is at fault as well.
    draft.invalid_agents |= draft.agents.is_empty();
    let manifest = check::check(&draft, manifest, &mut faults);
    if faults.is_empty() { Ok(manifest) } else { Err(faults.of(path, Source::new(text))) }
}

/// The bytes as text, without a byte-order mark.
fn decode<'b>(path: &str, bytes: &'b [u8]) -> Result<&'b str, Faults> {
    if bytes.len() as u64 > MOST_BYTES {
        let fault = Fault::whole(format!("the file has more than {MOST_BYTES} bytes"));
        return Err(Faults::of_file(path, fault.help("sweeps are shorter as ranges")));
    }
    let text = str::from_utf8(bytes).map_err(|error| {
        let offset = error.valid_up_to();
        let before = str::from_utf8(&bytes[..offset]).expect("valid up to there");
        let message = format!("not UTF-8: byte 0x{:02x} at offset {offset}", bytes[offset]);
        let fault = Fault::at(Span { start: offset, end: offset }, message);
        Faults::of_text(path, before, fault.help("save the file with the encoding UTF-8"))
    })?;
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    if text.trim().is_empty() {
        let fault = Fault::whole("the file is empty");
        return Err(Faults::of_file(path, fault.help("start from experiments/quickstart.toml")));
    }
    match text.find('\0') {
        None => Ok(text),
        Some(start) => {
            let message = format!("byte 0x00 at offset {start}: not a text file");
            let fault = Fault::at(Span { start, end: start + 1 }, message);
            Err(Faults::of_text(path, text, fault))
        }
    }
}

/// A TOML text as far as it could be read.
pub(crate) struct Document<'t> {
    pub(crate) root: Spanned<DeTable<'t>>,
    /// Keys set a second time, which leave the rest readable.
    pub(crate) repeats: FaultList,
    pub(crate) syntax: FaultList,
    /// From here on, lines may have been read as part of something that was not closed.
    broken_at: usize,
}

/// Reads a TOML text, and on behind a fault of its syntax.
pub(crate) fn document(text: &str) -> Document<'_> {
    let (root, errors) = DeTable::parse_recoverable(text);
    let span = |error: &toml::de::Error| error.span().map_or(Span { start: 0, end: 0 }, Span::from);
    let mut errors: Vec<(Span, &str)> =
        errors.iter().map(|error| (span(error), error.message())).collect();
    errors.sort_by_key(|(span, _)| *span);
    let source = Source::new(text);
    let (mut repeats, mut syntax) = (FaultList::default(), FaultList::default());
    let (mut broken_at, mut last_line) = (usize::MAX, 0);
    for (span, message) in errors {
        let line = source.position(span.start).line;
        if line == last_line {
            continue;
        }
        last_line = line;
        let written = text.get(span.start..span.end).unwrap_or("");
        if message == "duplicate key" {
            let name = shortened(written);
            repeats.add(Fault::at(span, format!("`{name}` is set a second time")));
            continue;
        }
        let fault = Fault::at(span, in_our_words(message, written));
        if breaks_structure(message) {
            broken_at = span.start;
            syntax.add(fault.help("a list or table that was opened before this may not be closed"));
            break;
        }
        syntax.add(fault);
    }
    Document { root, repeats, syntax, broken_at }
}

fn in_our_words(message: &str, written: &str) -> String {
    match (message.starts_with("string values must be quoted"), written) {
        (true, "") => "a value is missing".to_owned(),
        (true, word) => format!("`{}` is not a value: text stands in quotes", shortened(word)),
        (false, _) => format!("not valid TOML: {message}"),
    }
}

/// Whether a fault of the syntax makes the parser lose track of what belongs to what.
fn breaks_structure(message: &str) -> bool {
    ["array", "inline table", "recurse"].iter().any(|word| message.contains(word))
}
