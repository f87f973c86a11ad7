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

mod analysis;
mod cells;
mod check;
mod commas;
mod companions;
mod complete;
mod data;
mod declared;
mod draft;
mod estimate;
mod grid;
mod hints;
mod limits;
mod load;
mod parameter;
mod presence;
mod preset;
mod read;
mod resolved;
mod schema;
mod search;
mod section;
mod set;
mod table;
mod text;
mod value;
mod varying;

pub use analysis::axis::{CurveAxis, ERROR_AXIS};
pub use analysis::declared::Analysis;
pub use analysis::figure_keys::{FigureKeys, PanelKey, Theme, XScale};
pub use analysis::forms::Find;
pub use analysis::kind::{self, AnalysisKind};
pub use analysis::published::{Published, PublishedEstimate, PublishedRow};
pub use analysis::sides::Sides;
pub use companions::{companions, kept_text, self_contained};
pub use declared::{DeclaredAgent, Exclusion, Manifest, Zip, same_name};
pub use estimate::declared::DeclaredEstimate;
pub use grid::{Cell, Grid};
pub use hints::hints;
pub use limits::MOST_JOBS;
pub use load::{load, parse};
pub use parameter::{Parameters, free_parameters, parameter, parameters};
pub use schema::schema;
pub use search::declared::Search;
pub use search::draw::Draw;
pub use search::keys::{Fresh, Leaving};
pub use search::stage::Stage;
pub use section::{Section, SharedSections};
pub use set::{Overridden, Override, OverrideForm, load_with, parse_with};
pub(crate) use value::schema::value as value_schema;
pub(crate) use value::sweep::{Node, single, unexpected, written_value};
pub use value::sweep::{PolicyOf, Runs};
pub use varying::Varying;

pub use crate::text::{Fault, Faults, Position, nearest, nearest_value};
