//! From summaries to what a reader sees: pure functions, no database, no file.

mod captions;
pub mod data_table;
pub mod escape;
pub mod figure;
pub mod scene;
mod table;
mod tables;
mod words;

pub use table::{Line, summary_table};
