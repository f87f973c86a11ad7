//! Environments and their observations, declared by keywords or by a manifest, and checked by the code for
//! manifests.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

use jitai::environment::{Environment, Family, ObservationSpec, Scenario, Simulated};
use jitai::experiment::{self, Filter, Job, Manifest, PlannedJob};
use jitai::key::{Content, Kind, Value, json_object};
use pyo3::exceptions::{PyFileNotFoundError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyBytes, PyDict, PyFloat, PyInt, PyMapping, PySequence, PyString};
use toml::Value as Toml;

use crate::info::outcome;
use crate::interrupt::interruptible;

/// Maximum nesting of lists in a value; no key needs more than two levels.
const DEEPEST: usize = 8;
/// Maximum number of a manifest's environments that a message lists.
const SHOWN: usize = 5;

/// The table of the parameters of a model.
const PARAMETERS: &str = "parameters";

/// The keys of a manifest that do not describe an environment.
const NOT_OF_AN_ENVIRONMENT: [&str; 15] = [
    "agent",
    "analysis",
    "evaluation",
    "exclude",
    "extends",
    "format",
    "hypothesis",
    "name",
    "published",
    "question",
    "scenarios",
    "seeds",
    "time_limit_seconds",
    "trial",
    "zip",
];

/// An environment and its observations.
#[pyclass(frozen, module = "jitai._jitai")]
pub(crate) struct Declaration(Job);

impl Declaration {
    /// The declaration of a job's environment, if it is of a family that jitai simulates.
    fn of(job: Job) -> PyResult<Declaration> {
        match job.environment.family().is_external() {
            false => Ok(Declaration(job)),
            true => Err(outside_program()),
        }
    }

    /// The environment.
    pub(crate) fn environment(&self) -> &Environment {
        &self.0.environment
    }

    /// The simulation with this number of lanes, none of which has an episode yet.
    pub(crate) fn simulation(&self, lanes: usize) -> Simulated {
        // The participants of the test, whichever participants an agent is trained on.
        self.0.task().tested(lanes)
    }

    fn spec(&self) -> ObservationSpec {
        self.0.task().observations()
    }
}

#[pymethods]
impl Declaration {
    /// The environment with these keywords: keys of `[environment]`, and tables of a manifest as dicts.
    #[staticmethod]
    fn of_keys(
        scenario: Option<&Bound<'_, PyAny>>,
        extends: Option<&str>,
        keys: &Bound<'_, PyDict>,
    ) -> PyResult<Self> {
        let family = keys.get_item("family")?.and_then(|family| family.extract::<String>().ok());
        let family = family.and_then(|name| Family::named(&name)).unwrap_or(Family::first());
        if family.is_external() {
            return Err(outside_program());
        }
        let scenario = match scenario {
            Some(scenario) => Some(toml_of("scenario", scenario, 0)?),
            None if family.has_letters => {
                Some(Toml::String(family.example_scenarios[0].to_owned()))
            }
            // The preset of a model declares the features that its agent needs.
            None if extends.is_some() => None,
            None => Some(Toml::String(Scenario::all().to_string())),
        };
        let manifest = manifest_of(family, scenario, extends, keys)?;
        let mut jobs = experiment::jobs(&manifest);
        let first = jobs.next().ok_or_else(|| PyValueError::new_err("no environment"))?.job;
        if let Some(other) = jobs.find(|other| !is_same(&other.job, &first)) {
            let swept = differences(&first, &other.job).join("`, `");
            let message = format!("`{swept}`: expected one value, not a sweep");
            return Err(PyValueError::new_err(message));
        }
        Declaration::of(first)
    }

    /// The environment of a manifest: its only environment, or the only one that meets a filter.
    #[staticmethod]
    fn of_manifest(py: Python<'_>, path: PathBuf, filter: Option<&str>) -> PyResult<Self> {
        if !path.exists() {
            let message = format!("{}: no such file", path.display());
            return Err(PyFileNotFoundError::new_err(message));
        }
        let filter: Filter = filter.map_or(Ok(Filter::default()), str::parse).map_err(refused)?;
        let stop = AtomicBool::new(false);
        interruptible(
            py,
            || stop.store(true, Ordering::Relaxed),
            || {
                let manifest = experiment::load(&path).map_err(refused)?;
                of_manifest(&manifest, &filter, &stop).and_then(Declaration::of)
            },
        )?
    }

