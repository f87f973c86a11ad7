//! `jitai query`: read-only SQL on the store.

use std::io::{self, Read};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use crate::cli::answer::{self, AnswerFormat, Failed};
use crate::cli::{Error, Exit, StoreArgument, signals};
use crate::store::{QueryError, Reader};

/// Maximum time from a signal to the end of a query.
const PATIENCE: Duration = Duration::from_millis(500);

/// Run a read-only SQL query; docs/store.md describes the views
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// One SELECT statement, or - to read it from standard input
    sql: String,
    /// Output format
    #[arg(long, value_enum, default_value = "table")]
    format: AnswerFormat,
    #[command(flatten)]
    store: StoreArgument,
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    arguments.format.require()?;
    arguments.format.require_readable()?;
    let reader = Reader::open(&arguments.store.store)?;
    let mut sql = arguments.sql.clone();
    if sql == "-" {
        sql.clear();
        io::stdin()
            .read_to_string(&mut sql)
            .map_err(|source| Error::Io { what: "read the query".to_owned(), source })?;
    }
    let write = || answer::write(&reader, &sql, arguments.format, io::stdout().lock());
    match interruptible(&reader, write)? {
        Ok(()) => Ok(Exit::Done),
        Err(Failed::Query(QueryError::Interrupted)) => Ok(Exit::Interrupted),
        Err(failed) => Err(failed.into()),
    }
}

/// Runs `work`; a signal interrupts the query of the reader.
fn interruptible<T>(reader: &Reader, work: impl FnOnce() -> T) -> Result<T, Error> {
    let stop = signals::stop_flag()
        .map_err(|source| Error::Io { what: "listen for signals".to_owned(), source })?;
    let interrupter = reader.interrupter();
    let done = AtomicBool::new(false);
    thread::scope(|scope| {
        let interrupt = || {
            let mut stopped: Option<Instant> = None;
            while !done.load(Ordering::Relaxed) {
                if stop.load(Ordering::Relaxed) {
                    interrupter.interrupt();
                    // The interrupt ends the query, but writing its answer may take longer.
                    if stopped.get_or_insert_with(Instant::now).elapsed() > PATIENCE {
                        signals::end_now();
                    }
                }
                thread::park_timeout(Duration::from_millis(20));
            }
        };
        thread::Builder::new()
            .spawn_scoped(scope, interrupt)
            .map_err(|source| Error::Io { what: "start a thread".to_owned(), source })?;
        let result = work();
        done.store(true, Ordering::Relaxed);
        Ok(result)
    })
}
