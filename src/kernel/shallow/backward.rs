//! The gradient: a register of units at a time, over all rows.

use pulp::{Simd, WithSimd};

use super::{OUTPUTS, Shallow, ShallowGradient};

/// Adds to a gradient what the derivatives by the outputs make.
pub(super) struct Backward<'a, const K: usize> {
    pub(super) network: Shallow<'a>,
    /// \[rows, outputs\], row by row.
    pub(super) by_outputs: &'a [f32],
    pub(super) gradient: ShallowGradient<'a>,
}

impl<const K: usize> WithSimd for Backward<'_, K> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let units = self.network.bias.len();
        for unit in (0..units).step_by(S::F32_LANES) {
            if self.network.moments.is_empty() {
                self.column::<S, false>(simd, unit);
            } else {
                self.column::<S, true>(simd, unit);
            }
        }
    }
}

impl<const K: usize> Backward<'_, K> {
    /// One register of units, over all rows, which have moments or have none.
    #[inline(always)]
    #[allow(clippy::needless_range_loop)]
    fn column<S: Simd, const MOMENTS: bool>(&mut self, simd: S, unit: usize) {
        let Shallow { weight, bias, head, inputs, moments, rows } = self.network;
        let units = bias.len();
        let (zero, one) = (simd.splat_f32s(0.0), simd.splat_f32s(1.0));
        let (mut weights, mut by_weights) = ([zero; K], [zero; K]);
        for k in 0..K {
            weights[k] = load(simd, weight, k * units + unit);
            by_weights[k] = load(simd, self.gradient.weight, k * units + unit);
        }
        let (mut heads, mut by_heads) = ([zero; OUTPUTS], [zero; OUTPUTS]);
        for j in 0..OUTPUTS {
            heads[j] = load(simd, head, j * units + unit);
            by_heads[j] = load(simd, self.gradient.head, j * units + unit);
        }
        let start = load(simd, bias, unit);
        let mut by_start = load(simd, self.gradient.bias, unit);
        let inputs = &inputs.as_chunks::<K>().0[..rows];
        let by_outputs = &self.by_outputs.as_chunks::<OUTPUTS>().0[..rows];
        for (row, (inputs, by_outputs)) in inputs.iter().zip(by_outputs).enumerate() {
            let mut hidden = start;
            let mut entry = 0;
            if MOMENTS {
                entry = (K + moments[row] as usize) * units + unit;
                hidden = simd.add_f32s(hidden, load(simd, weight, entry));
            }
            for k in 0..K {
                hidden = simd.mul_add_f32s(simd.splat_f32s(inputs[k]), weights[k], hidden);
            }
            let positive = simd.greater_than_f32s(hidden, zero);
            let mut by_hidden = zero;
            for j in 0..OUTPUTS {
                let by_output = simd.splat_f32s(by_outputs[j]);
                by_hidden = simd.mul_add_f32s(by_output, heads[j], by_hidden);
                let more = simd.mul_add_f32s(by_output, hidden, by_heads[j]);
                by_heads[j] = simd.select_f32s(positive, more, by_heads[j]);
            }
            by_hidden = simd.select_f32s(positive, by_hidden, zero);
            by_start = simd.mul_add_f32s(one, by_hidden, by_start);
            for k in 0..K {
                let input = simd.splat_f32s(inputs[k]);
                by_weights[k] = simd.mul_add_f32s(input, by_hidden, by_weights[k]);
            }
            if MOMENTS {
                let sum = simd.add_f32s(load(simd, self.gradient.weight, entry), by_hidden);
                store::<S>(sum, self.gradient.weight, entry);
            }
        }
        for k in 0..K {
            store::<S>(by_weights[k], self.gradient.weight, k * units + unit);
        }
        for j in 0..OUTPUTS {
            store::<S>(by_heads[j], self.gradient.head, j * units + unit);
        }
        store::<S>(by_start, self.gradient.bias, unit);
    }
}

/// The register that starts at a position.
#[inline(always)]
fn load<S: Simd>(_: S, values: &[f32], at: usize) -> S::f32s {
    let (registers, _) = S::as_simd_f32s(&values[at..at + S::F32_LANES]);
    registers[0]
}

/// Puts a register at a position.
#[inline(always)]
fn store<S: Simd>(register: S::f32s, values: &mut [f32], at: usize) {
    let (registers, _) = S::as_mut_simd_f32s(&mut values[at..at + S::F32_LANES]);
    registers[0] = register;
}
