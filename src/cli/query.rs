//! `jitai query`: read-only SQL on the store.

use std::io::{self, Read, Write};
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use crate::cli::output::{Cell, Format, Rows};
use crate::cli::{Error, Exit, StoreArgument, signals};
use crate::store::{Answer, QueryError, Reader, Value};

/// Answer a read-only SQL query; the views are described in docs/store.md
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// One SELECT statement, or - to read it from standard input
    sql: String,
    /// How rows are written
    #[arg(long, value_enum, default_value = "table")]
    format: Format,
    #[command(flatten)]
    store: StoreArgument,
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    let reader = Reader::open(&arguments.store.store)?;
    let mut sql = arguments.sql.clone();
    if sql == "-" {
        sql.clear();
        io::stdin()
            .read_to_string(&mut sql)
            .map_err(|source| Error::Io { what: "read the query".to_owned(), source })?;
    }
    match interruptible(&reader, || write(&reader, &sql, arguments.format, io::stdout().lock()))? {
        Ok(()) => Ok(Exit::Done),
        Err(Failed::Query(QueryError::Interrupted)) => Ok(Exit::Interrupted),
        Err(failed) => Err(failed.into()),
    }
}

/// Why an answer could not be written.
pub(super) enum Failed {
    /// The query.
    Query(QueryError),
    /// The output.
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

/// Does `work` while a signal can interrupt the reader.
fn interruptible<T>(reader: &Reader, work: impl FnOnce() -> T) -> Result<T, Error> {
    let stop = signals::stop_flag()
        .map_err(|source| Error::Io { what: "listen for signals".to_owned(), source })?;
    let interrupter = reader.interrupter();
    let done = AtomicBool::new(false);
    thread::scope(|scope| {
        let watch = || {
            while !done.load(Ordering::Relaxed) {
                if stop.load(Ordering::Relaxed) {
                    interrupter.interrupt();
                }
                thread::park_timeout(Duration::from_millis(20));
            }
        };
        thread::Builder::new()
            .spawn_scoped(scope, watch)
            .map_err(|source| Error::Io { what: "start a thread".to_owned(), source })?;
        let result = work();
        done.store(true, Ordering::Relaxed);
        Ok(result)
    })
}

/// Writes the answer to a query.
pub(super) fn write<W: Write>(
    reader: &Reader,
    sql: &str,
    format: Format,
    out: W,
) -> Result<(), Failed> {
    let mut out = Some(out);
    let mut rows: Option<Rows<W>> = None;
    let mut failed = None;
    let answered = reader.query(sql, |answer| {
        let written = match answer {
            Answer::Columns(columns) => {
                let columns: Vec<String> = columns.iter().map(|name| (*name).to_owned()).collect();
                let out = out.take().expect("columns come once");
                Rows::new(format, &columns, out).map(|begun| rows = Some(begun))
            }
            Answer::Row(values) => {
                let cells: Vec<Cell> = values.iter().map(cell).collect();
                rows.as_mut().expect("columns come first").row(&cells)
            }
        };
        match written {
            Ok(()) => ControlFlow::Continue(()),
            Err(error) => {
                failed = Some(error);
                ControlFlow::Break(())
            }
        }
    });
    if let Some(error) = failed {
        return Err(Failed::Output(error));
    }
    answered.map_err(Failed::Query)?;
    rows.map_or(Ok(()), Rows::finish).map_err(Failed::Output)
}

fn cell(value: &Value<'_>) -> Cell {
    match value {
        Value::Null => Cell::Empty,
        Value::Integer(number) => Cell::Integer(*number),
        Value::Real(number) => Cell::Real(*number),
        Value::Text(text) => Cell::text(*text),
        // As SQL writes them.
        Value::Blob(bytes) => {
            let digits: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
            Cell::Text(format!("x'{digits}'"))
        }
    }
}
