//! `jitai report`: tables, figures and a page from the store.

use std::io::{self, Write};
use std::path::PathBuf;

use crate::cli::check::ManifestArguments;
use crate::cli::counting::Counting;
use crate::cli::{Error, Exit, StoreArgument, folder};
use crate::manifest::Published;
use crate::report::{AssembleError, AssemblyWork, Hosts, assemble, report};
use crate::store::Reader;

/// Write tables, figures and an HTML page about the results in the store
#[derive(clap::Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    manifests: ManifestArguments,
    /// Output folder; created if it does not exist
    #[arg(long, value_name = "DIR", value_hint = clap::ValueHint::DirPath)]
    out: PathBuf,
    /// Include host names in the table of provenance
    #[arg(long)]
    hosts: bool,
    #[command(flatten)]
    store: StoreArgument,
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    let manifests = arguments.manifests.load(&arguments.store)?;
    // Faults are reported before the folder is created.
    for manifest in &manifests {
        Published::of(manifest).map_err(|faults| Error::Manifests(vec![faults]))?;
    }
    let reader = Reader::open(&arguments.store.store)?;
    folder::make(&arguments.out)?;
    let mut shown: Option<(AssemblyWork, Counting)> = None;
    let experiments = assemble(&reader, &manifests, |work, done, of| {
        let is_other = shown.as_ref().is_none_or(|(shown, _)| *shown != work);
        if is_other || done == 1 {
            let what = match work {
                AssemblyWork::Jobs => "jobs read",
                AssemblyWork::Optima => "optima",
            };
            shown = Some((work, Counting::new(of, what)));
        }
        shown.iter_mut().for_each(|(_, shown)| shown.one_more());
    })
    .map_err(|error| match error {
        AssembleError::Published(faults) => Error::Manifests(vec![faults]),
        AssembleError::Store(error) => error.into(),
    })?;
    drop(shown);
    let store = arguments.store.store.file_name().unwrap_or_default().to_string_lossy();
    let hosts = if arguments.hosts { Hosts::Named } else { Hosts::Unnamed };
    let files = report(&experiments, &store, hosts);
    for file in &files {
        folder::write(&arguments.out.join(&file.name), &file.bytes)?;
    }
    let in_store = reader.manifests()?;
    let in_store: Vec<&str> = in_store.iter().map(|(name, _)| name.as_str()).collect();
    for note in experiments.iter().flat_map(|one| one.notes(&store, &in_store)) {
        writeln!(io::stderr(), "note: {note}")?;
    }
    let mut out = io::stdout().lock();
    writeln!(out, "{}", arguments.out.join("index.html").display())?;
    // The winners are texts to paste into a manifest.
    for winners in experiments.iter().filter_map(|one| one.race.as_ref()?.winners.as_ref()) {
        write!(out, "\n{winners}")?;
    }
    Ok(Exit::Done)
}
