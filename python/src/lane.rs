//! A single environment.

use std::io;

use jitai::environment::{
    Action, EpisodeStatus, LaneSet, LaneStreams, Observations, Purpose, Resumable, Simulated,
    StateReader, StateWriter, Stream, VectorEnvironment,
};
use numpy::PyArray1;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};

use crate::declaration::Declaration;
use crate::errors::{
    closed, gymnasium, looked_at, reset_needed, sound, unreadable_state, used_alone,
};
use crate::info::{Parts, mask, of_lane};

type Observation<'py> = Bound<'py, PyArray1<f32>>;
type Info<'py> = Bound<'py, PyDict>;

/// One lane of the simulation, with the random stream of the test of a job with the same seed.
#[pyclass(module = "jitai._jitai")]
pub(crate) struct Lane {
    declaration: Py<Declaration>,
    parts: Parts,
    simulation: Simulated,
    /// `None` before the first reset.
    seed: Option<u64>,
    streams: LaneStreams,
    observations: Observations,
    /// The last action of the episode, and what it added to the return.
    last: Option<(Action, f64)>,
    /// The return of the episode so far.
    total: f64,
    is_closed: bool,
}

impl Lane {
    fn observation<'py>(&mut self, py: Python<'py>) -> Observation<'py> {
        self.simulation.observe(&mut self.observations);
        match self.observations.one_hot() {
            0 => PyArray1::from_slice(py, self.observations.row(0)),
            _ => PyArray1::from_vec(py, self.observations.take_written_out()),
        }
    }

    fn info<'py>(&self, py: Python<'py>) -> PyResult<Info<'py>> {
        let outcome = self.last.map_or(0.0, |(_, outcome)| outcome);
        of_lane(py, &self.simulation, outcome, &self.parts)
    }

    fn status(&self) -> EpisodeStatus {
        self.simulation.statuses()[0]
    }

    fn require_step(&self, py: Python<'_>) -> PyResult<()> {
        if self.is_closed {
            Err(closed(py))
        } else if self.seed.is_none() {
            Err(reset_needed(py, "call reset() before the first step"))
        } else if self.status() != EpisodeStatus::Running {
            Err(reset_needed(py, "the episode has ended; call reset() before the next step"))
        } else {
            Ok(())
        }
    }

    /// A description of the current step.
    fn described(&self) -> String {
        if self.seed.is_none() {
            return "no episode yet".to_owned();
        }
        let environment = self.declaration.get().environment();
        let last = match self.last {
            None => "episode begins".to_owned(),
            Some((action, outcome)) => {
                format!("action {}, {outcome:.1} {}", action.index(), environment.return_unit())
            }
        };
        let end = match (self.status(), environment.family().termination_metric) {
            (EpisodeStatus::Running, _) => "",
            (EpisodeStatus::Terminated, "disengagement_rate") => "; disengaged",
            (EpisodeStatus::Terminated, _) => "; terminated",
            (EpisodeStatus::Truncated, _) => "; horizon",
        };
        let (time, state) = (self.simulation.times()[0], self.simulation.described_state(0));
        format!("step {time:2}: {state}; {last}; return {:.1}{end}", self.total)
    }

    fn copied(&self, py: Python<'_>) -> PyResult<Lane> {
        Ok(Lane {
            declaration: self.declaration.clone_ref(py),
            parts: self.parts.clone(),
            simulation: self.simulation.copied()?,
            streams: self.streams.clone(),
            observations: self.observations.clone(),
            ..*self
        })
    }

    fn save(&self) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        let mut out = StateWriter::new(&mut bytes);
        self.simulation.save(&mut out)?;
        self.streams.save(&mut out)?;
        out.one(self.total)?;
        let (action, outcome) = self.last.unwrap_or((Action::default(), f64::NAN));
        out.one(action.index() as u8)?;
        out.one(outcome)?;
        Ok(bytes)
    }
}

#[pymethods]
impl Lane {
    #[new]
    fn new(py: Python<'_>, declaration: Py<Declaration>, state_in_info: bool) -> PyResult<Self> {
        let declared = declaration.get();
        let simulation = declared.simulation(1);
        Ok(Lane {
            parts: Parts::new(py, declared.environment(), &simulation, state_in_info)?,
            observations: simulation.observation_spec().observations(),
            simulation,
            declaration,
            seed: None,
            streams: LaneStreams::Shared(Stream::new(0, Purpose::TestEnvironment)),
            last: None,
            total: 0.0,
            is_closed: false,
        })
    }

    /// Whether a reset needs a seed, because there is no random stream yet.
    #[getter]
    fn needs_seed(slf: &Bound<'_, Self>) -> PyResult<bool> {
        Ok(looked_at(slf)?.seed.is_none())
    }

