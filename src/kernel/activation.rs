//! Activations of hidden units, and their derivatives.

use pulp::{Simd, WithSimd};

use crate::kernel::{Isa, math};

/// A function of hidden units.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activation {
    /// max(0, x); what is not a number becomes 0.
    Relu,
    /// Hyperbolic tangent.
    Tanh,
}

impl Activation {
    /// Puts the activation of every value in its place.
    pub fn apply(self, isa: Isa, values: &mut [f32]) {
        isa.run(Apply { activation: self, values });
    }

    /// Multiplies every derivative by that of the activation, given the activated values.
    pub fn differentiate(self, isa: Isa, active: &[f32], derivatives: &mut [f32]) {
        assert_eq!(active.len(), derivatives.len(), "a derivative for each value");
        isa.run(Differentiate { activation: self, active, derivatives });
    }
}

struct Apply<'a> {
    activation: Activation,
    values: &'a mut [f32],
}

impl WithSimd for Apply<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match self.activation {
            Activation::Relu => {
                let (registers, rest) = S::as_mut_simd_f32s(self.values);
                for value in registers {
                    *value = where_positive(simd, *value, *value);
                }
                for value in rest {
                    *value = if *value > 0.0 { *value } else { 0.0 };
                }
            }
            Activation::Tanh => {
                for value in self.values {
                    *value = math::tanh(*value);
                }
            }
        }
    }
}

struct Differentiate<'a> {
    activation: Activation,
    active: &'a [f32],
    derivatives: &'a mut [f32],
}

impl WithSimd for Differentiate<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match self.activation {
            Activation::Relu => {
                let (active, active_rest) = S::as_simd_f32s(self.active);
                let (derivatives, rest) = S::as_mut_simd_f32s(self.derivatives);
                for (derivative, active) in derivatives.iter_mut().zip(active) {
                    *derivative = where_positive(simd, *active, *derivative);
                }
                for (derivative, active) in rest.iter_mut().zip(active_rest) {
                    *derivative = if *active > 0.0 { *derivative } else { 0.0 };
                }
            }
            Activation::Tanh => {
                for (derivative, active) in self.derivatives.iter_mut().zip(self.active) {
                    *derivative *= 1.0 - active * active;
                }
            }
        }
    }
}

/// The values where the signs are positive, 0 elsewhere. Written as a loop over numbers, the
/// compiler would store zeros under a mask, for which some processors take twenty times as long.
#[inline(always)]
fn where_positive<S: Simd>(simd: S, signs: S::f32s, values: S::f32s) -> S::f32s {
    let zero = simd.splat_f32s(0.0);
    simd.select_f32s(simd.greater_than_f32s(signs, zero), values, zero)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::test_numbers::{bits, numbers};

    #[test]
    fn relu_keeps_what_is_positive_on_every_instruction_set() {
        for len in [0, 1, 15, 16, 100] {
            let mut values = numbers(len, 1);
            let derivatives = numbers(len, 2);
            let special = [f32::NAN, 0.0, -0.0, f32::INFINITY, f32::NEG_INFINITY];
            values.iter_mut().step_by(3).zip(special).for_each(|(value, special)| *value = special);
            let positive = |by: &[f32]| -> Vec<f32> {
                by.iter().zip(&values).map(|(by, v)| if *v > 0.0 { *by } else { 0.0 }).collect()
            };
            for isa in Isa::available() {
                let (mut active, mut ours) = (values.clone(), derivatives.clone());
                Activation::Relu.apply(isa, &mut active);
                assert_eq!(bits(&active), bits(&positive(&values)), "{}", isa.name());
                Activation::Relu.differentiate(isa, &active, &mut ours);
                assert_eq!(bits(&ours), bits(&positive(&derivatives)), "{}", isa.name());
            }
        }
    }
}
