//! Arithmetic on many numbers at once, with the same bits on every processor.
//!
//! In: slices of numbers and an [`Isa`], the instruction set to use. Out: slices of numbers. It
//! knows no network, no episode and no job.
//!
//! Every number is computed by an order of operations that is written down and does not depend on
//! how many lanes a register has: products are chains of fused multiply-adds over their terms, one
//! chain for each element of the result; sums across lanes go over sixteen virtual lanes and then
//! by halves ([`dot()`]); logarithms and exponentials are polynomials of our own ([`math`]). What
//! needs registers held by hand is written with `pulp`, whose operations are safe and chosen at run
//! time; what works element by element is plain Rust, compiled once for each instruction set. What is relied
//! on is that a fused multiply-add, a division and a square root round correctly, which a test holds
//! for the first: the portable path takes it from the platform's C library.

mod activation;
mod adam;
mod aligned;
mod dot;
mod isa;
pub mod math;
mod product;
mod shallow;
mod transpose;

pub use activation::Activation;
pub use adam::Adam;
pub use aligned::{Aligned, LINE};
pub use dot::{LANES, dot};
pub use isa::{Isa, IsaError};
pub use product::{Product, Start};
pub use shallow::{MOST_INPUTS, OUTPUTS, Shallow, ShallowGradient};
pub use transpose::transpose;

#[cfg(test)]
mod test_numbers {
    /// Numbers without a pattern, in [-1, 1]; others for every seed below 100.
    pub(super) fn numbers(len: usize, seed: u32) -> Vec<f32> {
        let at = seed * 41_000_000;
        let value = |i: u32| (i.wrapping_add(at).wrapping_mul(2_654_435_761) >> 8) as f32;
        (0..len as u32).map(|i| value(i) / 8_388_608.0 - 1.0).collect()
    }

    pub(super) fn bits(values: &[f32]) -> Vec<u32> {
        values.iter().map(|value| value.to_bits()).collect()
    }
}
