//! `jitai run`: runs the jobs that have no completed run.

use std::fs::File;
use std::io::{self, Write};
use std::num::NonZeroUsize;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use clap::ValueEnum;

use crate::cli::check::ManifestArguments;
use crate::cli::on_end::{Jobs, OnEnd};
use crate::cli::output::{counted, shell_word};
use crate::cli::progress::{Progress, ProgressForm};
use crate::cli::reader::say;
use crate::cli::replacing::Replacing;
use crate::cli::signals::RESUME;
use crate::cli::workers::workers;
use crate::cli::{Error, Exit, StoreArgument, signals, summary};
use crate::env::Family;
use crate::job::JobKey;
use crate::key::printable;
use crate::manifest::Manifest;
use crate::plan::{Filter, Shard, Swept, headlines};
use crate::schedule::{
    self, Caller, Cause, End, EndedRun, Estimated, Event, EventSink, OnFailure, Options, Queued,
    Remaining, Selection, Speeds,
};
use crate::store::{FailedJob, Reader, RetryFailed, StoreError, mean_returns};
use crate::watch::failures;

/// Maximum number of different failures listed at the end.
const FAILURES_SHOWN: usize = 10;

/// Run the jobs of manifests that have no completed run yet; run the same command again to resume
/// after an interruption
///
/// The jobs of a search run one rung after the other, then the fresh seeds of the winners.
///
/// SIGINT (Ctrl-C), SIGTERM, SIGHUP, and the warnings of batch systems (SIGUSR1, SIGUSR2, SIGXCPU) save
/// every job and end the program within two seconds, with exit code 130. A signal that is ignored at
/// the start, for example under nohup, stays ignored.
#[derive(clap::Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    manifests: ManifestArguments,
    /// Number of jobs trained at the same time, at most 1024 [default: one per core]
    #[arg(long, value_name = "N", value_parser = workers)]
    workers: Option<NonZeroUsize>,
    /// Run only the jobs with these parameters, such as agent=dqn,gamma=0.9|0.99
    ///
    /// Commas separate conditions, and bars separate alternatives. A value that contains one of them stands in
    /// double quotes, which the shell must not remove: --filter 'agent="a,b"'. In quotes, \" and \\
    /// stand for a quote and a backslash.
    #[arg(long, value_name = "NAME=VALUE,...")]
    filter: Option<Filter>,
    /// Run only one shard of the jobs, such as 3/40 for the third of forty shards
    ///
    /// Every job belongs to exactly one shard, the same on every machine, and all shards take about
    /// equally long. With --filter, the filtered jobs are divided. Only the jobs of this shard are
    /// added to the store. Of a search, the present rung is divided: merge the stores of all shards
    /// and run the same commands on the merged store for the next one.
    #[arg(long, value_name = "I/N")]
    shard: Option<Shard>,
    /// Run failed jobs again; the failed runs stay in the store
    #[arg(long)]
    retry_failed: bool,
    #[command(flatten)]
    replacing: Replacing,
    /// Stop at the first job that fails
    #[arg(long)]
    fail_fast: bool,
    /// Write a checkpoint of every running job at this interval, in seconds
    ///
    /// A job that is killed loses its work since the last checkpoint; a job that is stopped loses
    /// nothing. If writing a checkpoint takes long, the interval grows to at most 25 seconds. After a
    /// kill, the first checkpoints come sooner: after a second, then at twice the time.
    #[arg(long, value_name = "SECONDS", default_value = "20", value_parser = seconds)]
    checkpoint_every: Duration,
    /// Show warnings and errors only, and no summary
    #[arg(long, short)]
    quiet: bool,
    /// Format of progress and summary
    ///
    /// With json, standard output has one object per line; its kind is under "event". Events of a
    /// worker (numbered from 0) and its job: started; completed, with wall_seconds and mean_return;
    /// failed, with wall_seconds, kind and message; interrupted, with wall_seconds; lost, when
    /// another process has taken over the job. A job that needs no run: skipped, with found
    /// (completed or failed). Checkpoints of a started job: resumed, with the episode at which the
    /// job continues; checkpoint_refused and checkpoint_not_kept, with file and reason. Estimates that
    /// completed jobs lacked: estimated, with the numbers of jobs read (from recorded decisions),
    /// trained (again), differing and failed. The last
    /// event: done, stopped (by a signal) or halted (by --fail-fast), with the number of jobs that
    /// ran, and the total numbers completed, failed and left. The end of a job is reported once it
    /// is stored, and before the next job of the same worker is reported as started.
    #[arg(long, value_enum, default_value = "text")]
    format: Format,
    /// Call this shell command once when the run ends, also after failures and Ctrl-C
    ///
    /// Its standard input is a JSON object: command (run), event (done, stopped, halted or error),
    /// exit_code, message (of an error), store, experiments, seconds, the total numbers completed,
    /// failed and left (null if the run ended before the jobs were counted), and failures, each with
    /// job_key, kind, message and jobs. Its output goes to standard error. After a signal it is not
    /// waited for, and a second Ctrl-C ends the run without it.
    #[arg(long, value_name = "COMMAND")]
    on_end: Option<String>,
    #[command(flatten)]
    store: StoreArgument,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    /// Progress on standard error, a table on standard output.
    Text,
    /// One JSON object per event and line, on standard output.
    Json,
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    let on_end = Arc::new(OnEnd::new(arguments.on_end.as_ref(), "run", &arguments.store.store));
    let last = Arc::clone(&on_end);
    let last = move || {
        signals::say_stopped();
        drop(last.call("stopped", Exit::Interrupted, None));
    };
    let stop = signals::stop_flag()
        .and_then(|stop| signals::end_in_time(stop.clone(), last).map(|()| stop))
        .map_err(|source| Error::Io { what: "listen for signals".to_owned(), source })?;
    let mut cause = Cause::NothingLeft;
    let ended = run_jobs(arguments, &on_end, &stop, &mut cause);
    on_end.after(&ended, cause.name(), &stop);
    ended
}

