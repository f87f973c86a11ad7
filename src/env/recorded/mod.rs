//! The family `recorded`: a trial that happened, whose decisions a file has.
//!
//! In: a CSV file, and expressions of its columns, the table `[data]` of a manifest. Out: a lane per person, in which
//! every step takes the recorded action and pays the recorded outcome, whatever an agent chooses. `docs/recorded.md`
//! describes the table. The file is read as that of a fit (`declared::pilot`).

mod constraints;
mod description;
mod drawn;
mod family;
mod log;
mod numbered;
mod parameters;
mod randomisation;
mod reading;
mod table;
#[cfg(test)]
mod tests;
mod world;

pub use description::LogDescription;
pub use drawn::{DrawnGroup, Grouping, Randomisation};
pub use family::{FAMILY, RecordedModel};
pub use log::{LogPerson, REACHED, RECORDED_PROBABILITY, RecordedLog};
pub use parameters::{DATA, LIST, LogParameters};
pub use table::{MayLack, NumberTable, records};
pub use world::RecordedWorld;
