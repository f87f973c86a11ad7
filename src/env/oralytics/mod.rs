//! The family `oralytics`: people who brush their teeth twice a day, and prompts to do so.
//!
//! The test beds V2 and V3 of Trella et al., "Oralytics Reinforcement Learning Algorithm", arXiv 2406.13127, and V4 of
//! Trella et al., "A Deployed Online Reinforcement Learning Algorithm In An Oral Health Clinical Trial", arXiv
//! 2409.02069. `docs/oralytics.md` states the model. The parameters of people come from a file that the manifest
//! names.

mod brushing;
mod constraints;
mod family;
mod feature;
mod parameters;
mod people;
mod person;
mod table;

pub use brushing::Brushing;
pub use family::{FAMILY, OralyticsModel};
pub use parameters::{CostScale, EffectSize, Oralytics, Rounding, TestBed};
pub use table::PEOPLE;
