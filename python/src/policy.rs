//! Trained policies, which act on observations from any source.

use std::io;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

use jitai::algorithm::{LinearThompson, Weights};
use jitai::environment::{
    Action, ActionSpec, EpisodeStatus, Interface, LaneSet, LaneStreams, ObservationSpec,
    Observations, Purpose, Resumable, StateError, StateReader, StateWriter, Stream,
    VectorEnvironment,
};
use jitai::policy::{
    ActionNetwork, Actions, Actor, BanditPolicy, Choice, NetworkPolicy, bandit_of, network_of,
    portable,
};
use jitai::results::{Reader, StoredWeights};
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::{PyKeyError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::declaration::json;
use crate::store::{dictionary, store_error};

/// An environment that shows given observations and whose steps do nothing.
struct Given {
    interface: Interface,
    rows: Observations,
    statuses: Vec<EpisodeStatus>,
}

impl Resumable for Given {
    fn save(&self, _: &mut StateWriter<'_>) -> io::Result<()> {
        Ok(())
    }

    fn restore(&mut self, _: &mut StateReader<'_>) -> Result<(), StateError> {
        Ok(())
    }
}

impl VectorEnvironment for Given {
    fn action_spec(&self) -> ActionSpec {
        ActionSpec { count: self.interface.actions, lowest_reward: 0.0, highest_reward: 0.0 }
    }

    fn observation_spec(&self) -> ObservationSpec {
        self.interface.observations.clone()
    }

    fn reset(&mut self, _: LaneSet<'_>, _: &mut LaneStreams) {}

    fn step(&mut self, _: &[Action], rewards: &mut [f64], _: &mut LaneStreams) {
        rewards.fill(0.0);
    }

    fn statuses(&self) -> &[EpisodeStatus] {
        &self.statuses
    }

    fn observe(&self, out: &mut Observations) {
        out.clear();
        out.extend(&self.rows, 0..self.rows.rows());
    }
}

/// What chooses the actions of a policy, with the random stream that they are drawn from.
struct Acting {
    stream: Stream,
    by: By,
}

/// A network or a bandit.
enum By {
    Network(Box<Network>),
    Bandit(Box<BanditPolicy>),
}

/// The actors of a network, and their buffers.
struct Network {
    given: Given,
    as_trained: Box<dyn Actor<Given>>,
    greedy: Box<dyn Actor<Given>>,
    network: Box<dyn ActionNetwork + Send>,
    choice: Choice,
    actions: Vec<Action>,
    numbers: Vec<f32>,
}

impl Network {
    fn act(&mut self, rows: &Rows, greedy: bool, stream: &mut Stream) -> Vec<i64> {
        let Network { given, as_trained, greedy: best, actions, .. } = self;
        actions.clear();
        actions.resize(rows.count(), Action::NONE);
        given.statuses.resize(rows.count(), EpisodeStatus::Running);
        given.rows = rows.observations();
        let actor = if greedy { best } else { as_trained };
        actor.act(given, stream, actions, None);
        actions.iter().map(|action| action.index() as i64).collect()
    }

    fn values(&mut self, rows: &Rows) -> &[f32] {
        self.network.evaluate(&rows.observations(), &mut self.numbers);
        &self.numbers
    }
}

/// Observations in the precision in which they were given, and the moments of their one-hots.
struct Rows {
    spec: ObservationSpec,
    letters: Vec<f64>,
    moments: Vec<Option<u32>>,
}

impl Rows {
    fn count(&self) -> usize {
        self.moments.len()
    }

    /// The observation of a row.
    fn row(&self, row: usize) -> (&[f64], Option<u32>) {
        let width = self.spec.features.len();
        (&self.letters[row * width..(row + 1) * width], self.moments[row])
    }

    fn part(&self, rows: Range<usize>) -> Rows {
        let width = self.spec.features.len();
        Rows {
            spec: self.spec.clone(),
            letters: self.letters[rows.start * width..rows.end * width].to_vec(),
            moments: self.moments[rows].to_vec(),
        }
    }

    /// The observations in the precision of networks.
    fn observations(&self) -> Observations {
        let mut observations = self.spec.observations();
        for row in 0..self.count() {
            let (letters, moment) = self.row(row);
            let letters: Vec<f32> = letters.iter().map(|entry| *entry as f32).collect();
            observations.push(&letters, moment);
        }
        observations
    }
}

/// Number of rows between two looks at signals.
const PART: usize = 1 << 14;

/// The trained policy of a job.
#[pyclass(frozen, module = "jitai._jitai")]
pub(crate) struct TrainedPolicy {
    stored: StoredWeights,
    weights: Weights,
    acting: Mutex<Acting>,
}

impl TrainedPolicy {
    fn lock(&self) -> MutexGuard<'_, Acting> {
        self.acting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn spec(&self) -> ObservationSpec {
        self.stored.job.task().observations()
    }

    fn read(&self, observations: &PyReadonlyArray2<'_, f64>) -> PyResult<Rows> {
        read(self.spec(), observations)
    }

    fn actions(&self) -> usize {
        self.stored.job.task().interface().actions
    }

    /// Computes with all rows, a part of them at a time, between which Ctrl-C ends the call.
    fn in_parts<T: Send>(
        &self,
        py: Python<'_>,
        rows: Rows,
        compute: impl Fn(&mut Acting, &Rows) -> Vec<T> + Sync,
    ) -> PyResult<Vec<T>> {
        let count = rows.count();
        if count <= PART {
            return Ok(py.detach(|| compute(&mut self.lock(), &rows)));
        }
        let mut results = Vec::with_capacity(count);
        for from in (0..count).step_by(PART) {
            let part = rows.part(from..count.min(from + PART));
            results.append(&mut py.detach(|| compute(&mut self.lock(), &part)));
            py.check_signals()?;
        }
        Ok(results)
    }

    fn of_stored(stored: StoredWeights) -> PyResult<Self> {
        let stream = Stream::new(stored.job.seed, Purpose::TestActions);
        if stored.job.agent.parameters::<LinearThompson>().is_some() {
            let (weights, bandit) = bandit_of(&stored).map_err(no_policy)?;
            let acting = Mutex::new(Acting { stream, by: By::Bandit(Box::new(bandit)) });
            return Ok(TrainedPolicy { stored, weights, acting });
        }
        let interface = stored.job.task().interface();
        let spec = interface.observations.clone();
        let (weights, NetworkPolicy { network, choice, .. }) =
            network_of(&stored).map_err(no_policy)?;
        let actor = |actions| -> PyResult<Box<dyn Actor<Given>>> {
            let (_, policy) = network_of(&stored).map_err(no_policy)?;
            Ok(policy.actor(spec.observations(), actions))
        };
        let by = By::Network(Box::new(Network {
            as_trained: actor(Actions::AsTrained)?,
            greedy: actor(Actions::Greedy)?,
            network,
            choice,
            given: Given { rows: spec.observations(), interface, statuses: Vec::new() },
            actions: Vec::new(),
            numbers: Vec::new(),
        }));
        Ok(TrainedPolicy { stored, weights, acting: Mutex::new(Acting { stream, by }) })
    }
}

#[pymethods]
impl TrainedPolicy {
    /// The policy of the only completed job whose key begins with `key`.
    #[staticmethod]
    fn from_store(py: Python<'_>, path: PathBuf, key: &str) -> PyResult<Self> {
        py.detach(|| {
            let reader = Reader::open(&path).map_err(store_error)?;
            TrainedPolicy::of_stored(reader.weights(key).map_err(store_error)?)
        })
    }

    /// The job's key.
    #[getter]
    fn job_key(&self) -> String {
        self.stored.job_key.to_string()
    }

    /// The description, as `jitai export --policy` writes it to `policy.json`.
    fn describe<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let described = py.detach(|| portable(&self.stored)).map_err(no_policy)?;
        json(py, &described.description)
    }

    /// Restarts the random stream of the actions, with a new seed or with the job's seed.
    #[pyo3(signature = (seed = None))]
    fn reset(&self, py: Python<'_>, seed: Option<u64>) {
        let seed = seed.unwrap_or(self.stored.job.seed);
        py.detach(|| self.lock().stream = Stream::new(seed, Purpose::TestActions));
    }

    /// An action for each row of observations, \[rows\].
    fn act<'py>(
        &self,
        py: Python<'py>,
        observations: PyReadonlyArray2<'py, f64>,
        greedy: bool,
    ) -> PyResult<Bound<'py, PyArray1<i64>>> {
        let rows = self.read(&observations)?;
        let choice = if greedy { Actions::Greedy } else { Actions::AsTrained };
        let actions = self.in_parts(py, rows, |Acting { stream, by }, part| match by {
            By::Network(network) => network.act(part, greedy, stream),
            By::Bandit(bandit) => {
                let mut act = |row| {
                    let word = if greedy { 0 } else { stream.bits() };
                    bandit.choose(choice, part.row(row), word).0.index() as i64
                };
                (0..part.count()).map(&mut act).collect()
            }
        })?;
        Ok(PyArray1::from_vec(py, actions))
    }

    /// The outputs of the network for every action, \[rows, actions\]: values or logits; of a bandit, means of rewards.
    fn values<'py>(
        &self,
        py: Python<'py>,
        observations: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let rows = self.read(&observations)?;
        let count = rows.count();
        let values = self.in_parts(py, rows, |acting, part| match &mut acting.by {
            By::Network(network) => network.values(part).to_vec(),
            By::Bandit(bandit) => {
                let mut of =
                    |row| bandit.values(part.row(row)).iter().map(|value| *value as f32).collect();
                (0..part.count()).flat_map(|row| -> Vec<f32> { of(row) }).collect()
            }
        })?;
        PyArray1::from_vec(py, values).reshape([count, self.actions()])
    }

    /// The probabilities of the actions, \[rows, actions\].
    fn probabilities<'py>(
        &self,
        py: Python<'py>,
        observations: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let rows = self.read(&observations)?;
        let (count, actions) = (rows.count(), self.actions());
        let probabilities = self.in_parts(py, rows, |acting, part| match &mut acting.by {
            By::Network(network) => {
                let values = network.values(part).to_vec();
                network.choice.probabilities(&values, actions)
            }
            By::Bandit(bandit) => {
                let mut of = |row| bandit.choose(Actions::AsTrained, part.row(row), 0).1.to_vec();
                (0..part.count()).flat_map(&mut of).collect()
            }
        })?;
        PyArray1::from_vec(py, probabilities).reshape([count, actions])
    }

    /// The weights by name.
    #[getter]
    fn weights<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let dict = PyDict::new(py);
        for (name, tensor) in &self.weights.tensors {
            let values = PyArray1::from_slice(py, &tensor.values);
            dict.set_item(name, values.call_method1("reshape", (tensor.shape.clone(),))?)?;
        }
        for (name, tensor) in &self.weights.doubles {
            let values = PyArray1::from_slice(py, &tensor.values);
            dict.set_item(name, values.call_method1("reshape", (tensor.shape.clone(),))?)?;
        }
        Ok(dict)
    }

    /// Numbers that the policy needs in addition to its weights, such as `epsilon`.
    #[getter]
    fn numbers<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        dictionary(py, self.weights.numbers.iter().map(|(name, value)| (name.clone(), *value)))
    }
}

