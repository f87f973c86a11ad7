//! `jitai status`: what has become of every experiment in a store.

use std::io::{self, IsTerminal, Write};
use std::thread;
use std::time::Duration;

use crate::cli::estimate::Episodes;
use crate::cli::output::{Cell, Format, Rows};
use crate::cli::run::speeds;
use crate::cli::{Error, Exit, StoreArgument, counts};
use crate::store::{ExperimentCounts, Reader};

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
    let left = reader.episodes_left()?;
    let mut rows = Rows::new(format, &counts::COLUMNS.map(str::to_owned), io::stdout().lock())?;
    let mut open = 0;
    for ExperimentCounts { experiment, counts } in reader.experiment_counts()? {
        open += counts.pending + counts.interrupted + counts.running;
        let mut episodes = Episodes::default();
        for of in left.iter().filter(|of| of.experiment == experiment) {
            episodes.add(&of.algorithm, of.episodes);
        }
        // As many at a time as are running now; one if none is.
        let seconds = speeds.seconds(&episodes).map(|s| s / counts.running.max(1) as f64);
        rows.row(&counts::cells(&experiment, &counts, seconds))?;
    }
    rows.finish()?;
    if format == Format::Table {
        show_failures(reader)?;
    }
    Ok(open)
}

fn show_failures(reader: &Reader) -> Result<(), Error> {
    let failed = reader.failed_jobs()?;
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
