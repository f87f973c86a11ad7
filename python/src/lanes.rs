//! A vector environment: many lanes, each with its own random stream.

use std::io;

use jitai::environment::{
    Action, EpisodeStatus, LaneSet, LaneStreams, Observations, Purpose, Resumable, Simulated,
    StateReader, StateWriter, Stream, VectorEnvironment,
};
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyUntypedArrayMethods};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};

use crate::declaration::Declaration;
use crate::errors::{
    closed, gymnasium, looked_at, reset_needed, sound, unreadable_state, used_alone,
};
use crate::info::{Parts, of_lanes};

type Batch<'py> = Bound<'py, PyArray2<f32>>;
type Column<'py, T> = Bound<'py, PyArray1<T>>;
type Info<'py> = Bound<'py, PyDict>;
/// Observations, rewards, terminated, truncated and infos.
type Stepped<'py> = (Batch<'py>, Column<'py, f64>, Column<'py, bool>, Column<'py, bool>, Info<'py>);

/// When the next episode of an ended lane begins, in Gymnasium's words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Autoreset {
    NextStep,
    SameStep,
    Disabled,
}

impl Autoreset {
    fn named(word: &str) -> PyResult<Self> {
        match word {
            "NextStep" => Ok(Autoreset::NextStep),
            "SameStep" => Ok(Autoreset::SameStep),
            "Disabled" => Ok(Autoreset::Disabled),
            other => Err(PyValueError::new_err(format!(
                "autoreset_mode: expected NextStep, SameStep or Disabled, found {other}"
            ))),
        }
    }

    fn word(self) -> &'static str {
        match self {
            Autoreset::NextStep => "NextStep",
            Autoreset::SameStep => "SameStep",
            Autoreset::Disabled => "Disabled",
        }
    }
}

/// Many lanes of the simulation. Lane i with seed s takes the same steps as a single environment with seed
/// s.
#[pyclass(module = "jitai._jitai")]
pub(crate) struct Lanes {
    declaration: Py<Declaration>,
    parts: Parts,
    autoreset: Autoreset,
    simulation: Simulated,
    /// The seed of every lane; empty before the first reset.
    seeds: Vec<u64>,
    streams: LaneStreams,
    observations: Observations,
    actions: Vec<Action>,
    /// Lanes whose episodes had ended before the step.
    ended: Vec<bool>,
    is_closed: bool,
}

impl Lanes {
    fn count(&self) -> usize {
        self.ended.len()
    }

