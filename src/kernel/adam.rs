//! The optimiser Adam.

use pulp::{Scalar, Simd, WithSimd};

use crate::kernel::{Aligned, Isa, math};

const BETA_1: f64 = 0.9;
const BETA_2: f64 = 0.999;
/// The published epsilon.
const EPSILON: f64 = 1e-8;
/// Moments below this size are set to 0 when they are rescaled. Without a gradient, moments would decay into
/// denormals, which are slow on many processors. Moments become too small to move a parameter long before
/// that.
const QUIET: f32 = 1e-30;
/// Moments are rescaled when the decay factor of the first one falls to this value: every 66 updates.
const RENEWED_AT: f64 = 1e-3;

/// The state of Adam for an array of parameters.
///
/// A moment m <- beta m + (1 - beta) g is stored as m / beta^k, where k counts the updates since the last
/// rescaling. An update then only adds (1 - beta) / beta^k g, and beta^k is a factor of the step that all
/// parameters share. Rescaling writes m itself.
///
/// **Source**: Kingma and Ba, "Adam: a method for stochastic optimization", 2015, with the
/// published constants beta_1 = 0.9, beta_2 = 0.999, and epsilon = 1e-8 unless it is given.
#[derive(Clone, Debug)]
pub struct Adam {
    learning_rate: f64,
    epsilon: f64,
    pub(crate) first: Aligned,
    pub(crate) second: Aligned,
    /// beta_1 and beta_2 to the power of the number of updates.
    pub(crate) powers: [f64; 2],
    /// beta_1 and beta_2 to the power of the number of updates since the last rescaling.
    pub(crate) decays: [f64; 2],
}

impl Adam {
    /// The state of `parameters` parameters before the first update.
    pub fn new(learning_rate: f64, parameters: usize) -> Self {
        Adam::with_epsilon(learning_rate, EPSILON, parameters)
    }

    /// The state with another epsilon.
    pub fn with_epsilon(learning_rate: f64, epsilon: f64, parameters: usize) -> Self {
        Adam {
            learning_rate,
            epsilon,
            first: Aligned::zeros(parameters),
            second: Aligned::zeros(parameters),
            powers: [1.0; 2],
            decays: [1.0; 2],
        }
    }

    /// Sets the step size of later updates.
    pub fn set_learning_rate(&mut self, learning_rate: f64) {
        self.learning_rate = learning_rate;
    }

    /// Updates the parameters by their gradient and sets the gradient to 0.
    pub fn update(&mut self, isa: Isa, parameters: &mut [f32], gradient: &mut [f32]) {
        let step = self.begin();
        let (first, second) = (&mut self.first[..], &mut self.second[..]);
        isa.run(Update { step, parameters, gradient, first, second });
        if self.decays[0] <= RENEWED_AT {
            isa.run(Renewal { kept: &mut self.first, decay: self.decays[0] as f32 });
            isa.run(Renewal { kept: &mut self.second, decay: self.decays[1] as f32 });
            self.decays = [1.0; 2];
        }
    }

    fn begin(&mut self) -> Step {
        for (i, beta) in [BETA_1, BETA_2].into_iter().enumerate() {
            self.powers[i] *= beta;
            self.decays[i] *= beta;
        }
        let [first, second] = self.powers.map(|power| 1.0 - power);
        let scale = (self.decays[1] / second).sqrt();
        Step {
            shares: [
                ((1.0 - BETA_1) / self.decays[0]) as f32,
                ((1.0 - BETA_2) / self.decays[1]) as f32,
            ],
            rate: (self.learning_rate * self.decays[0] / (first * scale)) as f32,
            epsilon: (self.epsilon / scale) as f32,
        }
    }
}

/// The constants of an update, shared by all parameters: first += share g, second += share g^2, parameter -=
/// rate first / (sqrt(second) + epsilon), for the moments as stored.
#[derive(Clone, Copy, Debug)]
struct Step {
    shares: [f32; 2],
    rate: f32,
    epsilon: f32,
}

impl Step {
    /// The parameters and their moments after a step along the gradient.
    #[inline(always)]
    fn after<S: Simd>(
        self,
        simd: S,
        gradient: S::f32s,
        [parameter, first, second]: [S::f32s; 3],
    ) -> [S::f32s; 3] {
        let [share_1, share_2] = self.shares.map(|share| simd.splat_f32s(share));
        let (rate, epsilon) = (simd.splat_f32s(self.rate), simd.splat_f32s(self.epsilon));
        let first = simd.mul_add_f32s(share_1, gradient, first);
        let second = simd.mul_add_f32s(simd.mul_f32s(share_2, gradient), gradient, second);
        let by = simd.div_f32s(first, math::root_plus(simd, second, epsilon));
        [simd.negate_mul_add_f32s(rate, by, parameter), first, second]
    }

