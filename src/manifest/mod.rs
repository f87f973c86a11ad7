//! What an experimenter declares: the manifest, from its TOML text to a validated value.
//!
//! In: a file. Out: a [`Manifest`], complete and consistent, or every [`Fault`] of the file at once,
//! each at its line and column. On the way a text becomes a tree, the tree a draft (what this file
//! says), the draft is laid over the preset that it extends, gets the defaults, and is held against
//! the rules that keys have between them.
//!
//! Keys are declared where they are used ([`crate::key`]): the environment's, those of each
//! algorithm, and here those of [`Evaluation`]. Reading, checking, schema and reference follow from
//! the declarations.
//!
//! It does not know what a job is, what has run, or how anything is simulated or trained.

mod analyses;
mod analysis;
mod analysis_kind;
mod cells;
mod check;
mod complete;
mod condition;
mod declared;
mod draft;
mod evaluation;
mod fault;
mod grid;
mod limits;
mod load;
mod noise;
mod parameter;
mod presence;
mod preset;
mod published;
mod range;
mod read;
mod resolved;
mod schema;
mod section;
mod sides;
mod source;
mod sweep;
mod varying;
mod written;

pub use analysis::Analysis;
pub use analysis_kind::{
    ANALYSED_METRICS, AnalysisKind, Contrast, CurveAxis, DataPart, ERROR_AXIS, Pairing,
    SelectionRule,
};
pub use condition::{Condition, Described, Setting, short_name};
pub use declared::{DeclaredAgent, Exclusion, Manifest, Zip};
pub use evaluation::{Evaluation, RecordedDecisions, TestActions};
pub(crate) use fault::FaultList;
pub use fault::{Fault, Faults, nearest};
pub use grid::{Cell, Grid};
pub use limits::MOST_JOBS;
pub(crate) use load::{Document, document};
pub use load::{load, parse};
pub use parameter::{Parameters, parameter, parameters};
pub use published::{Published, PublishedCurve, PublishedErrors, PublishedHeatMap, PublishedTest};
pub use schema::schema;
pub use section::Section;
pub use sides::Sides;
pub use source::{Position, hidden, printable};
pub(crate) use source::{Source, Span};
pub use varying::Varying;
