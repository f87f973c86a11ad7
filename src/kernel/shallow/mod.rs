//! Networks with one hidden layer of rectified linear units and four outputs, computed without storing the
//! hidden units.
//!
//! The results have the same bits as [`crate::kernel::Product`], the activation and [`crate::kernel::dot`] in
//! sequence.

mod backward;
mod forward;
mod network;
#[cfg(test)]
mod tests;

pub use network::{MOST_INPUTS, OUTPUTS, Shallow, ShallowGradient};
