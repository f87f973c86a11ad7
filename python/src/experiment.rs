//! Experiments: manifests that are checked, planned, run and reported in this process.

use std::collections::HashSet;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Sender;
use std::time::{Duration, Instant};

use jitai::algorithm::Parameter;
use jitai::experiment::{
    self, Caller, End, EndedRun, Estimated, Event, EventLog, EventSink, Factors, Faults, Filter,
    MOST_WORKERS, Manifest, OnFailure, Options, Overridden, Override, Preview, Published,
    Remaining, RetryFailed, Runs, Selection, Shard, Speeds, Store, Survey, SweepError, Swept,
};
use jitai::policy::posterior_in;
use jitai::results::{self, AssembleError, Hosts, Interrupter, Reader, ReportedExperiment};
use jitai::store::StoreError;
use pyo3::exceptions::{PyFileNotFoundError, PyOSError, PyRuntimeError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyString};
use serde_json::{Value as Json, json};

use crate::declaration::{json as of_json, refused, toml_of};
use crate::interrupt::{attended, interruptible};
use crate::store::store_error;

pyo3::create_exception!(
    jitai,
    ManifestError,
    PyValueError,
    "A manifest has faults: the message has all of them, and `faults` is a list of dicts with `file`, `line`, \
     `column`, `message` and `help`."
);

/// A manifest: a file, or a dict of its keys as TOML.
enum Given {
    File(PathBuf),
    Text(String),
}

impl Given {
    fn of(given: &Bound<'_, PyAny>) -> PyResult<Self> {
        if given.is_instance_of::<PyDict>() {
            let table = toml_of("manifest", given, 0)?;
            return toml::to_string(&table).map(Given::Text).map_err(refused);
        }
        // The text of a manifest that a store has.
        if given.is_instance_of::<PyBytes>() {
            return String::from_utf8(given.extract()?).map(Given::Text).map_err(refused);
        }
        if given.is_instance_of::<PyString>() || given.hasattr("__fspath__")? {
            let path: PathBuf = given.extract()?;
            return match path.exists() {
                true => Ok(Given::File(path)),
                false => {
                    let message = format!("{}: no such file", path.display());
                    Err(PyFileNotFoundError::new_err(message))
                }
            };
        }
        let found = given.get_type().name()?;
        Err(PyTypeError::new_err(format!("manifest: expected a path or a dict, found {found}")))
    }
}

/// What a call asks for.
struct Asked {
    manifests: Vec<Given>,
    set: Vec<Override>,
    /// The store, to which values such as `run:KEY` refer, too.
    store: PathBuf,
    filter: Option<Filter>,
    shard: Option<Shard>,
    options: Options,
    /// Whether a manifest may remove most jobs of its experiment.
    replace: bool,
    /// The call, for the list of commands that changed the store.
    call: String,
}

/// The argument with a name; `None` if it is missing or `None`.
///
/// **Errors**: it has another type.
fn argument<'py, T: for<'a> FromPyObject<'a, 'py>>(
    arguments: &Bound<'py, PyDict>,
    name: &str,
    expected: &str,
) -> PyResult<Option<T>> {
    let Some(value) = arguments.get_item(name)?.filter(|value| !value.is_none()) else {
        return Ok(None);
    };
    let found = value.repr()?;
    let value = value.extract().map(Some);
    value.map_err(|_| PyTypeError::new_err(format!("{name}: expected {expected}, found {found}")))
}

