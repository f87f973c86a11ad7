//! A pilot: recorded decisions in the terms of a model, ready to be fitted.
//!
//! In: the text of a model with `[fit]`, and a CSV file of decisions. Out: for every draw that the data have, its values
//! and what its parameters are linear in, computed by the model's own program; and simulated pilots of the people of a
//! fit. `docs/fit.md` describes the section. The module estimates nothing.

mod assembly;
mod calendar;
mod design;
mod file;
mod linear_form;
mod plan;
mod read;
mod section;
mod simulated;
mod sources;
mod terms;

// A recorded trial reads such files, too.
pub(in crate::env) use calendar::{Calendar, SKIPPED};
pub use file::DataFaults;
pub(in crate::env) use file::{ColumnFormula, Header, RecordedRows, header, reader, rows};
pub(in crate::env) use section::WrittenColumn;
pub use section::{EffectSource, FitMethod};
pub use simulated::{LongRun, PilotWorld, SimulatedDecisions};
pub use terms::{
    DrawCounts, DrawPredictor, FitCoefficient, FitLaw, FittedDraw, ImputedColumn, Pilot,
    PilotError, PilotPerson,
};
