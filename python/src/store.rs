//! Results in a store, column by column.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

use jitai::results::{Answer, QueryError, Reader, SqlValue};
use jitai::store::StoreError;
use numpy::PyArray1;
use pyo3::exceptions::{
    PyFileNotFoundError, PyKeyError, PyMemoryError, PyOSError, PyRuntimeError, PyValueError,
};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyList};

/// A store that is open for reading.
#[pyclass(frozen, module = "jitai._jitai")]
pub(crate) struct StoreReader(Mutex<Option<Reader>>);

impl StoreReader {
    fn lock(&self) -> MutexGuard<'_, Option<Reader>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The exception for calls on a closed store.
fn closed() -> PyErr {
    PyValueError::new_err("the store is closed; open it again with jitai.open")
}

#[pymethods]
impl StoreReader {
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let reader = py.detach(|| Reader::open(&path)).map_err(store_error)?;
        Ok(StoreReader(Mutex::new(Some(reader))))
    }

    /// Whether the store has a view; stores of earlier versions lack newer views.
    fn has_view(&self, py: Python<'_>, name: &str) -> PyResult<bool> {
        py.detach(|| match &*self.lock() {
            Some(reader) => reader.has_view(name).map_err(store_error),
            None => Err(closed()),
        })
    }

    /// The result of a query: name and values of every column, in order. Values are an array of integers,
    /// or an array of floats with NaN for NULL, or a list.
    fn columns<'py>(
        &self,
        py: Python<'py>,
        sql: &str,
    ) -> PyResult<Vec<(String, Bound<'py, PyAny>)>> {
        let columns = py.detach(|| match &*self.lock() {
            Some(reader) => answer(reader, sql),
            None => Err(closed()),
        })?;
        columns.into_iter().map(|column| Ok((column.name, column.values.of_python(py)?))).collect()
    }

    /// Closes the file.
    fn close(&self, py: Python<'_>) {
        let reader = py.detach(|| self.lock().take());
        drop(reader);
    }

    #[getter]
    fn is_closed(&self) -> bool {
        self.lock().is_none()
    }
}

/// The exception for an error of the store.
pub(crate) fn store_error(error: StoreError) -> PyErr {
    let message = error.to_string();
    match error {
        StoreError::Missing { .. } | StoreError::MissingFolder { .. } => {
            PyFileNotFoundError::new_err(message)
        }
        StoreError::NotAKey { .. }
        | StoreError::NoSuchJob { .. }
        | StoreError::NotCompleted { .. }
        | StoreError::AmbiguousKey { .. } => PyKeyError::new_err(message),
        StoreError::CannotOpen { .. } | StoreError::Disk { .. } => PyOSError::new_err(message),
        StoreError::Empty { .. }
        | StoreError::NotAStore { .. }
        | StoreError::Foreign { .. }
        | StoreError::Newer { .. }
        | StoreError::Older { .. } => PyValueError::new_err(message),
        _ => PyRuntimeError::new_err(message),
    }
}

fn query_error(error: QueryError) -> PyErr {
    match &error {
        QueryError::TooLarge => PyMemoryError::new_err(error.to_string()),
        QueryError::Damaged { .. } | QueryError::Interrupted => {
            PyRuntimeError::new_err(error.to_string())
        }
        _ => PyValueError::new_err(error.to_string()),
    }
}

/// A column of a result.
struct Column {
    name: String,
    values: Values,
}

/// A value of a column with several types.
enum Cell {
    Null,
    Integer(i64),
    Real(f64),
    Text(String),
    Blob(Vec<u8>),
}

impl From<SqlValue<'_>> for Cell {
    fn from(value: SqlValue<'_>) -> Self {
        match value {
            SqlValue::Null => Cell::Null,
            SqlValue::Integer(whole) => Cell::Integer(whole),
            SqlValue::Real(real) => Cell::Real(real),
            SqlValue::Text(text) => Cell::Text(text.to_owned()),
            SqlValue::Blob(bytes) => Cell::Blob(bytes.to_vec()),
        }
    }
}

/// The values of a column, in the narrowest type that holds all values so far.
enum Values {
    /// NULLs only: their count.
    Nulls(usize),
    Integers(Vec<i64>),
    /// Floats, with NaN for NULL.
    Reals(Vec<f64>),
    Cells(Vec<Cell>),
}

/// Largest integer up to which all integers are exact as floats.
const LARGEST_EXACT: i64 = 1 << 53;

