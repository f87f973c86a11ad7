//! Results in a store, column by column.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, TryLockError};
use std::thread;
use std::time::Duration;

use jitai::results::{Answer, ColumnType, QueryError, Reader, SqlValue};
use jitai::store::StoreError;
use numpy::PyArray1;
use pyo3::exceptions::{
    PyFileNotFoundError, PyKeyError, PyMemoryError, PyOSError, PyRuntimeError, PyTypeError,
    PyValueError,
};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyBytes, PyDict, PyFloat, PyInt, PyList, PyString};

use crate::interrupt::interruptible;

/// A store that is open for reading.
#[pyclass(frozen, module = "jitai._jitai")]
pub(crate) struct StoreReader(Mutex<Option<Reader>>);

impl StoreReader {
    /// Calls `work` with the reader. Ctrl-C ends a wait for another thread that uses the reader, and the
    /// reader's query.
    fn with<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&Reader) -> PyResult<T> + Send,
    ) -> PyResult<T> {
        let mut held = self.lock(py)?;
        let reader = held.as_mut().ok_or_else(closed)?;
        let interrupter = reader.interrupter();
        interruptible(py, move || interrupter.interrupt(), move || work(reader))?
    }

    /// The reader, once no other thread uses it. Whoever holds it may wait for the interpreter, which
    /// therefore must not be held while waiting.
    fn lock(&self, py: Python<'_>) -> PyResult<MutexGuard<'_, Option<Reader>>> {
        loop {
            match self.0.try_lock() {
                Ok(held) => return Ok(held),
                Err(TryLockError::Poisoned(held)) => return Ok(held.into_inner()),
                Err(TryLockError::WouldBlock) => py.detach(|| thread::sleep(PAUSE)),
            }
            py.check_signals()?;
        }
    }
}

/// Interval of the attempts to get a reader that another thread uses.
const PAUSE: Duration = Duration::from_millis(5);

/// The exception for calls on a closed store.
fn closed() -> PyErr {
    PyValueError::new_err("the store is closed; open it again with jitai.open")
}

/// The name and the kind of a column, its values, and which of them are NULL: `None` if none is.
type PyColumn<'py> = (String, &'static str, Bound<'py, PyAny>, Option<Bound<'py, PyArray1<bool>>>);

#[pymethods]
impl StoreReader {
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let reader = py.detach(|| Reader::open(&path)).map_err(store_error)?;
        Ok(StoreReader(Mutex::new(Some(reader))))
    }

    /// Whether the store has a view; stores of earlier versions lack newer views.
    fn has_view(&self, py: Python<'_>, name: &str) -> PyResult<bool> {
        self.with(py, |reader| reader.has_view(name).map_err(store_error))
    }

    /// The names of the experiments.
    fn experiments(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        let manifests = self.with(py, |reader| reader.manifests().map_err(store_error))?;
        Ok(manifests.into_iter().map(|(name, _)| name).collect())
    }

    /// The columns of a view, of one experiment or of all.
    fn view<'py>(
        &self,
        py: Python<'py>,
        name: &str,
        experiment: Option<String>,
    ) -> PyResult<Vec<PyColumn<'py>>> {
        let experiments: Vec<String> = experiment.into_iter().collect();
        let all = self.with(py, |reader| reader.exports(&experiments).map_err(store_error))?;
        let sql = all.into_iter().find(|(view, _)| *view == name).and_then(|(_, sql)| sql);
        let sql = sql.ok_or_else(|| PyValueError::new_err(format!("no view {name}")))?;
        self.columns(py, &sql, Vec::new())
    }

    /// The columns of the answer to a query, in order. The values of a column of the kinds `integer` and
    /// `real` are an array, with 0 and NaN for NULL; those of `text`, `bytes`, `mixed` and `null` are a list.
    /// `values` are the values of the query's parameters, with their names.
    #[pyo3(signature = (sql, values = Vec::new()))]
    fn columns<'py>(
        &self,
        py: Python<'py>,
        sql: &str,
        values: Vec<(Option<String>, Bound<'py, PyAny>)>,
    ) -> PyResult<Vec<PyColumn<'py>>> {
        let values = values.into_iter().map(|(name, value)| Ok((name, Cell::of(&value)?)));
        let values = values.collect::<PyResult<Vec<_>>>()?;
        let columns = self.with(py, |reader| answer(reader, sql, &values))?;
        columns.into_iter().map(|column| column.of_python(py)).collect()
    }

    /// The text of the current manifest of an experiment.
    fn manifest(&self, py: Python<'_>, experiment: &str) -> PyResult<Option<String>> {
        self.with(py, |reader| reader.manifest(experiment).map_err(store_error))
    }

    /// Closes the file.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        let reader = self.lock(py)?.take();
        py.detach(|| drop(reader));
        Ok(())
    }

    #[getter]
    fn is_closed(&self) -> bool {
        // A reader that another thread uses is open.
        self.0.try_lock().is_ok_and(|reader| reader.is_none())
    }
}

