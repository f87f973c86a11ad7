//! The gates of a gated recurrent unit, and their derivatives.

use pulp::{Simd, WithSimd};

use crate::kernel::{Isa, math};

/// The number of gates: reset, update and new, stored side by side in each row in this order.
pub const GATES: usize = 3;

/// A step of a gated recurrent unit, after the products with its input and its state: r = σ(a_r + b_r), z =
/// σ(a_z + b_z), n = tanh(a_n + r b_n), h' = n + z (h - n).
///
/// **Shapes**: `from_input` a and `from_state` b are \[rows, 3 stride\]; `before` h and `after` h' are
/// \[rows, stride\]. All are row-major.
///
/// **Source**: Cho et al., "Learning phrase representations using RNN encoder-decoder for statistical machine
/// translation", 2014, in PyTorch's form: r is applied after the product with the state.
#[derive(Debug)]
pub struct GruStep<'a> {
    /// The length of a row of states: the units, and padding if there is any.
    pub stride: usize,
    /// The input's contribution to the gates; replaced by r, z and n.
    pub from_input: &'a mut [f32],
    /// The state's contribution to the gates.
    pub from_state: &'a [f32],
    /// The states before the step.
    pub before: &'a [f32],
    /// The states after the step.
    pub after: &'a mut [f32],
}

impl GruStep<'_> {
    /// Computes the states after the step.
    pub fn run(self, isa: Isa) {
        let rows = self.before.len() / self.stride;
        assert_eq!(self.before.len(), rows * self.stride, "whole rows");
        assert_eq!(self.after.len(), self.before.len(), "a state after for each before");
        assert_eq!(self.from_input.len(), GATES * self.before.len(), "all gates of the input");
        assert_eq!(self.from_state.len(), GATES * self.before.len(), "all gates of the state");
        isa.run(self);
    }
}

#[inline(always)]
fn sigmoid(x: f32) -> f32 {
    math::tanh(0.5 * x).mul_add(0.5, 0.5)
}

impl WithSimd for GruStep<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let stride = self.stride;
        let rows = self.from_input.chunks_exact_mut(GATES * stride);
        let rows = rows.zip(self.from_state.chunks_exact(GATES * stride));
        let states = self.before.chunks_exact(stride).zip(self.after.chunks_exact_mut(stride));
        for ((a, b), (before, after)) in rows.zip(states) {
            let (gates, new) = a.split_at_mut(2 * stride);
            let (b_gates, b_new) = b.split_at(2 * stride);
            gates.iter_mut().zip(b_gates).for_each(|(a, b)| *a = sigmoid(*a + *b));
            let (reset, update) = gates.split_at(stride);
            let each = new.iter_mut().zip(b_new.iter().zip(reset));
            each.for_each(|(n, (b, r))| *n = math::tanh(r.mul_add(*b, *n)));
            let each = after.iter_mut().zip(before).zip(new.iter().zip(update));
            each.for_each(|((after, h), (n, z))| *after = z.mul_add(*h - *n, *n));
        }
    }
}

/// The derivatives of a [`GruStep`], given the derivatives with respect to the states after it.
///
/// **Shapes**: as in [`GruStep`].
#[derive(Debug)]
pub struct GruGradient<'a> {
    /// The length of a row of states: the units, and padding if there is any.
    pub stride: usize,
    /// The gates r, z and n.
    pub gates: &'a [f32],
    /// The state's contribution to the gates; replaced by the derivatives with respect to it.
    pub from_state: &'a mut [f32],
    /// The states before the step.
    pub before: &'a [f32],
    /// The derivatives with respect to the states after the step; replaced by the derivatives with respect to
    /// the states before it, without the part that flows through the product with the state.
    pub by_after: &'a mut [f32],
    /// Receives the derivatives with respect to the input's contribution to the gates.
    pub by_input: &'a mut [f32],
}

impl GruGradient<'_> {
    /// Computes the derivatives.
    pub fn run(self, isa: Isa) {
        let rows = self.before.len() / self.stride;
        assert_eq!(self.before.len(), rows * self.stride, "whole rows");
        assert_eq!(self.by_after.len(), self.before.len(), "a derivative for each state");
        for gates in [self.gates.len(), self.from_state.len(), self.by_input.len()] {
            assert_eq!(gates, GATES * self.before.len(), "all gates");
        }
        isa.run(self);
    }
}