    /// The declaration in a text of [`Declaration::text`], which names files by their digests, with the texts
    /// of [`Declaration::files`].
    #[staticmethod]
    #[pyo3(signature = (text, files = Vec::new()))]
    fn of_text(text: &str, files: Vec<String>) -> PyResult<Self> {
        let mut job = Job::from_canonical(text).map_err(refused)?;
        job.environment = with_files(&job.environment, &files)?;
        Declaration::of(job)
    }

    /// The declaration as one line of text.
    fn text(&self) -> String {
        self.0.canonical()
    }

    /// The texts of the files that the environment's keys name.
    fn files(&self) -> Vec<String> {
        let values = self.environment().values().into_iter();
        let text = |value| match value {
            Value::Content(content) => content.text().map(str::to_owned),
            _ => None,
        };
        values.filter_map(text).collect()
    }

    #[allow(clippy::type_complexity)]
    fn __reduce__(slf: &Bound<'_, Self>) -> PyResult<(Py<PyAny>, (String, Vec<String>))> {
        let read = slf.get_type().getattr("of_text")?;
        Ok((read.unbind(), (slf.get().text(), slf.get().files())))
    }

    /// The scenario, such as `P-H-D`.
    #[getter]
    fn scenario(&self) -> String {
        self.0.scenario.to_string()
    }

    /// The name of the environment's family.
    #[getter]
    fn family(&self) -> &'static str {
        self.0.environment.family().name
    }

    /// The name in `info` of what a step adds to the return, such as `steps_walked`.
    #[getter]
    fn outcome(&self) -> String {
        outcome(self.environment())
    }

    /// Whether the cost of messages makes rewards differ from outcomes.
    #[getter]
    fn has_costs(&self) -> bool {
        self.environment().message_cost().is_some()
    }

    /// The meaning of every action, by number.
    #[getter]
    fn actions(&self) -> Vec<String> {
        self.0.environment.actions()
    }

    /// Every key of the environment with its value.
    #[getter]
    fn keys<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let keys = PyDict::new(py);
        let environment = self.environment();
        for (name, value) in json_object(environment.family().keys, &environment.values()) {
            keys.set_item(name, json(py, &value)?)?;
        }
        Ok(keys)
    }

    /// The name, the minimum and the maximum of every entry of an observation.
    #[getter]
    fn entries(&self) -> Vec<(String, f32, f32)> {
        let ObservationSpec { features, one_hot } = self.spec();
        // Gymnasium's checker objects to infinite bounds.
        let [least, most] = self.simulation(1).finite_bounds();
        let finite = |bound: f32, other| if bound.is_finite() { bound } else { other };
        let features = features
            .into_iter()
            .map(|feature| (feature.name, finite(feature.low, least), finite(feature.high, most)));
        features.chain((0..one_hot).map(|time| (format!("t{time}"), 0.0, 1.0))).collect()
    }

    /// Number of steps of an episode without disengagement.
    #[getter]
    fn longest_episode(&self) -> u32 {
        self.0.environment.longest_episode()
    }
}

/// A JSON value as a Python object.
pub(crate) fn json<'py>(py: Python<'py>, value: &serde_json::Value) -> PyResult<Bound<'py, PyAny>> {
    py.import("json")?.call_method1("loads", (value.to_string(),))
}

/// The refusal of an environment that is an outside program.
fn outside_program() -> PyErr {
    refused(
        "family = \"external\": the environment is a program, which `jitai run` starts for a job; \
         make the Gymnasium environment that the program serves",
    )
}

