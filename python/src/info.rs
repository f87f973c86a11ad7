//! The true state of lanes, as the dictionaries that Gymnasium calls `info`.

use jitai::environment::{Action, OPTIONS, ParticipantSampler, PhysicalActivity};
use numpy::{PyArray1, PyArrayMethods};
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// The parts of an `info`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Parts {
    /// The true state.
    pub(crate) state: bool,
    /// The mask of actions; only for environments with steps at which no message can be sent.
    pub(crate) masks: bool,
}

/// 1 for the actions that have a distinct effect in a lane, 0 for the others.
pub(crate) fn mask(lanes: &PhysicalActivity, lane: usize) -> [i8; OPTIONS] {
    std::array::from_fn(|index| {
        let action = Action::from_index(index).unwrap_or(Action::NONE);
        i8::from(lanes.taken(lane, action) == action)
    })
}

/// The parameters of the participant in a lane, by name; empty without a population.
fn participant(lanes: &PhysicalActivity, lane: usize) -> impl Iterator<Item = (&'static str, f64)> {
    let name = |place| ParticipantSampler::all_names().nth(place).unwrap_or_default();
    lanes.participant(lane).map(move |(place, value)| (name(place), value))
}

/// The state of one lane.
pub(crate) fn of_lane<'py>(
    py: Python<'py>,
    lanes: &PhysicalActivity,
    lane: usize,
    steps_walked: Option<f64>,
    parts: Parts,
) -> PyResult<Bound<'py, PyDict>> {
    let info = PyDict::new(py);
    if parts.state {
        let draw = lanes.context(lane);
        info.set_item(intern!(py, "step"), lanes.times()[lane])?;
        info.set_item(intern!(py, "context"), draw.context)?;
        info.set_item(intern!(py, "probability_0"), draw.probability_of_zero)?;
        info.set_item(intern!(py, "likely"), draw.likely)?;
        info.set_item(intern!(py, "habituation"), lanes.habituation()[lane])?;
        info.set_item(intern!(py, "disengagement"), lanes.disengagement()[lane])?;
        info.set_item(intern!(py, "available"), lanes.is_available(lane))?;
        info.set_item(intern!(py, "steps_walked"), steps_walked.unwrap_or(0.0))?;
        let mut participant = participant(lanes, lane).peekable();
        if participant.peek().is_some() {
            let values = PyDict::new(py);
            participant.try_for_each(|(name, value)| values.set_item(name, value))?;
            info.set_item(intern!(py, "participant"), values)?;
        }
    }
    if parts.masks {
        info.set_item(intern!(py, "action_mask"), PyArray1::from_slice(py, &mask(lanes, lane)))?;
    }
    Ok(info)
}

/// The state of the marked lanes, as an array per entry, each with a mask.
///
/// **Shapes**: `marked` and `steps_walked` are \[lanes\].
pub(crate) fn of_lanes<'py>(
    py: Python<'py>,
    lanes: &PhysicalActivity,
    marked: Option<&[bool]>,
    steps_walked: Option<&[f64]>,
    parts: Parts,
) -> PyResult<Bound<'py, PyDict>> {
    let columns = Columns { py, info: PyDict::new(py), marked, count: lanes.times().len() };
    if parts.state {
        columns.add("step", |lane| i64::from(lanes.times()[lane]))?;
        columns.add("context", |lane| i64::from(lanes.context(lane).context))?;
        columns.add("probability_0", |lane| lanes.context(lane).probability_of_zero)?;
        columns.add("likely", |lane| i64::from(lanes.context(lane).likely))?;
        columns.add("habituation", |lane| lanes.habituation()[lane])?;
        columns.add("disengagement", |lane| lanes.disengagement()[lane])?;
        columns.add("available", |lane| lanes.is_available(lane))?;
        columns.add("steps_walked", |lane| steps_walked.map_or(0.0, |steps| steps[lane]))?;
        let names: Vec<&str> = participant(lanes, 0).map(|(name, _)| name).collect();
        if !names.is_empty() {
            let people = columns.nested();
            for (index, name) in names.into_iter().enumerate() {
                let value =
                    |lane| participant(lanes, lane).nth(index).map_or(0.0, |(_, value)| value);
                people.add(name, value)?;
            }
            columns.info.set_item(intern!(py, "participant"), people.info)?;
            columns.add_mask("participant")?;
        }
    }
    if parts.masks {
        let shown = |lane: usize| if columns.has(lane) { mask(lanes, lane) } else { [0; 4] };
        let masks: Vec<i8> = (0..columns.count).flat_map(shown).collect();
        let masks = PyArray1::from_vec(py, masks).reshape([columns.count, OPTIONS])?;
        columns.info.set_item(intern!(py, "action_mask"), masks)?;
        columns.add_mask("action_mask")?;
    }
    Ok(columns.info)
}

/// The arrays of an info.
struct Columns<'py, 'a> {
    py: Python<'py>,
    info: Bound<'py, PyDict>,
    /// The lanes that have entries; `None` for all.
    marked: Option<&'a [bool]>,
    count: usize,
}

impl Columns<'_, '_> {
    /// An empty info for the same lanes.
    fn nested(&self) -> Self {
        Columns { info: PyDict::new(self.py), ..*self }
    }

    fn has(&self, lane: usize) -> bool {
        self.marked.is_none_or(|marked| marked[lane])
    }

    fn add<T: numpy::Element + Default>(
        &self,
        name: &str,
        of: impl Fn(usize) -> T,
    ) -> PyResult<()> {
        let values: Vec<T> = match self.marked {
            None => (0..self.count).map(of).collect(),
            Some(marked) => {
                let of_marked = |(lane, marked): (usize, &bool)| {
                    if *marked { of(lane) } else { T::default() }
                };
                marked.iter().enumerate().map(of_marked).collect()
            }
        };
        self.info.set_item(name, PyArray1::from_vec(self.py, values))?;
        self.add_mask(name)
    }

    fn add_mask(&self, name: &str) -> PyResult<()> {
        let mask = self.marked.map_or_else(|| vec![true; self.count], <[bool]>::to_vec);
        self.info.set_item(format!("_{name}"), PyArray1::from_vec(self.py, mask))
    }
}
