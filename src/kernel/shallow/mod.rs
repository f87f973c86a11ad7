//! Networks with one hidden layer of rectified linear units and four outputs, without storing the
//! hidden units.
//!
//! The results are those of [`crate::kernel::Product`], the activation and [`crate::kernel::dot`]
//! one after the other, to the bit.

mod backward;
mod forward;
mod network;
#[cfg(test)]
mod tests;

pub use network::{MOST_INPUTS, OUTPUTS, Shallow, ShallowGradient};
