//! Products of matrices.

use pulp::{Simd, WithSimd};

use crate::kernel::{Isa, LANES};

/// result\[i, j\] += Σ_p left\[i, p\] right\[p, j\].
///
/// Each element is one chain of fused multiply-adds over p, in order, whatever the instruction set
/// and however rows are grouped.
#[derive(Clone, Copy, Debug)]
pub struct Product<'a> {
    /// Element \[i, p\] stands at `i * left_row_step + p * left_term_step`.
    pub left: &'a [f32],
    /// See `left`.
    pub left_row_step: usize,
    /// See `left`.
    pub left_term_step: usize,
    /// \[terms, width\], row by row.
    pub right: &'a [f32],
    /// Length of the sums.
    pub terms: usize,
    /// Rows of the result.
    pub rows: usize,
    /// Columns of the result and of `right`; a multiple of [`LANES`].
    pub width: usize,
}

impl Product<'_> {
    /// Adds it to `result`, \[rows, width\], row by row.
    pub fn add_to(self, isa: Isa, result: &mut [f32]) {
        assert_eq!(self.width % LANES, 0, "rows are padded");
        assert!(self.right.len() >= self.terms * self.width, "a row of `right` for every term");
        assert!(result.len() >= self.rows * self.width, "room for every row");
        isa.run(Operation { product: self, result });
    }
}

/// Most terms that are added at a time; the chains go on from the stored sums.
const TERMS: usize = 128;

struct Operation<'a, 'b> {
    product: Product<'a>,
    result: &'b mut [f32],
}

impl WithSimd for Operation<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Operation { product, result } = self;
        for first in (0..product.terms).step_by(TERMS) {
            let part = Product {
                left: &product.left[first * product.left_term_step..],
                right: &product.right[first * product.width..],
                terms: TERMS.min(product.terms - first),
                ..product
            };
            let mut row = 0;
            while row + 6 <= part.rows {
                part.strip::<S, 6>(simd, row, result);
                row += 6;
            }
            while row + 4 <= part.rows {
                part.strip::<S, 4>(simd, row, result);
                row += 4;
            }
            while row < part.rows {
                part.strip::<S, 1>(simd, row, result);
                row += 1;
            }
        }
    }
}

// Nothing here is a closure or goes through a reference to a register: the compiler would put the
// sums into memory.
impl Product<'_> {
    /// I rows of the result, at most [`TERMS`] terms.
    #[inline(always)]
    #[allow(clippy::needless_range_loop)]
    fn strip<S: Simd, const I: usize>(&self, simd: S, row: usize, result: &mut [f32]) {
        // The rows' factors side by side, so that tiles walk along them without a check for each.
        let mut factors = [[0.0; I]; TERMS];
        let left = &self.left[row * self.left_row_step..];
        for (p, factors) in factors[..self.terms].iter_mut().enumerate() {
            for i in 0..I {
                factors[i] = left[i * self.left_row_step + p * self.left_term_step];
            }
        }
        let factors = &factors[..self.terms];
        let mut column = 0;
        // Eight registers of one row hide the latency of their chains.
        while I == 1 && column + 8 * S::F32_LANES <= self.width {
            self.tile::<S, I, 8>(simd, factors, row, column, result);
            column += 8 * S::F32_LANES;
        }
        // As many registers as leave room for the operands: 24 of 32, or 12 of 16.
        if S::F32_LANES != 8 {
            while column + 4 * S::F32_LANES <= self.width {
                self.tile::<S, I, 4>(simd, factors, row, column, result);
                column += 4 * S::F32_LANES;
            }
        }
        while column + 2 * S::F32_LANES <= self.width {
            self.tile::<S, I, 2>(simd, factors, row, column, result);
            column += 2 * S::F32_LANES;
        }
        while column + S::F32_LANES <= self.width {
            self.tile::<S, I, 1>(simd, factors, row, column, result);
            column += S::F32_LANES;
        }
    }

    /// I rows of V registers, held in registers over all the terms.
    #[inline(always)]
    #[allow(clippy::needless_range_loop, clippy::manual_memcpy)]
    fn tile<S: Simd, const I: usize, const V: usize>(
        &self,
        simd: S,
        factors: &[[f32; I]],
        row: usize,
        column: usize,
        result: &mut [f32],
    ) {
        let span = V * S::F32_LANES;
        let mut sums = [[simd.splat_f32s(0.0); V]; I];
        for i in 0..I {
            let at = (row + i) * self.width + column;
            let (stored, _) = S::as_simd_f32s(&result[at..at + span]);
            for v in 0..V {
                sums[i][v] = stored[v];
            }
        }
        let rights = self.right[column..].chunks(self.width);
        for (factors, right) in factors.iter().zip(rights) {
            let (right, _) = S::as_simd_f32s(&right[..span]);
            for i in 0..I {
                let factor = simd.splat_f32s(factors[i]);
                for v in 0..V {
                    sums[i][v] = simd.mul_add_f32s(factor, right[v], sums[i][v]);
                }
            }
        }
        for i in 0..I {
            let at = (row + i) * self.width + column;
            let (out, _) = S::as_mut_simd_f32s(&mut result[at..at + span]);
            for v in 0..V {
                out[v] = sums[i][v];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::test_numbers::{bits, numbers};

    #[test]
    fn every_element_is_a_chain_of_fused_multiply_adds_on_every_instruction_set() {
        // Miri takes a minute for what a processor does in one thousandth of a second.
        let (long, large, parts) = if cfg!(miri) {
            ((3, 40, 16), (9, 5, 48), (1, TERMS + 1, 16))
        } else {
            ((13, 40, 48), (64, 17, 144), (7, 2 * TERMS + 3, 16))
        };
        for (rows, terms, width) in [(1, 3, 128), (5, 1, 16), long, large, parts] {
            for transposed in [false, true] {
                let (left_row_step, left_term_step) =
                    if transposed { (1, rows + 2) } else { (terms + 2, 1) };
                let left = numbers((rows + 2) * (terms + 2), 1);
                let right = numbers(terms * width, 2);
                let start = numbers(rows * width, 3);
                let mut plain = start.clone();
                for i in 0..rows {
                    for j in 0..width {
                        for p in 0..terms {
                            let factor = left[i * left_row_step + p * left_term_step];
                            plain[i * width + j] =
                                factor.mul_add(right[p * width + j], plain[i * width + j]);
                        }
                    }
                }
                for isa in Isa::available() {
                    let mut ours = start.clone();
                    let (left, right) = (&left[..], &right[..]);
                    Product { left, left_row_step, left_term_step, right, terms, rows, width }
                        .add_to(isa, &mut ours);
                    assert_eq!(bits(&ours), bits(&plain), "{} {rows} {terms} {width}", isa.name());
                }
            }
        }
    }
}
