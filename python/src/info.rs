//! The true state of lanes, as the dictionaries that Gymnasium calls `info`.

use std::sync::Arc;

use jitai::environment::{Environment, Simulated, StateColumn, VectorEnvironment};
use jitai::key::Kind;
use numpy::{PyArray1, PyArrayMethods};
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyString};

/// The parts of an `info`. Copies share the names.
#[derive(Clone)]
pub(crate) struct Parts {
    /// Whether there is a true state.
    pub(crate) state: bool,
    /// Whether there is a mask of actions: only for environments with steps at which no message can be sent.
    pub(crate) masks: bool,
    /// The number of actions.
    pub(crate) actions: usize,
    names: Arc<Names>,
}

/// The names of entries.
struct Names {
    /// The columns of the state, in their order.
    state: Vec<Py<PyString>>,
    /// What a step adds to the return.
    outcome: Py<PyString>,
    /// An info of a state with these names, whose copies are filled faster than empty ones.
    empty: Py<PyDict>,
    /// The parameters in which participants can differ, by place.
    people: Vec<&'static str>,
}

impl Parts {
    /// The parts for lanes of this environment.
    pub(crate) fn new(
        py: Python<'_>,
        environment: &Environment,
        lanes: &Simulated,
        state: bool,
    ) -> PyResult<Parts> {
        let interned = |name: &str| PyString::intern(py, name).unbind();
        let mut columns = Vec::new();
        lanes.show_state(&mut |name, _| columns.push(interned(name)));
        let people = environment.family().people.iter();
        let differs = |kind: Kind| matches!(kind, Kind::Distribution(_));
        let outcome = interned(&outcome(environment));
        let empty = PyDict::new(py);
        empty.set_item(intern!(py, "step"), py.None())?;
        for name in columns.iter().chain([&outcome]) {
            empty.set_item(name, py.None())?;
        }
        let names = Names {
            state: columns,
            outcome,
            empty: empty.unbind(),
            people: people.filter(|key| differs(key.kind)).map(|key| key.name).collect(),
        };
        Ok(Parts {
            state,
            masks: environment.can_withhold(),
            actions: environment.actions().len(),
            names: Arc::new(names),
        })
    }
}

/// The name of what a step adds to the return: its unit, such as `steps_walked`.
pub(crate) fn outcome(environment: &Environment) -> String {
    environment.return_unit().replace(' ', "_")
}

/// Whether each action has an effect of its own in a lane.
pub(crate) fn mask(
    lanes: &Simulated,
    lane: usize,
    actions: usize,
) -> impl Iterator<Item = bool> + use<> {
    let can_send = lanes.can_send(lane);
    (0..actions).map(move |action| can_send || action == 0)
}

/// The state of one lane.
pub(crate) fn of_lane<'py>(
    py: Python<'py>,
    lanes: &Simulated,
    outcome: f64,
    parts: &Parts,
) -> PyResult<Bound<'py, PyDict>> {
    let info = match parts.state {
        true => parts.names.empty.bind(py).copy()?,
        false => PyDict::new(py),
    };
    if parts.state {
        info.set_item(intern!(py, "step"), lanes.times()[0])?;
        let mut names = parts.names.state.iter();
        let mut failed = None;
        lanes.show_state(&mut |_, column| {
            let Some(name) = names.next() else { return };
            let name = name.bind(py);
            let added = match column {
                StateColumn::Flags(flags) => info.set_item(name, flags[0]),
                StateColumn::Bytes(numbers) => info.set_item(name, numbers[0]),
                StateColumn::Reals(numbers) => info.set_item(name, numbers[0]),
            };
            if let Err(error) = added {
                failed = Some(error);
            }
        });
        if let Some(error) = failed {
            return Err(error);
        }
        info.set_item(parts.names.outcome.bind(py), outcome)?;
        let mut participant = Vec::new();
        lanes.participant(0, &mut participant);
        if !participant.is_empty() {
            let values = PyDict::new(py);
            let names = &parts.names.people;
            participant
                .iter()
                .try_for_each(|(place, value)| values.set_item(names[*place], value))?;
            info.set_item(intern!(py, "participant"), values)?;
        }
    }
    if parts.masks {
        let mask: Vec<i8> = mask(lanes, 0, parts.actions).map(i8::from).collect();
        info.set_item(intern!(py, "action_mask"), PyArray1::from_vec(py, mask))?;
    }
    Ok(info)
}

/// The state of the marked lanes, as an array per entry, each with a mask.
///
/// **Shapes**: `marked` and `outcomes` are \[lanes\].
pub(crate) fn of_lanes<'py>(
    py: Python<'py>,
    lanes: &Simulated,
    marked: Option<&[bool]>,
    outcomes: Option<&[f64]>,
    parts: &Parts,
) -> PyResult<Bound<'py, PyDict>> {
    let columns = Columns { py, info: PyDict::new(py), marked, count: lanes.lanes() };
    if parts.state {
        let times = lanes.times();
        columns.add("step", |lane| i64::from(times[lane]))?;
        let mut failed = None;
        lanes.show_state(&mut |name, column| {
            let added = match column {
                StateColumn::Flags(flags) => columns.add(name, |lane| flags[lane]),
                StateColumn::Bytes(numbers) => columns.add(name, |lane| i64::from(numbers[lane])),
                StateColumn::Reals(numbers) => columns.add(name, |lane| numbers[lane]),
            };
            if let Err(error) = added {
                failed = Some(error);
            }
        });
        if let Some(error) = failed {
            return Err(error);
        }
        let outcome = parts.names.outcome.to_str(py)?;
        columns.add(outcome, |lane| outcomes.map_or(0.0, |outcomes| outcomes[lane]))?;
        let mut values = Vec::new();
        lanes.participant(0, &mut values);
        let width = values.len();
        if width > 0 {
            (1..columns.count).for_each(|lane| lanes.participant(lane, &mut values));
            let people = columns.nested();
            for index in 0..width {
                let name = parts.names.people[values[index].0];
                people.add(name, |lane| values[lane * width + index].1)?;
            }
            columns.info.set_item(intern!(py, "participant"), people.info)?;
            columns.add_mask("participant")?;
        }
    }
    if parts.masks {
        let mut masks = vec![0; columns.count * parts.actions];
        for (lane, row) in masks.chunks_exact_mut(parts.actions).enumerate() {
            if columns.has(lane) {
                let open = mask(lanes, lane, parts.actions);
                row.iter_mut().zip(open).for_each(|(shown, open)| *shown = i8::from(open));
            }
        }
        let masks = PyArray1::from_vec(py, masks).reshape([columns.count, parts.actions])?;
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