impl Asked {
    fn of(arguments: &Bound<'_, PyDict>) -> PyResult<Asked> {
        let mut asked = Asked {
            manifests: Vec::new(),
            set: Vec::new(),
            store: argument(arguments, "store", "a path")?.unwrap_or_default(),
            filter: None,
            shard: None,
            options: Options::default(),
            replace: argument(arguments, "replace", "True or False")?.unwrap_or_default(),
            call: argument(arguments, "call", "a text")?.unwrap_or_default(),
        };
        if let Some(given) = arguments.get_item("manifests")? {
            for given in given.try_iter()? {
                asked.manifests.push(Given::of(&given?)?);
            }
        }
        if let Some(set) = argument::<Bound<'_, PyDict>>(arguments, "set", "a dict of keys")? {
            for (key, value) in set {
                let (key, value) = (key.str()?.to_string(), toml_of("set", &value, 0)?);
                asked.set.push(format!("{key}={value}").parse().map_err(refused)?);
            }
        }
        if let Some(filter) = argument::<String>(arguments, "filter", "a text")? {
            asked.filter = Some(filter.parse().map_err(refused)?);
        }
        if let Some(shard) = argument::<String>(arguments, "shard", "a text such as \"3/40\"")? {
            asked.shard = Some(shard.parse().map_err(refused)?);
        }
        let options = &mut asked.options;
        if let Some(workers) = argument::<i64>(arguments, "workers", "a whole number")? {
            let number = usize::try_from(workers).ok().and_then(NonZeroUsize::new);
            options.workers =
                number.filter(|number| number.get() <= MOST_WORKERS).ok_or_else(|| {
                    refused(format!("workers: expected 1 to {MOST_WORKERS}, found {workers}"))
                })?;
        }
        if argument(arguments, "retry_failed", "True or False")?.unwrap_or_default() {
            options.retry_failed = RetryFailed::Yes;
        }
        if argument(arguments, "fail_fast", "True or False")?.unwrap_or_default() {
            options.on_failure = OnFailure::Stop;
        }
        if let Some(every) = argument::<f64>(arguments, "checkpoint_every", "seconds")? {
            if !(0.01..=86_400.0).contains(&every) {
                return Err(refused(format!(
                    "checkpoint_every: expected 0.01 to 86400 seconds, found {every}"
                )));
            }
            options.checkpoint_every = Duration::from_secs_f64(every);
        }
        Ok(asked)
    }

    /// The jobs to run or to show.
    fn selection<'m>(&'m self, manifests: &'m [Manifest]) -> PyResult<Selection<'m>> {
        let selection = Selection::new(manifests, self.filter.as_ref()).map_err(refused)?;
        Ok(match self.shard {
            Some(shard) => selection.shard(shard),
            None => selection,
        })
    }

    /// The manifests.
    ///
    /// **Errors**: the faults of all manifests.
    fn read(&self) -> PyResult<Vec<Overridden>> {
        let posterior = |key: &str| posterior_in(&self.store, key);
        let (mut valid, mut faulty) = (Vec::new(), Vec::new());
        for given in &self.manifests {
            let runs = Runs(Some(&posterior));
            let read = match given {
                Given::File(path) => experiment::load_with(path, &self.set, runs),
                Given::Text(text) => experiment::parse_with("manifest", text, &self.set, runs),
            };
            match read {
                Ok(read) => valid.push(read),
                Err(faults) => faulty.push(faults),
            }
        }
        if faulty.is_empty() { Ok(valid) } else { Err(self::faulty(faulty)) }
    }

    /// The manifests, which have names of their own, and notes on analyses that overrides leave out.
    fn load(&self) -> PyResult<(Vec<Manifest>, Vec<String>)> {
        let read = self.read()?;
        let (mut manifests, mut notes) = (Vec::new(), Vec::new());
        for Overridden { manifest, left_out } in read {
            notes.extend(left_out);
            manifests.push(manifest);
        }
        match experiment::same_name(&manifests) {
            Some(message) => Err(refused(message)),
            None => Ok((manifests, notes)),
        }
    }

    /// The name of the store in messages.
    fn shown_store(&self) -> String {
        self.store.file_name().unwrap_or_default().to_string_lossy().into_owned()
    }
}

/// The exception for manifests with faults.
pub(crate) fn faulty(faulty: Vec<Faults>) -> PyErr {
    let message = faulty.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n");
    let error = ManifestError::new_err(message);
    let list: Vec<Json> = faulty
        .iter()
        .flat_map(|faults| match json!(faults) {
            Json::Array(list) => list,
            other => vec![other],
        })
        .collect();
    let noted =
        Python::attach(|py| error.value(py).setattr("faults", of_json(py, &Json::Array(list))?));
    noted.err().unwrap_or(error)
}

fn sweep_error(error: SweepError) -> PyErr {
    match error {
        SweepError::Store(error) => store_error(error),
        other => PyRuntimeError::new_err(other.to_string()),
    }
}

/// Messages of the program, with the names of Python for its options.
fn in_python(message: &str) -> String {
    message
        .replace("`--retry-failed`", "`retry_failed=True`")
        .replace("--retry-failed", "retry_failed=True")
        .replace("`jitai run`", "`jitai.run`")
}

