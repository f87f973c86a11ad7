//! `jitai status`: what has become of every experiment in a store.

use std::collections::HashMap;
use std::io::{self, IsTerminal, Write};
use std::mem;
use std::thread;
use std::time::Duration;

use serde_json::{Value, json};

use crate::cli::output::{Field, Format, Rows, counted};
use crate::cli::{Error, Exit, StoreArgument, counts, submissions, summary};
use crate::cluster::{Cluster, Look};
use crate::manifest;
use crate::plan::Swept;
use crate::schedule::{self, Episodes, Speeds};
use crate::store::{ExperimentCounts, FailedJob, Reader, Store};

/// Show the experiments of a store: jobs by state, failures with their reasons
///
/// The seconds left are estimated from earlier runs, for one worker a core, as `jitai run` takes it.
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// Show it again every two seconds, until all jobs have ended or no process runs any
    #[arg(long)]
    watch: bool,
    /// How rows are written
    #[arg(long, value_enum, default_value = "table")]
    format: Format,
    /// Merge first what submissions to a cluster have handed in
    #[arg(long)]
    merge: bool,
    /// Show the submissions to a cluster only: chunks by state, jobs done and left, core-hours
    #[arg(long, conflicts_with = "watch")]
    submissions: bool,
    #[command(flatten)]
    store: StoreArgument,
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    let mut rested = false;
    if arguments.merge {
        let look = look(arguments)?;
        submissions::collect(&look, &mut Store::open(&arguments.store.store)?)?;
    }
    if arguments.submissions {
        let look = look(arguments)?;
        let reader = Reader::open(&arguments.store.store)?;
        submissions::show(&look, &submissions::ended(&reader)?, arguments.format)?;
        return Ok(Exit::Done);
    }
    loop {
        let reader = Reader::open(&arguments.store.store)?;
        if arguments.watch && io::stdout().is_terminal() {
            // Clear the screen, cursor home.
            write!(io::stdout(), "\u{1b}[2J\u{1b}[H")?;
        }
        let Unfinished { running, waiting } = show(&reader, arguments.format)?;
        if arguments.format == Format::Table {
            show_submissions(arguments, &reader)?;
        }
        if !arguments.watch || running + waiting == 0 {
            return Ok(Exit::Done);
        }
        // Between two jobs none may be running, so one look is not enough.
        if running == 0 && mem::replace(&mut rested, true) {
            let jobs = counted(waiting, "job");
            writeln!(io::stderr(), "{jobs} left, but no process runs any; `jitai run` goes on")?;
            return Ok(Exit::Done);
        }
        rested &= running == 0;
        drop(reader);
        thread::sleep(Duration::from_secs(2));
    }
}

/// The submissions of the store, and what the cluster says of them.
fn look(arguments: &Arguments) -> Result<Look, Error> {
    let engine = submissions::engine();
    Ok(Cluster::of(&arguments.store.store, &*engine)?.look()?)
}

/// Prints the submissions of the store below its experiments, if there are any.
fn show_submissions(arguments: &Arguments, reader: &Reader) -> Result<(), Error> {
    let look = look(arguments)?;
    if look.surveys.is_empty() {
        return Ok(());
    }
    writeln!(io::stdout(), "\nsubmissions:")?;
    submissions::show(&look, &submissions::ended(reader)?, Format::Table)
}

/// Jobs that have still to end.
#[derive(Default)]
struct Unfinished {
    running: u64,
    /// Pending or interrupted.
    waiting: u64,
}

/// Prints the state of the store.
fn show(reader: &Reader, format: Format) -> Result<Unfinished, Error> {
    let speeds = Speeds::of(reader)?;
    let failed = Failed::read(reader)?;
    let workers = schedule::one_per_core().get() as f64;
    let mut columns = counts::COLUMNS.map(str::to_owned).to_vec();
    if format == Format::Json {
        columns.push("failures".to_owned());
    }
    let mut rows = Rows::new(format, &columns, io::stdout().lock())?;
    let mut unfinished = Unfinished::default();
    for ExperimentCounts { experiment, counts, episodes_left } in reader.experiment_counts()? {
        unfinished.running += counts.running;
        unfinished.waiting += counts.pending + counts.interrupted;
        let mut episodes = Episodes::default();
        for (algorithm, left) in &episodes_left {
            episodes.add(algorithm, *left);
        }
        let seconds = speeds.seconds(&episodes).map(|s| s / workers);
        let mut fields = counts::fields(&experiment, &counts, seconds);
        if format == Format::Json {
            fields.push(Field::Nested(failed.described(&experiment)));
        }
        rows.row(&fields)?;
    }
    rows.finish()?;
    match format {
        Format::Table => failed.list()?,
        Format::Json => {}
        _ if failed.jobs.is_empty() => {}
        _ => {
            let jobs = counted(failed.jobs.len(), "failed job");
            let told =
                "table and json tell the reasons, and so does `failure_message` of run_summary";
            writeln!(io::stderr(), "{jobs}: {told}")?;
        }
    }
    Ok(unfinished)
}

/// The failed jobs of a store, with what tells them from others of their experiments.
struct Failed {
    jobs: Vec<FailedJob>,
    /// By experiment, of those that have failed jobs.
    swept: HashMap<String, Swept>,
}

impl Failed {
    fn read(reader: &Reader) -> Result<Failed, Error> {
        let jobs = reader.failed_jobs()?;
        let mut swept = HashMap::new();
        for FailedJob { experiment, .. } in &jobs {
            if !swept.contains_key(experiment) {
                let text = reader.manifest(experiment)?.unwrap_or_default();
                // A manifest of another release may mean nothing to this one.
                let manifest = manifest::parse(experiment, text.as_bytes()).ok();
                swept.insert(experiment.clone(), Swept::of(manifest.as_slice()));
            }
        }
        Ok(Failed { jobs, swept })
    }

    /// The failed jobs of an experiment for programs.
    fn described(&self, experiment: &str) -> Value {
        let ours = self.jobs.iter().filter(|job| job.experiment == experiment);
        ours.map(|failed| {
            json!({
                "job_key": failed.job_key.to_string(),
                "agent": failed.agent,
                "scenario": failed.job.as_ref().map(|job| job.scenario.to_string()),
                "sigma": failed.job.as_ref().map(|job| job.environment.sigma),
                "seed": failed.job.as_ref().map(|job| job.seed),
                "swept": failed.job.as_ref().map(|job| {
                    self.swept[experiment].object(&failed.agent, job)
                }),
                "attempt": failed.attempt,
                "failure_kind": failed.failure.kind.name(),
                "failure_message": failed.failure.message,
                "failure_episode": failed.failure.episode,
            })
        })
        .collect()
    }

    fn list(&self) -> Result<(), Error> {
        if self.jobs.is_empty() {
            return Ok(());
        }
        let mut out = io::stdout().lock();
        writeln!(out, "\nfailed:")?;
        let columns = ["experiment", "job_key", "job", "attempt", "kind", "episode", "message"];
        let mut rows = Rows::new(Format::Table, &columns.map(str::to_owned), &mut out)?;
        for failed in &self.jobs {
            rows.row(&[
                Field::text(&failed.experiment),
                Field::text(failed.job_key.to_string()),
                Field::text(summary::name_of_failed(&self.swept[&failed.experiment], failed)),
                Field::Integer(i64::from(failed.attempt)),
                Field::text(failed.failure.kind.name()),
                Field::Integer(i64::from(failed.failure.episode)),
                Field::text(&failed.failure.message),
            ])?;
        }
        Ok(rows.finish()?)
    }
}
