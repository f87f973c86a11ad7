//! Rows for people and for programs: aligned text, CSV or JSON on standard output.

use std::borrow::Cow;
use std::io::{self, Write};

use clap::ValueEnum;
use comfy_table::{CellAlignment, ColumnConstraint, ContentArrangement, Table, Width, presets};
use data_encoding::HEXLOWER;
use serde_json::Value;

pub(super) use crate::job::counted;
use crate::key::printable;
pub(super) use crate::report::no_experiment;
use crate::report::{defused, rounded};

/// Spaces on the left and on the right of each column of a table.
const PADDING: (u16, u16) = (0, 2);

/// Number of rows that are aligned together. Longer tables are written in blocks of this size.
const ALIGNED_TOGETHER: usize = 10_000;

/// Maximum number of characters of a field in a table.
const MOST_SHOWN: usize = 2_000;

/// Output format of rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Format {
    /// Aligned columns for reading.
    Table,
    /// Comma-separated values with a header line (RFC 4180); a text that a spreadsheet would execute
    /// gets a leading apostrophe.
    Csv,
    /// A JSON array with one object per line.
    Json,
}

/// Output format of a report about a store.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum TextOrJson {
    /// Text for reading.
    Text,
    /// One JSON object.
    Json,
}

/// One value of a row.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum OutputField<'a> {
    /// No value: empty in text and CSV, `null` in JSON.
    Empty,
    /// A whole number.
    Integer(i64),
    /// A number that a table shows with 12 significant digits; full precision in CSV and JSON.
    Real(f64),
    /// A number that a table shows with this number of decimals; full precision in CSV and JSON. Zero has
    /// no sign.
    Rounded(f64, usize),
    /// Numbers written out, such as `12.3 ± 4.5`.
    Figure(String),
    /// Text.
    Text(Cow<'a, str>),
    /// Bytes, written as an SQL literal.
    Bytes(&'a [u8]),
    /// A list or object; written as text except in JSON.
    Nested(Value),
}

impl<'a> OutputField<'a> {
    pub(super) fn text(text: impl Into<Cow<'a, str>>) -> Self {
        OutputField::Text(text.into())
    }

    fn is_number(&self) -> bool {
        matches!(
            self,
            OutputField::Integer(_)
                | OutputField::Real(_)
                | OutputField::Rounded(..)
                | OutputField::Figure(_)
        )
    }

    /// The text for a table: rounded, with control characters escaped, and cut if it is long.
    fn for_reading(&self) -> String {
        match self {
            OutputField::Rounded(value, decimals) => rounded(*value, *decimals),
            OutputField::Real(value) => short(significant(*value)),
            OutputField::Text(text) => shown(text),
            OutputField::Nested(value) => shown(&value.to_string()),
            OutputField::Bytes(bytes) if bytes.len() > MOST_SHOWN / 2 => {
                let first = HEXLOWER.encode(&bytes[..MOST_SHOWN / 2]);
                format!("x'{first}… ({} bytes)", bytes.len())
            }
            OutputField::Empty
            | OutputField::Integer(_)
            | OutputField::Figure(_)
            | OutputField::Bytes(_) => self.exact().into_owned(),
        }
    }

    /// The text with every digit.
    fn exact(&self) -> Cow<'_, str> {
        match self {
            OutputField::Empty => Cow::Borrowed(""),
            OutputField::Integer(value) => Cow::Owned(value.to_string()),
            OutputField::Real(value) => Cow::Owned(short(*value)),
            // Adding 0 removes the sign of −0.
            OutputField::Rounded(value, _) => Cow::Owned(short(value + 0.0)),
            OutputField::Figure(text) => Cow::Borrowed(text),
            OutputField::Text(text) => Cow::Borrowed(text),
            OutputField::Bytes(bytes) => Cow::Owned(as_sql(bytes)),
            OutputField::Nested(value) => Cow::Owned(value.to_string()),
        }
    }

    /// The text for CSV, safe to open in a spreadsheet.
    fn for_csv(&self) -> Cow<'_, str> {
        match self {
            OutputField::Text(text) => defused(text),
            _ => self.exact(),
        }
    }

    /// Writes the field as JSON, long bytes in pieces.
    fn write_json(&self, out: &mut impl Write) -> io::Result<()> {
        match self {
            OutputField::Empty => out.write_all(b"null"),
            OutputField::Integer(value) => Ok(serde_json::to_writer(out, value)?),
            OutputField::Real(value) => Ok(serde_json::to_writer(out, value)?),
            OutputField::Rounded(value, _) => Ok(serde_json::to_writer(out, &(value + 0.0))?),
            OutputField::Figure(text) => Ok(serde_json::to_writer(out, text)?),
            OutputField::Text(text) => Ok(serde_json::to_writer(out, text)?),
            OutputField::Bytes(bytes) => {
                out.write_all(b"\"x'")?;
                for piece in bytes.chunks(1 << 12) {
                    out.write_all(HEXLOWER.encode(piece).as_bytes())?;
                }
                out.write_all(b"'\"")
            }
            OutputField::Nested(value) => Ok(serde_json::to_writer(out, value)?),
        }
    }
}

