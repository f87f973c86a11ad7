//! Activations of hidden units, and their derivatives.

use pulp::{Simd, WithSimd};

use crate::kernel::{Isa, math};

/// A function of hidden units.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activation {
    /// max(0, x); NaN becomes 0.
    Relu,
    /// Hyperbolic tangent.
    Tanh,
}

impl Activation {
    /// Replaces every value by its activation, in place.
    pub fn apply(self, isa: Isa, values: &mut [f32]) {
        isa.run(Apply { activation: self, values });
    }

    /// Writes each derivative multiplied by the derivative of the activation, which follows from the
    /// activated value.
    ///
    /// The results go to `out`, because compilers turn an update in place into masked stores, which take
    /// twenty times as long on some processors.
    ///
    /// **Shapes**: all slices have the same length.
    pub fn differentiate(self, isa: Isa, active: &[f32], derivatives: &[f32], out: &mut [f32]) {
        assert_eq!(active.len(), derivatives.len(), "a derivative for each value");
        assert_eq!(out.len(), derivatives.len(), "room for every derivative");
        isa.run(Differentiate { activation: self, active, derivatives, out });
    }
}

struct Apply<'a> {
    activation: Activation,
    values: &'a mut [f32],
}

impl WithSimd for Apply<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        match self.activation {
            Activation::Relu => {
                // `max` may return either of 0 and -0; adding 0 makes both +0.
                for value in self.values {
                    *value = value.max(0.0) + 0.0;
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
    derivatives: &'a [f32],
    out: &'a mut [f32],
}

impl WithSimd for Differentiate<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let each = self.out.iter_mut().zip(self.derivatives.iter().zip(self.active));
        match self.activation {
            Activation::Relu => {
                for (out, (derivative, active)) in each {
                    *out = if *active > 0.0 { *derivative } else { 0.0 };
                }
            }
            Activation::Tanh => {
                for (out, (derivative, active)) in each {
                    *out = derivative * (1.0 - active * active);
                }
            }
        }
    }
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
                let (mut active, mut ours) = (values.clone(), vec![1.0; len]);
                Activation::Relu.apply(isa, &mut active);
                assert_eq!(bits(&active), bits(&positive(&values)), "{}", isa.name());
                Activation::Relu.differentiate(isa, &active, &derivatives, &mut ours);
                assert_eq!(bits(&ours), bits(&positive(&derivatives)), "{}", isa.name());
            }
        }
    }
}
