//! `jitai log`: shows the commands that changed a store.

use std::io;

use crate::cli::output::{Format, OutputField, OutputRows};
use crate::cli::{Error, Exit, StoreArgument};
use crate::store::{Command, Reader};

/// Show which commands changed a store, when, and from which folder
///
/// A command is recorded with its first change; a command that changes nothing is not recorded. The
/// manifests of a command are in the view `manifest`, with the time from which they were used.
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// Output format
    #[arg(long, value_enum, default_value = "table")]
    format: Format,
    #[command(flatten)]
    store: StoreArgument,
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    let recorded = Reader::open(&arguments.store.store)?.log()?;
    let columns = ["changed_at", "command", "folder", "host", "code_version", "git_revision"];
    let columns = columns.map(str::to_owned);
    let mut rows = OutputRows::new(arguments.format, &columns, io::stdout().lock())?;
    for (changed_at, command) in &recorded {
        let Command { words, folder, host, code_version, git_revision } = command;
        let texts = [changed_at, words, folder, host, code_version, git_revision];
        rows.row(&texts.map(OutputField::text))?;
    }
    rows.finish()?;
    Ok(Exit::Done)
}