/// The environment with the texts of files of which it knows only the digests.
fn with_files(environment: &Environment, files: &[String]) -> PyResult<Environment> {
    let family = environment.family();
    let mut values = environment.values();
    for (key, value) in family.keys.iter().zip(&mut values) {
        if let (Kind::Content(form), Value::Content(content)) = (key.kind, value)
            && !content.is_none()
        {
            let read = files.iter().filter_map(|text| Content::read(form, text).ok());
            *content = read.into_iter().find(|read| read == content).ok_or_else(|| {
                refused(format!("`{}`: the text of {content} is missing; pass its files", key.name))
            })?;
        }
    }
    let read = (family.read)(family, &values, &environment.people_values());
    read.ok_or_else(|| refused("the environment cannot be read"))
}

pub(crate) fn refused(error: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// The manifest that declares a single environment.
fn manifest_of(
    family: &Family,
    scenario: Option<Toml>,
    extends: Option<&str>,
    keys: &Bound<'_, PyDict>,
) -> PyResult<Manifest> {
    let text = |text: &str| Toml::String(text.to_owned());
    let agent = [("name", "never"), ("algorithm", "rule"), ("rule", "never")];
    let agent = agent.map(|(key, word)| (key.to_owned(), text(word))).into_iter().collect();
    let mut manifest = toml::Table::from_iter([
        ("format".to_owned(), Toml::Integer(1)),
        ("name".to_owned(), text("environment")),
        ("seeds".to_owned(), Toml::Integer(1)),
        ("agent".to_owned(), Toml::Array(vec![Toml::Table(agent)])),
    ]);
    if let Some(scenario) = scenario {
        manifest.insert("scenarios".to_owned(), Toml::Array(vec![scenario]));
    }
    if let Some(preset) = extends {
        manifest.insert("extends".to_owned(), text(preset));
    }
    let mut environment = toml::Table::new();
    for (name, value) in keys {
        let name: String = name.extract()?;
        let is_key = family.keys.iter().any(|key| key.name == name);
        let value = toml_of(&name, &value, 0)?;
        // The parameters of a model are a table of the environment.
        let is_key = is_key || (name == PARAMETERS && family.with_parameters.is_some());
        if value.is_table() && !is_key && !NOT_OF_AN_ENVIRONMENT.contains(&name.as_str()) {
            manifest.insert(name, value);
        } else {
            environment.insert(name, value);
        }
    }
    manifest.insert("environment".to_owned(), Toml::Table(environment));
    let text = toml::to_string(&manifest).map_err(refused)?;
    experiment::parse("keywords", text.as_bytes()).map_err(|faults| {
        let said = faults.list().iter().map(|fault| match fault.hint() {
            Some(hint) => format!("{} ({hint})", fault.message()),
            None => fault.message().to_owned(),
        });
        PyValueError::new_err(said.collect::<Vec<_>>().join("; "))
    })
}

/// A value in the notation of manifests.
pub(crate) fn toml_of(name: &str, value: &Bound<'_, PyAny>, depth: usize) -> PyResult<Toml> {
    let of_type = |what: String| {
        PyTypeError::new_err(format!(
            "`{name}`: expected a number, a word, true or false, or a list of these, found {what}"
        ))
    };
    if depth > DEEPEST {
        return Err(of_type("a deeply nested list".to_owned()));
    }
    if let Ok(flag) = value.cast::<PyBool>() {
        return Ok(Toml::Boolean(flag.is_true()));
    }
    if value.is_instance_of::<PyInt>() {
        let too_large = |_| {
            PyValueError::new_err(format!(
                "`{name}`: expected a whole number of 64 bits, found {value}"
            ))
        };
        return value.extract().map(Toml::Integer).map_err(too_large);
    }
    if let Ok(number) = value.cast::<PyFloat>() {
        return Ok(Toml::Float(number.value()));
    }
    if value.is_instance_of::<PyString>() {
        return Ok(Toml::String(value.extract()?));
    }
    if value.is_instance_of::<PyBytes>() {
        return Err(of_type("bytes".to_owned()));
    }
    // Lists, tuples and ranges.
    if value.cast::<PySequence>().is_ok() {
        let items = value.try_iter()?;
        let items = items.map(|item| toml_of(name, &item?, depth + 1));
        return Ok(Toml::Array(items.collect::<PyResult<_>>()?));
    }
    if let Ok(table) = value.cast::<PyMapping>() {
        let entries = table.items()?.into_iter().map(|entry| {
            let (key, value): (Bound<'_, PyAny>, Bound<'_, PyAny>) = entry.extract()?;
            let key: String =
                key.extract().map_err(|_| of_type("a key that is not a word".into()))?;
            let value = toml_of(&format!("{name}.{key}"), &value, depth + 1)?;
            Ok((key, value))
        });
        return Ok(Toml::Table(entries.collect::<PyResult<_>>()?));
    }
    // Paths.
    if value.hasattr("__fspath__")? {
        return Ok(Toml::String(value.extract::<PathBuf>()?.display().to_string()));
    }
    // NumPy scalars and arrays.
    if value.hasattr("tolist")? {
        return toml_of(name, &value.call_method0("tolist")?, depth + 1);
    }
    Err(of_type(value.get_type().name()?.to_string()))
}

/// The only environment that meets a filter. Ends early once `stop` is set.
fn of_manifest(manifest: &Manifest, filter: &Filter, stop: &AtomicBool) -> PyResult<Job> {
    let mut distinct: Vec<Job> = Vec::new();
    let jobs = experiment::jobs(manifest).take_while(|_| !stop.load(Ordering::Relaxed));
    for PlannedJob { job, .. } in jobs.filter(|job| filter.meets(job)) {
        if distinct.len() <= SHOWN && distinct.iter().all(|other| !is_same(other, &job)) {
            distinct.push(job);
        }
    }
    match distinct.as_slice() {
        _ if stop.load(Ordering::Relaxed) => Err(refused("stopped")),
        [] => Err(refused(filter.why_none(|| experiment::jobs(manifest)))),
        [only] => Ok(only.clone()),
        [first, others @ ..] => {
            let mut names: Vec<String> = Vec::new();
            for name in others.iter().flat_map(|other| differences(first, other)) {
                if !names.contains(&name) {
                    names.push(name);
                }
            }
            let mut listed: Vec<String> =
                distinct.iter().take(SHOWN).map(|job| described(job, &names)).collect();
            if distinct.len() > SHOWN {
                listed.push("…".to_owned());
            }
            Err(PyValueError::new_err(format!(
                "{} declares several environments; choose one by environment=\"…\": {}",
                manifest.path,
                listed.join("; ")
            )))
        }
    }
}

/// Whether two jobs have equal environments, populations and observations.
fn is_same(job: &Job, other: &Job) -> bool {
    job.environment == other.environment
        && job.agent.history() == other.agent.history()
        && job.scenario == other.scenario
}

/// The parameters of a job's environment and population, by their names in filters.
fn parameters(job: &Job) -> impl Iterator<Item = (String, Value)> {
    let family = job.environment.family();
    let environment = family.keys.iter().zip(job.environment.values());
    let population = family.people.iter().zip(job.environment.people_values());
    environment
        .map(|(key, value)| (key.name.to_owned(), value))
        .chain(population.map(|(key, value)| (format!("population.{}", key.name), value)))
}

/// The names of the parameters in which two jobs' environments differ.
fn differences(job: &Job, other: &Job) -> Vec<String> {
    let scenario = (job.scenario != other.scenario).then(|| "scenario".to_owned());
    let pairs = parameters(job).zip(parameters(other));
    let keys = pairs.filter(|((_, ours), (_, theirs))| ours != theirs).map(|((name, _), _)| name);
    scenario.into_iter().chain(keys).collect()
}

/// The values of these parameters, in the notation of filters.
fn described(job: &Job, names: &[String]) -> String {
    let value = |name: &String| match name.as_str() {
        "scenario" => job.scenario.to_string(),
        _ => match parameters(job).find(|(known, _)| known == name) {
            Some((_, Value::Choice(word))) => word.to_owned(),
            Some((_, value)) => value.to_string(),
            None => String::new(),
        },
    };
    let terms: Vec<_> = names.iter().map(|name| format!("{name}={}", value(name))).collect();
    terms.join(",")
}
