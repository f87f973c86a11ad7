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
    fn with_simd<S: Simd>(self, _: S) {
        match self.activation {
            Activation::Relu => {
                for value in self.values {
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
    fn with_simd<S: Simd>(self, _: S) {
        let each = self.derivatives.iter_mut().zip(self.active);
        match self.activation {
            Activation::Relu => {
                for (derivative, active) in each {
                    *derivative = if *active > 0.0 { *derivative } else { 0.0 };
                }
            }
            Activation::Tanh => {
                for (derivative, active) in each {
                    *derivative *= 1.0 - active * active;
                }
            }
        }
    }
}
