//! `jitai run`: runs what is missing.

use std::io::{self, Write};
use std::num::NonZeroUsize;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use clap::ValueEnum;

use crate::cli::output::{counted, shell_word};
use crate::cli::progress::{Shown, Style};
use crate::cli::workers::workers;
use crate::cli::{Error, Exit, StoreArgument, check, signals, summary};
use crate::manifest::{Manifest, printable, short_name};
use crate::plan::{Filter, JobKey, Shard, Swept};
use crate::schedule::{self, OnFailure, Options, Queued, Remaining, Selection, Speeds, Tally};
use crate::store::{FailedJob, Reader, RetryFailed, Store};

/// Failed jobs that are listed at the end.
const FAILURES_SHOWN: usize = 10;

/// Run the jobs of manifests that have no completed run yet; run again to go on after an
/// interruption
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// Manifests (TOML files)
    #[arg(required = true, value_name = "MANIFEST")]
    manifests: Vec<PathBuf>,
    /// Jobs that train at the same time, at most 1024 [default: one a core]
    #[arg(long, value_name = "N", value_parser = workers)]
    workers: Option<NonZeroUsize>,
    /// Run only jobs with these parameters, such as agent=dqn,sigma=0.4|0.6
    #[arg(long, value_name = "NAME=VALUE,...")]
    filter: Option<Filter>,
    /// Run only one of several parts of the jobs, such as 3/40 for the third of forty
    ///
    /// Every job is in one part, the same on every machine; the parts take about as long. Only the
    /// jobs of the part are entered in the store. With --filter, the jobs that meet it are parted.
    #[arg(long, value_name = "I/N")]
    shard: Option<Shard>,
    /// Run jobs again that failed before; the failed runs stay in the store
    #[arg(long)]
    retry_failed: bool,
    /// Stop at the first job that fails
    #[arg(long)]
    fail_fast: bool,
    /// Write a checkpoint of every job after so many seconds, and again
    ///
    /// A job that is killed loses what it did since its last one; one that is stopped loses
    /// nothing. Where writing one takes long, there is more time between two, up to 25 seconds.
    #[arg(long, value_name = "SECONDS", default_value = "20", value_parser = seconds)]
    checkpoint_every: Duration,
    /// Show no progress; what is unusual is told
    #[arg(long, short)]
    quiet: bool,
    /// How progress and summary are written
    ///
    /// With json, standard output has an object a line, each with its kind under "event". Of a
    /// worker (from 0) and its job: started; completed, with wall_seconds and mean_return; failed,
    /// with wall_seconds, kind and message; interrupted, with wall_seconds; lost, when another
    /// process has taken the job over. Of a job that needs no run: skipped, with found (completed
    /// or failed). Of a checkpoint of a started job: resumed, with the episode that the job goes on
    /// from; checkpoint_refused and checkpoint_not_kept, with file and reason. Last: done, stopped
    /// (by a signal) or halted (by --fail-fast), with the numbers of jobs that ran, and that are
    /// completed, failed and left in all. A worker's job is told to have ended once it is stored,
    /// and before the worker's next is told to have started.
    #[arg(long, value_enum, default_value = "text")]
    format: Format,
    #[command(flatten)]
    store: StoreArgument,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    /// Progress on standard error, a table on standard output.
    Text,
    /// An object an event, one a line, on standard output.
    Json,
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    let stop = signals::stop_flag()
        .and_then(|stop| signals::end_in_time(stop.clone()).map(|()| stop))
        .map_err(|source| Error::Io { what: "listen for signals".to_owned(), source })?;
    let manifests = check::load_all(&arguments.manifests)?;
    let mut selection = Selection::new(&manifests, arguments.filter.as_ref())?;
    if let Some(shard) = arguments.shard {
        selection = selection.shard(shard);
    }
    let wanted = selection.queue();
    let mut store = Store::open(&arguments.store.store)?;
    for manifest in &manifests {
        if register_experiment(&mut store, manifest, &selection, &stop)?.is_break() {
            let _ =
                writeln!(io::stderr(), "stopped before the first job; the same command goes on");
            return Ok(Exit::Interrupted);
        }
    }
    let options = arguments.options();
    let remaining = Remaining::of(&store, wanted, options.retry_failed)?;
    let mut end = End::before(&remaining);
    let reader = Reader::open(&arguments.store.store)?;
    if !remaining.queue.is_empty() {
        let mut shown = arguments.shown(&reader, &remaining.queue, Swept::of(&manifests))?;
        // Without the mark a crash counts as a kill, which is no reason not to run.
        let mark_crash = |mark| drop(signals::mark_crash(mark));
        let queue = remaining.queue;
        let swept = schedule::run_queue(&mut store, queue, options, &stop, mark_crash, &mut shown);
        drop(shown);
        end.tally = swept?;
    }
    if end.left() > 0 {
        // A signal after the last job has stopped nothing.
        end.cause = match options.on_failure {
            _ if stop.load(Ordering::Relaxed) => Cause::Signal,
            OnFailure::Stop => Cause::Failure,
            OnFailure::Continue => Cause::NothingLeft,
        };
    }
    match end.show(arguments, &reader, &selection) {
        // Who closed the pipe has read enough; the exit code still says what became of the jobs.
        Err(Error::Io { source, .. }) if source.kind() == io::ErrorKind::BrokenPipe => {}
        shown => shown?,
    }
    Ok(end.exit())
}