/// The name of each manifest, the number of its jobs as lines, and hints.
#[pyfunction]
#[allow(clippy::type_complexity)]
pub(crate) fn check(
    py: Python<'_>,
    arguments: &Bound<'_, PyDict>,
) -> PyResult<Vec<(String, u64, Vec<String>, Vec<String>)>> {
    let asked = Asked::of(arguments)?;
    interruptible(
        py,
        || (),
        || {
            let read = asked.read()?;
            let published = read.iter().filter_map(|one| Published::of(&one.manifest).err());
            let faults: Vec<Faults> = published.collect();
            if !faults.is_empty() {
                return Err(faulty(faults));
            }
            if let Some(message) = experiment::same_name(read.iter().map(|one| &one.manifest)) {
                return Err(refused(message));
            }
            let checked = read.into_iter().map(|Overridden { manifest, mut left_out }| {
                left_out.extend(experiment::hints(&manifest));
                left_out.extend(results::splits(&manifest));
                let races = experiment::race_jobs(&manifest);
                let count = races.map_or_else(|| experiment::count(&manifest), |jobs| jobs.most);
                let lines = experiment::race_line(&manifest).map(|line| vec![line]);
                let lines = lines.unwrap_or_else(|| Factors::lines(&manifest));
                (manifest.name.clone(), count, lines, left_out)
            });
            Ok(checked.collect())
        },
    )?
}

/// A plan as a dict: `experiments` with their jobs by state, `notes`, and `jobs`, one dict each.
#[pyfunction]
pub(crate) fn plan<'py>(
    py: Python<'py>,
    arguments: &Bound<'py, PyDict>,
    lists_jobs: bool,
) -> PyResult<Bound<'py, PyAny>> {
    let asked = Asked::of(arguments)?;
    let planned = interruptible(
        py,
        || (),
        || {
            let (declared, mut notes) = asked.load()?;
            let reader = match Reader::open(&asked.store) {
                Ok(reader) => Some(reader),
                Err(StoreError::Missing { .. } | StoreError::Empty { .. }) => None,
                Err(error) => return Err(store_error(error)),
            };
            let manifests = &*declared;
            let selection = asked.selection(manifests)?;
            let selection = selection.at_stage(reader.as_ref()).map_err(store_error)?;
            notes.extend(declared.iter().filter_map(experiment::race_line));
            let races = experiment::race_notes(&declared, reader.as_ref());
            notes.extend(races.map_err(store_error)?);
            let survey = Survey::of(&selection, reader.as_ref());
            if lists_jobs {
                return planned_jobs(survey, manifests);
            }
            let speeds = reader.as_ref().map_or(Ok(Speeds::default()), Speeds::of);
            let speeds = speeds.map_err(store_error)?;
            let preview = Preview::of(survey, manifests, speeds, asked.options.workers);
            let preview = preview.map_err(store_error)?;
            let experiments = preview.experiments().map(|(name, counts, left)| {
                json!({
                    "experiment": name, "jobs": counts.total(), "completed": counts.completed,
                    "running": counts.running, "failed": counts.failed,
                    "interrupted": counts.interrupted, "pending": counts.pending,
                    "seconds_left": left.map(|left| left.as_secs_f64()),
                })
            });
            let experiments: Vec<Json> = experiments.collect();
            let (all, left) = preview.all();
            notes.extend(preview.notes().iter().map(|note| in_python(note)));
            Ok(json!({
                "experiments": experiments, "to_run": all.pending + all.interrupted,
                "seconds_left": left.map(|left| left.as_secs_f64()), "notes": notes,
            }))
        },
    )??;
    of_json(py, &planned)
}

/// The jobs of manifests, an object each.
fn planned_jobs(mut survey: Survey<'_>, manifests: &[Manifest]) -> PyResult<Json> {
    let swept = Swept::of(manifests);
    let mut jobs = Vec::new();
    for (index, manifest) in manifests.iter().enumerate() {
        survey
            .walk(index, |surveyed| {
                let reason = surveyed.reason()?.map(|reason| in_python(&reason.to_string()));
                let planned = &surveyed.planned;
                jobs.push(json!({
                    "experiment": manifest.name, "job_key": surveyed.key.to_string(),
                    "agent": &*planned.agent, "scenario": planned.job.scenario.to_string(),
                    "sigma": planned.job.number(Parameter::Environment("sigma")),
                    "seed": planned.job.seed, "state": surveyed.state.name(), "reason": reason,
                    "swept": swept.object(&planned.agent, &planned.job),
                }));
                Ok::<_, StoreError>(())
            })
            .map_err(store_error)?;
    }
    Ok(Json::Array(jobs))
}

