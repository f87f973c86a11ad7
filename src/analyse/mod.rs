//! From records to summaries: pure functions, no database, no output.
//!
//! The unit of analysis is the trained policy (a seed), never the test episode.

mod summary;

pub use summary::{Arm, ArmSummary, Fate, Means, mean_and_sd, summarise};
