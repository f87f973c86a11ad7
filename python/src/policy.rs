//! Trained policies, which act on observations from any source.

use std::io;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

use jitai::algorithm::Weights;
use jitai::environment::{
    Action, ActionSpec, EpisodeStatus, Interface, LaneSet, LaneStreams, ObservationSpec,
    Observations, Purpose, Resumable, StateError, StateReader, StateWriter, Stream,
    VectorEnvironment,
};
use jitai::policy::{ActionNetwork, Actions, Actor, Choice, NetworkPolicy, network_of, portable};
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

/// The actors of a policy, and their buffers.
struct Acting {
    given: Given,
    as_trained: Box<dyn Actor<Given>>,
    greedy: Box<dyn Actor<Given>>,
    network: Box<dyn ActionNetwork + Send>,
    stream: Stream,
    actions: Vec<Action>,
    numbers: Vec<f32>,
}

/// Number of rows between two looks at signals.
const PART: usize = 1 << 14;

/// The trained policy of a job.
#[pyclass(frozen, module = "jitai._jitai")]
pub(crate) struct TrainedPolicy {
    stored: StoredWeights,
    weights: Weights,
    choice: Choice,
    acting: Mutex<Acting>,
}

impl TrainedPolicy {
    fn lock(&self) -> MutexGuard<'_, Acting> {
        self.acting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn spec(&self) -> ObservationSpec {
        self.stored.job.task().observations()
    }

    fn actions(&self) -> usize {
        self.stored.job.task().interface().actions
    }

    /// Computes with all rows, a part of them at a time, between which Ctrl-C ends the call.
    fn in_parts<T: Send>(
        &self,
        py: Python<'_>,
        rows: Observations,
        compute: impl Fn(&mut Acting, Observations) -> Vec<T> + Sync,
    ) -> PyResult<Vec<T>> {
        let count = rows.rows();
        if count <= PART {
            return Ok(py.detach(|| compute(&mut self.lock(), rows)));
        }
        let mut results = Vec::with_capacity(count);
        for from in (0..count).step_by(PART) {
            results.append(&mut py.detach(|| {
                let mut part = self.spec().observations();
                part.extend(&rows, from..count.min(from + PART));
                compute(&mut self.lock(), part)
            }));
            py.check_signals()?;
        }
        Ok(results)
    }

    fn of_stored(stored: StoredWeights) -> PyResult<Self> {
        let interface = stored.job.task().interface();
        let spec = interface.observations.clone();
        let (weights, NetworkPolicy { network, choice, .. }) =
            network_of(&stored).map_err(no_policy)?;
        let actor = |actions| -> PyResult<Box<dyn Actor<Given>>> {
            let (_, policy) = network_of(&stored).map_err(no_policy)?;
            Ok(policy.actor(spec.observations(), actions))
        };
        let acting = Acting {
            as_trained: actor(Actions::AsTrained)?,
            greedy: actor(Actions::Greedy)?,
            network,
            given: Given { rows: spec.observations(), interface, statuses: Vec::new() },
            stream: Stream::new(stored.job.seed, Purpose::TestActions),
            actions: Vec::new(),
            numbers: Vec::new(),
        };
        Ok(TrainedPolicy { stored, weights, choice, acting: Mutex::new(acting) })
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
        observations: PyReadonlyArray2<'py, f32>,
        greedy: bool,
    ) -> PyResult<Bound<'py, PyArray1<i64>>> {
        let rows = read(&self.spec(), &observations)?;
        let actions = self.in_parts(py, rows, |acting, part| {
            let Acting { given, as_trained, greedy: best, stream, actions, .. } = acting;
            actions.clear();
            actions.resize(part.rows(), Action::NONE);
            given.statuses.resize(part.rows(), EpisodeStatus::Running);
            given.rows = part;
            let actor = if greedy { best } else { as_trained };
            actor.act(given, stream, actions, None);
            actions.iter().map(|action| action.index() as i64).collect()
        })?;
        Ok(PyArray1::from_vec(py, actions))
    }

    /// The outputs of the network for every action, \[rows, actions\]: values or logits.
    fn values<'py>(
        &self,
        py: Python<'py>,
        observations: PyReadonlyArray2<'py, f32>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let rows = read(&self.spec(), &observations)?;
        let count = rows.rows();
        let values = self.in_parts(py, rows, |acting, part| {
            acting.network.evaluate(&part, &mut acting.numbers);
            acting.numbers.clone()
        })?;
        PyArray1::from_vec(py, values).reshape([count, self.actions()])
    }

    /// The probabilities of the actions, \[rows, actions\].
    fn probabilities<'py>(
        &self,
        py: Python<'py>,
        observations: PyReadonlyArray2<'py, f32>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let values = self.values(py, observations)?.to_vec()?;
        let actions = self.actions();
        let rows = values.len() / actions;
        let probabilities = py.detach(|| self.choice.probabilities(&values, actions));
        PyArray1::from_vec(py, probabilities).reshape([rows, actions])
    }

    /// The weights by name.
    #[getter]
    fn weights<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let arrays = self.weights.tensors.iter().map(|(name, tensor)| {
            let values = PyArray1::from_slice(py, &tensor.values);
            (name.clone(), values, tensor.shape.clone())
        });
        let dict = PyDict::new(py);
        for (name, values, shape) in arrays {
            dict.set_item(name, values.call_method1("reshape", (shape,))?)?;
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
fn read(spec: &ObservationSpec, given: &PyReadonlyArray2<'_, f32>) -> PyResult<Observations> {
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
    let mut observations = spec.observations();
    for (row, entries) in values.chunks_exact(inputs).enumerate().take(rows) {
        if let Some(place) = entries.iter().position(|entry| !entry.is_finite()) {
            return Err(PyValueError::new_err(format!(
                "observations: entry {place} of row {row} is {}, not a finite number",
                entries[place]
            )));
        }
        let (features, times) = entries.split_at(width);
        let moment = times.iter().position(|entry| *entry == 1.0);
        let is_one_hot = times.iter().filter(|entry| **entry != 0.0).count() == 1;
        if spec.one_hot > 0 && !(moment.is_some() && is_one_hot) {
            return Err(PyValueError::new_err(format!(
                "observations: the last {} entries of row {row} are not a one-hot of the time",
                spec.one_hot
            )));
        }
        observations.push(features, moment.filter(|_| spec.one_hot > 0).map(|at| at as u32));
    }
    Ok(observations)
}
