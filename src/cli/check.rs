//! `jitai check`: validates manifests and reports every fault at once.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use serde_json::json;

use crate::cli::output::counted;
use crate::cli::{Error, Exit};
use crate::manifest::{self, Faults, Manifest, Published};
use crate::plan;

/// Validate manifests; every fault at once, each with its line, column and remedy
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// Manifests (TOML files)
    #[arg(required = true, value_name = "MANIFEST")]
    manifests: Vec<PathBuf>,
    /// How faults are written
    #[arg(long, value_enum, default_value = "text")]
    format: Format,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    /// For reading, on standard error.
    Text,
    /// An array of objects on standard output.
    Json,
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    let mut faulty = Vec::new();
    for path in &arguments.manifests {
        let loaded = manifest::load(path);
        match loaded.and_then(|manifest| Published::of(&manifest).map(|_| manifest)) {
            Ok(manifest) if arguments.format == Format::Text => {
                let jobs = counted(plan::count(&manifest), "job");
                writeln!(io::stdout(), "{}: ok, {jobs}", path.display())?;
            }
            Ok(_) => {}
            Err(faults) => faulty.push(faults),
        }
    }
    match arguments.format {
        Format::Json => {
            let all: Vec<_> = faulty
                .iter()
                .flat_map(|faults| match json!(faults) {
                    serde_json::Value::Array(list) => list,
                    other => vec![other],
                })
                .collect();
            writeln!(io::stdout(), "{:#}", serde_json::Value::Array(all))?;
            Ok(if faulty.is_empty() { Exit::Done } else { Exit::Usage })
        }
        Format::Text if faulty.is_empty() => Ok(Exit::Done),
        Format::Text => Err(Error::Manifests(faulty)),
    }
}

/// Loads manifests; every fault of every one is reported.
pub(super) fn load_all<P: AsRef<Path>>(paths: &[P]) -> Result<Vec<Manifest>, Error> {
    let mut manifests = Vec::new();
    let mut faulty: Vec<Faults> = Vec::new();
    for path in paths {
        match manifest::load(path.as_ref()) {
            Ok(manifest) => manifests.push(manifest),
            Err(faults) => faulty.push(faults),
        }
    }
    if !faulty.is_empty() {
        return Err(Error::Manifests(faulty));
    }
    // Two manifests of one name would take turns at being the same experiment.
    for (i, manifest) in manifests.iter().enumerate() {
        if let Some(other) = manifests[..i].iter().find(|other| other.name == manifest.name) {
            return Err(Error::Usage(format!(
                "{} and {} have the same name, {:?}; give each experiment its own",
                other.path, manifest.path, manifest.name
            )));
        }
    }
    Ok(manifests)
}