/// The number with 12 significant digits, as many as the values of a range have, and with all digits before
/// its point.
fn significant(number: f64) -> f64 {
    const ALL_WHOLE: f64 = 1e12;
    if number.abs() >= ALL_WHOLE {
        return number;
    }
    format!("{number:.11e}").parse().unwrap_or(number)
}

/// Every digit of a number, with an exponent if it would begin or end with many zeros.
fn short(number: f64) -> String {
    let size = number.abs();
    let is_plain = size == 0.0 || (1e-5..1e17).contains(&size) || !size.is_finite();
    if is_plain { number.to_string() } else { format!("{number:e}") }
}

/// The maximum width of a table, from the environment variable `COLUMNS`; `None` for any width.
fn widest() -> Option<u16> {
    std::env::var("COLUMNS").ok()?.trim().parse().ok().filter(|columns| *columns > 0)
}

/// Bytes as an SQL literal.
pub(super) fn as_sql(bytes: &[u8]) -> String {
    format!("x'{}'", HEXLOWER.encode(bytes))
}

/// The text for a table: [`printable`], and cut if it is long.
fn shown(text: &str) -> String {
    match text.char_indices().nth(MOST_SHOWN) {
        None => printable(text),
        Some((end, _)) => {
            format!("{}… ({} characters)", printable(&text[..end]), text.chars().count())
        }
    }
}

/// A word for a shell, quoted if necessary.
pub(super) fn shell_word(text: &str) -> String {
    let plain = |c: char| c.is_alphanumeric() || "/._-".contains(c);
    if !text.is_empty() && text.chars().all(plain) {
        text.to_owned()
    } else if text.contains(['"', '$', '`', '\\', '!']) || !text.contains('\'') {
        format!("'{}'", text.replace('\'', "'\\''"))
    } else {
        format!("\"{text}\"")
    }
}

/// A writer of rows with the same columns.
pub(super) enum OutputRows<W: Write> {
    /// Rows are collected to find the widths of the columns, and written in blocks. The widths of
    /// earlier blocks are minimum widths for the next block.
    Table(W, Box<Table>, Vec<u16>),
    /// Written immediately.
    Csv(Box<csv::Writer<W>>),
    /// Written immediately, with the names of the columns and the number of rows so far.
    Json(W, Vec<String>, usize),
}

impl<W: Write> OutputRows<W> {
    /// Starts a writer of rows with these columns.
    pub(super) fn new(format: Format, columns: &[String], mut out: W) -> io::Result<Self> {
        Ok(match format {
            Format::Table => {
                let mut table = empty(columns.len());
                table.set_header(columns.iter().map(|name| shown(name)));
                lay_out(&mut table, &[]);
                OutputRows::Table(out, Box::new(table), Vec::new())
            }
            Format::Csv => {
                let mut writer = csv::Writer::from_writer(out);
                writer.write_record(columns).map_err(cause)?;
                OutputRows::Csv(Box::new(writer))
            }
            Format::Json => {
                out.write_all(b"[")?;
                OutputRows::Json(out, columns.to_vec(), 0)
            }
        })
    }

