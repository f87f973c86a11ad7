//! `jitai query`: read-only SQL on the store.

use std::io::{self, Read};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use crate::cli::answer::{self, AnswerFormat, Failed};
use crate::cli::{Error, Exit, StoreArgument, signals};
use crate::store::{QueryError, Reader};

/// How long after a signal the query may take to end.
const PATIENCE: Duration = Duration::from_millis(500);

/// Answer a read-only SQL query; the views are described in docs/store.md
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// One SELECT statement, or - to read it from standard input
    sql: String,
    /// How rows are written
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

/// Does `work` while a signal can interrupt the reader.
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
                    // An answer may be long to write.
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
