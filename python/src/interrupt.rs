//! Long calls that Ctrl-C ends, as it ends Python code.

use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::Duration;

use numpy::{PyArray1, PyArrayMethods};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;

/// Interval at which a long call looks for signals.
const LOOK: Duration = Duration::from_millis(50);

/// Runs `work` without the interpreter's lock. The main thread, the only one that handles Python's signals,
/// does so meanwhile and leaves `work` to another thread. Where a handler raises an exception, as the handler
/// of Ctrl-C raises `KeyboardInterrupt`, calls `stop` until `work` ends, and returns the exception.
pub(crate) fn interruptible<T: Send>(
    py: Python<'_>,
    stop: impl Fn() + Send,
    work: impl FnOnce() -> T + Send,
) -> PyResult<T> {
    if !is_main_thread(py)? {
        return Ok(py.detach(work));
    }
    py.detach(move || {
        thread::scope(|scope| {
            // Closed when the work ends, even by a panic.
            let (running, ended) = mpsc::channel::<()>();
            let worker = thread::Builder::new().spawn_scoped(scope, move || {
                let _running = running;
                work()
            })?;
            let mut raised = None;
            while let Err(RecvTimeoutError::Timeout) = ended.recv_timeout(LOOK) {
                raised = raised.or_else(|| Python::attach(|py| py.check_signals()).err());
                if raised.is_some() {
                    stop();
                }
            }
            let result = worker.join().map_err(|_| {
                PyRuntimeError::new_err("jitai failed internally; standard error has the reason")
            });
            raised.map_or(result, Err)
        })
    })
}

fn is_main_thread(py: Python<'_>) -> PyResult<bool> {
    let threading = py.import("threading")?;
    let main = threading.call_method0("main_thread")?.getattr("ident")?;
    threading.call_method0("get_ident")?.eq(main)
}

/// Looks up what the crate `numpy` needs of NumPy. It panics where a look-up fails, and a look-up runs Python
/// code, which Ctrl-C can end; hence all of them happen when the module is imported.
pub(crate) fn load_numpy(py: Python<'_>) -> PyResult<()> {
    py.import("numpy.lib")?;
    py.check_signals()?;
    drop(PyArray1::<f32>::from_slice(py, &[0.0]).readonly());
    Ok(())
}