impl Arguments {
    fn retry(&self) -> RetryFailed {
        if self.retry_failed { RetryFailed::Yes } else { RetryFailed::No }
    }

    fn options(&self) -> Options {
        Options {
            workers: self.workers.unwrap_or_else(schedule::one_per_core),
            retry_failed: self.retry(),
            on_failure: if self.fail_fast { OnFailure::Stop } else { OnFailure::Continue },
            checkpoint_every: self.checkpoint_every,
        }
    }

    fn shown(&self, reader: &Reader, queue: &[Queued], swept: Swept) -> Result<Shown, Error> {
        let style = match self.format {
            Format::Json => Style::Json,
            Format::Text if self.quiet => Style::Quiet,
            Format::Text => Style::for_stderr(),
        };
        let workers = self.options().workers.get();
        Ok(Shown::new(style, queue, workers, Speeds::of(reader)?, swept))
    }
}

/// A time between two checkpoints.
fn seconds(text: &str) -> Result<Duration, String> {
    let seconds = text.parse().ok().filter(|seconds| (0.01..=86_400.0).contains(seconds));
    seconds
        .map(Duration::from_secs_f64)
        .ok_or_else(|| "expected a number of seconds from 0.01 to 86400".to_owned())
}

/// Registers a manifest, and says so if that drops jobs; breaks off if `stop` is set.
pub(super) fn register_experiment(
    store: &mut Store,
    manifest: &Manifest,
    selection: &Selection<'_>,
    stop: &AtomicBool,
) -> Result<ControlFlow<()>, Error> {
    let registered = schedule::register_experiment(store, manifest, selection.keys(), stop)?;
    let Some(registered) = registered else {
        return Ok(ControlFlow::Break(()));
    };
    if registered.dropped > 0 {
        let _ = writeln!(
            io::stderr(),
            "{name} no longer has {} that it had before; results stay in the store. If the manifest is \
             meant as another experiment than before, give it another name",
            counted(registered.dropped, "job"),
            name = printable(&manifest.name),
        );
    }
    Ok(ControlFlow::Continue(()))
}

/// Why a sweep ended.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Cause {
    /// Every job has ended.
    NothingLeft,
    /// A signal.
    Signal,
    /// The first job that failed, as `--fail-fast` asks.
    Failure,
}

/// How a sweep ended.
struct End {
    /// Jobs that were to be run.
    queued: usize,
    /// Jobs that were completed before it.
    completed_before: usize,
    /// Jobs that had failed before it and were not run again.
    failed_before: usize,
    tally: Tally,
    cause: Cause,
}

impl End {
    /// The end of a sweep that has not begun.
    fn before(remaining: &Remaining) -> End {
        End {
            queued: remaining.queue.len(),
            completed_before: remaining.completed,
            failed_before: remaining.failed,
            tally: Tally::default(),
            cause: Cause::NothingLeft,
        }
    }

    fn completed(&self) -> usize {
        self.completed_before + self.tally.already_completed + self.tally.completed
    }

    fn failed(&self) -> usize {
        self.failed_before + self.tally.already_failed + self.tally.failed
    }

    fn left(&self) -> usize {
        self.completed_before + self.failed_before + self.queued - self.completed() - self.failed()
    }

    fn exit(&self) -> Exit {
        match self.cause {
            Cause::Signal => Exit::Interrupted,
            Cause::Failure => Exit::JobsFailed,
            Cause::NothingLeft if self.failed() > 0 => Exit::JobsFailed,
            Cause::NothingLeft => Exit::Done,
        }
    }

    /// Tells how it ended and, if a person reads it, what came out.
    fn show(
        &self,
        arguments: &Arguments,
        reader: &Reader,
        selection: &Selection<'_>,
    ) -> Result<(), Error> {
        let manifests = selection.manifests();
        self.tell(arguments)?;
        // Summarising a large experiment takes longer than a stop may.
        if arguments.format == Format::Json || self.cause == Cause::Signal {
            return Ok(());
        }
        let example = summary::print(reader, selection)?;
        if arguments.quiet {
            return Ok(());
        }
        if self.failed() > 0 {
            list_failures(&reader.failed_jobs()?, manifests)?;
        }
        Ok(tell_next(arguments, manifests, example)?)
    }

