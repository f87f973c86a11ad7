//! Estimates of causal effects from decisions.
//!
//! In: a declaration and the decisions of a run, one at a time. Out: a job's [`Estimates`](crate::job::Estimates).
//! Only sums of each person are kept, so that decisions need not be stored. The sums of a person do not depend on when
//! other persons decide: decisions that are read from a store give the same bits as decisions that are being made.
//!
//! The module knows no simulation, no store and no policy. Student's t distribution, which analyses also use, is
//! here.

mod estimation;
mod root;
mod student;
mod symmetric;
#[cfg(test)]
mod tests;
mod wcls;

pub(crate) use estimation::with_standard_error;
pub use estimation::{Estimation, Layout};
pub(crate) use root::root;
pub(crate) use student::{chi_squared_of_p, t_of_p, two_sided_p};
pub use wcls::Correction;
pub(crate) use wcls::Sums;
