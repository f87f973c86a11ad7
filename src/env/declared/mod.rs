//! The family `declared`: a world that a model file declares.
//!
//! In: the text of a model, files of people and rows, values of the model's parameters. Out: a simulation of any number of
//! people. `docs/models.md` describes the files. A text is read (`grammar` for its expressions, `read` for its
//! tables), its names are resolved, and its formulas are compiled once into a `program` that computes all lanes at a
//! time. A `pilot` runs the same program on recorded decisions, so that a fit computes what a simulation computes.

mod columns;
mod constraints;
mod description;
mod distribution;
mod draft;
mod expression;
mod family;
mod grammar;
mod missing;
mod model;
mod numbers;
mod pilot;
mod program;
mod read;
mod resolve;
mod rolled;
mod rows;
#[cfg(test)]
mod tests;
mod world;

pub use family::{DeclaredModel, FAMILY};
pub use model::ModelFile;
pub(in crate::env) use pilot::{
    Calendar, ColumnFormula, Header, RecordedRows, SKIPPED, WrittenColumn, header, reader, rows,
};
pub use pilot::{
    DataFaults, DrawCounts, DrawPredictor, EffectSource, FitCoefficient, FitLaw, FitMethod,
    FittedDraw, ImputedColumn, LongRun, Pilot, PilotError, PilotPerson, PilotWorld,
    SimulatedDecisions,
};
pub use rolled::Rolled;
pub use world::World;
