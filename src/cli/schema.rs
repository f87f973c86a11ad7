//! `jitai schema`: the JSON Schema of manifests, or of cluster profiles.

use std::io::{self, Write};

use crate::cli::{Error, Exit};
use crate::cluster;
use crate::manifest;

/// Print the JSON Schema of manifests, for use in editors
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// Print the schema of cluster profiles (`jitai submit --cluster`) instead
    #[arg(long)]
    cluster: bool,
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    let schema = if arguments.cluster { cluster::schema() } else { manifest::schema() };
    writeln!(io::stdout(), "{schema:#}")?;
    Ok(Exit::Done)
}
