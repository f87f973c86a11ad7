//! Texts of files that a key names. A file is known by its content, wherever it lies.

use std::any::Any;
use std::fmt;
use std::path::Path;
use std::sync::Arc;

use data_encoding::HEXLOWER;
use sha2::{Digest, Sha256};

use crate::text::FaultList;

/// The form of the texts of a key.
#[derive(Debug)]
pub struct ContentForm {
    /// What the file is, to follow "the name of": "a CSV file of participants".
    pub what: &'static str,
    /// Parses a text; the error says what is wrong and where.
    pub parse: fn(&str) -> Result<Parsed, ContentFault>,
    /// The part of a text by which it is known, as a text of the same form; `None` for the whole text. A form with
    /// such a part also takes `run:KEY`, a completed job of a store, whose policy has this form.
    pub canonical: Option<Canonical>,
    /// Texts that come with the program, by the names that stand for them in the place of a file's.
    pub shipped: &'static [(&'static str, &'static str)],
    /// What to do where the file is missing.
    pub help: Option<&'static str>,
    /// Maximum size of the file in bytes.
    pub most_bytes: u64,
}

/// Maximum size of most files in bytes.
pub const MOST_BYTES: u64 = 10_000_000;

/// What is wrong with a text.
#[derive(Debug)]
pub enum ContentFault {
    /// This, with the line.
    Says(String),
    /// These faults, by their positions.
    Listed(FaultList),
}

impl fmt::Display for ContentFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            ContentFault::Says(says) => f.write_str(says),
            ContentFault::Listed(faults) => {
                f.write_str(&faults.messages().collect::<Vec<_>>().join("; "))
            }
        }
    }
}

impl From<String> for ContentFault {
    fn from(says: String) -> ContentFault {
        ContentFault::Says(says)
    }
}

impl ContentForm {
    /// The admitted values, in words.
    pub fn expectation(&self) -> String {
        let run = if self.canonical.is_some() { ", \"run:\" and the key of a job" } else { "" };
        let shipped =
            self.shipped.iter().map(|(name, _)| format!(", \"{name}\"")).collect::<String>();
        format!("\"none\"{run}{shipped}, or the name of {}", self.what)
    }

    /// The text that comes with the program under this name.
    pub fn shipped(&self, written: &str) -> Option<&'static str> {
        self.shipped.iter().find(|(name, _)| *name == written).map(|(_, text)| *text)
    }

    /// The key of the job that a value names instead of a file.
    pub fn run<'t>(&self, written: &'t str) -> Option<&'t str> {
        written.strip_prefix(RUN).filter(|_| self.canonical.is_some())
    }
}

/// Stands before the key of a job.
const RUN: &str = "run:";

/// Returns the part of a text by which it is known; the error says what is wrong.
pub type Canonical = fn(&str) -> Result<String, String>;

/// What a text has been parsed to.
pub type Parsed = Arc<dyn Any + Send + Sync>;

impl PartialEq for ContentForm {
    fn eq(&self, other: &ContentForm) -> bool {
        self.what == other.what
    }
}

/// The text of a file, or none. A text whose first line begins with `# synthetic` is invented, and its name says so
/// wherever a job is shown. Equal texts are equal, whatever the names of their files and the ends of their lines.
///
/// Jobs name a text by its SHA-256 alone, so that a store of many jobs stays small. A job that is read from a store
/// therefore lacks the text.
#[derive(Clone, Debug, Default)]
pub struct Content(Option<Arc<Known>>);

#[derive(Debug)]
struct Known {
    is_synthetic: bool,
    /// In hexadecimal digits.
    sha256: String,
    /// The text with what it has been parsed to; `None` if only the digest is known.
    text: Option<(String, Parsed)>,
    /// The name of the file, for messages; it is no part of the content.
    file: Option<String>,
}

/// A text with line feeds, without a byte-order mark.
fn plain(text: &str) -> String {
    text.trim_start_matches('\u{feff}').replace("\r\n", "\n")
}

/// The SHA-256 of some bytes, in hexadecimal digits.
pub fn digest(bytes: &[u8]) -> String {
    HEXLOWER.encode(&Sha256::digest(bytes))
}

/// The word for no text.
const NONE: &str = "none";
/// Stands before a digest.
const PREFIX: &str = "sha256:";
/// Number of hexadecimal digits of a digest.
const DIGITS: usize = 64;
/// Number of the digits that readers see.
const SHOWN_DIGITS: usize = 8;
/// Stands before both for an invented text.
const SYNTHETIC: &str = "synthetic:";
/// The first line of an invented text begins so.
const MARK: &str = "# synthetic";

impl Content {
    /// The content of a file of this form with this text.
    ///
    /// **Errors**: the text is not of this form.
    pub fn read(form: &ContentForm, text: &str) -> Result<Content, ContentFault> {
        let mut text =
            form.canonical.map_or(Ok(plain(text)), |canonical| canonical(&plain(text)))?;
        text.truncate(text.trim_end().len());
        text.push('\n');
        let parsed = (form.parse)(&text)?;
        Ok(Content(Some(Arc::new(Known {
            is_synthetic: text.starts_with(MARK),
            sha256: digest(text.as_bytes()),
            text: Some((text, parsed)),
            file: None,
        }))))
    }

    /// The same content, of the file of this name.
    pub fn of_file(self, name: &str) -> Content {
        let Some(known) = self.0 else { return self };
        let Known { is_synthetic, sha256, text, .. } = &*known;
        let file = Some(name.to_owned());
        Content(Some(Arc::new(Known {
            is_synthetic: *is_synthetic,
            sha256: sha256.clone(),
            text: text.clone(),
            file,
        })))
    }