/// Runs the jobs; `cause` receives why the run ended.
fn run_jobs(
    arguments: &Arguments,
    on_end: &OnEnd,
    stop: &AtomicBool,
    cause: &mut Cause,
) -> Result<Exit, Error> {
    let manifests = arguments.manifests.load(&arguments.store)?;
    on_end.experiments(manifests.iter().map(|manifest| manifest.name.clone()));
    // A faulty filter makes no store.
    let selection = Selection::new(&manifests, arguments.filter.as_ref())?;
    let selection = match arguments.shard {
        Some(shard) => selection.shard(shard),
        None => selection,
    };
    let mut store = arguments.store.open()?;
    if !arguments.replacing.permit(&arguments.store, &store.reader()?, &manifests)? {
        return Ok(Exit::Differs);
    }
    let mut console = Console { arguments, on_end, shown: None, stages: 0 };
    let options = arguments.options();
    let ended = schedule::run_manifests(&mut store, &selection, options, stop, &mut console)?;
    let Some(EndedRun { end, selection }) = ended else {
        say(&format!("stopped before the first job; {RESUME}"));
        return Ok(Exit::Interrupted);
    };
    *cause = end.cause();
    match show(&end, arguments, &store.reader()?, &selection) {
        // A closed pipe is no failure; the exit code still reports the outcome of the jobs.
        Err(Error::Io { source, .. }) if source.kind() == io::ErrorKind::BrokenPipe => {}
        shown => shown?,
    }
    Ok(exit(&end))
}

/// What the user sees and hears of a run.
struct Console<'a> {
    arguments: &'a Arguments,
    on_end: &'a OnEnd,
    /// The progress of the jobs of a stage.
    shown: Option<Progress>,
    /// The number of stages that have begun.
    stages: usize,
}

impl EventSink for Console<'_> {
    fn on_event(&mut self, event: Event<'_>) {
        self.on_end.hear(&event);
        if let Some(shown) = &mut self.shown {
            shown.on_event(event);
        }
    }
}

