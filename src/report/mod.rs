//! From summaries to what a reader sees: pure functions, no database, no file.

mod arm_tables;
mod assemble;
pub mod data_table;
mod document;
pub mod escape;
mod figure;
mod kinds;
mod latex;
mod optima;
mod page;
mod reproduction;
pub mod scene;
mod table;
mod tables;
mod words;

pub use assemble::{Work, assemble};
pub use document::{ReportFile, ReportedExperiment, report};
pub use table::{Line, summary_table};
