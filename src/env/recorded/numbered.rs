//! The text by which jobs know the file of a recorded trial, without what identifies its people.

use std::collections::HashMap;

use crate::env::declared::{header, reader};
use crate::env::recorded::parameters::LogParameters;
use crate::env::recorded::reading::LogColumns;

/// A file's text with the columns that the keys read, and people numbered from 1 in the order of their first rows. The
/// names stay where they are to be kept, or where an expression reads them as numbers. Numbering a numbered text changes nothing.
/// `None` for a text with faults.
pub(super) fn numbered(text: &str, of: &LogParameters) -> Option<String> {
    let mut reader = reader(text.as_bytes());
    let header = header(&mut reader).ok()?;
    let columns = LogColumns::new(of, &header).ok()?;
    let mut kept = columns.used();
    let has_names = of.keep_identifiers || kept.contains(&columns.person);
    kept.push(columns.person);
    kept.sort_unstable();
    kept.dedup();
    let mut out = csv::Writer::from_writer(Vec::with_capacity(text.len()));
    out.write_record(kept.iter().map(|column| header.name(*column))).ok()?;
    let mut numbers: HashMap<String, String> = HashMap::new();
    let mut record = csv::StringRecord::new();
    while reader.read_record(&mut record).ok()? {
        let name = &record[columns.person];
        if !has_names && !numbers.contains_key(name) {
            numbers.insert(name.to_owned(), (numbers.len() + 1).to_string());
        }
        let person = numbers.get(name).map_or(name, String::as_str);
        let cell =
            |column: &usize| if *column == columns.person { person } else { &record[*column] };
        out.write_record(kept.iter().map(cell)).ok()?;
    }
    String::from_utf8(out.into_inner().ok()?).ok()
}
