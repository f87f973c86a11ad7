//! Texts that authors write: their TOML tree, what is wrong with them, and how it is shown.
//!
//! In: the text of a manifest or of a model. Out: tables with positions, and faults, each with its line and a hint. The
//! module does not know what a key means.

mod document;
mod fault;
mod printable;
mod source;

pub(crate) use document::{Document, document};
pub use fault::{Fault, FaultList, Faults, nearest, nearest_value};
pub(crate) use fault::{near, shortened};
pub use printable::{DIRECTION, hidden, printable, quoted};
pub use source::Position;
pub(crate) use source::{Located, Source, Span};
