//! The command line, one file per verb. Reads arguments, calls the library and prints results.
//!
//! Standard output carries data; standard error carries progress and messages. Exit codes: 0 done, 1
//! some jobs failed or results differ, 2 wrong usage or manifest, 3 store or system error, 130
//! interrupted.

mod after_study;
mod answer;
mod cancel;
mod changes;
mod check;
mod completions;
mod confirm;
mod counting;
mod counts;
mod decide;
mod doctor;
mod error;
mod export;
mod export_data;
mod fit;
mod folder;
mod forget;
pub mod input;
mod log;
mod manual;
mod merge;
mod on_end;
mod optimum;
mod output;
#[cfg(feature = "parquet")]
mod parquet;
mod plan;
mod progress;
mod query;
mod races;
mod reader;
mod replacing;
mod replay;
mod report;
mod run;
mod schema;
#[cfg(feature = "screen")]
mod screen;
mod self_test;
mod setting;
mod signals;
mod simulate;
mod status;
mod steps;
mod store_argument;
mod submissions;
mod submit;
mod summary;
mod task;
mod trial;
mod verb;
mod watch;
mod workers;
mod world;

pub(crate) use error::{Error, Exit};
use store_argument::StoreArgument;
pub use verb::main;
