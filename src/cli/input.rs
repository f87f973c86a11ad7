//! What people type and hand over, read as the commands read it and answered with a value.
//!
//! In: the text of `--filter`, or the bytes of a file of trajectories. Out: what a command would go
//! on with, or its message. Nothing is printed and no file is opened, so that input of any kind can
//! be tried by the million.

use std::io;

use crate::cli::output::Format;
use crate::cli::replay;
use crate::cli::steps::StepRows;
use crate::manifest::Manifest;
use crate::plan::Filter;
use crate::schedule::Selection;

/// How many jobs of the manifests `--filter` lets through, those of equal content counted once.
///
/// **Errors**: the message of `plan` and `run`.
pub fn filtered(text: &str, manifests: &[Manifest]) -> Result<usize, String> {
    let filter: Filter = text.parse().map_err(|error| format!("{error}"))?;
    match Selection::new(manifests, Some(&filter)) {
        Ok(selection) => Ok(selection.queue().len()),
        Err(error) => Err(error.to_string()),
    }
}

/// How many recorded values differ when the trajectories are replayed.
///
/// **Errors**: the message of `simulate --replay`.
pub fn replayed(bytes: &[u8]) -> Result<usize, String> {
    let trajectories = replay::parse(bytes)?;
    let rows = StepRows::new(Format::Csv, io::sink());
    let answered = rows.and_then(|mut rows| trajectories.replay(&mut rows));
    let differences = answered.map_err(|error| error.to_string())??;
    Ok(differences.count)
}
