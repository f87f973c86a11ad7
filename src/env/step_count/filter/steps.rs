//! What the steps walked tell of the context in which they were walked.

use super::evidence::Evidence;
use crate::env::step_count::dynamics::Dynamics;
use crate::env::step_count::noise::FLOOR;
use crate::env::step_count::parameters::{StepCount, StepNoise};
use crate::env::variates::ln_gamma_density;
use crate::env::vector::Action;
use crate::kernel::math;

/// The likelihoods of context 0 and of context 1 up to a common factor, given habituation after the step.
#[inline(always)]
pub(super) fn of_contexts(
    person: &StepCount,
    dynamics: &Dynamics,
    habituation: f64,
    evidence: &Evidence,
) -> [f64; 2] {
    let Some(steps) = evidence.steps else { return [1.0; 2] };
    let expected = expected(person, dynamics, evidence.action, habituation);
    match person.step_noise {
        _ if expected[0] == expected[1] => [1.0; 2],
        StepNoise::None => expected.map(|expected| f64::from(u8::from(expected == steps))),
        StepNoise::Gamma => {
            let [zero, one] = expected.map(|mean| ln_density(dynamics, mean, steps));
            let most = if zero > one { zero } else { one };
            [zero, one].map(|ln| relative(ln - most))
        }
    }
}

/// The likelihood of a difference of logarithms, at most 0. Less than e^-600 counts as nothing, so that products stay
/// normal numbers.
#[inline(always)]
pub(super) fn relative(ln: f64) -> f64 {
    if ln > -600.0 { math::exp(ln) } else { 0.0 }
}

/// The steps walked in each context without noise.
#[inline(always)]
pub(super) fn expected(
    person: &StepCount,
    dynamics: &Dynamics,
    action: Action,
    habituation: f64,
) -> [f64; 2] {
    let is_cut = person.steps_cut_at_zero && person.step_noise == StepNoise::None;
    let cut = |steps: f64| if is_cut & (steps < 0.0) { 0.0 } else { steps };
    [cut(dynamics.reward(0, action, habituation)), cut(dynamics.reward(1, action, habituation))]
}

/// The logarithm of the density of gamma-distributed steps around `expected`, up to a constant of the person.
#[inline(always)]
pub(super) fn ln_density(dynamics: &Dynamics, expected: f64, steps: f64) -> f64 {
    let mean = if expected > FLOOR { expected } else { FLOOR };
    ln_gamma_density(mean, dynamics.sigma_s, steps)
}
