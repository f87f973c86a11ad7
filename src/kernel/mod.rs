//! Vectorised arithmetic with bit-identical results on every processor.
//!
//! In: slices of numbers and an [`Isa`], the instruction set to use. Out: slices of numbers. The
//! module does not depend on networks, episodes or jobs.
//!
//! Every result has a documented order of operations that does not depend on the width of registers. Each
//! element of a product is one chain of fused multiply-adds over its terms. Sums across lanes use sixteen
//! virtual lanes, which are then added by halves ([`dot()`]). Logarithms and exponentials are our own
//! polynomials ([`math`]).
//!
//! Code that must keep values in registers is written with `pulp`, whose operations are safe and selected at
//! run time. Element-wise code is plain Rust, compiled once for each instruction set. Both rely on correct
//! rounding of fused multiply-adds, divisions and square roots. A test checks fused multiply-adds, which the
//! portable path takes from the platform's C library.

mod activation;
mod adam;
mod aligned;
mod dot;
mod gru;
mod isa;
pub mod math;
mod norm;
mod product;
mod shallow;
mod transpose;

pub use activation::Activation;
pub use adam::Adam;
pub use aligned::{Aligned, LINE};
pub use dot::{LANES, dot};
pub use gru::{GATES, GruGradient, GruStep};
pub use isa::{Isa, IsaError};
pub use norm::clip_norm;
pub use product::{Product, SumStart};
pub use shallow::{MOST_INPUTS, OUTPUTS, Shallow, ShallowGradient};
pub use transpose::transpose;

#[cfg(test)]
mod test_numbers {
    /// Numbers without a pattern, in [-1, 1], different for every seed below 100.
    pub(super) fn numbers(len: usize, seed: u32) -> Vec<f32> {
        let at = seed * 41_000_000;
        let value = |i: u32| (i.wrapping_add(at).wrapping_mul(2_654_435_761) >> 8) as f32;
        (0..len as u32).map(|i| value(i) / 8_388_608.0 - 1.0).collect()
    }

    pub(super) fn bits(values: &[f32]) -> Vec<u32> {
        values.iter().map(|value| value.to_bits()).collect()
    }
}