    #[inline(always)]
    fn take<S: Simd>(
        self,
        simd: S,
        parameters: &mut [S::f32s],
        gradient: &mut [S::f32s],
        moments: [&mut [S::f32s]; 2],
    ) {
        let [first, second] = moments.map(|moments| moments.iter_mut());
        let parameters = parameters.iter_mut().zip(gradient);
        for ((parameter, gradient), (first, second)) in parameters.zip(first.zip(second)) {
            let after = self.after(simd, *gradient, [*parameter, *first, *second]);
            [*parameter, *first, *second] = after;
            *gradient = simd.splat_f32s(0.0);
        }
    }
}

/// A step of all parameters.
struct Update<'a> {
    step: Step,
    parameters: &'a mut [f32],
    gradient: &'a mut [f32],
    first: &'a mut [f32],
    second: &'a mut [f32],
}

impl WithSimd for Update<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (parameters, few_parameters) = S::as_mut_simd_f32s(self.parameters);
        let (gradient, few_gradient) = S::as_mut_simd_f32s(self.gradient);
        let (first, few_first) = S::as_mut_simd_f32s(self.first);
        let (second, few_second) = S::as_mut_simd_f32s(self.second);
        self.step.take(simd, parameters, gradient, [first, second]);
        let few = [few_first, few_second];
        self.step.take(Scalar::new(), few_parameters, few_gradient, few);
    }
}

/// Rescales stored moments: multiplies them by their decay.
struct Renewal<'a> {
    kept: &'a mut [f32],
    decay: f32,
}

impl WithSimd for Renewal<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for moment in self.kept {
            let renewed = *moment * self.decay;
            *moment = if renewed.abs() < QUIET { 0.0 } else { renewed };
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
        // The first step is the learning rate, with the sign opposite to the gradient's.
        let close = |a: f32, b: f32| assert!((a - b).abs() < 1e-6, "{a} {b}");
        [0.9, 2.1, 3.0].into_iter().zip(parameters).for_each(|(hand, ours)| close(hand, ours));
        assert_eq!(gradient, [0.0; 3]);
        // m = 0.9 * 0.05 - 0.1 * 0.5 = -0.005, v = 0.999 * 0.00025 + 0.001 * 0.25 = 0.00049975,
        // corrected by 0.19 and 0.001999: m = -0.0263158, sqrt(v) = 0.5.
        adam.update(Isa::chosen(), &mut parameters, &mut [-0.5, 0.0, 0.0]);
        close(parameters[0], 0.9 + 0.1 * 0.026_315_8 / 0.5);
    }

    #[test]
    fn steps_are_those_of_the_formula_however_often_moments_were_renewed() {
        let mut adam = Adam::new(1e-3, 5);
        let mut ours = [0.0f32; 5];
        let (mut theirs, mut moments) = ([0.0f64; 5], [[0.0f64; 2]; 5]);
        let mut powers = [1.0, 1.0];
        for step in 0..400 {
            powers = [powers[0] * BETA_1, powers[1] * BETA_2];
            // Gradients are of sizes from 1e-6 to 100, and 0 for 150 updates.
            let gradient = |i: usize| {
                let silent = (100..250).contains(&step);
                let size = 10f32.powi(2 * i as i32 - 6);
                if silent { 0.0 } else { size * (((i * 31 + step * 17) % 13) as f32 - 5.0) }
            };
            adam.update(Isa::chosen(), &mut ours, &mut std::array::from_fn::<f32, 5, _>(gradient));
            for (i, [first, second]) in moments.iter_mut().enumerate() {
                let g = f64::from(gradient(i));
                *first = BETA_1 * *first + (1.0 - BETA_1) * g;
                *second = BETA_2 * *second + (1.0 - BETA_2) * g * g;
                let corrected = [*first / (1.0 - powers[0]), *second / (1.0 - powers[1])];
                theirs[i] -= 1e-3 * corrected[0] / (corrected[1].sqrt() + EPSILON);
            }
            for (ours, theirs) in ours.into_iter().zip(theirs) {
                let apart = (f64::from(ours) - theirs).abs();
                assert!(apart < 1e-6, "{step}: {ours} {theirs}");
            }
        }
    }

    #[test]
    fn steps_have_the_epsilon_and_the_rate_that_are_given() {
        let mut adam = Adam::with_epsilon(0.1, 0.5, 1);
        let mut parameters = [0.0f32];
        // The corrected moments of the first step are the gradient and its square.
        adam.update(Isa::chosen(), &mut parameters, &mut [1.5]);
        assert!((parameters[0] + 0.1 * 1.5 / 2.0).abs() < 1e-6, "{}", parameters[0]);
        adam.set_learning_rate(0.2);
        adam.update(Isa::chosen(), &mut parameters, &mut [1.5]);
        assert!((parameters[0] + 0.3 * 1.5 / 2.0).abs() < 1e-6, "{}", parameters[0]);
    }

    #[test]
    fn moments_of_a_quiet_parameter_become_zero_and_not_denormal() {
        let mut adam = Adam::new(1e-3, 1);
        let mut parameters = [1.0f32];
        adam.update(Isa::chosen(), &mut parameters, &mut [1e-3]);
        // Under Miri, there are only enough steps for the first moment to become 0.
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
            for step in 0..150 {
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