impl WithSimd for GruGradient<'_> {
    type Output = ();

    #[inline(always)]
    #[allow(clippy::needless_range_loop)]
    fn with_simd<S: Simd>(self, _: S) {
        let stride = self.stride;
        let rows = self.gates.chunks_exact(GATES * stride);
        let rows = rows.zip(self.from_state.chunks_exact_mut(GATES * stride));
        let rows = rows.zip(self.by_input.chunks_exact_mut(GATES * stride));
        let states = self.before.chunks_exact(stride).zip(self.by_after.chunks_exact_mut(stride));
        for (((gates, b), by_a), (before, by_after)) in rows.zip(states) {
            let (r, rest) = gates.split_at(stride);
            let (z, n) = rest.split_at(stride);
            let (b_r, rest) = b.split_at_mut(stride);
            let (b_z, b_n) = rest.split_at_mut(stride);
            let (a_r, rest) = by_a.split_at_mut(stride);
            let (a_z, a_n) = rest.split_at_mut(stride);
            let (r, z, n, before) = (&r[..stride], &z[..stride], &n[..stride], &before[..stride]);
            let (b_r, b_z, b_n) = (&mut b_r[..stride], &mut b_z[..stride], &mut b_n[..stride]);
            let (a_r, a_z, a_n) = (&mut a_r[..stride], &mut a_z[..stride], &mut a_n[..stride]);
            let by_after = &mut by_after[..stride];
            for i in 0..stride {
                let by = by_after[i];
                let by_new = by * (1.0 - z[i]) * (1.0 - n[i] * n[i]);
                let by_update = by * (before[i] - n[i]) * (z[i] * (1.0 - z[i]));
                let by_reset = by_new * b_n[i] * (r[i] * (1.0 - r[i]));
                (a_r[i], a_z[i], a_n[i]) = (by_reset, by_update, by_new);
                (b_r[i], b_z[i], b_n[i]) = (by_reset, by_update, by_new * r[i]);
                by_after[i] = by * z[i];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::test_numbers::{bits, numbers};

    /// The states after the step in f64, computed directly from the formulas.
    fn plain(a: &[f32], b: &[f32], before: &[f32], stride: usize) -> Vec<f64> {
        let sigmoid = |x: f64| 1.0 / (1.0 + libm::exp(-x));
        let after = |i: usize| {
            let (row, unit) = (i / stride, i % stride);
            let at = |gate: usize| (GATES * row + gate) * stride + unit;
            let [a, b] = [a, b].map(|x| [0, 1, 2].map(|gate| f64::from(x[at(gate)])));
            let (r, z) = (sigmoid(a[0] + b[0]), sigmoid(a[1] + b[1]));
            let n = libm::tanh(a[2] + r * b[2]);
            (1.0 - z) * n + z * f64::from(before[i])
        };
        (0..before.len()).map(after).collect()
    }

    const STRIDES: [usize; 3] = [16, 5, 1];
    const ROWS: usize = 3;

    fn given(stride: usize) -> [Vec<f32>; 3] {
        let scaled = |len, seed| numbers(len, seed).into_iter().map(|x| 2.0 * x).collect();
        let gates = GATES * ROWS * stride;
        [scaled(gates, 1), scaled(gates, 2), scaled(ROWS * stride, 3)]
    }

    #[test]
    fn steps_are_those_of_the_formula_on_every_instruction_set() {
        for stride in STRIDES {
            let [a, b, before] = given(stride);
            let expected = plain(&a, &b, &before, stride);
            let mut made = Isa::available().into_iter().map(|isa| {
                let (mut gates, mut after) = (a.clone(), vec![0.0; before.len()]);
                let step = GruStep {
                    stride,
                    from_input: &mut gates,
                    from_state: &b,
                    before: &before,
                    after: &mut after,
                };
                step.run(isa);
                for (ours, expected) in after.iter().zip(&expected) {
                    assert!((f64::from(*ours) - expected).abs() < 1e-6, "{ours} {expected}");
                }
                (bits(&gates), bits(&after))
            });
            let first = made.next().unwrap();
            assert!(made.all(|other| other == first));
        }
    }

    #[test]
    fn gradients_are_differences_of_the_steps() {
        for stride in STRIDES {
            let [a, b, before] = given(stride);
            let weights = numbers(before.len(), 4);
            let sum = |a: &[f32], b: &[f32], before: &[f32]| -> f64 {
                let after = plain(a, b, before, stride);
                after.iter().zip(&weights).map(|(h, w)| h * f64::from(*w)).sum()
            };
            for isa in Isa::available() {
                let (mut gates, mut after) = (a.clone(), vec![0.0; before.len()]);
                let step = GruStep {
                    stride,
                    from_input: &mut gates,
                    from_state: &b,
                    before: &before,
                    after: &mut after,
                };
                step.run(isa);
                let (mut by_b, mut by_before) = (b.clone(), weights.clone());
                let mut by_a = vec![0.0; a.len()];
                let gradient = GruGradient {
                    stride,
                    gates: &gates,
                    from_state: &mut by_b,
                    before: &before,
                    by_after: &mut by_before,
                    by_input: &mut by_a,
                };
                gradient.run(isa);
                const STEP: f32 = 1.0 / 1024.0;
                let check = |which: usize, gradient: &[f32]| {
                    for i in (0..gradient.len()).step_by(5) {
                        let moved = |by: f32| {
                            let mut moved = [a.clone(), b.clone(), before.clone()];
                            moved[which][i] += by;
                            sum(&moved[0], &moved[1], &moved[2])
                        };
                        let difference = (moved(STEP) - moved(-STEP)) / (2.0 * f64::from(STEP));
                        let off = (difference - f64::from(gradient[i])).abs();
                        assert!(off < 2e-5, "{which} {i}: {difference} {}", gradient[i]);
                    }
                };
                check(0, &by_a);
                check(1, &by_b);
                check(2, &by_before);
            }
        }
    }
}
