//! Errors as the corresponding exceptions of Python and Gymnasium.

use jitai::environment::Simulated;
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use pyo3::pyclass::boolean_struct::False;
use pyo3::types::PyType;
use pyo3::{PyClass, PyRef, PyRefMut};

/// The exception of `gymnasium.error` with this name.
pub(crate) fn gymnasium(py: Python<'_>, name: &str, message: String) -> PyErr {
    let kind = py.import("gymnasium.error").and_then(|module| module.getattr(name));
    match kind.and_then(|kind| Ok(kind.cast_into::<PyType>()?)) {
        Ok(kind) => PyErr::from_type(kind, message),
        Err(error) => error,
    }
}

/// The exception for calls on a closed environment.
pub(crate) fn closed(py: Python<'_>) -> PyErr {
    let message = "the environment is closed; create a new one".to_owned();
    gymnasium(py, "ClosedEnvironmentError", message)
}

/// The exception for calls that need a running episode.
pub(crate) fn reset_needed(py: Python<'_>, message: impl Into<String>) -> PyErr {
    gymnasium(py, "ResetNeeded", message.into())
}

/// The exception for a saved state that does not fit the environment.
pub(crate) fn unreadable_state(error: impl std::fmt::Display) -> PyErr {
    PyRuntimeError::new_err(format!(
        "the saved state cannot be read: {error}; restore it with the release that saved it"
    ))
}

/// Checks that a simulation can go on.
///
/// **Errors**: a number of its model is missing or out of its range.
pub(crate) fn sound(simulation: &Simulated) -> PyResult<()> {
    simulation.failure().map_or(Ok(()), |says| Err(PyRuntimeError::new_err(says.to_owned())))
}

/// The environment, for a change of its state.
///
/// **Errors**: another thread uses it.
pub(crate) fn used_alone<'py, T: PyClass<Frozen = False>>(
    environment: &Bound<'py, T>,
) -> PyResult<PyRefMut<'py, T>> {
    environment.try_borrow_mut().map_err(|_| in_use())
}

/// The environment, to look at its state.
///
/// **Errors**: another thread changes it.
pub(crate) fn looked_at<'py, T: PyClass>(environment: &Bound<'py, T>) -> PyResult<PyRef<'py, T>> {
    environment.try_borrow().map_err(|_| in_use())
}

fn in_use() -> PyErr {
    PyRuntimeError::new_err(
        "another thread is using the environment; use it from one thread at a time, or make one for \
         each thread",
    )
}
