//! Networks with one hidden layer of rectified linear units and four outputs, computed without storing the
//! hidden units.
//!
//! The results are bit-identical to [`crate::kernel::Product`], the activation and
//! [`crate::kernel::dot`] in sequence.

mod backward;
mod forward;
mod network;
#[cfg(test)]
mod tests;

pub use network::{MOST_INPUTS, OUTPUTS, Shallow, ShallowGradient};