    /// Begins an episode, at the start of a seed's stream or at the current position of the stream.
    #[pyo3(signature = (seed = None))]
    fn reset<'py>(
        slf: &Bound<'py, Self>,
        seed: Option<u64>,
    ) -> PyResult<(Observation<'py>, Info<'py>)> {
        let py = slf.py();
        let lane = &mut *used_alone(slf)?;
        if lane.is_closed {
            return Err(closed(py));
        }
        if let Some(seed) = seed {
            lane.seed = Some(seed);
            lane.streams = LaneStreams::Shared(Stream::new(seed, Purpose::TestEnvironment));
        } else if lane.seed.is_none() {
            return Err(reset_needed(py, "the first reset needs a seed"));
        }
        lane.simulation.reset(LaneSet::All, &mut lane.streams);
        sound(&lane.simulation)?;
        (lane.last, lane.total) = (None, 0.0);
        Ok((lane.observation(py), lane.info(py)?))
    }

    /// Takes a step: observation, reward, whether the episode terminated, whether it was truncated, and the
    /// true state.
    #[allow(clippy::type_complexity)]
    fn step<'py>(
        slf: &Bound<'py, Self>,
        action: &Bound<'py, PyAny>,
    ) -> PyResult<(Observation<'py>, f64, bool, bool, Info<'py>)> {
        let py = slf.py();
        let lane = &mut *used_alone(slf)?;
        lane.require_step(py)?;
        let action = action_of(action, lane.parts.actions)?;
        let mut reward = [0.0];
        let taken = if lane.parts.masks { lane.simulation.taken(0, action) } else { action };
        lane.simulation.step(&[action], &mut reward, &mut lane.streams);
        sound(&lane.simulation)?;
        let outcome = lane.simulation.outcomes(&reward)[0];
        lane.last = Some((taken, outcome));
        lane.total += outcome;
        let status = lane.status();
        Ok((
            lane.observation(py),
            reward[0],
            status == EpisodeStatus::Terminated,
            status == EpisodeStatus::Truncated,
            lane.info(py)?,
        ))
    }

    /// \[actions\]: whether each action has an effect of its own at the current step.
    fn action_masks(slf: &Bound<'_, Self>) -> PyResult<Vec<bool>> {
        let lane = looked_at(slf)?;
        match lane.seed {
            None => Err(reset_needed(slf.py(), "call reset() before action_masks()")),
            Some(_) => Ok(mask(&lane.simulation, 0, lane.parts.actions).collect()),
        }
    }

    /// A description of the current step.
    fn line(slf: &Bound<'_, Self>) -> PyResult<String> {
        Ok(looked_at(slf)?.described())
    }

    /// Closes the environment.
    fn close(slf: &Bound<'_, Self>) -> PyResult<()> {
        used_alone(slf)?.is_closed = true;
        Ok(())
    }

    fn __copy__(slf: &Bound<'_, Self>) -> PyResult<Lane> {
        looked_at(slf)?.copied(slf.py())
    }

    fn __deepcopy__(slf: &Bound<'_, Self>, _memo: &Bound<'_, PyAny>) -> PyResult<Lane> {
        Lane::__copy__(slf)
    }

    #[allow(clippy::type_complexity)]
    fn __reduce__<'py>(
        slf: &Bound<'py, Self>,
    ) -> PyResult<(
        Bound<'py, PyAny>,
        (Py<Declaration>, bool, Option<u64>, bool, Bound<'py, PyBytes>),
    )> {
        let lane = looked_at(slf)?;
        let bytes = PyBytes::new(slf.py(), &lane.save()?);
        let declaration = lane.declaration.clone_ref(slf.py());
        let arguments = (declaration, lane.parts.state, lane.seed, lane.is_closed, bytes);
        Ok((slf.get_type().getattr("restored")?, arguments))
    }

    /// Restores a pickled lane.
    #[staticmethod]
    fn restored(
        py: Python<'_>,
        declaration: Py<Declaration>,
        state_in_info: bool,
        seed: Option<u64>,
        is_closed: bool,
        state: &[u8],
    ) -> PyResult<Lane> {
        let mut lane = Lane::new(py, declaration, state_in_info)?;
        (lane.seed, lane.is_closed) = (seed, is_closed);
        let seed = seed.unwrap_or_default();
        lane.streams = LaneStreams::Shared(Stream::new(seed, Purpose::TestEnvironment));
        let mut bytes = state;
        let from = &mut StateReader::new(&mut bytes);
        lane.simulation.restore(from).map_err(unreadable_state)?;
        lane.streams.restore(from).map_err(unreadable_state)?;
        lane.total = from.one().map_err(unreadable_state)?;
        let action: u8 = from.one().map_err(unreadable_state)?;
        let outcome: f64 = from.one().map_err(unreadable_state)?;
        let action = Action::from_index(action.into());
        let action = action.filter(|action| action.index() < lane.parts.actions);
        lane.last = action.map(|action| (action, outcome)).filter(|_| !outcome.is_nan());
        Ok(lane)
    }
}

/// The action for a Python or NumPy integer, among this number of actions.
fn action_of(action: &Bound<'_, PyAny>, count: usize) -> PyResult<Action> {
    let index: i64 = match action.extract() {
        Ok(index) => index,
        Err(_) => whole(action, count)?,
    };
    let place = usize::try_from(index).ok().filter(|index| *index < count);
    let found = || invalid_action(action.py(), count, index.to_string());
    place.and_then(Action::from_index).ok_or_else(found)
}

/// The integer in a value of another type, such as an array with one element.
fn whole(action: &Bound<'_, PyAny>, count: usize) -> PyResult<i64> {
    let py = action.py();
    let too_long = || invalid_action(py, count, "a number of more than 64 bits".to_owned());
    if action.is_instance_of::<pyo3::types::PyInt>() {
        return Err(too_long());
    }
    let refused = |what: String| {
        let last = count - 1;
        PyTypeError::new_err(format!("an action is a whole number from 0 to {last}, found {what}"))
    };
    let array = py.import("numpy")?.call_method1("asarray", (action,))?;
    let kind: String = array.getattr("dtype")?.getattr("kind")?.extract()?;
    let size: usize = array.getattr("size")?.extract()?;
    if !matches!(kind.as_str(), "i" | "u") || size != 1 {
        return Err(refused(action.get_type().name()?.to_string()));
    }
    let item = array.call_method0("item")?;
    item.extract().map_err(|_| too_long())
}

fn invalid_action(py: Python<'_>, count: usize, found: String) -> PyErr {
    let message = format!("an action is a number from 0 to {}, found {found}", count - 1);
    gymnasium(py, "InvalidAction", message)
}