    fn observed<'py>(&mut self, py: Python<'py>) -> PyResult<Batch<'py>> {
        let rows = self.count();
        py.detach(|| self.simulation.observe(&mut self.observations));
        // NumPy takes ownership of the buffer, without a copy.
        let values = self.observations.take_written_out();
        let inputs = values.len() / rows;
        PyArray1::from_vec(py, values).reshape([rows, inputs])
    }

    fn require_open(&self, py: Python<'_>) -> PyResult<()> {
        if self.is_closed { Err(closed(py)) } else { Ok(()) }
    }

    /// Reads the actions for a step.
    fn read(&mut self, py: Python<'_>, actions: &Bound<'_, PyAny>) -> PyResult<()> {
        let given = as_integers(py, actions)?;
        let given = given.as_slice()?;
        if given.len() != self.count() {
            return Err(PyValueError::new_err(format!(
                "expected {} actions, one per lane, found {}",
                self.count(),
                given.len()
            )));
        }
        let count = self.parts.actions as u64;
        let is_action = |index: &i64| (*index as u64) < count;
        if !given.iter().all(is_action) {
            let lane = given.iter().position(|index| !is_action(index)).unwrap_or_default();
            let (last, found) = (count - 1, given[lane]);
            let message =
                format!("lane {lane}: an action is a number from 0 to {last}, found {found}");
            return Err(gymnasium(py, "InvalidAction", message));
        }
        for (action, index) in self.actions.iter_mut().zip(given) {
            *action = Action::from_index(*index as usize).unwrap_or_default();
        }
        Ok(())
    }

    /// Adds the last observations and states of lanes that have just ended, and begins their next episodes.
    fn restart<'py>(
        &mut self,
        py: Python<'py>,
        outcomes: &mut [f64],
        info: &Info<'py>,
    ) -> PyResult<()> {
        self.mark_ended();
        if !self.ended.contains(&true) {
            return Ok(());
        }
        self.simulation.observe(&mut self.observations);
        let last = self.observations.take_written_out();
        let inputs = last.len() / self.count();
        let rows = py.import("numpy")?.call_method1("full", (self.count(), py.None(), "object"))?;
        for (lane, row) in last.chunks_exact(inputs).enumerate() {
            if self.ended[lane] {
                rows.set_item(lane, PyArray1::from_slice(py, row))?;
            }
        }
        info.set_item("final_obs", rows)?;
        info.set_item("_final_obs", PyArray1::from_slice(py, &self.ended))?;
        let marked = Some(&self.ended[..]);
        let state = of_lanes(py, &self.simulation, marked, Some(outcomes), &self.parts)?;
        info.set_item("final_info", state)?;
        info.set_item("_final_info", PyArray1::from_slice(py, &self.ended))?;
        self.simulation.reset(LaneSet::Masked(&self.ended), &mut self.streams);
        for (outcome, ended) in outcomes.iter_mut().zip(&self.ended) {
            *outcome = if *ended { 0.0 } else { *outcome };
        }
        Ok(())
    }

    fn mark_ended(&mut self) {
        let statuses = self.simulation.statuses().iter();
        let marks = self.ended.iter_mut().zip(statuses);
        marks.for_each(|(ended, status)| *ended = *status != EpisodeStatus::Running);
    }

    /// Whether the episode of each lane has this status.
    fn lanes_at(&self, status: EpisodeStatus) -> Vec<bool> {
        self.simulation.statuses().iter().map(|other| *other == status).collect()
    }

    /// Begins episodes, as `reset` describes.
    fn begin<'py>(
        &mut self,
        py: Python<'py>,
        seeds: Option<Vec<Option<u64>>>,
        mask: Option<PyReadonlyArray1<'py, bool>>,
    ) -> PyResult<(Batch<'py>, Info<'py>)> {
        self.require_open(py)?;
        let count = self.count();
        let mask = mask.map(|mask| mask.to_vec()).transpose()?;
        let lengths = [seeds.as_ref().map(Vec::len), mask.as_ref().map(Vec::len)];
        if lengths.into_iter().flatten().any(|length| length != count) {
            return Err(PyValueError::new_err(format!(
                "expected a seed and an entry of reset_mask for each of {count} lanes"
            )));
        }
        let is_reset = |lane: usize| mask.as_ref().is_none_or(|mask| mask[lane]);
        let seeds = seeds.unwrap_or_else(|| vec![None; count]);
        if self.seeds.is_empty() {
            let first: Option<Vec<u64>> = seeds.iter().copied().collect();
            let first = first.filter(|_| mask.is_none()).ok_or_else(|| {
                reset_needed(py, "the first reset begins all lanes, each with a seed")
            })?;
            let stream = |seed: &u64| Stream::new(*seed, Purpose::TestEnvironment);
            self.streams = LaneStreams::PerLane(first.iter().map(stream).collect());
            self.seeds = first;
        } else {
            for (lane, seed) in seeds.into_iter().enumerate().filter(|(lane, _)| is_reset(*lane)) {
                if let Some(seed) = seed {
                    self.seeds[lane] = seed;
                    *self.streams.of(lane) = Stream::new(seed, Purpose::TestEnvironment);
                }
            }
        }
        let lanes = mask.as_deref().map_or(LaneSet::All, LaneSet::Masked);
        self.simulation.reset(lanes, &mut self.streams);
        sound(&self.simulation)?;
        let info = of_lanes(py, &self.simulation, mask.as_deref(), None, &self.parts)?;
        Ok((self.observed(py)?, info))
    }

    /// Takes a step in every lane, as `step` describes.
    fn take_step<'py>(
        &mut self,
        py: Python<'py>,
        actions: &Bound<'py, PyAny>,
    ) -> PyResult<Stepped<'py>> {
        self.require_open(py)?;
        if self.seeds.is_empty() {
            return Err(reset_needed(py, "call reset() before the first step"));
        }
        self.mark_ended();
        if self.autoreset == Autoreset::Disabled
            && let Some(lane) = self.ended.iter().position(|ended| *ended)
        {
            let message = format!(
                "the episode of lane {lane} has ended; reset it with \
                 reset(options={{\"reset_mask\": …}}) before the next step"
            );
            return Err(reset_needed(py, message));
        }
        self.read(py, actions)?;
        let mut rewards = vec![0.0; self.count()];
        let Lanes { simulation, streams, actions, ended, autoreset, .. } = self;
        py.detach(|| {
            simulation.step(actions, &mut rewards, streams);
            if *autoreset == Autoreset::NextStep && ended.contains(&true) {
                simulation.reset(LaneSet::Masked(ended), streams);
            }
        });
        sound(&self.simulation)?;
        let terminated = self.lanes_at(EpisodeStatus::Terminated);
        let truncated = self.lanes_at(EpisodeStatus::Truncated);
        let info = PyDict::new(py);
        let mut outcomes = Vec::new();
        if self.parts.state || self.autoreset == Autoreset::SameStep {
            outcomes = self.simulation.outcomes(&rewards).to_vec();
        }
        if self.autoreset == Autoreset::SameStep {
            self.restart(py, &mut outcomes, &info)?;
        }
        let state = of_lanes(py, &self.simulation, None, Some(&outcomes), &self.parts)?;
        info.update(state.as_mapping())?;
        Ok((
            self.observed(py)?,
            PyArray1::from_vec(py, rewards),
            PyArray1::from_vec(py, terminated),
            PyArray1::from_vec(py, truncated),
            info,
        ))
    }

    fn copied(&self, py: Python<'_>) -> PyResult<Lanes> {
        Ok(Lanes {
            declaration: self.declaration.clone_ref(py),
            parts: self.parts.clone(),
            simulation: self.simulation.copied()?,
            seeds: self.seeds.clone(),
            streams: self.streams.clone(),
            observations: self.observations.clone(),
            actions: self.actions.clone(),
            ended: self.ended.clone(),
            ..*self
        })
    }

    fn save(&self) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        let mut out = StateWriter::new(&mut bytes);
        self.simulation.save(&mut out)?;
        self.streams.save(&mut out)?;
        Ok(bytes)
    }
}

