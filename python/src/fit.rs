//! Fits: the people of a model, estimated from the decisions of a pilot.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Sender;

use jitai::fits::{DrawnFrom, FitRequest, Fitted, NoFit, NoPilot, Standing, plain_figures, read};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;

use crate::declaration::refused;
use crate::experiment::faulty;
use crate::interrupt::attended;

/// A pilot with its fit.
#[pyclass(frozen)]
pub(crate) struct FittedPilot {
    fitted: Fitted,
    model: String,
}

#[pymethods]
impl FittedPilot {
    /// What was read, and what the data do not say.
    #[getter]
    fn notes(&self) -> Vec<String> {
        self.fitted.notes()
    }

    /// Why the model may not be called fitted; nothing if it may.
    #[getter]
    fn why_not(&self) -> Vec<String> {
        match self.fitted.standing() {
            Standing::Fitted => Vec::new(),
            Standing::NotFitted(why) => why,
        }
    }

    /// The parameters of the model that are estimated.
    #[getter]
    fn parameters(&self) -> Vec<(String, f64)> {
        self.fitted.fit.parameters.clone()
    }

    /// The section of a manifest, with files in a folder, which ends with a separator.
    fn environment(&self, folder: &str) -> String {
        self.fitted.environment(&self.model, |name| format!("{folder}{name}"))
    }

    /// The name and the bytes of every file, with this section of a manifest on the page.
    fn files(&self, py: Python<'_>, environment: &str) -> Vec<(String, Vec<u8>)> {
        let files = py.detach(|| self.fitted.files(environment));
        files.into_iter().map(|file| (file.name, file.bytes)).collect()
    }

    /// Analysis, name, SVG and caption of every figure.
    fn figures(&self, py: Python<'_>) -> Vec<(String, String, String, String)> {
        let figures = py.detach(|| plain_figures(&self.fitted.page("")));
        let figure =
            |one: jitai::fits::ReportFigure| (one.analysis, one.name, one.svg, one.caption);
        figures.into_iter().map(figure).collect()
    }
}

/// Fits a model, with the name of its file and its text, to the decisions of a CSV text. `asked` is the number of simulated
/// pilots, that of draws, whether draws are a bootstrap, and the seed. `on_progress` is called on this
/// thread with what is done, how many, and of how many.
#[pyfunction]
pub(crate) fn fit(
    py: Python<'_>,
    model: (String, String),
    data: (String, Vec<u8>),
    asked: (u32, u32, bool, u64),
    on_progress: Option<Py<PyAny>>,
) -> PyResult<FittedPilot> {
    let (simulations, draws, bootstrap, seed) = asked;
    let from = if bootstrap { DrawnFrom::People } else { DrawnFrom::Estimates };
    let request = FitRequest { simulations, draws, from, seed };
    let stop = AtomicBool::new(false);
    type Done = (&'static str, usize, usize);
    let work = |events: Sender<Done>| {
        let stopped = || PyRuntimeError::new_err("stopped before the end of the fit");
        let pilot = read((&model.0, &model.1), (&data.0, data.1.as_slice()), &stop);
        let pilot = pilot.map_err(|why| match why {
            NoPilot::Stopped => stopped(),
            NoPilot::Model(faults) => faulty(vec![faults]),
            NoPilot::Data(says) => refused(says),
        })?;
        // A closed channel means that the call has ended.
        let mut progress = |what, done, of| _ = events.send((what, done, of));
        Fitted::new(pilot, request, &stop, &mut progress).map_err(|why| match why {
            NoFit::Stopped => stopped(),
            NoFit::Nobody(ref notes) => refused(format!("{why}; {}", notes.join("; "))),
            NoFit::Alike => refused(why),
        })
    };
    let heed = |py: Python<'_>, done: Done| match &on_progress {
        Some(on_progress) => on_progress.bind(py).call1(done).map(drop),
        None => Ok(()),
    };
    let fitted = attended(py, || stop.store(true, Ordering::Relaxed), work, heed)??;
    Ok(FittedPilot { fitted, model: model.0 })
}
