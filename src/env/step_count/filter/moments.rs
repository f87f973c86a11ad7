//! The numbers of a belief, from sums over the states that it holds possible.

use crate::env::step_count::dynamics::Dynamics;
use crate::env::step_count::full_step::cut;
use crate::kernel::math;

/// The numbers of a belief.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Moments {
    /// The probability of context 0.
    pub(super) zero: f64,
    /// Mean and standard deviation.
    pub(super) habituation: [f64; 2],
    /// Mean and standard deviation.
    pub(super) risk: [f64; 2],
    /// The probability that a wrong message would reach the threshold.
    pub(super) near: f64,
}

/// Whether a wrong message would raise this disengagement risk to the threshold.
#[inline(always)]
pub(super) fn is_near(dynamics: &Dynamics, risk: f64) -> bool {
    dynamics.annoyed(risk) >= dynamics.disengagement_threshold
}

/// Sums over states, with weights that are not normalised.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sums {
    pub(super) weight: f64,
    zero: f64,
    near: f64,
    habituation: Spread,
    risk: Spread,
}

impl Sums {
    /// Sums over no states. Habituation and risk are measured from one state's values, so that a single state has no
    /// deviation at all.
    #[inline(always)]
    pub(super) fn from(habituation: f64, risk: f64) -> Sums {
        let of = |origin| Spread { origin, first: 0.0, second: 0.0 };
        Sums { weight: 0.0, zero: 0.0, near: 0.0, habituation: of(habituation), risk: of(risk) }
    }

    /// Adds a state with the weights of both contexts.
    #[inline(always)]
    pub(super) fn add(
        &mut self,
        dynamics: &Dynamics,
        weights: [f64; 2],
        habituation: f64,
        risk: f64,
    ) {
        let weight = weights[0] + weights[1];
        self.weight += weight;
        self.zero += weights[0];
        self.near += if is_near(dynamics, risk) { weight } else { 0.0 };
        self.habituation.add(weight, habituation);
        self.risk.add(weight, risk);
    }

    /// The numbers of the belief; `None` if there is no weight.
    #[inline(always)]
    pub(super) fn moments(&self) -> Option<Moments> {
        (self.weight > 0.0).then(|| Moments {
            zero: share(self.zero, self.weight),
            habituation: self.habituation.moments(self.weight),
            risk: self.risk.moments(self.weight),
            near: share(self.near, self.weight),
        })
    }
}

/// A part of a weight as a probability, at most 1 after rounding.
#[inline(always)]
fn share(part: f64, weight: f64) -> f64 {
    let share = part / weight;
    if share < 1.0 { share } else { 1.0 }
}

/// Sums for a mean and a standard deviation.
#[derive(Clone, Copy, Debug)]
struct Spread {
    /// The value from which the others are measured.
    origin: f64,
    /// Sums of the distance from the origin, and of its square.
    first: f64,
    second: f64,
}

impl Spread {
    #[inline(always)]
    fn add(&mut self, weight: f64, value: f64) {
        let distance = value - self.origin;
        self.first += weight * distance;
        self.second += weight * distance * distance;
    }

    #[inline(always)]
    fn moments(&self, weight: f64) -> [f64; 2] {
        let mean = self.first / weight;
        let variance = self.second / weight - mean * mean;
        // The root of less than a normal number is 0.
        let deviation = if variance > f64::MIN_POSITIVE { math::root(variance) } else { 0.0 };
        [cut(self.origin + mean, 0.0, 1.0), deviation]
    }
}
