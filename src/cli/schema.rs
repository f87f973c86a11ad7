//! `jitai schema`: the JSON Schema of the manifest.

use std::io::{self, Write};

use crate::cli::{Error, Exit};
use crate::manifest;

/// Print the JSON Schema of manifests, for editors
#[derive(clap::Args)]
pub(super) struct Arguments {}

pub(super) fn run(_: &Arguments) -> Result<Exit, Error> {
    writeln!(io::stdout(), "{:#}", manifest::schema())?;
    Ok(Exit::Done)
}
