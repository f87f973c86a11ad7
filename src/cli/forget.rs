//! `jitai forget`: removes an experiment from a store.

use std::collections::HashSet;
use std::io::{self, Write};

use crate::cli::output::{counted, no_experiment};
use crate::cli::{Error, Exit, StoreArgument, confirm, submissions};
use crate::cluster;
use crate::key::printable;
use crate::store::{Belongings, Counts, Forgotten, Reader};

/// Remove an experiment from a store; the results of its jobs stay, unless --results is given
///
/// First shows what would be removed, and asks. Without --results, all results stay. Results also
/// stay if an edit of the manifest has dropped their jobs from the experiment. To remove them
/// later, run the manifest that has their jobs again, and forget it with --results. Jobs that
/// another experiment holds always stay. Nothing is removed while a process or a task of a cluster
/// runs jobs of the experiment. The file keeps its size: SQLite uses the free space for
/// later results. No command brings back what was removed, so copy the store first if in doubt.
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// The experiment: the `name` of its manifest
    #[arg(value_name = "EXPERIMENT")]
    experiment: String,
    /// Also remove the jobs that no other experiment holds, with all their runs and results
    #[arg(long)]
    results: bool,
    /// Do not ask
    #[arg(long)]
    yes: bool,
    #[command(flatten)]
    store: StoreArgument,
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    let Arguments { experiment, results, yes, store } = arguments;
    let name = printable(experiment);
    let file = printable(&store.store.display().to_string());
    let reader = Reader::open(&store.store)?;
    let manifests = reader.manifests()?;
    let known: Vec<&str> = manifests.iter().map(|(name, _)| name.as_str()).collect();
    let unknown = || Error::Usage(no_experiment(&file, experiment, &known));
    let belongings = reader.belongings(experiment)?.ok_or_else(unknown)?;
    let Belongings { jobs, alone, unheld } = belongings;
    writeln!(io::stderr(), "{name} has {}; {}", described(&jobs), only_here(&jobs, &alone))?;
    if unheld > 0 {
        let held = format!("no experiment holds {} with results", counted(unheld, "job"));
        let remedy = "if earlier texts of this experiment declared them (view `manifest`), run such \
                      a text first to remove their results, too";
        writeln!(io::stderr(), "note: {held}; {remedy}")?;
    }
    let what = if *results {
        format!("remove {name} and the results of {}", counted(alone.total(), "job"))
    } else {
        format!("remove {name}; all results stay in the store")
    };
    if !*yes && !confirm::asked(&what, "--yes")? {
        return Ok(Exit::Differs);
    }
    let submissions = submissions::require_closed(store, &reader, experiment)?;
    let mut removed = HashSet::new();
    reader.jobs_of(experiment, |key| {
        removed.insert(key);
    })?;
    let mut open = store.open()?;
    let is_running = || -> Result<bool, Error> {
        Ok(open.reader()?.belongings(experiment)?.is_some_and(|now| now.jobs.running > 0))
    };
    // Jobs that stay in the store count as merged, whether they are listed or not.
    if *results && !is_running()? {
        cluster::forget(&submissions, &removed)?;
    }
    match open.forget(experiment, *results)? {
        Forgotten::Unknown => Err(unknown()),
        Forgotten::Running => {
            let what = "a process runs jobs of it; stop the process, or wait until it ends";
            Err(Error::Usage(format!("nothing was removed from {file}: {what}")))
        }
        Forgotten::Removed(Belongings { jobs, alone, .. }) => {
            let (with, without_results) = match *results {
                true => (format!(", with {}", counted(alone.total(), "job")), alone.completed),
                false => (String::new(), 0),
            };
            let stay = counted(jobs.completed - without_results, "job");
            writeln!(
                io::stdout(),
                "{name} removed from {file}{with}; the results of {stay} of it stay"
            )?;
            Ok(Exit::Done)
        }
    }
}

/// Jobs by state; states without jobs are left out.
fn described(jobs: &Counts) -> String {
    let states = [
        (jobs.completed, "completed"),
        (jobs.failed, "failed"),
        (jobs.running, "running"),
        (jobs.interrupted, "interrupted"),
        (jobs.pending, "pending"),
    ];
    let states = states.iter().filter(|(count, _)| *count > 0);
    let states: Vec<String> = states.map(|(count, state)| format!("{count} {state}")).collect();
    let jobs = counted(jobs.total(), "job");
    if states.is_empty() { jobs } else { format!("{jobs} ({})", states.join(", ")) }
}

fn only_here(jobs: &Counts, alone: &Counts) -> String {
    match jobs.total() - alone.total() {
        0 => "no other experiment holds them".to_owned(),
        shared => format!("other experiments hold {shared} of them, too"),
    }
}