/// Runs the jobs of manifests without a completed run: how the run ended as a dict. `on_event` is called with a
/// dict for each event, on this thread.
#[pyfunction]
pub(crate) fn run<'py>(
    py: Python<'py>,
    arguments: &Bound<'py, PyDict>,
    on_event: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let asked = Asked::of(arguments)?;
    let stop = AtomicBool::new(false);
    let heed = |py: Python<'_>, event: Json| match &on_event {
        Some(on_event) => on_event.bind(py).call1((of_json(py, &event)?,)).map(drop),
        None => Ok(()),
    };
    let ended = attended(
        py,
        || stop.store(true, Ordering::Relaxed),
        |events: Sender<Json>| swept(&asked, &stop, &events),
        heed,
    )??;
    of_json(py, &ended)
}

/// Runs the jobs, and sends every event.
fn swept(asked: &Asked, stop: &AtomicBool, events: &Sender<Json>) -> PyResult<Json> {
    let (manifests, notes) = asked.load()?;
    let selection = asked.selection(&manifests)?;
    let store = Store::open(&asked.store).map_err(store_error)?;
    let mut store = store.changed_by(experiment::command(asked.call.clone()));
    let reader = store.reader().map_err(store_error)?;
    for manifest in manifests.iter().filter(|_| !asked.replace) {
        if let Some(what) = experiment::removal(&reader, manifest).map_err(store_error)? {
            return Err(refused(format!("this would {what}; to allow it, pass replace=True")));
        }
    }
    let mut sent = Sent {
        events,
        notes,
        workers: asked.options.workers,
        log: None,
        ran: 0,
        estimating: HashSet::new(),
        done: 0,
        progressed: Instant::now(),
    };
    let ended = experiment::run(&mut store, &selection, asked.options, stop, &mut sent);
    let Some(EndedRun { end, .. }) = ended.map_err(sweep_error)? else {
        return Err(PyRuntimeError::new_err("stopped before the first job"));
    };
    let mut notes = sent.notes;
    notes.extend(experiment::race_notes(&manifests, Some(&reader)).map_err(store_error)?);
    Ok(json!({
        "event": end.cause().name(), "ran": end.ran(), "completed": end.completed(), "failed": end.failed(),
        "left": end.left(), "line": end.line("call jitai.run again to resume"), "notes": notes,
    }))
}

/// What is sent of a run.
struct Sent<'a> {
    events: &'a Sender<Json>,
    notes: Vec<String>,
    workers: NonZeroUsize,
    /// `None` before the first stage.
    log: Option<EventLog>,
    /// Number of jobs that ran to their end.
    ran: usize,
    /// The workers that add estimates of completed jobs.
    estimating: HashSet<usize>,
    /// Number of jobs that need no more work.
    done: usize,
    progressed: Instant,
}

/// Time between two reports of progress.
const PROGRESS: Duration = Duration::from_millis(500);

impl Sent<'_> {
    fn send(&self, event: Json) {
        drop(self.events.send(event));
    }
}

impl EventSink for Sent<'_> {
    fn on_event(&mut self, event: Event<'_>) {
        match &event {
            Event::Started { worker, .. } => {
                match event.is_of_run() {
                    true => self.estimating.remove(worker),
                    false => self.estimating.insert(*worker),
                };
            }
            Event::Ended { outcome: experiment::Outcome::Interrupted, .. } => {}
            Event::Ended { .. } | Event::Skipped { .. } if event.is_of_run() => {
                self.done += 1;
                self.ran += usize::from(matches!(event, Event::Ended { .. }));
            }
            Event::Tick { progress, .. } if self.progressed.elapsed() >= PROGRESS => {
                self.progressed = Instant::now();
                let part = |of: &experiment::TrainingProgress| {
                    f64::from(of.episode) / f64::from(of.episodes.max(1))
                };
                let runs = progress.iter().enumerate();
                let runs = runs.filter(|(worker, _)| !self.estimating.contains(worker));
                let parts: f64 = runs.filter_map(|(_, of)| of.as_ref()).map(part).sum();
                self.send(json!({ "event": "progress", "done": self.done as f64 + parts }));
            }
            Event::FewerWorkers { started, reason } => {
                let reason = reason.to_string();
                self.send(json!({
                    "event": "fewer_workers", "started": started, "reason": reason,
                }));
            }
            _ => {}
        }
        let events = self.log.as_mut().map(|log| log.of(&event)).unwrap_or_default();
        events.into_iter().for_each(|event| self.send(event));
    }
}

