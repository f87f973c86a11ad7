//! The command line: one file a verb. Reads arguments, calls the library, prints.
//!
//! Standard output is data; standard error is progress and messages. Exit codes: 0 done, 1 some
//! jobs failed or a replay differs, 2 bad usage or manifest, 3 store or system error, 130 interrupted.

mod answer;
mod check;
mod counting;
mod counts;
mod doctor;
mod error;
mod export;
mod folder;
pub mod input;
mod optimum;
mod output;
#[cfg(feature = "parquet")]
mod parquet;
mod plan;
mod progress;
mod query;
mod replay;
mod report;
mod run;
mod schema;
mod setting;
mod signals;
mod simulate;
mod status;
mod steps;
mod summary;

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, Parser, Subcommand};

use crate::kernel::Isa;
use crate::kill_point;
use crate::schedule::MOST_WORKERS;

pub(crate) use error::{Error, Exit};

/// Reinforcement-learning experiments for just-in-time adaptive interventions.
#[derive(Parser)]
#[command(name = "jitai", version, max_term_width = 100)]
struct Arguments {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Subcommand)]
enum Verb {
    Check(check::Arguments),
    Plan(plan::Arguments),
    Run(run::Arguments),
    Status(status::Arguments),
    Query(query::Arguments),
    Report(report::Arguments),
    Export(export::Arguments),
    Doctor(doctor::Arguments),
    Simulate(Box<simulate::Arguments>),
    Optimum(optimum::Arguments),
    Schema(schema::Arguments),
}

const DEFAULT_STORE: &str = "jitai.sqlite";

/// Which store a command works on.
#[derive(Args)]
struct StoreArgument {
    /// The store: a SQLite file
    #[arg(long, value_name = "FILE", env = "JITAI_STORE", default_value = DEFAULT_STORE)]
    store: PathBuf,
}

impl StoreArgument {
    /// The argument as a further command needs it: nothing for the store that it would use anyway.
    fn as_option(&self) -> String {
        let usual = std::env::var_os("JITAI_STORE").unwrap_or_else(|| DEFAULT_STORE.into());
        if self.store.as_os_str() == usual {
            return String::new();
        }
        format!(" --store {}", output::shell_word(&self.store.display().to_string()))
    }
}

/// A number of workers, as `--workers` takes it.
fn workers(text: &str) -> Result<NonZeroUsize, String> {
    text.parse()
        .ok()
        .filter(|workers: &NonZeroUsize| workers.get() <= MOST_WORKERS)
        .ok_or_else(|| format!("expected a whole number from 1 to {MOST_WORKERS}"))
}

/// Runs the program with the arguments of the process.
pub fn main() -> ExitCode {
    let verb = Arguments::parse().verb;
    if let Err(error) = Isa::check_choice() {
        return Error::Usage(error.to_string()).report().into();
    }
    if let Ok(Err(error)) =
        std::env::var(kill_point::VARIABLE).map(|text| kill_point::choose(&text))
    {
        return Error::Usage(error.to_string()).report().into();
    }
    if let Err(source) = signals::survive_file_limits() {
        return Error::Io { what: "listen for signals".to_owned(), source }.report().into();
    }
    let result = match verb {
        Verb::Check(arguments) => check::run(&arguments),
        Verb::Plan(arguments) => plan::run(&arguments),
        Verb::Run(arguments) => run::run(&arguments),
        Verb::Status(arguments) => status::run(&arguments),
        Verb::Query(arguments) => query::run(&arguments),
        Verb::Report(arguments) => report::run(&arguments),
        Verb::Export(arguments) => export::run(&arguments),
        Verb::Doctor(arguments) => doctor::run(&arguments),
        Verb::Simulate(arguments) => simulate::run(&arguments),
        Verb::Optimum(arguments) => optimum::run(&arguments),
        Verb::Schema(arguments) => schema::run(&arguments),
    };
    match result {
        Ok(exit) => exit.into(),
        Err(error) => error.report().into(),
    }
}