fn no_policy(error: impl std::fmt::Display) -> PyErr {
    PyKeyError::new_err(error.to_string())
}

/// Observations from rows whose one-hot entries are written out.
fn read(spec: ObservationSpec, given: &PyReadonlyArray2<'_, f64>) -> PyResult<Rows> {
    let (inputs, width) = (spec.inputs(), spec.features.len());
    let [rows, columns] = [given.shape()[0], given.shape()[1]];
    if columns != inputs {
        let names: Vec<&str> = spec.features.iter().map(|f| f.name.as_str()).collect();
        return Err(PyValueError::new_err(format!(
            "observations: expected {inputs} entries per row ({}), found {columns}",
            names.join(", ")
        )));
    }
    let values = given.as_slice().map_err(|_| {
        PyTypeError::new_err("observations: expected rows one after the other in memory")
    })?;
    let mut read = Rows { spec, letters: Vec::new(), moments: Vec::new() };
    let one_hot = read.spec.one_hot;
    for (row, entries) in values.chunks_exact(inputs).enumerate().take(rows) {
        if let Some(place) = entries.iter().position(|entry| !(*entry as f32).is_finite()) {
            return Err(PyValueError::new_err(format!(
                "observations: entry {place} of row {row} is {}, not a finite number",
                entries[place]
            )));
        }
        let (features, times) = entries.split_at(width);
        let moment = times.iter().position(|entry| *entry == 1.0);
        let is_one_hot = times.iter().filter(|entry| **entry != 0.0).count() == 1;
        if one_hot > 0 && !(moment.is_some() && is_one_hot) {
            return Err(PyValueError::new_err(format!(
                "observations: the last {} entries of row {row} are not a one-hot of the time",
                one_hot
            )));
        }
        read.letters.extend_from_slice(features);
        read.moments.push(moment.filter(|_| one_hot > 0).map(|at| at as u32));
    }
    Ok(read)
}
