//! Trained policies, which act on observations from any source.

use std::ops::Range;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

use jitai::algorithm::{LinearThompson, Weights};
use jitai::environment::{
    Action, ContextDraw, EpisodeStatus, ObservationSpec, Observations, Purpose, Resumable,
    StateReader, StateWriter, Stream,
};
use jitai::experiment::{Job, JobKey};
use jitai::policy::{
    ActionNetwork, Actions, BanditPolicy, Choice, NetworkPolicy, RuleParameters, RulePolicy,
    RuleState, bandit_of, describe_job, network_of, portable,
};
use jitai::results::{Reader, StoredWeights};
use numpy::ndarray::ArrayView1;
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::{PyKeyError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};

use crate::declaration::json;
use crate::errors::unreadable_state;
use crate::store::{dictionary, store_error};

/// What chooses the actions of a policy, with the random stream that they are drawn from.
struct Acting {
    seed: u64,
    stream: Stream,
    by: By,
}

/// A network, a bandit or a rule.
enum By {
    Network(Box<Network>),
    Bandit(Box<BanditPolicy>),
    Rule(Box<RulePolicy>),
}

/// A network, and its buffers.
struct Network {
    network: Box<dyn ActionNetwork + Send>,
    choice: Choice,
    /// Memory of the episodes, \[rows, memory\]; empty before their first observation.
    memory: Vec<f32>,
    numbers: Vec<f32>,
}

impl Network {
    fn act(&mut self, rows: &Rows, greedy: bool, stream: &mut Stream) -> Vec<i64> {
        let choice = if greedy { Choice::EpsilonGreedy { epsilon: 0.0 } } else { self.choice };
        self.memory.resize(rows.count() * self.network.memory(), 0.0);
        self.network.recall(&rows.observations(), &mut self.memory, &mut self.numbers);
        let mut actions = vec![Action::NONE; rows.count()];
        choice.choose(&mut self.numbers, &mut actions, stream);
        actions.iter().map(|action| action.index() as i64).collect()
    }

    /// The outputs for the next observations, which are not remembered.
    fn values(&mut self, rows: &Rows) -> &[f32] {
        let mut memory = self.memory.clone();
        memory.resize(rows.count() * self.network.memory(), 0.0);
        self.network.recall(&rows.observations(), &mut memory, &mut self.numbers);
        &self.numbers
    }
}

/// The state of the simulation in each row, as a rule knows it.
type States = Vec<RuleState>;

/// Observations in the precision in which they were given, and the moments of their one-hots.
struct Rows {
    spec: ObservationSpec,
    letters: Vec<f64>,
    moments: Vec<Option<u32>>,
    /// The states that a rule acts on; empty for other policies.
    states: States,
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

    /// The state of a row; any state for a rule that needs none.
    fn state(&self, row: usize) -> &RuleState {
        const ANY: RuleState = RuleState {
            context: ContextDraw::FIXED_FIRST,
            time: 0,
            habituation: 0.0,
            disengagement: 0.0,
            status: EpisodeStatus::Running,
        };
        self.states.get(row).unwrap_or(&ANY)
    }

