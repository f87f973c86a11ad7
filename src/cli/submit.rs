//! `jitai submit`: submits missing jobs to a cluster.

use std::collections::HashSet;
use std::io::{self, Write};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use serde_json::json;

use crate::cli::check::ManifestArguments;
use crate::cli::on_end::{Jobs, OnEnd};
use crate::cli::output::{TextOrJson, counted};
use crate::cli::reader::say;
use crate::cli::replacing::Replacing;
use crate::cli::{Error, Exit, StoreArgument, signals, submissions};
use crate::cluster::{
    self, ChunkState, ChunkSurvey, Cluster, ClusterError, ClusterLook, Loss, Profile, Request,
    Submission, SubmissionDraft,
};
use crate::manifest::Manifest;
use crate::plan::Filter;
use crate::schedule::{self, Selection, Survey};
use crate::store::{JobState, Reader, RetryFailed, Store, StoreError};
use crate::watch::failures;

/// First and longest time between two checks of a submission with `--wait`.
const LOOK: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(15));
/// Time between two lines of progress.
const SAY: Duration = Duration::from_secs(10);

/// Submit the jobs of manifests that have no completed run yet to a Slurm cluster
///
/// Jobs are packed into chunks, one per task of a job array. Every task hands in a store, which is
/// merged by the next `jitai submit`, by `jitai status --merge`, or by --wait. Submitting again
/// submits only the jobs that are neither completed nor held by the cluster. Of a search, a submission
/// is one rung.
#[derive(clap::Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    manifests: ManifestArguments,
    /// Profile of the cluster (TOML file) [default: Slurm with its own defaults]
    #[arg(long, value_name = "FILE")]
    cluster: Option<PathBuf>,
    /// Print the script, the chunks and the core-hours without submitting
    #[arg(long)]
    dry_run: bool,
    /// Wait for the submission to end, merge its results, and resubmit the jobs of tasks that died
    #[arg(long, conflicts_with = "dry_run")]
    wait: bool,
    /// With --wait: call this shell command once when the submission ends, also after failures and Ctrl-C
    ///
    /// Its standard input is a JSON object as for `jitai run`; command is submit, and event is done,
    /// lost (jobs are left that submitting again would not help), stopped (the tasks continue) or error.
    #[arg(long, value_name = "COMMAND", requires = "wait")]
    on_end: Option<String>,
    /// Submit only the jobs with these parameters, such as agent=dqn,gamma=0.9|0.99, as for `run`
    #[arg(long, value_name = "NAME=VALUE,...")]
    filter: Option<Filter>,
    /// Submit failed jobs again; the failed runs stay in the store
    #[arg(long)]
    retry_failed: bool,
    #[command(flatten)]
    replacing: Replacing,
    /// Output format
    #[arg(long, value_enum, default_value = "text")]
    format: TextOrJson,
    #[command(flatten)]
    store: StoreArgument,
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    let stop = signals::stop_flag()
        .map_err(|source| Error::Io { what: "listen for signals".to_owned(), source })?;
    let on_end = OnEnd::new(arguments.on_end.as_ref(), "submit", &arguments.store.store);
    let ended = submit(arguments, &on_end, &stop);
    let event = if let Ok(Exit::System) = ended { "lost" } else { "done" };
    on_end.after(&ended, event, &stop);
    ended
}

fn submit(arguments: &Arguments, on_end: &OnEnd, stop: &AtomicBool) -> Result<Exit, Error> {
    let profile = match &arguments.cluster {
        Some(path) => Profile::load(path).map_err(|faults| Error::Manifests(vec![faults]))?,
        None => Profile::default(),
    };
    let manifests = arguments.manifests.load(&arguments.store)?;
    on_end.experiments(manifests.iter().map(|manifest| manifest.name.clone()));
    // A faulty filter makes no store.
    let selection = Selection::new(&manifests, arguments.filter.as_ref())?;
    let program = this_program()?;
    let retry = if arguments.retry_failed { RetryFailed::Yes } else { RetryFailed::No };
    let cluster = Cluster::of(&arguments.store.store, cluster::connect)?;
    if arguments.dry_run {
        return dry_run(arguments, &cluster, &selection, (retry, &profile, &program));
    }
    // On a machine without a cluster, nothing is written.
    cluster.limits(profile.engine).map_err(ClusterError::from)?;
    let mut store = arguments.store.open()?;
    if !arguments.replacing.permit(&arguments.store, &store.reader()?, &manifests)? {
        return Ok(Exit::Differs);
    }
    let staged = selection.at_stage(Some(&store.reader()?))?;
    if schedule::register(&mut store, &staged, stop, say)?.is_break() {
        return Ok(Exit::Interrupted);
    }
    let (profile, program) = (&profile, &*program);
    let mut submitting =
        Submitting { arguments, cluster, selection, profile, program, retry, store, stop };
    let (draft, submitted) = submitting.round()?;
    if submitted.is_none() && stop.load(Ordering::Relaxed) {
        return Ok(Exit::Interrupted);
    }
    submitting.report(&draft, submitted.as_ref())?;
    if arguments.wait {
        let exit = submitting.follow()?;
        submitting.summarise(on_end)?;
        return Ok(exit);
    }
    Ok(Exit::Done)
}

