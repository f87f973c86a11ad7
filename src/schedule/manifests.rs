//! Runs manifests: from registration to stored runs.

use std::collections::HashSet;
use std::fs::{self, File};
use std::iter;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use super::estimates::add_estimates;
use super::event::{Event, EventSink};
use super::queued::Queued;
use super::race::at_stage;
use super::selection::Selection;
use super::survey::Remaining;
use super::sweep::{Context, OnFailure, Options, SweepError, Tally};
use crate::job::{JobKey, counted};
use crate::key::printable;
use crate::manifest::{self, Manifest, Runs};
use crate::plan::{self, Filter};
use crate::portable::posterior_in;
use crate::store::{Experiment, Reader, Registered, RetryFailed, Store, StoreError};
use crate::train;

/// Registers a manifest with its jobs, or only with its jobs in `part`. Returns `None` if `stop` was set
/// before the registration was complete.
///
/// **Errors**: the store fails.
pub fn register_experiment(
    store: &mut Store,
    manifest: &Manifest,
    part: Option<&HashSet<JobKey>>,
    stop: &AtomicBool,
) -> Result<Option<Registered>, StoreError> {
    let experiment = Experiment {
        name: &manifest.name,
        question: manifest.question.as_deref(),
        hypothesis: manifest.hypothesis.as_deref(),
        manifest: &manifest.source,
    };
    let jobs = plan::jobs(manifest).map(|planned| (planned.agent, planned.form));
    let registered = store.register_until(stop, &experiment, jobs, part)?;
    let declared = manifest.agents.iter().flat_map(|agent| {
        manifest.estimates_of(&agent.name).into_iter().map(|one| (agent.name.as_str(), one))
    });
    store.declare_estimates(&manifest.name, declared)?;
    Ok(registered)
}

/// The manifest of an experiment in a store, from its text; `None` if this release cannot read it. The files that it
/// names are read beside a file with the same text that a command of the store names, or else in the working folder.
pub fn stored_manifest(reader: &Reader, text: &str) -> Option<Manifest> {
    let policy = |key: &str| posterior_in(reader.path(), key);
    let path = match manifest::companions(text).is_empty() {
        true => None,
        false => path_of(reader, text),
    };
    let label = path.as_deref().unwrap_or(Path::new("manifest.toml")).to_string_lossy();
    let read = manifest::parse_with(&label, text, &[], Runs(Some(&policy)));
    read.ok().map(|read| read.manifest)
}

/// The path of a manifest with this text, from the commands that changed the store; the latest command first.
fn path_of(reader: &Reader, text: &str) -> Option<PathBuf> {
    let log = reader.log().unwrap_or_default();
    let mut paths = log.iter().rev().flat_map(|(_, command)| {
        // A path with spaces stands between quotes.
        let quoted = command.words.split(['\'', '"']);
        let words = quoted.flat_map(|words| iter::once(words).chain(words.split_whitespace()));
        let manifests = words.filter(|word| word.ends_with(".toml"));
        manifests.map(|path| Path::new(&command.folder).join(path))
    });
    paths.find(|path| fs::read_to_string(path).is_ok_and(|found| found == text))
}

/// The warning that a registration dropped jobs of the experiment; `None` if it dropped no job.
pub fn dropped_note(manifest: &Manifest, registered: &Registered) -> Option<String> {
    let (name, jobs) = (printable(&manifest.name), counted(registered.dropped, "job"));
    (registered.dropped > 0).then(|| match manifest.search {
        // A race that goes back to an earlier rung, because it has more arms, is no new experiment.
        Some(_) => format!(
            "the race of {name} does not need {jobs} at its present rung; their results stay in the store"
        ),
        None => format!(
            "{name} no longer has {jobs} that it had before; their results stay in the store; if this manifest is a \
             new experiment, give it another name"
        ),
    })
}

