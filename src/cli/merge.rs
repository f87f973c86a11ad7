//! `jitai merge`: copies the runs of other stores into one.

use std::io::{self, Write};
use std::path::PathBuf;

use serde_json::{Value, json};

use crate::cli::counting::Counting;
use crate::cli::output::{TextOrJson, counted};
use crate::cli::{Error, Exit, StoreArgument};
use crate::key::printable;
use crate::store::{self, Conflict, Damage, Merged, Origin, OtherManifest, Sources};

/// Copy the runs of other stores into one: completed runs with their results, and failed runs
///
/// Every result is checked against its digest. Runs that the store already has are not changed, so
/// merging again copies nothing. The other stores are only read. Other processes may write to any of
/// the stores meanwhile. Exits with 1 if a job has different results in two stores (the target store
/// keeps its own), or if a run is damaged (it is not copied).
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// Stores, or folders: all files NAME.sqlite in a folder and in its subfolder `parts`
    #[arg(required = true, value_name = "FROM")]
    from: Vec<PathBuf>,
    /// Output format
    #[arg(long, value_enum, default_value = "text")]
    format: TextOrJson,
    #[command(flatten)]
    store: StoreArgument,
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    let sources = store::stores_of(&arguments.from, &arguments.store.store)?;
    if sources.is_empty() {
        let named = arguments.from.iter().map(|path| format!("`{}`", path.display()));
        let named = named.collect::<Vec<_>>().join(" and ");
        return Err(Error::Usage(format!("no store to merge: no file in {named} ends in .sqlite")));
    }
    let sources = Sources::open(sources)?;
    let mut into = arguments.store.open()?;
    let mut counting = Counting::new(0, "runs");
    let merged = store::merge(&sources, &mut into, |progress| {
        counting.advance(progress.done, progress.of);
    });
    drop(counting);
    let merged = merged?;
    match arguments.format {
        TextOrJson::Text => show(arguments, &merged)?,
        TextOrJson::Json => writeln!(io::stdout(), "{}", as_json(&merged))?,
    }
    let clean = merged.conflicts.is_empty() && merged.damaged.is_empty();
    Ok(if clean { Exit::Done } else { Exit::Differs })
}

fn show(arguments: &Arguments, merged: &Merged) -> io::Result<()> {
    let mut out = io::stdout().lock();
    let into = printable(&arguments.store.store.display().to_string());
    let stores = counted(merged.sources as u64, "store");
    for OtherManifest { source, experiment } in &merged.differing {
        let source = printable(&source.display().to_string());
        writeln!(
            out,
            "experiment {} has a different manifest in {source}; {into} keeps its own manifest and has \
             the jobs of both",
            printable(experiment)
        )?;
    }
    show_conflicts(&mut out, &into, &merged.conflicts)?;
    for Damage { source, job_key, what } in &merged.damaged {
        let run = job_key.as_ref().map_or(String::new(), |key| format!("the run of job {key}: "));
        let source = printable(&source.display().to_string());
        writeln!(out, "{source} is damaged; not merged: {run}{}", printable(what))?;
    }
    if merged.in_progress > 0 {
        let jobs = counted(merged.in_progress as u64, "job");
        writeln!(out, "{jobs} not merged, because {into} is running the same; merge again later")?;
    }
    let Merged { experiments, jobs, completed, failed, already_there, estimates, .. } = merged;
    if *estimates > 0 {
        let rows = counted(*estimates as u64, "row");
        writeln!(out, "{rows} of estimates added to runs that {into} had")?;
    }
    if experiments + jobs + completed + failed + estimates == 0 {
        let runs = counted(*already_there as u64, "run");
        let is_clean = merged.conflicts.is_empty() && merged.damaged.is_empty();
        let equal = match is_clean && merged.in_progress == 0 && *already_there > 0 {
            true => "; every completed run has the same results",
            false => "",
        };
        let had = match *already_there {
            0 => String::new(),
            _ => format!(": {into} already has {runs} of them"),
        };
        return writeln!(out, "nothing to copy from {stores}{had}{equal}");
    }
    writeln!(
        out,
        "{into}: {} and {} copied from {stores}, with {} and {}; {already_there} were already there",
        counted(*completed as u64, "completed run"),
        counted(*failed as u64, "failed run"),
        counted(*jobs as u64, "job"),
        counted(*experiments as u64, "experiment"),
    )
}

fn show_conflicts(out: &mut impl Write, into: &str, conflicts: &[Conflict]) -> io::Result<()> {
    for Conflict { source, job_key, theirs, ours } in conflicts {
        let source = printable(&source.display().to_string());
        writeln!(out, "job {job_key} has different results in {source}; {into} keeps its own")?;
        for (store, origin) in [(source.as_str(), theirs), (into, ours)] {
            let Origin { results_sha256, host, processor, code_version, git_revision } = origin;
            let made_by = format!("jitai {code_version} ({git_revision}) on {host} ({processor})");
            writeln!(out, "  {results_sha256} in {store}, by {}", printable(&made_by))?;
        }
    }
    Ok(())
}

fn as_json(merged: &Merged) -> Value {
    let origin = |origin: &Origin| {
        let Origin { results_sha256, host, processor, code_version, git_revision } = origin;
        json!({
            "results_sha256": results_sha256, "host": host, "processor": processor,
            "code_version": code_version, "git_revision": git_revision,
        })
    };
    let conflicts = merged.conflicts.iter().map(|conflict| {
        let Conflict { source, job_key, theirs, ours } = conflict;
        json!({
            "source": source.display().to_string(), "job_key": job_key,
            "theirs": origin(theirs), "ours": origin(ours),
        })
    });
    let damaged = merged.damaged.iter().map(|Damage { source, job_key, what }| {
        json!({ "source": source.display().to_string(), "job_key": job_key, "what": what })
    });
    let differing = merged.differing.iter().map(|OtherManifest { source, experiment }| {
        json!({ "source": source.display().to_string(), "experiment": experiment })
    });
    json!({
        "stores": merged.sources, "experiments": merged.experiments, "jobs": merged.jobs,
        "completed": merged.completed, "failed": merged.failed,
        "already_there": merged.already_there, "in_progress": merged.in_progress,
        "estimates": merged.estimates,
        "conflicts": conflicts.collect::<Vec<_>>(), "damaged": damaged.collect::<Vec<_>>(),
        "other_manifests": differing.collect::<Vec<_>>(),
    })
}