/// The path of this program, which the nodes run.
fn this_program() -> Result<PathBuf, Error> {
    std::env::current_exe()
        .map_err(|source| Error::Io { what: "find the path of this program".to_owned(), source })
}

/// The state of a `submit` command.
struct Submitting<'a> {
    arguments: &'a Arguments,
    cluster: Cluster<'a>,
    /// What the command submits, before its races have come to a stage.
    selection: Selection<'a>,
    profile: &'a Profile,
    program: &'a Path,
    retry: RetryFailed,
    store: Store,
    stop: &'a AtomicBool,
}

impl Submitting<'_> {
    fn manifests(&self) -> &[Manifest] {
        self.selection.manifests()
    }

    /// Whether a manifest is a search.
    fn is_race(&self) -> bool {
        self.manifests().iter().any(|manifest| manifest.search.is_some())
    }

    fn request<'s>(&'s self, selection: &'s Selection<'s>) -> Request<'s> {
        let Submitting { profile, program, retry, .. } = *self;
        Request { selection, retry, profile, program }
    }

    /// Merges finished work and submits missing jobs.
    fn round(&mut self) -> Result<(SubmissionDraft, Option<Submission>), Error> {
        let profile = self.profile;
        let limits = self.cluster.limits(profile.engine).map_err(ClusterError::from)?;
        let submissions = self.cluster.submissions();
        submissions.make(profile.folder())?;
        let _lock = submissions.lock()?;
        let mut look = self.cluster.look()?;
        if let Some(silence) = look.silence {
            return Err(ClusterError::from(silence).into());
        }
        for name in self.cluster.abandon_unknown(&mut look)? {
            say(&format!("{name} never reached the cluster; its jobs can be submitted again"));
        }
        self.collect(&look)?;
        let reader = self.store.reader()?;
        let selection = self.selection.at_stage(Some(&reader))?;
        // The races may have come to further jobs.
        let registered = match self.is_race() {
            true => schedule::register(&mut self.store, &selection, self.stop, say)?,
            false => ControlFlow::Continue(()),
        };
        let request = self.request(&selection);
        let draft = self.cluster.draft(request, Some(&reader), &look, limits)?;
        let submitted = match draft.chunks.is_empty() || registered.is_break() {
            true => None,
            false => Some(self.cluster.launch(&draft, request)?),
        };
        Ok((draft, submitted))
    }

    /// Merges new parts and records jobs that crashed their tasks.
    fn collect(&mut self, look: &ClusterLook) -> Result<(), Error> {
        let merged = submissions::collect(look, &mut self.store)?;
        if merged.completed + merged.failed > 0 && !self.arguments.wait {
            let runs = counted(merged.completed + merged.failed, "run");
            say(&format!("merged {runs} from earlier submissions"));
        }
        let crashed = self.cluster.record_crashes(look, &mut self.store)?;
        if let Some(key) = crashed.first() {
            let others = match crashed.len() {
                1 => String::new(),
                all => format!(" and {}", failures::more(all - 1)),
            };
            say(&format!(
                "job {key}{others} failed (crashed): three tasks died while running it; \
                 `jitai submit --retry-failed` submits it again"
            ));
        }
        Ok(())
    }

    fn report(&self, draft: &SubmissionDraft, submitted: Option<&Submission>) -> Result<(), Error> {
        let mut out = io::stdout();
        if self.arguments.format == TextOrJson::Json {
            let object = json!({
                "submission": submitted.map(Submission::name),
                "array": submitted.and_then(Submission::array),
                "folder": submitted.map(|submission| submission.path().display().to_string()),
                "chunks": draft.chunks.len(), "jobs": draft.jobs(),
                "core_hours": draft.core_hours(), "completed": draft.completed,
                "failed": draft.failed, "running": draft.running, "held": draft.held,
                "deferred": draft.deferred,
            });
            return Ok(writeln!(out, "{object}")?);
        }
        match submitted {
            Some(submission) => writeln!(
                out,
                "submitted {}: {} in {}, about {:.2} core-hours; array {}\n{}",
                submission.name(),
                counted(draft.jobs(), "job"),
                counted(draft.chunks.len(), "chunk"),
                draft.core_hours(),
                submission.array().unwrap_or_default(),
                submission.path().display(),
            )?,
            None => writeln!(out, "nothing to submit")?,
        }
        say(&others(draft));
        self.say_races()
    }

    /// Says where the races stand. The next `jitai submit` submits their next jobs.
    fn say_races(&self) -> Result<(), Error> {
        let reader = self.store.reader()?;
        for note in schedule::race_notes(self.manifests(), Some(&reader))? {
            say(&note);
        }
        let again = !self.arguments.wait && !schedule::races_ended(self.manifests(), &reader)?;
        if again {
            say("submit again when the tasks have ended: the races may want more jobs");
        }
        Ok(())
    }

    /// Waits until the cluster holds no more jobs and nothing can be submitted again.
    fn follow(&mut self) -> Result<Exit, Error> {
        // A job that fails again is not retried again.
        self.retry = RetryFailed::No;
        let (mut pause, most) = LOOK;
        let (mut said_at, mut said) = (None::<Instant>, String::new());
        loop {
            let begun = Instant::now();
            while begun.elapsed() < pause {
                if self.stop.load(Ordering::Relaxed) {
                    say("stopped waiting; the tasks continue on the cluster");
                    return Ok(Exit::Interrupted);
                }
                thread::sleep(Duration::from_millis(50));
            }
            pause = (pause * 2).min(most);
            let look = self.cluster.look()?;
            let line = progress(&look);
            if line != said && said_at.is_none_or(|at| at.elapsed() >= SAY) {
                say(&line);
                (said_at, said) = (Some(Instant::now()), line);
            }
            if look.silence.is_some() {
                continue;
            }
            self.collect(&look)?;
            if self.ours(&look).any(|(_, survey)| submissions::is_open(survey)) {
                continue;
            }
            let reader = self.store.reader()?;
            let limits = self.profile.engine.usual_limits();
            let selection = self.selection.at_stage(Some(&reader))?;
            let request = self.request(&selection);
            let draft = self.cluster.draft(request, Some(&reader), &look, limits)?;
            if draft.held > 0 {
                // The tasks of a cancelled submission are about to end.
                continue;
            }
            if draft.chunks.is_empty() {
                self.say_races()?;
                return Ok(self.end(&draft));
            }
            if !self.ours(&look).last().is_some_and(|(_, survey)| may_submit_again(survey)) {
                return self.give_up(&look, &reader);
            }
            let (draft, submitted) = self.round()?;
            if let Some(submission) = submitted {
                let (name, jobs) = (submission.name(), counted(draft.jobs(), "job"));
                let chunks = counted(draft.chunks.len(), "chunk");
                // The jobs of a race's next rung are new.
                let again = if self.is_race() { "submitted as" } else { "submitted again as" };
                say(&format!("{again} {name}: {jobs} in {chunks}"));
                self.say_races()?;
            }
            pause = LOOK.0;
        }
    }

    /// The submissions of these experiments, whose end the command awaits.
    fn ours<'l>(
        &self,
        look: &'l ClusterLook,
    ) -> impl DoubleEndedIterator<Item = &'l (Submission, ChunkSurvey)> {
        let names: Vec<&str> = self.manifests().iter().map(|m| m.name.as_str()).collect();
        let is_ours = |submission: &Submission| {
            submission.intent.experiments.iter().any(|name| names.contains(&name.as_str()))
        };
        let ours: Vec<_> = look.surveys.iter().filter(|(one, _)| is_ours(one)).collect();
        ours.into_iter()
    }

    /// Adds the jobs and the failures of the store to the summary of `--on-end`.
    fn summarise(&self, on_end: &OnEnd) -> Result<(), Error> {
        let reader = self.store.reader()?;
        let mut jobs = Jobs::default();
        let selection = self.selection.at_stage(Some(&reader))?;
        Survey::of(&selection, Some(&reader)).walk_all(|job| {
            *match job.state {
                JobState::Completed => &mut jobs.completed,
                JobState::Failed => &mut jobs.failed,
                JobState::Pending | JobState::Interrupted | JobState::Running => &mut jobs.left,
            } += 1;
            Ok::<_, StoreError>(())
        })?;
        on_end.jobs(jobs);
        let ours: HashSet<&str> = self.manifests().iter().map(|one| one.name.as_str()).collect();
        for failed in reader.failed_jobs()? {
            if ours.contains(failed.experiment.as_str()) {
                on_end.failed(failed.job_key, &failed.failure);
            }
        }
        Ok(())
    }

    fn end(&self, draft: &SubmissionDraft) -> Exit {
        say(&format!("{} completed, {} failed", draft.completed, draft.failed));
        if draft.failed > 0 { Exit::JobsFailed } else { Exit::Done }
    }

    /// Lists the lost chunks that resubmission would not help.
    fn give_up(&self, look: &ClusterLook, reader: &Reader) -> Result<Exit, Error> {
        let ended = submissions::ended(reader)?;
        for (submission, survey) in &look.surveys {
            if survey.stopped.is_none() {
                submissions::list_lost(submission, survey, &ended)?;
            }
        }
        say("jobs are left; run `jitai submit` to submit them again");
        Ok(Exit::System)
    }
}

