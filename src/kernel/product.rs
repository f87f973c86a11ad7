//! Products of matrices.

use pulp::{Simd, WithSimd};

use crate::kernel::{Isa, LANES};

/// result\[i, j\] = start\[i, j\] + Σ_p left\[i, p\] right\[p, j\].
///
/// Each element is one chain of fused multiply-adds over p, in order, on every instruction set and for every
/// grouping of rows.
#[derive(Clone, Copy, Debug)]
pub struct Product<'a> {
    /// The initial values of the sums.
    pub start: SumStart<'a>,
    /// Element \[i, p\] is at `i * left_stride + p`, or at `p * left_stride + i` if transposed.
    pub left: &'a [f32],
    /// See `left`.
    pub left_stride: usize,
    /// See `left`.
    pub left_transposed: bool,
    /// \[terms, width\], row-major.
    pub right: &'a [f32],
    /// The number of terms of each sum.
    pub terms: usize,
    /// The number of rows of the result.
    pub rows: usize,
    /// The number of columns of the result and of `right`; a multiple of [`LANES`].
    pub width: usize,
}

/// The initial values of the sums of a [`Product`].
#[derive(Clone, Copy, Debug)]
pub enum SumStart<'a> {
    /// The previous contents of the result.
    Stored,
    /// The same numbers in every row, \[width\].
    Row(&'a [f32]),
    /// Zero.
    Zero,
}

impl Product<'_> {
    /// Writes the product to `result`, \[rows, width\], row-major.
    pub fn write_to(self, isa: Isa, result: &mut [f32]) {
        assert_eq!(self.width % LANES, 0, "rows are padded");
        assert!(self.terms > 0, "at least one term");
        assert!(self.right.len() >= self.terms * self.width, "a row of `right` for every term");
        assert!(result.len() >= self.rows * self.width, "room for every row");
        let lines =
            if self.left_transposed { (self.terms, self.rows) } else { (self.rows, self.terms) };
        let left = lines.0.saturating_sub(1) * self.left_stride + lines.1;
        assert!(self.rows == 0 || self.left.len() >= left, "a factor for every row and term");
        assert!(!matches!(self.start, SumStart::Row(row) if row.len() < self.width), "a whole row");
        isa.run(Operation { product: self, result });
    }
}

/// The most terms that are added in one pass; later passes continue from the stored sums.
const TERMS: usize = 128;
/// The most rows of the result that are computed at a time.
const STRIP: usize = 6;

struct Operation<'a, 'b> {
    product: Product<'a>,
    result: &'b mut [f32],
}

impl WithSimd for Operation<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Operation { product, result } = self;
        let mut room = [0.0; STRIP * TERMS];
        for first in (0..product.terms).step_by(TERMS) {
            let left = if product.left_transposed { first * product.left_stride } else { first };
            let part = Product {
                start: if first == 0 { product.start } else { SumStart::Stored },
                left: &product.left[left..],
                right: &product.right[first * product.width..],
                terms: TERMS.min(product.terms - first),
                ..product
            };
            let mut row = 0;
            while row + STRIP <= part.rows {
                part.strip::<S, STRIP>(simd, row, &mut room, result);
                row += STRIP;
            }
            while row + 4 <= part.rows {
                part.strip::<S, 4>(simd, row, &mut room, result);
                row += 4;
            }
            while row < part.rows {
                part.strip::<S, 1>(simd, row, &mut room, result);
                row += 1;
            }
        }
    }
}

// There are no closures and no references to registers here: they would make the compiler spill the sums to
// the stack.
impl Product<'_> {
    /// I rows of the result, at most [`TERMS`] terms.
    #[inline(always)]
    fn strip<S: Simd, const I: usize>(
        &self,
        simd: S,
        row: usize,
        room: &mut [f32; STRIP * TERMS],
        result: &mut [f32],
    ) {
        // The factors of the rows side by side, so that tiles read them without bounds checks.
        let factors = &mut room.as_chunks_mut::<I>().0[..self.terms];
        self.gather(row, factors);
        let factors = &*factors;
        let mut column = 0;
        // One row needs eight registers to hide the latency of their chains.
        while I == 1 && column + 8 * S::F32_LANES <= self.width {
            self.tile::<S, I, 8>(simd, factors, row, column, result);
            column += 8 * S::F32_LANES;
        }
        // As many accumulators as fit beside the operands: 24 of 32 registers, or 12 of 16.
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

    /// Copies the factors of I rows, interleaved term by term.
    #[inline(always)]
    #[allow(clippy::needless_range_loop)]
    fn gather<const I: usize>(&self, row: usize, factors: &mut [[f32; I]]) {
        if self.left_transposed {
            let terms = self.left[row..].chunks(self.left_stride);
            factors.iter_mut().zip(terms).for_each(|(to, left)| to.copy_from_slice(&left[..I]));
        } else {
            let mut rows = [self.left; I];
            for i in 0..I {
                rows[i] = &self.left[(row + i) * self.left_stride..][..factors.len()];
            }
            for (p, factors) in factors.iter_mut().enumerate() {
                for i in 0..I {
                    factors[i] = rows[i][p];
                }
            }
        }
    }

    /// I rows by V registers of columns; the sums stay in registers over all terms.
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
            let start = match self.start {
                SumStart::Stored => &result[(row + i) * self.width + column..],
                SumStart::Row(row) => &row[column..],
                SumStart::Zero => continue,
            };
            let (start, _) = S::as_simd_f32s(&start[..span]);
            for v in 0..V {
                sums[i][v] = start[v];
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
        // Miri takes a minute for these sizes, a processor one millisecond.
        let (long, large, parts) = if cfg!(miri) {
            ((3, 40, 16), (9, 5, 48), (1, TERMS + 1, 16))
        } else {
            ((13, 40, 48), (64, 17, 144), (7, 2 * TERMS + 3, 16))
        };
        for (rows, terms, width) in [(1, 3, 128), (5, 1, 16), long, large, parts] {
            let right = numbers(terms * width, 2);
            let (before, row) = (numbers(rows * width, 3), numbers(width, 4));
            let starts = [SumStart::Stored, SumStart::Row(&row), SumStart::Zero];
            for (start, transposed) in starts.into_iter().flat_map(|s| [(s, false), (s, true)]) {
                let left_stride = if transposed { rows + 2 } else { terms + 2 };
                let (lines, of_line) = if transposed { (terms, rows) } else { (rows, terms) };
                let left = numbers((lines - 1) * left_stride + of_line, 1);
                let mut plain = match start {
                    SumStart::Stored => before.clone(),
                    SumStart::Row(row) => row.repeat(rows),
                    SumStart::Zero => vec![0.0; rows * width],
                };
                for i in 0..rows {
                    for j in 0..width {
                        for p in 0..terms {
                            let at =
                                if transposed { p * left_stride + i } else { i * left_stride + p };
                            plain[i * width + j] =
                                left[at].mul_add(right[p * width + j], plain[i * width + j]);
                        }
                    }
                }
                let product = Product {
                    start,
                    left: &left,
                    left_stride,
                    left_transposed: transposed,
                    right: &right,
                    terms,
                    rows,
                    width,
                };
                for isa in Isa::available() {
                    let mut ours = before.clone();
                    product.write_to(isa, &mut ours);
                    assert_eq!(bits(&ours), bits(&plain), "{} {rows} {terms} {width}", isa.name());
                }
            }
        }
    }
}