impl Caller for Sent<'_> {
    fn note(&mut self, note: &str) {
        self.notes.push(note.to_owned());
    }

    fn begin(
        &mut self,
        (selection, remaining): (&Selection<'_>, &Remaining),
        _: &End,
        _: &Reader,
    ) -> Result<(), StoreError> {
        self.send(json!({
            "event": "queued", "jobs": remaining.queue.len(), "completed": remaining.completed,
            "failed": remaining.failed,
        }));
        let workers = self.workers.get().min(remaining.queue.len() + remaining.lacking.len());
        self.log = Some(EventLog::new(workers, Swept::of(selection.manifests())));
        self.done = self.ran;
        Ok(())
    }

    fn end(&mut self, estimated: Option<&Estimated>) {
        if let Some(estimated) = estimated.filter(|estimated| estimated.failed() > 0) {
            let failed = estimated.failed();
            let reason = estimated.reason();
            self.notes.push(format!("no estimates of {failed} completed jobs: {reason}"));
        }
    }
}

/// Calls `work` with the experiments of manifests and their results.
fn assembled<T: Send>(
    py: Python<'_>,
    asked: &Asked,
    work: impl FnOnce(&Reader, Vec<ReportedExperiment>) -> PyResult<T> + Send,
) -> PyResult<T> {
    let running: Mutex<Option<Interrupter>> = Mutex::new(None);
    let stop = || {
        if let Ok(running) = running.lock()
            && let Some(interrupter) = &*running
        {
            interrupter.interrupt();
        }
    };
    interruptible(py, stop, || {
        let (manifests, _) = asked.load()?;
        let faults: Vec<Faults> =
            manifests.iter().filter_map(|one| Published::of(one).err()).collect();
        if !faults.is_empty() {
            return Err(faulty(faults));
        }
        let reader = Reader::open(&asked.store).map_err(store_error)?;
        if let Ok(mut running) = running.lock() {
            *running = Some(reader.interrupter());
        }
        let experiments = results::assemble(&reader, &manifests, |_, _, _| {});
        let experiments = experiments.map_err(|error| match error {
            AssembleError::Published(faults) => faulty(vec![faults]),
            AssembleError::Store(error) => store_error(error),
        })?;
        work(&reader, experiments)
    })?
}

/// Writes a report: notes, and the best settings of selections as TOML.
#[pyfunction]
pub(crate) fn report(
    py: Python<'_>,
    arguments: &Bound<'_, PyDict>,
    out: PathBuf,
    hosts: bool,
) -> PyResult<(Vec<String>, Vec<String>)> {
    let asked = Asked::of(arguments)?;
    let store = asked.shown_store();
    assembled(py, &asked, |reader, experiments| {
        let hosts = if hosts { Hosts::Named } else { Hosts::Unnamed };
        for file in results::report(&experiments, &store, hosts) {
            file.write(&out).map_err(|error| not_written(&out.join(&file.name), error))?;
        }
        let in_store = reader.manifests().map_err(store_error)?;
        let in_store: Vec<&str> = in_store.iter().map(|(name, _)| name.as_str()).collect();
        let notes = experiments.iter().flat_map(|one| one.notes(&store, &in_store)).collect();
        let winners = experiments.into_iter().filter_map(|one| one.race?.winners);
        Ok((notes, winners.collect()))
    })
}

fn not_written(path: &Path, error: std::io::Error) -> PyErr {
    PyOSError::new_err(format!("failed to write `{}`: {error}", path.display()))
}

/// The figures of a report: analysis, name, SVG and caption of each; and the names of all analyses, among them `race`
/// for the race of a search.
#[pyfunction]
#[allow(clippy::type_complexity)]
pub(crate) fn figures(
    py: Python<'_>,
    arguments: &Bound<'_, PyDict>,
) -> PyResult<(Vec<(String, String, String, String)>, Vec<String>)> {
    let asked = Asked::of(arguments)?;
    assembled(py, &asked, |_, experiments| {
        let figures = results::figures(&experiments).into_iter();
        let figures = figures.map(|one| (one.analysis, one.name, one.svg, one.caption));
        let names = experiments.iter().flat_map(|one| {
            let race = one.race.iter().map(|_| "race".to_owned());
            race.chain(one.findings.iter().map(|(finding, _)| finding.name.clone()))
        });
        Ok((figures.collect(), names.collect()))
    })
}
