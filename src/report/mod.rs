//! From summaries to what a reader sees: pure functions, no database, no file.

mod table;

pub use table::{Line, summary_table};
