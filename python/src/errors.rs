//! Errors as the corresponding exceptions of Python and Gymnasium.

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use pyo3::types::PyType;

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