    fn part(&self, rows: Range<usize>) -> Rows {
        let width = self.spec.features.len();
        Rows {
            spec: self.spec.clone(),
            letters: self.letters[rows.start * width..rows.end * width].to_vec(),
            moments: self.moments[rows.clone()].to_vec(),
            states: self.states.get(rows).unwrap_or_default().to_vec(),
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

    /// The rows of a call, which must fit the policy.
    fn read(
        &self,
        observations: &PyReadonlyArray2<'_, f64>,
        states: Option<PyReadonlyArray2<'_, f64>>,
    ) -> PyResult<Rows> {
        let mut rows = read(self.spec(), observations)?;
        match &self.lock().by {
            By::Rule(rule) if rule.needs_state() => {
                let states = states.ok_or_else(|| {
                    PyTypeError::new_err("info: this rule acts on the true state; pass info=…")
                })?;
                rows.states = states.as_array().rows().into_iter().map(state_of).collect();
            }
            By::Network(network) if network.network.memory() > 0 => {
                let running = network.memory.len() / network.network.memory();
                if running > 0 && running != rows.count() {
                    return Err(PyValueError::new_err(format!(
                        "observations: expected a row for each of {running} running episodes, found {}; \
                         begin() begins new episodes",
                        rows.count()
                    )));
                }
            }
            By::Rule(_) | By::Network(_) | By::Bandit(_) => {}
        }
        Ok(rows)
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
        if count == 0 {
            return Ok(Vec::new());
        }
        // The memory of episodes is of all rows.
        if count <= PART || self.has_memory() {
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

    fn has_memory(&self) -> bool {
        matches!(&self.lock().by, By::Network(network) if network.network.memory() > 0)
    }

    fn of_stored(stored: StoredWeights) -> PyResult<Self> {
        let seed = stored.job.seed;
        let acting =
            |by| Mutex::new(Acting { seed, stream: Stream::new(seed, Purpose::TestActions), by });
        if let Some(rule) = stored.job.agent.parameters::<RuleParameters>() {
            let rule = rule.policy(&stored.job.task()).map_err(no_policy)?;
            let acting = acting(By::Rule(Box::new(rule)));
            return Ok(TrainedPolicy { stored, weights: Weights::default(), acting });
        }
        if stored.job.agent.parameters::<LinearThompson>().is_some() {
            let (weights, bandit) = bandit_of(&stored).map_err(no_policy)?;
            let acting = acting(By::Bandit(Box::new(bandit)));
            return Ok(TrainedPolicy { stored, weights, acting });
        }
        let (weights, NetworkPolicy { network, choice, .. }) =
            network_of(&stored).map_err(no_policy)?;
        let (memory, numbers) = (Vec::new(), Vec::new());
        let acting = acting(By::Network(Box::new(Network { network, choice, memory, numbers })));
        Ok(TrainedPolicy { stored, weights, acting })
    }
}

/// A pickled job: its key, its content, which has files by their digests, as the store has them, and the description of its
/// environment.
type Saved = ([u8; 16], String, Option<String>);

/// The columns of [`state_of`], names of `info`.
const STATE: [&str; 6] =
    ["step", "context", "likely", "probability_0", "habituation", "disengagement"];

/// The state of a rule, from a row of numbers in the order of [`STATE`].
fn state_of(row: ArrayView1<'_, f64>) -> RuleState {
    RuleState {
        time: row[0] as u32,
        context: ContextDraw {
            context: row[1] as u8,
            likely: row[2] as u8,
            probability_of_zero: row[3],
        },
        habituation: row[4],
        disengagement: row[5],
        status: EpisodeStatus::Running,
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

    /// The description, as `jitai export --policy` writes it to `policy.json`; of a rule, its job.
    fn describe<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        if matches!(self.lock().by, By::Rule(_)) {
            return json(py, &describe_job(&self.stored));
        }
        let described = py.detach(|| portable(&self.stored)).map_err(no_policy)?;
        json(py, &described.description)
    }

    /// The algorithm.
    #[getter]
    fn algorithm(&self) -> &'static str {
        self.stored.job.algorithm()
    }

    /// The names of `info` that the policy acts on, in the order of the columns of `states`.
    #[getter]
    fn state_names(&self) -> Vec<&'static str> {
        match &self.lock().by {
            By::Rule(rule) if rule.needs_state() => STATE.to_vec(),
            By::Rule(_) | By::Network(_) | By::Bandit(_) => Vec::new(),
        }
    }

    /// Restarts the random stream of the actions, with a new seed or with the job's seed, and begins new episodes.
    #[pyo3(signature = (seed = None))]
    fn reset(&self, py: Python<'_>, seed: Option<u64>) -> PyResult<()> {
        let seed = seed.unwrap_or(self.stored.job.seed);
        py.detach(|| {
            let mut acting = self.lock();
            (acting.seed, acting.stream) = (seed, Stream::new(seed, Purpose::TestActions));
        });
        self.begin(None)
    }

    /// Begins new episodes: in the rows of a mask, or in any number of rows.
    #[pyo3(signature = (mask = None))]
    fn begin(&self, mask: Option<Vec<bool>>) -> PyResult<()> {
        let acting = &mut *self.lock();
        let By::Network(network) = &mut acting.by else { return Ok(()) };
        let Some(mask) = mask else {
            network.memory.clear();
            return Ok(());
        };
        let mut rows = network.memory.chunks_exact_mut(network.network.memory().max(1));
        if rows.len() > 0 && rows.len() != mask.len() {
            return Err(PyValueError::new_err(format!(
                "mask: expected an entry for each of {} running episodes, found {}",
                rows.len(),
                mask.len()
            )));
        }
        for begins in mask {
            if let (Some(row), true) = (rows.next(), begins) {
                row.fill(0.0);
            }
        }
        Ok(())
    }

    /// Everything that another process needs for an equal policy.
    #[allow(clippy::type_complexity)]
    fn __reduce__<'py>(
        slf: &Bound<'py, Self>,
    ) -> PyResult<(
        Bound<'py, PyAny>,
        (Saved, Option<Bound<'py, PyBytes>>, u64, Bound<'py, PyBytes>, Vec<f32>),
    )> {
        let policy = slf.get();
        let bytes = |bytes: &[u8]| PyBytes::new(slf.py(), bytes);
        let acting = policy.lock();
        let mut position = Vec::new();
        acting.stream.save(&mut StateWriter::new(&mut position))?;
        let memory = match &acting.by {
            By::Network(network) => network.memory.clone(),
            By::Bandit(_) | By::Rule(_) => Vec::new(),
        };
        let job = &policy.stored.job;
        let weights = policy.stored.safetensors.as_deref().map(bytes);
        let saved = (policy.stored.job_key.0, job.canonical(), job.environment.description());
        let state = (saved, weights, acting.seed, bytes(&position), memory);
        Ok((slf.get_type().getattr("restored")?, state))
    }

    /// Restores a pickled policy.
    #[staticmethod]
    fn restored(
        saved: Saved,
        weights: Option<Vec<u8>>,
        seed: u64,
        position: &[u8],
        memory: Vec<f32>,
    ) -> PyResult<Self> {
        let (key, text, description) = saved;
        let mut job = Job::from_canonical(&text).map_err(no_policy)?;
        // What a job alone does not say of a program or a model.
        let described = description.and_then(|text| job.environment.described(&text));
        job.environment = described.unwrap_or(job.environment);
        let stored = StoredWeights { job_key: JobKey(key), job, safetensors: weights };
        let policy = TrainedPolicy::of_stored(stored)?;
        {
            let acting = &mut *policy.lock();
            (acting.seed, acting.stream) = (seed, Stream::new(seed, Purpose::TestActions));
            let mut position = position;
            let restored = acting.stream.restore(&mut StateReader::new(&mut position));
            restored.map_err(unreadable_state)?;
            if let By::Network(network) = &mut acting.by {
                network.memory = memory;
            }
        }
        Ok(policy)
    }

    /// An action for each row of observations, \[rows\].
    fn act<'py>(
        &self,
        py: Python<'py>,
        observations: PyReadonlyArray2<'py, f64>,
        greedy: bool,
        states: Option<PyReadonlyArray2<'py, f64>>,
    ) -> PyResult<Bound<'py, PyArray1<i64>>> {
        let rows = self.read(&observations, states)?;
        if greedy && matches!(self.lock().by, By::Rule(_)) {
            let message = "greedy=True applies to trained policies, and this policy is a rule";
            return Err(PyValueError::new_err(message));
        }
        let count = self.actions();
        let choice = if greedy { Actions::Greedy } else { Actions::AsTrained };
        let actions = self.in_parts(py, rows, |Acting { stream, by, .. }, part| match by {
            By::Network(network) => network.act(part, greedy, stream),
            By::Bandit(bandit) => {
                let mut act = |row| {
                    let word = if greedy { 0 } else { stream.bits() };
                    bandit.choose(choice, part.row(row), word).0.index() as i64
                };
                (0..part.count()).map(&mut act).collect()
            }
            By::Rule(rule) => {
                let mut act = |row| rule.choose(part.state(row), count, stream).index() as i64;
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
        if matches!(self.lock().by, By::Rule(_)) {
            return Err(PyValueError::new_err("a rule has no values"));
        }
        let rows = self.read(&observations, None)?;
        let count = rows.count();
        let values = self.in_parts(py, rows, |acting, part| match &mut acting.by {
            By::Network(network) => network.values(part).to_vec(),
            By::Bandit(bandit) => {
                let mut of =
                    |row| bandit.values(part.row(row)).iter().map(|value| *value as f32).collect();
                (0..part.count()).flat_map(|row| -> Vec<f32> { of(row) }).collect()
            }
            By::Rule(_) => Vec::new(),
        })?;
        PyArray1::from_vec(py, values).reshape([count, self.actions()])
    }

    /// The probabilities of the actions, \[rows, actions\].
    fn probabilities<'py>(
        &self,
        py: Python<'py>,
        observations: PyReadonlyArray2<'py, f64>,
        states: Option<PyReadonlyArray2<'py, f64>>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let rows = self.read(&observations, states)?;
        let (count, actions) = (rows.count(), self.actions());
        let probabilities = self.in_parts(py, rows, |acting, part| match &mut acting.by {
            By::Network(network) => {
                let values = network.values(part).to_vec();
                network.choice.probabilities(&values, actions)
            }
            By::Bandit(bandit) => {
                let mut probabilities =
                    |row| bandit.choose(Actions::AsTrained, part.row(row), 0).1.to_vec();
                (0..part.count()).flat_map(&mut probabilities).collect()
            }
            By::Rule(rule) => {
                let mut probabilities = vec![0.0; part.count() * actions];
                for (row, out) in probabilities.chunks_exact_mut(actions).enumerate() {
                    let action = rule.choose(part.state(row), actions, &mut acting.stream.clone());
                    rule.write_probabilities(action, out);
                }
                probabilities
            }
        })?;
        PyArray1::from_vec(py, probabilities).reshape([count, actions])
    }

    /// The bandit that has also learned from decisions, \[rows\], whose actions were drawn with these probabilities, \[rows,
    /// actions\].
    fn updated(
        &self,
        py: Python<'_>,
        observations: PyReadonlyArray2<'_, f64>,
        actions: Vec<i64>,
        rewards: Vec<f64>,
        probabilities: Option<PyReadonlyArray2<'_, f64>>,
    ) -> PyResult<TrainedPolicy> {
        let invalid = |says: String| Err(PyValueError::new_err(says));
        let parameters: Option<LinearThompson> = self.stored.job.agent.parameters();
        let Some(parameters) = parameters else {
            let of = self.stored.job.algorithm();
            return invalid(format!(
                "linear_thompson alone learns from a log, and this policy is of {of}"
            ));
        };
        let rows = self.read(&observations, None)?;
        let (count, of_action) = (rows.count(), self.actions());
        if [actions.len(), rewards.len()] != [count; 2] {
            let (actions, rewards) = (actions.len(), rewards.len());
            return invalid(format!(
                "expected an action and a reward for each of {count} observations, found {actions} and {rewards}"
            ));
        }
        let chances = match &probabilities {
            Some(given) if given.shape() == [count, of_action] => given.as_slice()?.to_vec(),
            Some(given) => {
                let [rows, columns] = [given.shape()[0], given.shape()[1]];
                return invalid(format!(
                    "probabilities: expected {count} rows of {of_action} actions, found {rows} of {columns}"
                ));
            }
            None if parameters.action_centring => {
                let says =
                    "probabilities: with action centring, learning needs those of all actions";
                return invalid(says.to_owned());
            }
            None => vec![0.0; count * of_action],
        };
        let taken = |action: &i64| {
            let index = usize::try_from(*action).ok().filter(|index| *index < of_action);
            index.and_then(Action::from_index)
        };
        if let Some(row) = actions.iter().position(|action| taken(action).is_none()) {
            let (action, last) = (actions[row], of_action - 1);
            return invalid(format!("actions: row {row} has {action}, expected 0 to {last}"));
        }
        if let Some(row) = rewards.iter().position(|reward| !reward.is_finite()) {
            return invalid(format!("rewards: row {row} has no finite number"));
        }
        if let Some(index) = chances.iter().position(|p| !(0.0..=1.0).contains(p)) {
            let row = index / of_action;
            return invalid(format!("probabilities: row {row} has a number outside of 0 to 1"));
        }
        let of_taken =
            |row: usize| chances[row * of_action..][..of_action].get(actions[row] as usize);
        if probabilities.is_some()
            && let Some(row) = (0..count).find(|row| of_taken(*row) == Some(&0.0))
        {
            let action = actions[row];
            return invalid(format!("probabilities: row {row} has 0 for its action {action}"));
        }
        py.detach(|| {
            let (_, mut bandit) = bandit_of(&self.stored).map_err(no_policy)?;
            for row in 0..count {
                let own = &chances[row * of_action..(row + 1) * of_action];
                let action = taken(&actions[row]).unwrap_or_default();
                bandit.learn(rows.row(row), (action, own), rewards[row]);
            }
            let safetensors = Some(bandit.weights().to_bytes());
            TrainedPolicy::of_stored(StoredWeights { safetensors, ..self.stored.clone() })
        })
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
    let mut read = Rows { spec, letters: Vec::new(), moments: Vec::new(), states: Vec::new() };
    let one_hot = read.spec.one_hot;
    for (row, entries) in values.chunks_exact(inputs).enumerate().take(rows) {
        if let Some(index) = entries.iter().position(|entry| !(*entry as f32).is_finite()) {
            return Err(PyValueError::new_err(format!(
                "observations: entry {index} of row {row} is {}, not a finite number",
                entries[index]
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