fn as_real(whole: i64) -> Option<f64> {
    (-LARGEST_EXACT..=LARGEST_EXACT).contains(&whole).then_some(whole as f64)
}

impl Values {
    fn push(&mut self, value: SqlValue<'_>) {
        *self = match (std::mem::replace(self, Values::Nulls(0)), value) {
            (Values::Nulls(count), SqlValue::Null) => Values::Nulls(count + 1),
            (Values::Nulls(0), SqlValue::Integer(whole)) => Values::Integers(vec![whole]),
            (Values::Nulls(count), SqlValue::Real(real)) => {
                let mut reals = vec![f64::NAN; count];
                reals.push(real);
                Values::Reals(reals)
            }
            (Values::Integers(mut wholes), SqlValue::Integer(whole)) => {
                wholes.push(whole);
                Values::Integers(wholes)
            }
            (Values::Reals(mut reals), SqlValue::Real(real)) => {
                reals.push(real);
                Values::Reals(reals)
            }
            (Values::Reals(mut reals), SqlValue::Null) => {
                reals.push(f64::NAN);
                Values::Reals(reals)
            }
            (Values::Cells(mut cells), value) => {
                cells.push(value.into());
                Values::Cells(cells)
            }
            (values, value) => {
                let mut cells = values.into_cells();
                cells.push(value.into());
                Values::Cells(cells)
            }
        };
    }

    fn into_cells(self) -> Vec<Cell> {
        match self {
            Values::Nulls(count) => (0..count).map(|_| Cell::Null).collect(),
            Values::Integers(wholes) => wholes.into_iter().map(Cell::Integer).collect(),
            Values::Reals(reals) => {
                let cell = |real: f64| if real.is_nan() { Cell::Null } else { Cell::Real(real) };
                reals.into_iter().map(cell).collect()
            }
            Values::Cells(cells) => cells,
        }
    }

    /// Mixed integers, floats and NULLs as floats, if all integers are exact.
    fn narrowed(self) -> Self {
        let Values::Cells(cells) = self else { return self };
        let real = |cell: &Cell| match cell {
            Cell::Null => Some(f64::NAN),
            Cell::Integer(whole) => as_real(*whole),
            Cell::Real(real) => Some(*real),
            Cell::Text(_) | Cell::Blob(_) => None,
        };
        match cells.iter().map(real).collect::<Option<Vec<f64>>>() {
            Some(reals) => Values::Reals(reals),
            None => Values::Cells(cells),
        }
    }

    fn of_python(self, py: Python<'_>) -> PyResult<Bound<'_, PyAny>> {
        Ok(match self.narrowed() {
            Values::Nulls(count) => PyList::new(py, (0..count).map(|_| py.None()))?.into_any(),
            Values::Integers(wholes) => PyArray1::from_vec(py, wholes).into_any(),
            Values::Reals(reals) => PyArray1::from_vec(py, reals).into_any(),
            Values::Cells(cells) => {
                let list = PyList::empty(py);
                for cell in cells {
                    match cell {
                        Cell::Null => list.append(py.None())?,
                        Cell::Integer(whole) => list.append(whole)?,
                        Cell::Real(real) => list.append(real)?,
                        Cell::Text(text) => list.append(text)?,
                        Cell::Blob(bytes) => list.append(PyBytes::new(py, &bytes))?,
                    }
                }
                list.into_any()
            }
        })
    }
}

fn answer(reader: &Reader, sql: &str) -> PyResult<Vec<Column>> {
    let mut columns: Vec<Column> = Vec::new();
    reader
        .query(sql, |part| {
            match part {
                Answer::Columns(names) => {
                    let column =
                        |name: &&str| Column { name: (*name).to_owned(), values: Values::Nulls(0) };
                    columns = names.iter().map(column).collect();
                }
                Answer::Row(values) => {
                    let pairs = columns.iter_mut().zip(values);
                    pairs.for_each(|(column, value)| column.values.push(*value));
                }
            }
            ControlFlow::Continue(())
        })
        .map_err(query_error)?;
    Ok(columns)
}

/// A dictionary of names and values.
pub(crate) fn dictionary<'py, V: IntoPyObject<'py>>(
    py: Python<'py>,
    entries: impl IntoIterator<Item = (String, V)>,
) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    for (name, value) in entries {
        dict.set_item(name, value)?;
    }
    Ok(dict)
}