/// Whether resubmission may help: the task of every lost chunk died. A task that reported an error
/// would report the error again.
fn may_submit_again(survey: &ChunkSurvey) -> bool {
    survey.stopped.is_none()
        && survey.chunks.iter().all(|chunk| match chunk.state {
            ChunkState::Lost(Loss::NotBegun | Loss::Stopped | Loss::Failed(_)) => false,
            ChunkState::Lost(Loss::Died)
            | ChunkState::Waiting
            | ChunkState::Running
            | ChunkState::Finished
            | ChunkState::Unknown => true,
        })
}

/// The progress line about open submissions.
fn progress(look: &ClusterLook) -> String {
    let (mut waiting, mut running, mut unknown, mut left) = (0, 0, 0, 0);
    for (_, survey) in look.surveys.iter().filter(|(_, survey)| submissions::is_open(survey)) {
        let counts = survey.counts();
        waiting += counts.waiting;
        running += counts.running;
        unknown += counts.unknown;
        left += survey.chunks.iter().map(|chunk| chunk.left.len()).sum::<usize>();
    }
    match &look.silence {
        Some(silence) => format!("{} unknown: {silence}", counted(unknown, "chunk")),
        None => format!(
            "{} running, {waiting} waiting, {} left",
            counted(running, "chunk"),
            counted(left, "job")
        ),
    }
}

