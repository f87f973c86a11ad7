//! The manifest, in which an experimenter declares an experiment: from TOML text to a validated value.
//!
//! In: a file. Out: a [`Manifest`], complete and consistent, or every [`Fault`] of the file at once, each
//! with its line and column. The text becomes a TOML tree, and the tree a draft: the content of this one
//! file. The draft is laid over the preset that it extends, completed with defaults, and checked against
//! the rules between keys.
//!
//! Keys are declared where they are used ([`crate::key`]): keys of the environment and of each algorithm in
//! their modules, keys of the evaluation with jobs. Reading, checking, schema and reference follow from the
//! declarations.
//!
//! It contains no jobs and their status, no simulation and no training.

mod analysed_jobs;
mod analyses;
mod analysis;
mod analysis_field;
mod analysis_kind;
mod axis;
mod cells;
mod check;
mod companions;
mod complete;
mod declared;
mod document;
mod draft;
mod draw;
mod edits;
mod estimate;
mod estimates;
mod fault;
mod figure_keys;
mod free;
mod grid;
mod hints;
mod limits;
mod load;
mod parameter;
mod participant_range;
mod people;
mod points;
mod presence;
mod preset;
mod published;
mod range;
mod read;
mod repair;
mod resolved;
mod respelt;
mod schema;
mod search;
mod searches;
mod section;
mod set;
mod sides;
mod source;
mod stage;
mod sweep;
mod value_schema;
mod varying;
mod written;

pub use analysis::Analysis;
pub use analysis_kind::{
    ActionChoice, AnalysisKind, Bins, Contrast, Curve, DidItLearn, EstimateNames, FamilyName, Find,
    HeatMap, InferenceError, LearningCurve, OperatingCharacteristics, Pairing, Recovery, Selection,
    SelectionRule,
};
pub use axis::{CurveAxis, ERROR_AXIS};
pub use companions::{companions, self_contained};
pub use declared::{DeclaredAgent, Exclusion, Manifest, Zip, same_name};
pub(crate) use document::{Document, document};
pub use draw::Draw;
pub use estimate::DeclaredEstimate;
pub(crate) use fault::FaultList;
pub use fault::{Fault, Faults, nearest, nearest_value};
pub use figure_keys::{FigureKeys, PanelKey, Theme, XScale};
pub use grid::{Cell, Grid};
pub use hints::hints;
pub use limits::MOST_JOBS;
pub use load::{load, parse};
pub use parameter::{Parameters, free_parameters, parameter, parameters};
pub use published::{Published, PublishedRow};
pub use schema::schema;
pub use search::{Leaving, Search};
pub use section::Section;
pub use set::{Overridden, Override, OverrideForm, load_with, parse_with};
pub use sides::Sides;
pub use source::Position;
pub(crate) use source::{Source, Span};
pub use stage::Stage;
pub(crate) use sweep::{Node, single, unexpected, written_value};
pub use sweep::{PolicyOf, Runs};
pub(crate) use value_schema::value as value_schema;
pub use varying::Varying;