    /// Adds a row, one field per column.
    pub(super) fn row(&mut self, fields: &[OutputField<'_>]) -> io::Result<()> {
        match self {
            OutputRows::Table(out, table, widths) => {
                if table.row_count() >= ALIGNED_TOGETHER {
                    print(table, out)?;
                    *widths = table.column_max_content_widths();
                    **table = empty(widths.len());
                }
                for (field, column) in fields.iter().zip(table.column_iter_mut()) {
                    // The cell's alignment also applies to the header.
                    if field.is_number() {
                        column.set_cell_alignment(CellAlignment::Right);
                    }
                }
                table.add_row(fields.iter().map(|field| {
                    let side =
                        if field.is_number() { CellAlignment::Right } else { CellAlignment::Left };
                    comfy_table::Cell::new(field.for_reading()).set_alignment(side)
                }));
                if table.row_count() == 1 {
                    lay_out(table, widths);
                }
            }
            OutputRows::Csv(writer) => {
                for field in fields {
                    writer.write_field(field.for_csv().as_bytes()).map_err(cause)?;
                }
                writer.write_record(None::<&[u8]>).map_err(cause)?;
            }
            OutputRows::Json(out, columns, count) => {
                out.write_all(if *count == 0 { b"\n{" } else { b",\n{" })?;
                // A map would sort the columns by name.
                for (i, (name, field)) in columns.iter().zip(fields).enumerate() {
                    if i > 0 {
                        out.write_all(b",")?;
                    }
                    serde_json::to_writer(&mut *out, name)?;
                    out.write_all(b":")?;
                    field.write_json(out)?;
                }
                out.write_all(b"}")?;
                *count += 1;
            }
        }
        Ok(())
    }

    /// Writes the end of the output.
    pub(super) fn finish(self) -> io::Result<()> {
        match self {
            OutputRows::Table(mut out, table, _) => {
                print(&table, &mut out)?;
                out.flush()
            }
            OutputRows::Csv(mut writer) => writer.flush(),
            OutputRows::Json(mut out, _, count) => {
                out.write_all(if count == 0 { b"]\n" } else { b"\n]\n" })?;
                out.flush()
            }
        }
    }
}

/// A table without rows, for this number of columns. It is not narrower than its columns can be read.
fn empty(columns: usize) -> Table {
    const NARROWEST: usize = 8;
    let mut table = Table::new();
    table.load_style(presets::NOTHING);
    if let Some(width) = widest().filter(|width| usize::from(*width) >= NARROWEST * columns) {
        table.set_content_arrangement(ContentArrangement::Dynamic);
        table.set_width(width);
    }
    table
}

fn print(table: &Table, out: &mut impl Write) -> io::Result<()> {
    table.lines().try_for_each(|line| writeln!(out, "{}", line.trim_end()))
}

/// Sets the padding and the minimum widths of the columns.
fn lay_out(table: &mut Table, widths: &[u16]) {
    let widths = widths.iter().copied().chain(std::iter::repeat(0));
    for (column, width) in table.column_iter_mut().zip(widths) {
        column.set_padding(PADDING);
        let width = Width::Fixed(width + PADDING.0 + PADDING.1);
        column.set_constraint(ColumnConstraint::LowerBoundary(width));
    }
}

/// The I/O error behind a CSV error, which keeps a closed pipe recognisable.
pub(super) fn cause(error: csv::Error) -> io::Error {
    match error.into_kind() {
        csv::ErrorKind::Io(error) => error,
        other => io::Error::other(format!("{other:?}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(format: Format) -> String {
        let mut out = Vec::new();
        let columns = ["name", "mean"].map(str::to_owned);
        let mut rows = OutputRows::new(format, &columns, &mut out).unwrap();
        rows.row(&[OutputField::text("a,\"b\"\u{1b}[31m"), OutputField::Rounded(1234.5678, 1)])
            .unwrap();
        rows.row(&[OutputField::text("c"), OutputField::Empty]).unwrap();
        rows.finish().unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn tables_round_align_and_escape() {
        let expected = "name               mean\na,\"b\"\\u{1b}[31m  1234.6\nc\n";
        assert_eq!(written(Format::Table), expected);
    }

    #[test]
    fn formulas_are_defused_in_csv_and_numbers_are_not() {
        let mut out = Vec::new();
        let columns = ["a", "b", "c"].map(str::to_owned);
        let mut rows = OutputRows::new(Format::Csv, &columns, &mut out).unwrap();
        let bytes = [0, 0xaf];
        rows.row(&[
            OutputField::text("=cmd()"),
            OutputField::text("-0.5"),
            OutputField::Bytes(&bytes),
        ])
        .unwrap();
        rows.row(&[
            OutputField::Real(-0.5),
            OutputField::Figure("-1 ± 2".into()),
            OutputField::Empty,
        ])
        .unwrap();
        rows.finish().unwrap();
        let text = String::from_utf8(out).unwrap();
        assert_eq!(text, "a,b,c\n'=cmd(),-0.5,x'00af'\n-0.5,-1 ± 2,\n");
    }

    #[test]
    fn rows_past_those_aligned_together_keep_the_same_columns() {
        let mut out = Vec::new();
        let columns = ["name", "count", "note"].map(str::to_owned);
        let mut rows = OutputRows::new(Format::Table, &columns, &mut out).unwrap();
        for row in 0..=ALIGNED_TOGETHER {
            let name = if row == 0 { "a long name" } else { "x" };
            rows.row(&[OutputField::text(name), OutputField::Integer(7), OutputField::text("end")])
                .unwrap();
        }
        rows.finish().unwrap();
        let text = String::from_utf8(out).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 2 + ALIGNED_TOGETHER);
        assert_eq!(lines[ALIGNED_TOGETHER], lines[ALIGNED_TOGETHER + 1]);
        assert_eq!(lines[2], "x                7  end");
    }

    #[test]
    fn zero_has_no_sign_unless_a_query_returns_one() {
        let (nothing, little) = (OutputField::Rounded(-0.0, 2), OutputField::Rounded(-0.004, 2));
        assert_eq!([&nothing, &little].map(OutputField::for_reading), ["0.00", "0.00"]);
        assert_eq!([&nothing, &little].map(|field| field.exact().into_owned()), ["0", "-0.004"]);
        let json = |field: OutputField<'_>| {
            let mut out = Vec::new();
            field.write_json(&mut out).unwrap();
            String::from_utf8(out).unwrap()
        };
        assert_eq!((json(nothing), json(OutputField::Real(-0.0))), ("0.0".into(), "-0.0".into()));
    }

    #[test]
    fn words_for_a_shell_are_quoted_as_they_need() {
        for (text, expected) in [
            ("results/a.sqlite", "results/a.sqlite"),
            ("a b", "'a b'"),
            ("it's", "\"it's\""),
            ("it's $5", "'it'\\''s $5'"),
            ("", "''"),
        ] {
            assert_eq!(shell_word(text), expected);
        }
    }

    #[test]
    fn csv_keeps_every_digit_and_quotes() {
        assert_eq!(written(Format::Csv), "name,mean\n\"a,\"\"b\"\"\u{1b}[31m\",1234.5678\nc,\n");
    }

    #[test]
    fn json_is_an_array_of_objects() {
        let value: Value = serde_json::from_str(&written(Format::Json)).unwrap();
        assert_eq!(value[0]["mean"], 1234.5678);
        assert_eq!(value[1]["mean"], Value::Null);
        assert_eq!(value.as_array().unwrap().len(), 2);
    }
}
