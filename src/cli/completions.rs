//! `jitai completions`: completions of commands and options for shells.

use std::io::{self, Write};

use clap_complete::Shell;

use crate::cli::{Error, Exit};

/// Print the completions of commands and options for a shell
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// The shell
    shell: Shell,
}

/// Prints the completions of `command`, the whole program.
pub(super) fn run(arguments: &Arguments, mut command: clap::Command) -> Result<Exit, Error> {
    // The generator panics if it cannot write, as to a closed pipe.
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut command, "jitai", &mut script);
    io::stdout().write_all(&script)?;
    Ok(Exit::Done)
}
