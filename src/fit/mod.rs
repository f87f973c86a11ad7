//! A fit: the coefficients of a model's people, estimated from recorded decisions.
//!
//! In: a [`Pilot`](crate::env::declared::Pilot), the decisions in the terms of a model. Out: coefficients of everybody with
//! standard errors, what the data do not say, and files that a manifest names. The module opens no file.

mod check;
mod draws;
mod estimate;
mod fitted;
mod likelihood;
mod newton;
mod output;
mod page;
mod prior;
mod solve;

pub use check::{Check, CheckedNumber, HeldOut};
pub use draws::{DrawnFrom, draws};
pub use estimate::{Fit, FitNote, Fitting, GroupFit};
pub use fitted::{FitRequest, Fitted, NoFit, NoPilot, read};
pub use output::files;
pub use page::Standing;
