//! Adam.

use pulp::{Simd, WithSimd};

use crate::kernel::{Aligned, Isa, math};

const BETA_1: f64 = 0.9;
const BETA_2: f64 = 0.999;
const EPSILON: f32 = 1e-8;
/// Moments below this become 0. Those of a unit that has gone quiet would decay into denormal
/// numbers, on which processors are slow, and move nothing long before that.
const QUIET: f32 = 1e-30;

/// The state of Adam for an array of parameters.
///
/// **Source**: Kingma and Ba, "Adam: a method for stochastic optimization", 2015, with the
/// published constants beta_1 = 0.9, beta_2 = 0.999, epsilon = 1e-8.
#[derive(Clone, Debug)]
pub struct Adam {
    learning_rate: f64,
    first: Aligned,
    second: Aligned,
    /// beta_1 and beta_2 to the power of the updates made.
    powers: [f64; 2],
}

impl Adam {
    /// The state before the first update of so many parameters.
    pub fn new(learning_rate: f64, parameters: usize) -> Self {
        Adam {
            learning_rate,
            first: Aligned::zeros(parameters),
            second: Aligned::zeros(parameters),
            powers: [1.0, 1.0],
        }
    }

    /// The first and second moments of every parameter, and beta_1 and beta_2 to the power of the
    /// updates made: all that an update depends on.
    pub fn state(&self) -> ([&[f32]; 2], [f64; 2]) {
        ([&self.first, &self.second], self.powers)
    }

    /// As [`Adam::state`], to be changed.
    pub fn state_mut(&mut self) -> ([&mut [f32]; 2], &mut [f64; 2]) {
        ([&mut self.first, &mut self.second], &mut self.powers)
    }

    /// Moves the parameters by their gradient, which becomes 0.
    pub fn update(&mut self, isa: Isa, parameters: &mut [f32], gradient: &mut [f32]) {
        self.powers[0] *= BETA_1;
        self.powers[1] *= BETA_2;
        let [first, second] = self.powers.map(|power| 1.0 - power);
        isa.run(Update {
            step: (self.learning_rate / first) as f32,
            scale: (1.0 / second.sqrt()) as f32,
            parameters,
            gradient,
            first: &mut self.first,
            second: &mut self.second,
        });
    }
}

/// parameter -= step * first / (scale * sqrt(second) + epsilon).
struct Update<'a> {
    step: f32,
    scale: f32,
    parameters: &'a mut [f32],
    gradient: &'a mut [f32],
    first: &'a mut [f32],
    second: &'a mut [f32],
}

impl WithSimd for Update<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let (decay_1, share_1) = (BETA_1 as f32, (1.0 - BETA_1) as f32);
        let (decay_2, share_2) = (BETA_2 as f32, (1.0 - BETA_2) as f32);
        let state = self.first.iter_mut().zip(self.second);
        let parameters = self.parameters.iter_mut().zip(self.gradient);
        for ((parameter, gradient), (first, second)) in parameters.zip(state) {
            let g = *gradient;
            *gradient = 0.0;
            let m = decay_1.mul_add(*first, share_1 * g);
            let v = decay_2.mul_add(*second, share_2 * g * g);
            let m = if m.abs() < QUIET { 0.0 } else { m };
            let v = if v < QUIET { 0.0 } else { v };
            *first = m;
            *second = v;
            *parameter -= self.step * m / self.scale.mul_add(math::root_f32(v), EPSILON);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_those_of_the_formula_by_hand() {
        let mut adam = Adam::new(0.1, 3);
        let (mut parameters, mut gradient) = ([1.0f32, 2.0, 3.0], [0.5f32, -4.0, 0.0]);
        adam.update(Isa::chosen(), &mut parameters, &mut gradient);
        // The first step is the learning rate against the gradient's sign.
        let close = |a: f32, b: f32| assert!((a - b).abs() < 1e-6, "{a} {b}");
        [0.9, 2.1, 3.0].into_iter().zip(parameters).for_each(|(hand, ours)| close(hand, ours));
        assert_eq!(gradient, [0.0; 3]);
        // m = 0.9 * 0.05 - 0.1 * 0.5 = -0.005, v = 0.999 * 0.00025 + 0.001 * 0.25 = 0.00049975,
        // corrected by 0.19 and 0.001999: m = -0.0263158, sqrt(v) = 0.5.
        adam.update(Isa::chosen(), &mut parameters, &mut [-0.5, 0.0, 0.0]);
        close(parameters[0], 0.9 + 0.1 * 0.026_315_8 / 0.5);
    }

    #[test]
    fn moments_of_a_quiet_parameter_become_zero_and_not_denormal() {
        let mut adam = Adam::new(1e-3, 1);
        let mut parameters = [1.0f32];
        adam.update(Isa::chosen(), &mut parameters, &mut [1e-3]);
        // Under Miri, long enough for the first moment alone.
        let steps = if cfg!(miri) { 1_000 } else { 50_000 };
        for _ in 0..steps {
            adam.update(Isa::chosen(), &mut parameters, &mut [0.0]);
            for moment in [adam.first[0], adam.second[0]] {
                assert!(moment == 0.0 || moment.abs() >= QUIET, "{moment}");
            }
        }
        assert_eq!(adam.first[0], 0.0);
        assert!(cfg!(miri) || adam.second[0] == 0.0);
    }

    #[test]
    fn every_instruction_set_makes_the_same_bits() {
        let mut made = Isa::available().into_iter().map(|isa| {
            let mut adam = Adam::new(6e-4, 37);
            let mut parameters: Vec<f32> = (0..37).map(|i| i as f32 / 37.0).collect();
            for step in 0..50 {
                let mut gradient: Vec<f32> =
                    (0..37).map(|i| ((i * 31 + step * 17) % 13) as f32 - 6.0).collect();
                adam.update(isa, &mut parameters, &mut gradient);
            }
            parameters.iter().map(|p| p.to_bits()).collect::<Vec<_>>()
        });
        let first = made.next().unwrap();
        assert!(made.all(|other| other == first));
    }
}
