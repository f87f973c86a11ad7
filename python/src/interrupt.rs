//! Long calls that Ctrl-C ends, as it ends Python code.

use std::convert::Infallible;
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::thread;
use std::time::{Duration, Instant};

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
    attended(py, stop, |_running: Sender<Infallible>| work(), |_, never| match never {})
}

/// [`interruptible`] on any thread, with messages that `work` sends until it ends: `heed` receives them on this
/// thread. Its exceptions stop `work`, too.
pub(crate) fn attended<T: Send, M: Send>(
    py: Python<'_>,
    stop: impl Fn() + Send,
    work: impl FnOnce(Sender<M>) -> T + Send,
    mut heed: impl FnMut(Python<'_>, M) -> PyResult<()> + Send,
) -> PyResult<T> {
    py.detach(move || {
        thread::scope(|scope| {
            // Closed when the work ends, even by a panic.
            let (running, inbox) = mpsc::channel::<M>();
            let worker = thread::Builder::new().spawn_scoped(scope, move || work(running))?;
            let mut raised = None;
            let mut looked = Instant::now();
            loop {
                let received = inbox.recv_timeout(LOOK);
                let heeded = match received {
                    Err(RecvTimeoutError::Disconnected) => break,
                    Err(RecvTimeoutError::Timeout) => Ok(()),
                    Ok(message) if raised.is_none() => Python::attach(|py| heed(py, message)),
                    Ok(_) => Ok(()),
                };
                raised = raised.or(heeded.err());
                if looked.elapsed() >= LOOK {
                    looked = Instant::now();
                    raised = raised.or_else(|| Python::attach(|py| py.check_signals()).err());
                }
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