    fn tell(&self, arguments: &Arguments) -> Result<(), Error> {
        if arguments.format == Format::Json {
            let event = serde_json::json!({
                "event": match self.cause {
                    Cause::NothingLeft => "done",
                    Cause::Signal => "stopped",
                    Cause::Failure => "halted",
                },
                "ran": self.ran(), "completed": self.completed(),
                "failed": self.failed(), "left": self.left(),
            });
            writeln!(io::stdout(), "{event}")?;
            return Ok(());
        }
        if arguments.quiet {
            return Ok(());
        }
        let (completed, failed, left) = (self.completed(), self.failed(), self.left());
        let ran = counted(self.ran(), "job");
        let ran = format!("{ran} run, {completed} completed in all, {failed} failed");
        let line = match self.cause {
            Cause::Signal => {
                let completed = counted(completed, "job");
                format!("stopped: {completed} completed, {left} left; the same command goes on")
            }
            Cause::Failure => {
                format!("{ran}; halted after the first failure; {} left", counted(left, "job"))
            }
            Cause::NothingLeft if self.queued == 0 && failed == 0 => match completed {
                0 => "nothing to run: no job is in this shard".to_owned(),
                1 => "nothing to run: the job is completed".to_owned(),
                _ => format!("nothing to run: all {completed} jobs are completed"),
            },
            Cause::NothingLeft => ran,
        };
        // A closed standard error is no reason to fail after the work is done.
        let _ = writeln!(io::stderr(), "{line}");
        Ok(())
    }

    fn ran(&self) -> usize {
        self.tally.completed + self.tally.failed
    }
}

/// Lists the failed jobs of the manifests' experiments, the first few of them.
fn list_failures(failed: &[FailedJob], manifests: &[Manifest]) -> Result<(), Error> {
    let is_ours = |job: &&FailedJob| manifests.iter().any(|ours| ours.name == job.experiment);
    let ours: Vec<_> = failed.iter().filter(is_ours).collect();
    let swept = Swept::of(manifests);
    let mut out = io::stdout().lock();
    writeln!(out, "\nfailed:")?;
    for job in ours.iter().take(FAILURES_SHOWN) {
        let message = printable(&job.failure.message);
        let (key, name) = (job.job_key, summary::name_of_failed(&swept, job));
        writeln!(out, "  {key} {name}: {} ({message})", job.failure.kind)?;
    }
    if ours.len() > FAILURES_SHOWN {
        writeln!(out, "  and {} more, which `jitai status` lists", ours.len() - FAILURES_SHOWN)?;
    }
    writeln!(out, "  `--retry-failed` runs them again and keeps these runs")?;
    Ok(())
}

/// Says what a person would do next; `example` is a completed job.
fn tell_next(
    arguments: &Arguments,
    manifests: &[Manifest],
    example: Option<JobKey>,
) -> io::Result<()> {
    let mut out = io::stdout().lock();
    let store = arguments.store.as_option();
    writeln!(out, "\nnext:")?;
    writeln!(out, "  jitai status{store}")?;
    writeln!(out, "  jitai query{store} {}", shell_word(&example_query(manifests)))?;
    writeln!(out, "  jitai export{store} --out results")?;
    let named = arguments.manifests.iter().map(|path| shell_word(&path.to_string_lossy()));
    let named: Vec<String> = named.collect();
    writeln!(out, "  jitai report{store} {} --out report", named.join(" "))?;
    if let Some(key) = example {
        let key = &key.to_string()[..8];
        writeln!(out, "  jitai simulate{store} --policy run:{key}")?;
    }
    Ok(())
}

/// The mean return of every arm of the manifests' experiments, as SQL.
fn example_query(manifests: &[Manifest]) -> String {
    let names: Vec<String> = manifests.iter().map(|manifest| sql_text(&manifest.name)).collect();
    let (mut columns, condition) = match names.as_slice() {
        [name] => (Vec::new(), format!("= {name}")),
        names => (vec!["experiment".to_owned()], format!("IN ({})", names.join(", "))),
    };
    columns.extend(["agent", "scenario", "sigma"].map(str::to_owned));
    for name in Swept::of(manifests).names() {
        columns.push(format!(
            "(SELECT value FROM parameter AS p WHERE p.job_key = run_summary.job_key AND name = '{name}') \
             AS {}",
            short_name(&name)
        ));
    }
    let groups: Vec<String> = (1..=columns.len()).map(|place| place.to_string()).collect();
    format!(
        "SELECT {}, avg(mean_return) FROM run_summary \
         WHERE status = 'completed' AND experiment {condition} GROUP BY {}",
        columns.join(", "),
        groups.join(", ")
    )
}

/// A text as SQL writes it; as its bytes where a terminal would not show it as it is.
fn sql_text(text: &str) -> String {
    if printable(text) == text {
        return format!("'{}'", text.replace('\'', "''"));
    }
    let digits: String = text.bytes().map(|byte| format!("{byte:02x}")).collect();
    format!("CAST(x'{digits}' AS TEXT)")
}
