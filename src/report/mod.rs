//! From summaries to what a reader sees: pure functions, no database, no file.

mod arm_tables;
mod captions;
mod data_table;
mod document;
mod escape;
mod figure;
mod latex;
mod page;
mod scene;
mod section;
mod table;
mod tables;
mod words;

pub use document::{ReportFile, report};
pub use escape::defused;
pub use section::ReportedExperiment;
pub use table::{Line, summary_table};
