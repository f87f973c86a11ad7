//! The command line: one file a verb. Reads arguments, calls the library, prints.
//!
//! Standard output is data; standard error is progress and messages. Exit codes: 0 done, 1 some
//! jobs failed, or results differ, 2 bad usage or manifest, 3 store or system error, 130 interrupted.

mod answer;
mod cancel;
mod check;
mod counting;
mod counts;
mod doctor;
mod error;
mod export;
mod folder;
pub mod input;
mod merge;
mod optimum;
mod output;
#[cfg(feature = "parquet")]
mod parquet;
mod plan;
mod progress;
mod query;
mod replay;
mod report;
mod run;
mod schema;
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
mod verb;
mod workers;

pub(crate) use error::{Error, Exit};
use store_argument::StoreArgument;
pub use verb::main;
