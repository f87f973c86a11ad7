//! The parsers of user input as functions, for tests with generated input.
//!
//! In: the text of `--filter`, or the bytes of a file of trajectories. Out: a value, or the error
//! message of the command. The functions print nothing and open no file.

use std::io;

use crate::cli::output::Format;
use crate::cli::replay;
use crate::cli::steps::StepRows;
use crate::manifest::Manifest;
use crate::plan::Filter;
use crate::schedule::{Selection, Survey};

/// The number of distinct jobs of the manifests that match `--filter`.
///
/// **Errors**: the message of `plan` and `run`.
pub fn filtered(text: &str, manifests: &[Manifest]) -> Result<usize, String> {
    let filter: Filter = text.parse().map_err(|error| format!("{error}"))?;
    let selection = Selection::new(manifests, Some(&filter)).map_err(|error| error.to_string())?;
    let queue =
        Survey::of(&selection, None).queue(|_, _| true).map_err(|error| error.to_string())?;
    Ok(queue.len())
}

/// The number of recorded values that differ when the trajectories are replayed.
///
/// **Errors**: the message of `simulate --replay`.
pub fn replayed(bytes: &[u8]) -> Result<usize, String> {
    let trajectories = replay::parse(bytes)?;
    let rows = StepRows::new(Format::Csv, io::sink());
    let answered = rows.and_then(|mut rows| trajectories.replay(&mut rows));
    let differences = answered.map_err(|error| error.to_string())??;
    Ok(differences.count)
}
