//! `jitai watch`: an experiment while its jobs run, full-screen or as lines.

use std::collections::HashSet;
#[cfg(feature = "screen")]
use std::io::IsTerminal;
use std::io::{self, Write};
use std::sync::atomic::Ordering;
use std::thread;
use std::time::{Duration, Instant};

use crate::cli::output::{counted, no_experiment};
#[cfg(feature = "screen")]
use crate::cli::screen;
use crate::cli::{Error, Exit, StoreArgument, signals};
use crate::key::printable;
use crate::watch::{FailureView, View, ViewChoice, WatchError, Watcher};

/// Watch an experiment while its jobs run: jobs by state, time left, failures, and learning curves
///
/// On a terminal, the view fills the screen until you press q. It shows the learning curve of an arm
/// with its standard deviation over seeds, from completed and running jobs; keys choose the arm and the
/// metric. Elsewhere, or with --plain, a line is written whenever a number changes, until all jobs have
/// ended or no process is running one. Of a search, it shows where the races stand. Watching reads the store and
/// never delays a sweep. Jobs that are submitted to a cluster are watched through the folder of their submission.
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// The experiment: the `name` of its manifest [default: the one that runs, or else the latest]
    experiment: Option<String>,
    /// Write lines instead of filling the screen
    #[arg(long)]
    plain: bool,
    #[command(flatten)]
    store: StoreArgument,
}

impl Arguments {
    /// Lines about the experiment that runs, or else the latest.
    pub(super) fn plain(store: StoreArgument) -> Arguments {
        Arguments { experiment: None, plain: true, store }
    }
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    let stop = signals::lasting_stop_flag()
        // A terminal that nobody reads must not keep the program from ending.
        .and_then(|stop| signals::end_in_time(stop.clone(), || ()).map(|()| stop))
        .map_err(|source| Error::Io { what: "listen for signals".to_owned(), source })?;
    let path = &arguments.store.store;
    let mut watcher = Watcher::open(path)?;
    let mut choice =
        ViewChoice { experiment: arguments.experiment.clone(), ..ViewChoice::default() };
    let (mut view, mut pause) = watcher.look(&choice).map_err(|error| match error {
        WatchError::Unknown { name, known } => {
            let known: Vec<&str> = known.iter().map(String::as_str).collect();
            Error::Usage(no_experiment(&printable(&path.display().to_string()), &name, &known))
        }
        other => other.into(),
    })?;
    choice.experiment = Some(view.experiment.clone());
    #[cfg(feature = "screen")]
    if !arguments.plain && is_screen() {
        return screen::show(watcher, view, choice, &stop);
    }
    let mut lines = Lines::default();
    loop {
        lines.write(&view)?;
        if lines.is_over(&view)? {
            return Ok(Exit::Done);
        }
        let begun = Instant::now();
        while begun.elapsed() < pause {
            if stop.load(Ordering::Relaxed) {
                return Ok(Exit::Interrupted);
            }
            thread::sleep(Duration::from_millis(50));
        }
        (view, pause) = watcher.look(&choice)?;
    }
}

/// Whether a view can fill the terminal.
#[cfg(feature = "screen")]
fn is_screen() -> bool {
    let is_dumb = std::env::var_os("TERM").is_some_and(|term| term == "dumb");
    !is_dumb && io::stdin().is_terminal() && io::stdout().is_terminal()
}

/// The view as lines.
#[derive(Default)]
struct Lines {
    last: String,
    /// The failures that have been written.
    failed: HashSet<String>,
    /// Whether no process was running a job at the last look.
    rested: bool,
}

impl Lines {
    /// Writes what has changed.
    fn write(&mut self, view: &View) -> io::Result<()> {
        let mut out = io::stdout().lock();
        for FailureView { name, reason, .. } in &view.failures {
            if self.failed.insert(reason.clone()) {
                writeln!(out, "failed: {name}: {reason}")?;
            }
        }
        let line = format!("{}: {}", printable(&view.experiment), view.summary());
        let lines = view.notes().fold(line, |lines, line| lines + "\n  " + line);
        if lines != self.last {
            writeln!(out, "{lines}")?;
            self.last = lines;
        }
        out.flush()
    }

    /// Whether no more changes will come.
    fn is_over(&mut self, view: &View) -> io::Result<bool> {
        let waiting = view.counts.pending + view.counts.interrupted;
        if view.counts.running > 0 || view.held > 0 {
            self.rested = false;
            return Ok(false);
        }
        // Between two jobs, a process runs no job for a moment, so the state is read twice.
        if waiting > 0 && !std::mem::replace(&mut self.rested, true) {
            return Ok(false);
        }
        if waiting > 0 {
            let jobs = counted(waiting, "job");
            writeln!(
                io::stderr(),
                "{jobs} left, but no process is running; resume with `jitai run`"
            )?;
        }
        Ok(true)
    }
}
