//! From summaries to what a reader sees: pure functions, no database, no file.

mod arm_tables;
mod assemble;
mod data_table;
mod document;
mod escape;
mod figure;
mod kinds;
mod latex;
mod optima;
mod page;
mod reproduction;
mod scene;
mod section;
mod table;
mod tables;
mod words;

pub use assemble::{AssembleError, Work, assemble};
pub use document::{ReportFile, report};
pub use escape::defused;
pub use section::ReportedExperiment;
pub use table::{Line, summary_table};