/// The line about jobs that are not submitted.
fn others(draft: &SubmissionDraft) -> String {
    let SubmissionDraft { completed, failed, running, held, deferred, .. } = draft;
    let mut line = format!("{completed} completed, {failed} failed, {held} held by the cluster");
    if *running > 0 {
        line.push_str(&format!(", {running} running in this store"));
    }
    if *deferred > 0 {
        line.push_str(&format!(", {deferred} deferred to the next submission"));
    }
    line
}

fn dry_run(
    arguments: &Arguments,
    cluster: &Cluster<'_>,
    selection: &Selection<'_>,
    (retry, profile, program): (RetryFailed, &Profile, &Path),
) -> Result<Exit, Error> {
    let reader = match Reader::open(&arguments.store.store) {
        Ok(reader) => Some(reader),
        Err(StoreError::Missing { .. } | StoreError::Empty { .. }) => None,
        Err(error) => return Err(error.into()),
    };
    let selection = selection.at_stage(reader.as_ref())?;
    let request = Request { selection: &selection, retry, profile, program };
    let engine = profile.engine;
    let limits = cluster.limits(engine).or_else(|error| {
        let usual = engine.usual_limits();
        let most = usual.most_tasks;
        say(&format!("{error}; assuming arrays of at most {most} tasks"));
        Ok::<_, Error>(usual)
    })?;
    let look = cluster.look()?;
    let draft = cluster.draft(request, reader.as_ref(), &look, limits)?;
    let script = cluster.script(&draft, request);
    let mut out = io::stdout().lock();
    if arguments.format == TextOrJson::Json {
        let chunks: Vec<_> = draft
            .chunks
            .iter()
            .map(|chunk| json!({ "jobs": chunk.keys.len(), "seconds": chunk.seconds }))
            .collect();
        let object = json!({
            "script": script, "chunks": chunks, "jobs": draft.jobs(),
            "core_hours": draft.core_hours(),
        });
        writeln!(out, "{object}")?;
        return Ok(Exit::Done);
    }
    let Some(script) = script else {
        writeln!(out, "nothing to submit")?;
        say(&others(&draft));
        return Ok(Exit::Done);
    };
    writeln!(out, "{script}")?;
    show_chunks(&mut out, &draft)?;
    say(&others(&draft));
    Ok(Exit::Done)
}

/// Writes one line per chunk with its jobs and minutes, then the total.
fn show_chunks(out: &mut impl Write, draft: &SubmissionDraft) -> io::Result<()> {
    for (number, chunk) in draft.chunks.iter().enumerate() {
        let (jobs, minutes) = (counted(chunk.keys.len(), "job"), chunk.seconds / 60.0);
        writeln!(out, "# chunk {number}: {jobs}, about {minutes:.1} min of one core")?;
    }
    let (jobs, chunks) = (counted(draft.jobs(), "job"), counted(draft.chunks.len(), "chunk"));
    writeln!(out, "# {jobs} in {chunks}, about {:.2} core-hours", draft.core_hours())
}
