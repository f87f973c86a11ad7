//! Estimates of causal effects from decisions.
//!
//! In: a declaration and the decisions of a run, one at a time. Out: a job's [`Estimates`](crate::job::Estimates).
//! Of least squares only sums of each person are kept, so that decisions need not be stored. The sums of a person do not
//! depend on when other persons decide: decisions that are read from a store give the same bits as decisions that are being
//! made. Other estimators read all decisions together once the last is made.
//!
//! The module knows no simulation, no store and no policy. Student's t distribution, which analyses also use, is
//! here.

mod effect;
mod emee;
mod estimation;
mod layout;
mod root;
mod student;
mod symmetric;
#[cfg(test)]
mod tests;
mod together;
#[cfg(test)]
mod together_tests;
mod value;
mod wcls;

pub(crate) use effect::with_standard_error;
pub(crate) use emee::Rows;
pub use estimation::Estimation;
pub use layout::{Feature, Layout};
pub(crate) use root::root;
pub(crate) use student::{chi_squared_of_p, t_of_p, two_sided_p};
pub use wcls::Correction;
pub(crate) use wcls::Sums;