impl Caller for Console<'_> {
    fn note(&mut self, note: &str) {
        say(note);
    }

    fn begin(
        &mut self,
        (selection, remaining): (&Selection<'_>, &Remaining),
        before: &End,
        reader: &Reader,
    ) -> Result<(), StoreError> {
        self.on_end.jobs(jobs(before));
        if self.stages > 0 {
            self.arguments.say_stage(selection.manifests(), reader)?;
        }
        self.stages += 1;
        let again: Vec<Queued> =
            remaining.lacking.iter().filter(|queued| queued.trains()).cloned().collect();
        if self.arguments.says() && !again.is_empty() {
            let jobs = counted(again.len(), "completed job");
            say(&format!(
                "training {jobs} again for estimates: their decisions, or the costs of messages, are not recorded"
            ));
        }
        // Jobs whose decisions are read take no time to show.
        let queue = match self.arguments.format {
            Format::Text => [again, remaining.queue.clone()].concat(),
            Format::Json => remaining.queue.clone(),
        };
        if !queue.is_empty() {
            let swept = Swept::of(selection.manifests());
            let jobs = remaining.lacking.len() + remaining.queue.len();
            let workers = self.arguments.options().workers.get().min(jobs);
            self.shown =
                Some(self.arguments.shown((&queue, workers), (Speeds::of(reader)?, swept)));
        }
        Ok(())
    }

    fn mark_crash(&mut self, mark: File) {
        // If the mark cannot be set, a crash counts as a kill, and the jobs can still run.
        drop(signals::mark_crash(mark));
    }

    fn end(&mut self, estimated: Option<&Estimated>) {
        self.shown = None;
        if let Some(estimated) = estimated {
            self.arguments.say_estimated(estimated);
        }
    }
}

impl Arguments {
    /// Says where the races stand, before their next jobs run.
    fn say_stage(&self, manifests: &[Manifest], reader: &Reader) -> Result<(), StoreError> {
        if self.says() {
            for note in schedule::race_notes(manifests, Some(reader))? {
                say(&note);
            }
        }
        Ok(())
    }

    /// Whether the user reads more than warnings and errors.
    fn says(&self) -> bool {
        self.format == Format::Text && !self.quiet
    }

    fn options(&self) -> Options {
        Options {
            workers: self.workers.unwrap_or_else(schedule::one_per_core),
            retry_failed: if self.retry_failed { RetryFailed::Yes } else { RetryFailed::No },
            on_failure: if self.fail_fast { OnFailure::Stop } else { OnFailure::Continue },
            checkpoint_every: self.checkpoint_every,
        }
    }

    /// Says how estimates came about, and which jobs have none.
    fn say_estimated(&self, estimated: &Estimated) {
        let says = self.says();
        let Estimated { read, trained, differing, failures } = estimated;
        if self.format == Format::Json {
            let event = serde_json::json!({
                "event": "estimated", "read": read, "trained": trained, "differing": differing,
                "failed": failures.len(),
            });
            drop(writeln!(io::stdout(), "{event}"));
        }
        if says && *read > 0 {
            let jobs = counted(*read, "completed job");
            say(&format!("estimates of {jobs} computed from recorded decisions, without training"));
        }
        if says && *trained > 0 {
            let jobs = counted(*trained, "completed job");
            say(&format!("estimates of {jobs} computed by training again, with the same results"));
        }
        if *differing > 0 {
            let jobs = counted(*differing, "completed job");
            say(&format!(
                "no estimates of {jobs}: training again gave other results than the store has; \
                 record_decisions = \"test\" makes jobs that keep their decisions"
            ));
        }
        for failure in failures.iter().take(FAILURES_SHOWN) {
            say(&format!("no estimates of {}", printable(failure)));
        }
    }

    /// The progress of a queue.
    fn shown(
        &self,
        (queue, workers): (&[Queued], usize),
        (speeds, swept): (Speeds, Swept),
    ) -> Progress {
        let style = match self.format {
            Format::Json => ProgressForm::Json,
            Format::Text if self.quiet => ProgressForm::Quiet,
            Format::Text => ProgressForm::for_stderr(),
        };
        Progress::new(style, queue, workers, speeds, swept)
    }
}

/// Parses the time between two checkpoints.
fn seconds(text: &str) -> Result<Duration, String> {
    let seconds = text.parse().ok().filter(|seconds| (0.01..=86_400.0).contains(seconds));
    seconds
        .map(Duration::from_secs_f64)
        .ok_or_else(|| "expected a number of seconds from 0.01 to 86400".to_owned())
}

fn jobs(end: &End) -> Jobs {
    Jobs { completed: end.completed(), failed: end.failed(), left: end.left() }
}

fn exit(end: &End) -> Exit {
    match end.cause() {
        Cause::Stopped => Exit::Interrupted,
        Cause::Failure => Exit::JobsFailed,
        Cause::NothingLeft if end.failed() + end.estimated().failed() > 0 => Exit::JobsFailed,
        Cause::NothingLeft => Exit::Done,
    }
}