    /// The same file and what it was parsed to, known by this part of its text.
    pub fn known_by(&self, text: String) -> Content {
        let Some(known) = &self.0 else { return Content::default() };
        let parsed = known.text.as_ref().map(|(_, parsed)| Arc::clone(parsed));
        Content(Some(Arc::new(Known {
            is_synthetic: known.is_synthetic,
            sha256: digest(text.as_bytes()),
            text: parsed.map(|parsed| (text, parsed)),
            file: known.file.clone(),
        })))
    }

    /// The name of the file, if it is known.
    pub fn file(&self) -> Option<&str> {
        self.0.as_ref()?.file.as_deref()
    }

    /// The digest as [`Content::name`] has it, and the name of the file without its folder, if it is known.
    pub fn digest_and_file(&self) -> Option<(String, String)> {
        let known = self.0.as_ref()?;
        let file = Path::new(known.file.as_deref()?).file_name()?.to_str()?;
        Some((format!("{PREFIX}{}", known.sha256), file.to_owned()))
    }

    /// Whether the key names no file.
    pub fn is_none(&self) -> bool {
        self.0.is_none()
    }

    /// The text with line feeds and one at its end; `None` if the key names no file, or if only the digest is
    /// known.
    pub fn text(&self) -> Option<&str> {
        self.0.as_ref()?.text.as_ref().map(|(text, _)| text.as_str())
    }

    /// What the text was parsed to. `None` if there is no text, or if it was parsed to another type.
    pub fn parsed<T: Send + Sync + 'static>(&self) -> Option<Arc<T>> {
        let (_, parsed) = self.0.as_ref()?.text.as_ref()?;
        Arc::clone(parsed).downcast().ok()
    }

    /// The name that jobs have: `sha256:` with hexadecimal digits, `synthetic:` before it for an invented text, or
    /// `none`.
    pub fn name(&self) -> String {
        let Some(known) = &self.0 else { return NONE.to_owned() };
        let mark = if known.is_synthetic { SYNTHETIC } else { "" };
        format!("{mark}{PREFIX}{}", known.sha256)
    }

    /// The content of a name of [`Content::name`], without its text.
    pub(super) fn named(name: &str) -> Option<Content> {
        if name == NONE {
            return Some(Content::default());
        }
        let digest = name.strip_prefix(SYNTHETIC);
        let is_synthetic = digest.is_some();
        let sha256 = digest.unwrap_or(name).strip_prefix(PREFIX)?.to_owned();
        let is_digest = sha256.len() == DIGITS && HEXLOWER.decode(sha256.as_bytes()).is_ok();
        is_digest.then(|| {
            Content(Some(Arc::new(Known { is_synthetic, sha256, text: None, file: None })))
        })
    }

    /// Whether a text in a manifest is the word for no text.
    pub fn is_word_for_none(text: &str) -> bool {
        text == NONE
    }
}

/// A text for readers: the names of [`Content::name`] in the text have eight hexadecimal digits.
pub fn shortened(text: &str) -> String {
    let mut out = String::new();
    let mut rest = text;
    while let Some(at) = rest.find(PREFIX) {
        let (before, digest) = rest.split_at(at + PREFIX.len());
        let digits = digest.bytes().take_while(u8::is_ascii_hexdigit).count();
        let shown = if digits == DIGITS { SHOWN_DIGITS } else { digits };
        out += before;
        out += &digest[..shown];
        rest = &digest[digits..];
    }
    out + rest
}

impl PartialEq for Content {
    fn eq(&self, other: &Content) -> bool {
        self.name() == other.name()
    }
}

impl fmt::Display for Content {
    /// Writes the name in quotes, as messages do. A manifest has the name of the file or its text.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "\"{}\"", self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    static NUMBER: ContentForm = ContentForm {
        what: "a number",
        parse: |text| match text.trim_start_matches("# synthetic").trim().parse::<u32>() {
            Ok(number) => Ok(Arc::new(number)),
            Err(error) => Err(error.to_string().into()),
        },
        canonical: None,
        shipped: &[],
        help: None,
        most_bytes: MOST_BYTES,
    };

    #[test]
    fn a_text_is_known_by_its_content() {
        let read = |text| Content::read(&NUMBER, text).unwrap();
        let one = read("7\r\n");
        assert_eq!(one, read("\u{feff}7"));
        assert_ne!(one, read("8"));
        assert_eq!((one.text(), one.parsed::<u32>().as_deref()), (Some("7\n"), Some(&7)));
        assert!(one.parsed::<u64>().is_none());
        let named = Content::named(&one.name()).unwrap();
        assert_eq!((named.text(), &named), (None, &one));
        assert!(named.parsed::<u32>().is_none());
        assert_eq!(Content::named("none"), Some(Content::default()));
        assert_eq!(Content::named("sha256:12"), None);
        assert_eq!(one.to_string(), format!("\"{}\"", one.name()));
        assert!(Content::read(&NUMBER, "seven").is_err());
        let digest = "0123456789abcdef".repeat(4);
        let both = |digits: &str| format!("sha256:{digits} - synthetic:sha256:{digits} σ=1");
        assert_eq!(shortened(&both(&digest)), both("01234567"));
        let others = format!("none sha256: sha256:{digest}0 {digest}");
        assert_eq!(shortened(&others), others);
        let invented = read("# synthetic\n7");
        assert!(invented.name().starts_with("synthetic:sha256:"));
        assert_eq!(Content::named(&invented.name()), Some(invented));
    }
}