/// What the registration of a manifest would remove: `None` unless it would remove more than half of the jobs
/// of the experiment of its name.
///
/// **Errors**: the store fails.
pub fn removal(reader: &Reader, manifest: &Manifest) -> Result<Option<String>, StoreError> {
    // If the text is unchanged, only a new release can have changed the jobs.
    if reader.manifest(&manifest.name)?.is_none_or(|text| text == manifest.source) {
        return Ok(None);
    }
    let mut held: HashSet<JobKey> = HashSet::new();
    reader.jobs_of(&manifest.name, |key| {
        held.insert(key);
    })?;
    let before = held.len();
    for planned in plan::jobs(manifest) {
        held.remove(&planned.form.key());
    }
    let lost = held.len();
    Ok((2 * lost > before).then(|| {
        format!(
            "remove {lost} of {} from {} (their results stay in the store; if this manifest is a new \
             experiment, give it another name instead)",
            counted(before, "job"),
            printable(&manifest.name),
        )
    }))
}

/// Runs a queue, of the jobs that meet a filter if there is one, in its own session until all jobs have ended or `stop` is set. `mark_crash` receives the file
/// into which the process must write a byte when it crashes. A process that ends without writing this byte
/// counts as killed.
///
/// **Errors**: the store fails, or no worker can be started.
pub fn run_queue(
    store: &mut Store,
    (queue, filter): (Vec<Queued>, Option<&Filter>),
    options: Options,
    stop: &AtomicBool,
    mark_crash: impl FnOnce(File),
    sink: &mut dyn EventSink,
) -> Result<Tally, SweepError> {
    let filter = filter.map(ToString::to_string);
    let session = store.begin_filtered_session(&super::of_this_process(), filter.as_deref())?;
    mark_crash(store.crash_mark(session)?);
    let context = Context { options, train: &train::run, stop, curves: None };
    let swept = super::run(store, session, queue, context, sink);
    let ended = store.end_session(session);
    let tally = swept?;
    ended?;
    Ok(tally)
}

/// Registers manifests and runs all their jobs without a completed run, until all have ended or `stop` is
/// set. After a stop, running jobs write a checkpoint, from which a later call resumes them. The jobs of a search are
/// those that its races want; when they have ended, the next ones are registered and run.
///
/// **Errors**: the store fails, or no worker can be started.
pub fn run_manifests(
    store: &mut Store,
    manifests: &[Manifest],
    mut options: Options,
    stop: &AtomicBool,
    mut on_event: impl FnMut(Event<'_>),
) -> Result<Tally, SweepError> {
    let mut earlier = Tally::default();
    let mut staged = at_stage(manifests, Some(&store.reader()?))?;
    loop {
        let tally = run_stage(store, &staged, options, stop, &mut on_event)?.after(earlier);
        let next = at_stage(manifests, Some(&store.reader()?))?;
        let is_halted = options.on_failure == OnFailure::Stop && tally.failed > 0;
        if stop.load(Ordering::Relaxed) || is_halted || next == staged {
            return Ok(tally);
        }
        // A job that failed is not retried at the next stage.
        options.retry_failed = RetryFailed::No;
        (earlier, staged) = (tally, next);
    }
}

/// Registers manifests and runs their jobs.
fn run_stage(
    store: &mut Store,
    manifests: &[Manifest],
    options: Options,
    stop: &AtomicBool,
    on_event: &mut impl FnMut(Event<'_>),
) -> Result<Tally, SweepError> {
    for manifest in manifests {
        if register_experiment(store, manifest, None, stop)?.is_none() {
            return Ok(Tally::default());
        }
    }
    let selection = Selection::new(manifests, None).expect("no filter refuses");
    let remaining = Remaining::of(store, &selection, options.retry_failed)?;
    let workers = options.workers.get();
    let estimated =
        add_estimates(store, &remaining.lacking, workers, stop, &mut |_: Event<'_>| {})?;
    let tally = match remaining.queue.is_empty() {
        true => Tally::default(),
        false => run_queue(store, (remaining.queue, None), options, stop, |_| {}, on_event)?,
    };
    Ok(Tally {
        already_completed: tally.already_completed + remaining.completed,
        already_failed: tally.already_failed + remaining.failed,
        estimated: estimated.read + estimated.trained,
        not_estimated: estimated.differing + estimated.failures.len(),
        ..tally
    })
}