/// Reports how the sweep ended and, in text format, its results.
fn show(
    end: &End,
    arguments: &Arguments,
    reader: &Reader,
    selection: &Selection<'_>,
) -> Result<(), Error> {
    let manifests = selection.manifests();
    report(end, arguments)?;
    arguments.say_stage(manifests, reader)?;
    if end.cause() == Cause::NothingLeft
        && selection.is_filtered()
        && !schedule::races_ended(manifests, reader)?
    {
        say(
            "other jobs of this stage are not part of this command; when they have run and their stores are merged, run \
             it again",
        );
    }
    // Estimates are no part of a job, so their failures do not change the exit code.
    for manifest in manifests.iter().filter(|_| end.cause() != Cause::Stopped) {
        if let Some(failed) = reader.failed_estimates(&manifest.name)? {
            let name = printable(&manifest.name);
            let _ = writeln!(io::stderr(), "{name}: {}", printable(&failed.described()));
        }
    }
    // After a signal, there is no time to summarise a large experiment.
    if arguments.format == Format::Json || end.cause() == Cause::Stopped {
        return Ok(());
    }
    if arguments.quiet {
        return Ok(());
    }
    let example = summary::print(reader, selection)?;
    if end.failed() > 0 {
        list_failures(&reader.failed_jobs()?, manifests)?;
    }
    Ok(suggest_next(arguments, manifests, example)?)
}

fn report(end: &End, arguments: &Arguments) -> Result<(), Error> {
    if arguments.format == Format::Json {
        let event = serde_json::json!({
            "event": end.cause().name(),
            "ran": end.ran(), "completed": end.completed(),
            "failed": end.failed(), "left": end.left(),
        });
        writeln!(io::stdout(), "{event}")?;
        return Ok(());
    }
    if !arguments.quiet {
        // The work is done, so a closed standard error is not a failure.
        say(&end.line(RESUME));
    }
    Ok(())
}

/// Lists the first different failures of the manifests' experiments.
fn list_failures(failed: &[FailedJob], manifests: &[Manifest]) -> Result<(), Error> {
    let is_ours = |job: &&FailedJob| manifests.iter().any(|ours| ours.name == job.experiment);
    let different = failures::different(failed.iter().filter(is_ours));
    let swept = Swept::of(manifests);
    let mut out = io::stdout().lock();
    writeln!(out, "\nfailed:")?;
    for same in different.iter().take(FAILURES_SHOWN) {
        let (key, name) = (same.first.job_key, summary::name_of_failed(&swept, same.first));
        writeln!(out, "  {key} {}", same.described(&name))?;
    }
    let more: usize = different.iter().skip(FAILURES_SHOWN).map(|same| same.jobs).sum();
    if more > 0 {
        writeln!(out, "  and {}; `jitai status` lists all failures", failures::more(more))?;
    }
    writeln!(out, "  run them again with `--retry-failed`; the failed runs stay in the store")?;
    Ok(())
}

/// Suggests the next commands; `example` is a completed job.
fn suggest_next(
    arguments: &Arguments,
    manifests: &[Manifest],
    example: Option<JobKey>,
) -> io::Result<()> {
    let mut out = io::stdout().lock();
    let store = arguments.store.as_option();
    let experiments: Vec<&str> = manifests.iter().map(|manifest| manifest.name.as_str()).collect();
    let mut shown = headlines(manifests);
    shown.extend(Swept::of(manifests).names());
    let query = mean_returns(&experiments, &shown);
    writeln!(out, "\nnext:")?;
    writeln!(out, "  jitai status{store}")?;
    writeln!(out, "  jitai query{store} {}", shell_word(&query))?;
    writeln!(out, "  jitai export{store} --out results")?;
    let named: Vec<String> = arguments.manifests.words().collect();
    writeln!(out, "  jitai report{store} {} --out report", named.join(" "))?;
    // `simulate` plays the first family alone.
    let can_simulate = manifests.iter().all(|manifest| manifest.family() == Family::first());
    if let Some(key) = example.filter(|_| can_simulate) {
        let key = &key.to_string()[..8];
        writeln!(out, "  jitai simulate{store} --policy run:{key}")?;
    }
    Ok(())
}
