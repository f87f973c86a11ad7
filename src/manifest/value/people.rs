//! Reads distributions and rows of participants, and files.

use std::fs::{self, File};
use std::io::{self, Read};

use toml::de::DeValue;

use crate::key::{
    Column, Content, ContentFault, ContentForm, Distribution, Kind, MOST_BYTES, NumberRange, Rows,
    Value,
};
use crate::manifest::value::sweep::{Node, Reader};
use crate::text::{Fault, Span};

impl Reader<'_> {
    /// A distribution of numbers in a range.
    pub(in crate::manifest) fn distribution(
        &mut self,
        name: &str,
        of: NumberRange,
        node: &Node,
    ) -> Option<Value> {
        match Distribution::read(of, node) {
            Ok(distribution) => Some(Value::Distribution(distribution)),
            Err(error) => {
                let fault = Fault::at(error.span.into(), format!("`{name}`: {}", error.says));
                self.faults.add(match error.help {
                    Some(help) => fault.help(help),
                    None => fault,
                });
                None
            }
        }
    }

    /// Rows, from tables, from a CSV file or from the text of one.
    pub(in crate::manifest) fn rows(
        &mut self,
        name: &str,
        known: &'static [Column],
        node: &Node,
    ) -> Option<Value> {
        let here = Span::from(node.span());
        let read = match node.get_ref() {
            DeValue::Array(items) => Rows::from_tables(known, items).map_err(|error| {
                let span = error.span.map_or(here, Span::from);
                Fault::at(span, format!("`{name}`: {}", error.says))
            }),
            DeValue::String(text) if Rows::is_none(text) => Ok(Rows::default()),
            DeValue::String(text) if Rows::is_csv(text) => Rows::from_csv(known, text)
                .map_err(|error| Fault::at(here, format!("`{name}`: {}", error.says))),
            DeValue::String(file) => self
                .file(file, MOST_BYTES)
                .and_then(|text| {
                    Rows::from_csv(known, &text)
                        .map_err(|error| format!("`{file}`, {}", error.says))
                })
                .map_err(|says| {
                    let fault = Fault::at(here, format!("`{name}`: {says}"));
                    fault.help("a CSV file has a line of names, then one line per row")
                }),
            _ => {
                self.expected(name, &Kind::Rows(known).expectation(), node);
                return None;
            }
        };
        match read {
            Ok(rows) if self.count_in(name, rows.len() * rows.columns().len(), node) => {
                Some(Value::Rows(rows))
            }
            Ok(_) => None,
            Err(fault) => {
                self.faults.add(fault);
                None
            }
        }
    }

    /// The content of a file, or of a text with a line break.
    pub(in crate::manifest) fn content(
        &mut self,
        name: &str,
        form: &'static ContentForm,
        node: &Node,
    ) -> Option<Value> {
        let DeValue::String(written) = node.get_ref() else {
            self.expected(name, &Kind::Content(form).expectation(), node);
            return None;
        };
        if Content::is_word_for_none(written) {
            return Some(Value::Content(Content::default()));
        }
        let of = || format!("`{written}`, ");
        let (text, of) = match (form.shipped(written), form.run(written)) {
            _ if written.contains('\n') => (Ok(written.clone().into_owned()), String::new()),
            (Some(text), _) => (Ok(text.to_owned()), of()),
            (_, Some(key)) => (self.run(written, key), of()),
            _ => (self.file(written, form.most_bytes), of()),
        };
        let is_missing = text.is_err();
        let is_file = !written.contains('\n') && form.shipped(written).is_none();
        let content = match text {
            Ok(text) => match Content::read(form, &text) {
                Ok(content) => Ok(content),
                Err(ContentFault::Says(says)) => Err(format!("{of}{says}")),
                Err(ContentFault::Listed(found)) => {
                    let path = self.folder.join(&**written).display().to_string();
                    let file = is_file.then_some(&*path);
                    Err(self.faults.add_of_file(file, Some(&text), found))
                }
            },
            Err(says) => Err(says),
        };
        match content {
            Ok(content) if is_file => {
                let path = self.folder.join(&**written);
                Some(Value::Content(content.of_file(&path.display().to_string())))
            }
            Ok(content) => Some(Value::Content(content)),
            Err(says) => {
                let fault = Fault::at(node.span().into(), format!("`{name}`: {says}"));
                self.faults.add(match form.help.filter(|_| is_missing) {
                    Some(help) => fault.help(help),
                    None => fault,
                });
                None
            }
        }
    }

    /// The text of the policy of a job.
    fn run(&mut self, written: &str, key: &str) -> Result<String, String> {
        let run = self.runs.0.ok_or_else(|| {
            format!(
                "`{written}` names a job of a store, and no store is read here; write the file that \
                 `jitai export --policy {key}` makes, or its name"
            )
        })?;
        let text = run(key).map_err(|says| format!("`{written}`: {says}"))?;
        self.named_runs.push((written.to_owned(), text.clone()));
        Ok(text)
    }

    /// The text of a file beside the manifest.
    fn file(&self, name: &str, most: u64) -> Result<String, String> {
        let path = self.folder.join(name);
        let shown = path.display();
        let unreadable = |reason: &str| format!("`{shown}` cannot be read: {reason}");
        let kind = fs::metadata(&path).map_err(|error| unreadable(&error.to_string()))?;
        // Opening a pipe could block forever.
        if !kind.is_file() {
            return Err(unreadable("it is not a regular file"));
        }
        let mut text = String::new();
        let file = File::open(&path).map_err(|error| unreadable(&error.to_string()))?;
        let read = file.take(most + 1).read_to_string(&mut text);
        read.map_err(|error| match error.kind() {
            io::ErrorKind::InvalidData => unreadable("it is not in UTF-8; save the file as UTF-8"),
            _ => unreadable(&error.to_string()),
        })?;
        if text.len() as u64 > most {
            return Err(unreadable(&format!("it is larger than {most} bytes")));
        }
        if text.starts_with('\u{feff}') {
            text.replace_range(..'\u{feff}'.len_utf8(), "");
        }
        Ok(text)
    }
}
