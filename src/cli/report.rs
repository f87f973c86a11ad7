//! `jitai report`: tables, figures and a page from the store.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use crate::cli::check::ManifestArguments;
use crate::cli::counting::Counting;
use crate::cli::output::{counted, no_experiment};
use crate::cli::{Error, Exit, StoreArgument, folder};
use crate::manifest::Published;
use crate::report::{AssembleError, Hosts, ReportFile, ReportedExperiment, Work, assemble, report};
use crate::store::Reader;

/// Write tables, figures and an HTML page about the results in the store
#[derive(clap::Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    manifests: ManifestArguments,
    /// Output folder; created if it does not exist
    #[arg(long, value_name = "DIR")]
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
    let mut shown: Option<(Work, Counting)> = None;
    let experiments = assemble(&reader, &manifests, |work, done, of| {
        let is_other = shown.as_ref().is_none_or(|(shown, _)| *shown != work);
        if is_other || done == 1 {
            let what = match work {
                Work::Jobs => "jobs read",
                Work::Optima => "optima",
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
    files.iter().try_for_each(|file| write(&arguments.out, file))?;
    let in_store = reader.manifests()?;
    let in_store: Vec<&str> = in_store.iter().map(|(name, _)| name.as_str()).collect();
    for experiment in &experiments {
        if let Some(note) = unfinished(experiment) {
            writeln!(io::stderr(), "note: {note}")?;
        }
        if experiment.findings.is_empty() {
            let name = &experiment.name;
            writeln!(
                io::stderr(),
                "note: no figures of {name}, because it declares no [[analysis]]; the page has tables of its \
                 arms and agents"
            )?;
        }
        // Jobs of another experiment count, too, so a report without this one can be complete.
        let is_empty = experiment.jobs.iter().all(|job| job.completed().is_none());
        if is_empty && !in_store.contains(&experiment.name.as_str()) {
            let note = no_experiment(&store, &experiment.name, &in_store);
            writeln!(io::stderr(), "note: {note}")?;
        }
    }
    let mut out = io::stdout().lock();
    writeln!(out, "{}", arguments.out.join("index.html").display())?;
    // The winners are texts to paste into a manifest.
    for winners in experiments.iter().flat_map(|experiment| experiment.winners.iter().flatten()) {
        write!(out, "\n{winners}")?;
    }
    Ok(Exit::Done)
}

/// The number of jobs without a completed run; `None` if there are none.
fn unfinished(experiment: &ReportedExperiment) -> Option<String> {
    let jobs = &experiment.jobs;
    let missing = jobs.iter().filter(|job| job.completed().is_none()).count();
    (missing > 0).then(|| {
        format!(
            "{missing} of {} of {} {} no completed run",
            counted(jobs.len() as u64, "job"),
            experiment.name,
            if missing == 1 { "has" } else { "have" }
        )
    })
}

/// Writes a file of the report under a temporary name, and renames it once it is complete.
fn write(folder: &Path, file: &ReportFile) -> Result<(), Error> {
    let path = folder.join(&file.name);
    let failure = |source| Error::Io { what: format!("write `{}`", path.display()), source };
    if let Some(parent) = path.parent() {
        fs::create_dir_all(parent).map_err(failure)?;
    }
    let mut partial = path.clone().into_os_string();
    partial.push(".partial");
    fs::write(&partial, &file.bytes).map_err(failure)?;
    fs::rename(&partial, &path).map_err(failure)
}
