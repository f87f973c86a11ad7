//! `jitai manual`: manual pages for `man`.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use clap_mangen::Man;

use crate::cli::{Error, Exit};

/// Print the manual page of jitai, or write the pages of all commands
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// Write a page per command to this folder, for `man`: jitai.1, jitai-check.1 and so on
    #[arg(long, value_name = "DIR", value_hint = clap::ValueHint::DirPath)]
    out: Option<PathBuf>,
}

/// Prints or writes the pages of `command`, the whole program.
pub(super) fn run(arguments: &Arguments, command: clap::Command) -> Result<Exit, Error> {
    let mut command = command.disable_help_subcommand(true);
    // Gives the commands their names as words of the program.
    command.build();
    match &arguments.out {
        None => Man::new(command).render(&mut io::stdout())?,
        Some(folder) => {
            let pages = write_all(&command, folder).map_err(|source| Error::Io {
                what: format!("write the manual pages to {}", folder.display()),
                source,
            })?;
            writeln!(io::stderr(), "{pages} manual pages in {}", folder.display())?;
        }
    }
    Ok(Exit::Done)
}

/// Writes a page for the program and for each of its commands that `--help` shows; returns their number.
fn write_all(program: &clap::Command, folder: &Path) -> io::Result<usize> {
    fs::create_dir_all(folder)?;
    let shown = program.get_subcommands().filter(|verb| !verb.is_hide_set());
    let pages = std::iter::once(program).chain(shown);
    pages
        .map(|page| Man::new(page.clone()).generate_to(folder))
        .try_fold(0, |count, written| written.map(|_| count + 1))
}