/// The exception for an error of the store.
pub(crate) fn store_error(error: StoreError) -> PyErr {
    // Options of the program mean nothing in Python.
    let message = error.to_string();
    let message = message.replace(" with --store", "").replace("; --store names another store", "");
    match error {
        StoreError::Missing { .. } | StoreError::MissingFolder { .. } => {
            PyFileNotFoundError::new_err(message)
        }
        StoreError::NotAKey { .. }
        | StoreError::NoSuchJob { .. }
        | StoreError::NotCompleted { .. }
        | StoreError::AmbiguousKey { .. } => PyKeyError::new_err(message),
        StoreError::CannotOpen { .. }
        | StoreError::Disk { .. }
        | StoreError::HardLinked { .. }
        | StoreError::MountedAlone { .. } => PyOSError::new_err(message),
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
    declared: ColumnType,
    values: Values,
    /// Whether each value is NULL.
    nulls: Vec<bool>,
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

impl Cell {
    /// The value of a parameter of a query.
    fn of(value: &Bound<'_, PyAny>) -> PyResult<Cell> {
        // Scalars of NumPy are numbers of their own.
        let value = match value.hasattr("dtype")? && value.hasattr("item")? {
            true => value.call_method0("item")?,
            false => value.clone(),
        };
        Ok(match () {
            () if value.is_none() => Cell::Null,
            () if value.is_instance_of::<PyBool>() => {
                Cell::Integer(value.extract::<bool>()?.into())
            }
            () if value.is_instance_of::<PyInt>() => Cell::Integer(value.extract()?),
            () if value.is_instance_of::<PyFloat>() => Cell::Real(value.extract()?),
            () if value.is_instance_of::<PyString>() => Cell::Text(value.extract()?),
            () if value.is_instance_of::<PyBytes>() => Cell::Blob(value.extract()?),
            () => {
                return Err(PyTypeError::new_err(format!(
                    "parameters: expected numbers, texts, bytes or None, found {}",
                    value.get_type().name()?
                )));
            }
        })
    }

    fn as_sql(&self) -> SqlValue<'_> {
        match self {
            Cell::Null => SqlValue::Null,
            Cell::Integer(whole) => SqlValue::Integer(*whole),
            Cell::Real(real) => SqlValue::Real(*real),
            Cell::Text(text) => SqlValue::Text(text),
            Cell::Blob(bytes) => SqlValue::Blob(bytes),
        }
    }
}

/// The values of a column, in its declared type, or in the narrowest type that holds all values so far.
enum Values {
    /// NULLs only, without a declared type.
    Nulls,
    /// Integers, with 0 for NULL.
    Integers(Vec<i64>),
    /// Floats, with NaN for NULL.
    Reals(Vec<f64>),
    Cells(Vec<Cell>),
}

/// Largest integer up to which all integers are exact as floats.
const LARGEST_EXACT: i64 = 1 << 53;
/// Number of values that become Python objects between two looks at signals.
const CONVERTED: usize = 1 << 16;

fn as_real(whole: i64) -> Option<f64> {
    (-LARGEST_EXACT..=LARGEST_EXACT).contains(&whole).then_some(whole as f64)
}

impl Column {
    fn new(name: &str, declared: ColumnType) -> Column {
        let values = match declared {
            ColumnType::Integer => Values::Integers(Vec::new()),
            ColumnType::Real => Values::Reals(Vec::new()),
            ColumnType::Text => Values::Cells(Vec::new()),
            ColumnType::Several | ColumnType::Undeclared => Values::Nulls,
        };
        Column { name: name.to_owned(), declared, values, nulls: Vec::new() }
    }

    fn push(&mut self, value: SqlValue<'_>) {
        let count = self.nulls.len();
        self.nulls.push(value == SqlValue::Null);
        self.values = match (std::mem::replace(&mut self.values, Values::Nulls), value) {
            (Values::Nulls, SqlValue::Null) => Values::Nulls,
            (Values::Nulls, SqlValue::Integer(whole)) => extended(vec![0; count], whole).into(),
            (Values::Nulls, SqlValue::Real(real)) => extended(vec![f64::NAN; count], real).into(),
            (Values::Integers(wholes), SqlValue::Integer(whole)) => extended(wholes, whole).into(),
            (Values::Integers(wholes), SqlValue::Null) => extended(wholes, 0).into(),
            (Values::Integers(wholes), SqlValue::Real(real)) => match self.reals_of(&wholes) {
                Some(reals) => extended(reals, real).into(),
                None => Values::Cells(extended(self.cells_of(wholes.into()), Cell::Real(real))),
            },
            (Values::Reals(reals), SqlValue::Real(real)) => extended(reals, real).into(),
            (Values::Reals(reals), SqlValue::Null) => extended(reals, f64::NAN).into(),
            (Values::Reals(reals), SqlValue::Integer(whole)) => match as_real(whole) {
                Some(real) => extended(reals, real).into(),
                None => Values::Cells(extended(self.cells_of(reals.into()), Cell::Integer(whole))),
            },
            (values, value) => Values::Cells(extended(self.cells_of(values), value.into())),
        };
    }

    /// The integers as floats, with NaN for NULL; `None` if one of them is not exact.
    fn reals_of(&self, wholes: &[i64]) -> Option<Vec<f64>> {
        let pairs = wholes.iter().zip(&self.nulls);
        pairs.map(|(whole, null)| if *null { Some(f64::NAN) } else { as_real(*whole) }).collect()
    }

    fn cells_of(&self, values: Values) -> Vec<Cell> {
        let or_null = |(cell, null): (Cell, &bool)| if *null { Cell::Null } else { cell };
        match values {
            Values::Nulls => self.nulls[1..].iter().map(|_| Cell::Null).collect(),
            Values::Integers(wholes) => {
                wholes.into_iter().map(Cell::Integer).zip(&self.nulls).map(or_null).collect()
            }
            Values::Reals(reals) => {
                reals.into_iter().map(Cell::Real).zip(&self.nulls).map(or_null).collect()
            }
            Values::Cells(cells) => cells,
        }
    }

    /// The kind of the values, for the data frame.
    fn kind(&self) -> &'static str {
        let all = |fits: fn(&Cell) -> bool, cells: &[Cell]| {
            cells.iter().all(|cell| matches!(cell, Cell::Null) || fits(cell))
        };
        match &self.values {
            Values::Nulls if self.declared == ColumnType::Several => "text",
            Values::Nulls => "null",
            Values::Integers(_) => "integer",
            Values::Reals(_) => "real",
            Values::Cells(cells) if all(|cell| matches!(cell, Cell::Text(_)), cells) => "text",
            Values::Cells(cells) if all(|cell| matches!(cell, Cell::Blob(_)), cells) => "bytes",
            Values::Cells(_) => "mixed",
        }
    }

    fn of_python(self, py: Python<'_>) -> PyResult<PyColumn<'_>> {
        let kind = self.kind();
        let nulls = self.nulls.contains(&true).then(|| PyArray1::from_slice(py, &self.nulls));
        let values = match self.values {
            Values::Nulls => PyList::new(py, self.nulls.iter().map(|_| py.None()))?.into_any(),
            Values::Integers(wholes) => PyArray1::from_vec(py, wholes).into_any(),
            Values::Reals(reals) => PyArray1::from_vec(py, reals).into_any(),
            Values::Cells(cells) => {
                let list = PyList::empty(py);
                for (row, cell) in cells.into_iter().enumerate() {
                    if row % CONVERTED == 0 {
                        py.check_signals()?;
                    }
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
        };
        Ok((self.name, kind, values, nulls))
    }
}

impl From<Vec<i64>> for Values {
    fn from(wholes: Vec<i64>) -> Self {
        Values::Integers(wholes)
    }
}

impl From<Vec<f64>> for Values {
    fn from(reals: Vec<f64>) -> Self {
        Values::Reals(reals)
    }
}

/// The values and one more.
fn extended<T>(mut values: Vec<T>, last: T) -> Vec<T> {
    values.push(last);
    values
}

fn answer(reader: &Reader, sql: &str, values: &[(Option<String>, Cell)]) -> PyResult<Vec<Column>> {
    let values: Vec<(Option<&str>, SqlValue<'_>)> =
        values.iter().map(|(name, value)| (name.as_deref(), value.as_sql())).collect();
    // A frame would need other names than the query gives.
    if let Some(name) = reader.repeated_name(sql, &values).map_err(query_error)? {
        return Err(PyValueError::new_err(format!(
            "several columns are called `{name}`; name each of them, as in `a.{name} AS {name}_of_a`"
        )));
    }
    let mut columns: Vec<Column> = Vec::new();
    reader
        .query_with(sql, &values, |part| {
            match part {
                Answer::Columns(names) => {
                    let written = reader.written_out(sql, &values);
                    let types = reader.column_types(&written, names.len());
                    let pairs = names.iter().zip(types);
                    columns = pairs.map(|(name, kind)| Column::new(name, kind)).collect();
                }
                Answer::Row(values) => {
                    let pairs = columns.iter_mut().zip(values);
                    pairs.for_each(|(column, value)| column.push(*value));
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
