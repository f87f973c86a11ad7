//! The gradient: a register of units at a time, over all rows.

use pulp::{Simd, WithSimd};

use super::network::{MOST_INPUTS, OUTPUTS, Shallow, ShallowGradient};
use crate::kernel::Isa;

/// The average number of consecutive rows per moment from which its gradient is kept in a register.
const LONG_RUN: usize = 4;

impl Shallow<'_> {
    /// Adds the gradient for the derivatives with respect to the outputs, \[rows, outputs\], row-major.
    pub fn backward(self, isa: Isa, by_outputs: &[f32], gradient: ShallowGradient<'_>) {
        self.check();
        assert_eq!(by_outputs.len(), self.rows * OUTPUTS, "derivatives for every row");
        match self.inputs.len() / self.rows {
            1 => isa.run(Backward::<1> { network: self, by_outputs, gradient }),
            2 => isa.run(Backward::<2> { network: self, by_outputs, gradient }),
            3 => isa.run(Backward::<3> { network: self, by_outputs, gradient }),
            4 => isa.run(Backward::<4> { network: self, by_outputs, gradient }),
            5 => isa.run(Backward::<5> { network: self, by_outputs, gradient }),
            6 => isa.run(Backward::<6> { network: self, by_outputs, gradient }),
            inputs => panic!("{inputs} inputs are more than {MOST_INPUTS}"),
        }
    }
}

/// Adds the gradient for the derivatives with respect to the outputs.
struct Backward<'a, const K: usize> {
    network: Shallow<'a>,
    /// \[rows, outputs\], row-major.
    by_outputs: &'a [f32],
    gradient: ShallowGradient<'a>,
}

impl<const K: usize> WithSimd for Backward<'_, K> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let Shallow { bias, moments, rows, .. } = self.network;
        let runs = 1 + moments.windows(2).filter(|pair| pair[0] != pair[1]).count();
        for column in 0..bias.len() / S::F32_LANES {
            if moments.is_empty() {
                self.column::<S, false, false>(simd, column);
            } else if runs * LONG_RUN > rows {
                self.column::<S, true, false>(simd, column);
            } else {
                self.column::<S, true, true>(simd, column);
            }
        }
    }
}

impl<const K: usize> Backward<'_, K> {
    /// One register of units over all rows; `column` counts registers, and `MOMENTS` is whether rows have
    /// moments. With `RUNS`, consecutive rows with the same moment accumulate its gradient in a register.
    /// Without, every row loads and stores it, which is faster if moments last only a few rows.
    #[inline(always)]
    #[allow(clippy::needless_range_loop)]
    fn column<S: Simd, const MOMENTS: bool, const RUNS: bool>(&mut self, simd: S, column: usize) {
        let Shallow { weight, bias, head, inputs, moments, rows } = self.network;
        let columns = bias.len() / S::F32_LANES;
        let (weight, bias, head) = (
            &S::as_simd_f32s(weight).0[column..],
            S::as_simd_f32s(bias).0,
            S::as_simd_f32s(head).0,
        );
        let by_weight = &mut S::as_mut_simd_f32s(self.gradient.weight).0[column..];
        let by_bias = &mut S::as_mut_simd_f32s(self.gradient.bias).0[column];
        let by_head = &mut S::as_mut_simd_f32s(self.gradient.head).0[column..];
        let zero = simd.splat_f32s(0.0);
        let (mut weights, mut by_weights) = ([zero; K], [zero; K]);
        for k in 0..K {
            (weights[k], by_weights[k]) = (weight[k * columns], by_weight[k * columns]);
        }
        let (mut heads, mut by_heads) = ([zero; OUTPUTS], [zero; OUTPUTS]);
        for j in 0..OUTPUTS {
            (heads[j], by_heads[j]) = (head[j * columns + column], by_head[j * columns]);
        }
        let (start, mut by_start) = (bias[column], *by_bias);
        let inputs = &inputs.as_chunks::<K>().0[..rows];
        // Reads the inputs a second time, because there are not enough registers to keep them.
        let again = &std::hint::black_box(inputs)[..rows];
        let by_outputs = &self.by_outputs.as_chunks::<OUTPUTS>().0[..rows];
        let (entries, by_entries) = if MOMENTS {
            let by_entries = &mut by_weight[K * columns..];
            (&weight[K * columns..][..by_entries.len()], by_entries)
        } else {
            (&weight[..0], &mut by_weight[..0])
        };
        let mut row = 0;
        while row < rows {
            let (mut first, mut entry, mut end) = (start, 0, rows);
            if MOMENTS {
                entry = moments[row] as usize * columns;
                first = simd.add_f32s(start, entries[entry]);
                end = row + 1;
                while RUNS && end < rows && moments[end] == moments[row] {
                    end += 1;
                }
            }
            let mut by_entry = if MOMENTS { by_entries[entry] } else { zero };
            for row in row..end.min(rows) {
                let mut hidden = first;
                for k in 0..K {
                    hidden = simd.mul_add_f32s(simd.splat_f32s(inputs[row][k]), weights[k], hidden);
                }
                // NaN may or may not become 0 here; such a training fails either way.
                hidden = simd.max_f32s(hidden, zero);
                let mut by_hidden = zero;
                for j in 0..OUTPUTS {
                    let by_output = simd.splat_f32s(by_outputs[row][j]);
                    by_hidden = simd.mul_add_f32s(by_output, heads[j], by_hidden);
                    by_heads[j] = simd.mul_add_f32s(by_output, hidden, by_heads[j]);
                }
                by_hidden = simd.select_f32s(simd.greater_than_f32s(hidden, zero), by_hidden, zero);
                by_start = simd.add_f32s(by_start, by_hidden);
                for k in 0..K {
                    let input = simd.splat_f32s(again[row][k]);
                    by_weights[k] = simd.mul_add_f32s(input, by_hidden, by_weights[k]);
                }
                if MOMENTS {
                    by_entry = simd.add_f32s(by_entry, by_hidden);
                }
            }
            if MOMENTS {
                by_entries[entry] = by_entry;
            }
            row = end;
        }
        for k in 0..K {
            by_weight[k * columns] = by_weights[k];
        }
        for j in 0..OUTPUTS {
            by_head[j * columns] = by_heads[j];
        }
        *by_bias = by_start;
    }
}
