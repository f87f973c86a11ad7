//! Writes the answers to queries in the requested format.

use std::io::{self, IsTerminal, Write};
use std::ops::ControlFlow;

use clap::ValueEnum;

use crate::cli::Error;
use crate::cli::output::{Format, OutputField, OutputRows};
#[cfg(feature = "parquet")]
use crate::cli::parquet::Columns;
use crate::store::{Answer, QueryError, Reader, SqlValue};

/// Output format of an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum AnswerFormat {
    /// Aligned columns for reading.
    Table,
    /// Comma-separated values with a header line (RFC 4180); a text that a spreadsheet would execute
    /// gets a leading apostrophe.
    Csv,
    /// A JSON array with one object per line.
    Json,
    /// Apache Parquet, with types; missing in a build with `--no-default-features`.
    Parquet,
}

impl AnswerFormat {
    /// Checks that this build supports the format.
    ///
    /// **Errors**: the build lacks the feature; the message says how to build with it.
    pub(super) fn require(self) -> Result<(), Error> {
        if self == AnswerFormat::Parquet && !cfg!(feature = "parquet") {
            return Err(Error::Usage(
                "--format parquet: not supported by this build; build with `cargo build --release \
                 --features parquet`, or use csv"
                    .to_owned(),
            ));
        }
        Ok(())
    }

    /// Checks that standard output can take the format.
    ///
    /// **Errors**: standard output is a terminal and the format is binary.
    pub(super) fn require_readable(self) -> Result<(), Error> {
        if self == AnswerFormat::Parquet && io::stdout().is_terminal() {
            return Err(Error::Usage(
                "--format parquet: binary output to a terminal; redirect it to a file, as in \
                 `> answer.parquet`"
                    .to_owned(),
            ));
        }
        Ok(())
    }
}

/// Why an answer could not be written.
pub(super) enum Failed {
    /// The query failed.
    Query(QueryError),
    /// The output could not be written.
    Output(io::Error),
}

impl From<Failed> for Error {
    fn from(failed: Failed) -> Self {
        match failed {
            Failed::Query(error) => Error::Query(error),
            Failed::Output(error) => error.into(),
        }
    }
}

/// The writer of an answer.
enum Written<W: Write> {
    /// Written row by row.
    Lines(OutputRows<W>),
    /// Collected as columns, and written at the end.
    #[cfg(feature = "parquet")]
    Columns(Columns, W),
}

impl<W: Write> Written<W> {
    #[cfg_attr(not(feature = "parquet"), allow(unused_variables))]
    fn begin(
        (reader, sql): (&Reader, &str),
        format: AnswerFormat,
        names: &[&str],
        out: W,
    ) -> Result<Self, Failed> {
        let format = match format {
            AnswerFormat::Table => Format::Table,
            AnswerFormat::Csv => Format::Csv,
            AnswerFormat::Json => Format::Json,
            #[cfg(feature = "parquet")]
            AnswerFormat::Parquet => {
                let types = reader.column_types(sql, names.len());
                return Ok(Written::Columns(Columns::new(names, &types), out));
            }
            #[cfg(not(feature = "parquet"))]
            AnswerFormat::Parquet => {
                return Err(Failed::Output(io::ErrorKind::Unsupported.into()));
            }
        };
        let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
        OutputRows::new(format, &names, out).map(Written::Lines).map_err(Failed::Output)
    }

    fn row(&mut self, values: &[SqlValue<'_>]) -> io::Result<()> {
        match self {
            Written::Lines(rows) => rows.row(&values.iter().map(field).collect::<Vec<_>>()),
            #[cfg(feature = "parquet")]
            Written::Columns(columns, _) => {
                columns.row(values);
                Ok(())
            }
        }
    }

    fn finish(self) -> io::Result<()> {
        match self {
            Written::Lines(rows) => rows.finish(),
            #[cfg(feature = "parquet")]
            Written::Columns(columns, out) => columns.write(out),
        }
    }
}

/// Writes the answer to a query.
pub(super) fn write<W: Write>(
    reader: &Reader,
    sql: &str,
    format: AnswerFormat,
    out: W,
) -> Result<(), Failed> {
    let mut out = Some(out);
    let mut written: Option<Written<W>> = None;
    let mut failed = None;
    let answered = reader.query(sql, |answer| {
        let result = match answer {
            Answer::Columns(names) => {
                let out = out.take().expect("columns come once");
                Written::begin((reader, sql), format, names, out).map(|begun| written = Some(begun))
            }
            Answer::Row(values) => {
                let written = written.as_mut().expect("columns come first");
                written.row(values).map_err(Failed::Output)
            }
        };
        match result {
            Ok(()) => ControlFlow::Continue(()),
            Err(error) => {
                failed = Some(error);
                ControlFlow::Break(())
            }
        }
    });
    if let Some(failed) = failed {
        return Err(failed);
    }
    answered.map_err(Failed::Query)?;
    written.map_or(Ok(()), Written::finish).map_err(Failed::Output)
}

fn field<'a>(value: &SqlValue<'a>) -> OutputField<'a> {
    match *value {
        SqlValue::Null => OutputField::Empty,
        SqlValue::Integer(number) => OutputField::Integer(number),
        SqlValue::Real(number) => OutputField::Real(number),
        SqlValue::Text(text) => OutputField::text(text),
        SqlValue::Blob(bytes) => OutputField::Bytes(bytes),
    }
}
