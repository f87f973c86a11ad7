//! `jitai schema`: the JSON Schema of the manifest, or of a cluster's profile.

use std::io::{self, Write};

use crate::cli::{Error, Exit};
use crate::cluster;
use crate::manifest;

/// Print the JSON Schema of manifests, for editors
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// That of the profiles of `jitai submit --cluster` instead
    #[arg(long)]
    cluster: bool,
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    let schema = if arguments.cluster { cluster::schema() } else { manifest::schema() };
    writeln!(io::stdout(), "{schema:#}")?;
    Ok(Exit::Done)
}
