//! Clipping of gradients by their norm.

use pulp::{Simd, WithSimd};

use crate::kernel::{Isa, dot};

/// Added to a norm to avoid division by 0.
const LEAST_NORM: f32 = 1e-6;

/// Scales numbers so that their Euclidean norm is at most `most`; returns the norm before scaling.
///
/// The factor is min(1, most / (norm + 1e-6)), as in PyTorch's `clip_grad_norm_`.
///
/// **Shapes**: the number of `values` is a multiple of [`crate::kernel::LANES`].
pub fn clip_norm(isa: Isa, values: &mut [f32], most: f32) -> f32 {
    let mut squares = [0.0];
    dot(isa, values, values, values.len(), &[0.0], &mut squares);
    let norm = squares[0].sqrt();
    let factor = most / (norm + LEAST_NORM);
    if factor < 1.0 {
        isa.run(Scale { values, factor });
    }
    norm
}

struct Scale<'a> {
    values: &'a mut [f32],
    factor: f32,
}

impl WithSimd for Scale<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.values.iter_mut().for_each(|value| *value *= self.factor);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_arrays_are_scaled_and_short_ones_are_not() {
        for isa in Isa::available() {
            let mut values = [0.0; 32];
            (values[1], values[20]) = (3.0, -4.0);
            let before = values;
            assert_eq!(clip_norm(isa, &mut values, 5.0), 5.0);
            // PyTorch also scales at the limit, by 5 / 5.000001.
            assert!((values[20] + 4.0).abs() < 2e-6 && (values[1] - 3.0).abs() < 2e-6);
            values = before;
            assert_eq!(clip_norm(isa, &mut values, 6.0), 5.0);
            assert_eq!(values, before);
            assert_eq!(clip_norm(isa, &mut values, 0.5), 5.0);
            assert!((values[1] - 0.3).abs() < 1e-6 && (values[20] + 0.4).abs() < 1e-6);
        }
    }
}
