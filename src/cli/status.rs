//! `jitai status`: what has become of every experiment in a store.

use std::io::{self, IsTerminal, Write};
use std::thread;
use std::time::Duration;

use serde_json::json;

use crate::cli::estimate::Episodes;
use crate::cli::output::{Cell, Format, Rows};
use crate::cli::run::speeds;
use crate::cli::{Error, Exit, StoreArgument, counts};
use crate::store::{ExperimentCounts, FailedJob, Reader};

/// Show the experiments of a store: jobs by state, failures with their reasons
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// Show it again every two seconds, until all jobs have ended
    #[arg(long)]
    watch: bool,
    /// How rows are written
    #[arg(long, value_enum, default_value = "table")]
    format: Format,
    #[command(flatten)]
    store: StoreArgument,
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    loop {
        let reader = Reader::open(&arguments.store.store)?;
        if arguments.watch && io::stdout().is_terminal() {
            // Clear the screen, cursor home.
            write!(io::stdout(), "\u{1b}[2J\u{1b}[H")?;
        }
        let open = show(&reader, arguments.format)?;
        if !arguments.watch || open == 0 {
            return Ok(Exit::Done);
        }
        drop(reader);
        thread::sleep(Duration::from_secs(2));
    }
}

/// Prints the state of the store; returns how many jobs have still to end.
fn show(reader: &Reader, format: Format) -> Result<u64, Error> {
    let speeds = speeds(reader)?;
    let failed = reader.failed_jobs()?;
    let mut columns = counts::COLUMNS.map(str::to_owned).to_vec();
    if format == Format::Json {
        columns.push("failures".to_owned());
    }
    let mut rows = Rows::new(format, &columns, io::stdout().lock())?;
    let mut open = 0;
    for ExperimentCounts { experiment, counts, episodes_left } in reader.experiment_counts()? {
        open += counts.pending + counts.interrupted + counts.running;
        let mut episodes = Episodes::default();
        for (algorithm, left) in &episodes_left {
            episodes.add(algorithm, *left);
        }
        // As many at a time as are running now; one if none is.
        let seconds = speeds.seconds(&episodes).map(|s| s / counts.running.max(1) as f64);
        let mut cells = counts::cells(&experiment, &counts, seconds);
        if format == Format::Json {
            let ours = failed.iter().filter(|job| job.experiment == experiment);
            cells.push(Cell::Nested(ours.map(described).collect()));
        }
        rows.row(&cells)?;
    }
    rows.finish()?;
    if format == Format::Table {
        show_failures(failed)?;
    }
    Ok(open)
}

/// A failed job for programs.
fn described(job: &FailedJob) -> serde_json::Value {
    json!({
        "job_key": job.job_key.to_string(),
        "agent": job.agent,
        "attempt": job.attempt,
        "failure_kind": job.failure.kind.name(),
        "failure_message": job.failure.message,
        "failure_episode": job.failure.episode,
    })
}

fn show_failures(failed: Vec<FailedJob>) -> Result<(), Error> {
    if failed.is_empty() {
        return Ok(());
    }
    let mut out = io::stdout().lock();
    writeln!(out, "\nfailed:")?;
    let columns = ["experiment", "job_key", "agent", "attempt", "kind", "episode", "message"];
    let mut rows = Rows::new(Format::Table, &columns.map(str::to_owned), &mut out)?;
    for job in failed {
        rows.row(&[
            Cell::text(job.experiment),
            Cell::text(job.job_key.to_string()),
            Cell::text(job.agent),
            Cell::Integer(i64::from(job.attempt)),
            Cell::text(job.failure.kind.name()),
            Cell::Integer(i64::from(job.failure.episode)),
            Cell::text(job.failure.message),
        ])?;
    }
    Ok(rows.finish()?)
}