#[pymethods]
impl Lanes {
    #[new]
    fn new(
        py: Python<'_>,
        declaration: Py<Declaration>,
        lanes: usize,
        autoreset: &str,
        state_in_info: bool,
    ) -> PyResult<Self> {
        if lanes == 0 || lanes > 1 << 24 {
            return Err(PyValueError::new_err(format!(
                "num_envs: expected a whole number from 1 to {}, found {lanes}",
                1 << 24
            )));
        }
        let declared = declaration.get();
        let simulation = declared.simulation(lanes);
        Ok(Lanes {
            parts: Parts::new(py, declared.environment(), &simulation, state_in_info)?,
            autoreset: Autoreset::named(autoreset)?,
            observations: simulation.observation_spec().observations(),
            simulation,
            declaration,
            seeds: Vec::new(),
            streams: LaneStreams::PerLane(Vec::new()),
            actions: vec![Action::default(); lanes],
            ended: vec![false; lanes],
            is_closed: false,
        })
    }

    /// Whether a reset needs seeds, because there are no random streams yet.
    #[getter]
    fn needs_seed(slf: &Bound<'_, Self>) -> PyResult<bool> {
        Ok(looked_at(slf)?.seeds.is_empty())
    }

    /// Begins episodes in all lanes, or in the lanes of a mask. A lane with a seed begins at the start of
    /// the seed's stream, other lanes at the current position of their streams.
    #[pyo3(signature = (seeds = None, mask = None))]
    fn reset<'py>(
        slf: &Bound<'py, Self>,
        seeds: Option<Vec<Option<u64>>>,
        mask: Option<PyReadonlyArray1<'py, bool>>,
    ) -> PyResult<(Batch<'py>, Info<'py>)> {
        used_alone(slf)?.begin(slf.py(), seeds, mask)
    }

    /// Takes a step in every lane: observations, rewards, which episodes terminated, which were truncated,
    /// and the true states.
    fn step<'py>(slf: &Bound<'py, Self>, actions: &Bound<'py, PyAny>) -> PyResult<Stepped<'py>> {
        used_alone(slf)?.take_step(slf.py(), actions)
    }

    /// Closes the environment.
    fn close(slf: &Bound<'_, Self>) -> PyResult<()> {
        used_alone(slf)?.is_closed = true;
        Ok(())
    }

    fn __copy__(slf: &Bound<'_, Self>) -> PyResult<Lanes> {
        looked_at(slf)?.copied(slf.py())
    }

    fn __deepcopy__(slf: &Bound<'_, Self>, _memo: &Bound<'_, PyAny>) -> PyResult<Lanes> {
        Lanes::__copy__(slf)
    }

    fn __reduce__<'py>(
        slf: &Bound<'py, Self>,
    ) -> PyResult<(Bound<'py, PyAny>, Bound<'py, pyo3::types::PyTuple>)> {
        let lanes = looked_at(slf)?;
        let arguments = (
            lanes.declaration.clone_ref(slf.py()),
            lanes.count(),
            lanes.autoreset.word(),
            lanes.parts.state,
            lanes.seeds.clone(),
            lanes.is_closed,
            PyBytes::new(slf.py(), &lanes.save()?),
        );
        Ok((slf.get_type().getattr("restored")?, arguments.into_pyobject(slf.py())?))
    }

    /// Restores pickled lanes.
    #[staticmethod]
    #[allow(clippy::too_many_arguments)]
    fn restored(
        py: Python<'_>,
        declaration: Py<Declaration>,
        lanes: usize,
        autoreset: &str,
        state_in_info: bool,
        seeds: Vec<u64>,
        is_closed: bool,
        state: &[u8],
    ) -> PyResult<Lanes> {
        let mut lanes = Lanes::new(py, declaration, lanes, autoreset, state_in_info)?;
        if !seeds.is_empty() && seeds.len() != lanes.count() {
            return Err(unreadable_state("it has seeds for another number of lanes"));
        }
        let streams = seeds.iter().map(|seed| Stream::new(*seed, Purpose::TestEnvironment));
        lanes.streams = LaneStreams::PerLane(streams.collect());
        (lanes.seeds, lanes.is_closed) = (seeds, is_closed);
        let mut bytes = state;
        let from = &mut StateReader::new(&mut bytes);
        lanes.simulation.restore(from).map_err(unreadable_state)?;
        lanes.streams.restore(from).map_err(unreadable_state)?;
        Ok(lanes)
    }
}

/// Actions as contiguous 64-bit integers, without a copy if they already have this form.
fn as_integers<'py>(
    py: Python<'py>,
    actions: &Bound<'py, PyAny>,
) -> PyResult<PyReadonlyArray1<'py, i64>> {
    if let Ok(array) = actions.cast::<PyArray1<i64>>()
        && let Ok(array) = array.try_readonly()
        && array.is_contiguous()
    {
        return Ok(array);
    }
    let numpy = py.import("numpy")?;
    let array = numpy.call_method1("asarray", (actions,))?;
    let dtype = array.getattr("dtype")?;
    let kind: String = dtype.getattr("kind")?.extract()?;
    let axes: usize = array.getattr("ndim")?.extract()?;
    if axes != 1 {
        return Err(PyValueError::new_err(format!(
            "actions: expected an array of one axis, found {axes}"
        )));
    }
    if !matches!(kind.as_str(), "i" | "u") {
        return Err(PyTypeError::new_err(format!(
            "actions: expected whole numbers, found {}",
            dtype.str()?
        )));
    }
    // Unsigned integers that are too large become negative, and are rejected as actions later.
    let array = numpy.call_method1("ascontiguousarray", (array, "int64"))?;
    array.extract()
}
