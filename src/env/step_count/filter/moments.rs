//! The numbers of a belief, from sums over the states that it holds possible.

use crate::env::step_count::dynamics::Dynamics;
use crate::env::step_count::full_step::cut;
use crate::kernel::math;

/// The numbers of a belief.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct BeliefMoments {
    /// The probability of context 0.
    pub(super) zero: f64,
    /// Mean and standard deviation.
    pub(super) habituation: [f64; 2],
    /// Mean and standard deviation.
    pub(super) risk: [f64; 2],
    /// The probability that a wrong message would reach the threshold.
    pub(super) near: f64,
}

/// The number of states that sums add side by side, each to an accumulator of its own: the order of additions is the
/// same on every instruction set.
pub(super) const SIDE: usize = 8;

/// Numbers of states side by side.
pub(super) type Block = [f64; SIDE];

/// Sums over states, with weights that are not normalised.
#[derive(Clone, Copy, Debug)]
pub(super) struct StateSums {
    weight: Block,
    squares: Block,
    zero: Block,
    near: Block,
    habituation: Spread,
    risk: Spread,
}

impl StateSums {
    /// Sums over no states. Habituation and risk are measured from one state's values, so that a single state has no
    /// deviation at all.
    #[inline(always)]
    pub(super) fn from(habituation: f64, risk: f64) -> StateSums {
        let none = [0.0; SIDE];
        let start_at = |origin| Spread { origin, first: none, second: none };
        let (habituation, risk) = (start_at(habituation), start_at(risk));
        StateSums { weight: none, squares: none, zero: none, near: none, habituation, risk }
    }

    /// Adds states with the weights of context 0 and of context 1, their risks and those that a wrong message leads to.
    #[inline(always)]
    pub(super) fn add(
        &mut self,
        dynamics: &Dynamics,
        [zero, one]: [&Block; 2],
        [risk, wrong]: [&Block; 2],
    ) {
        let weight = combined([zero, one], |[zero, one]| zero + one);
        let threshold = dynamics.disengagement_threshold;
        let near = combined(
            [&weight, wrong],
            |[weight, wrong]| if wrong >= threshold { weight } else { 0.0 },
        );
        add(&mut self.weight, &weight);
        add(&mut self.near, &near);
        self.risk.add(&weight, risk);
    }

    /// Adds what only noise of the state makes uncertain: the contexts, habituations, and the squares of the weights.
    #[inline(always)]
    pub(super) fn add_noisy(&mut self, [zero, one]: [&Block; 2], habituation: &Block) {
        let weight = combined([zero, one], |[zero, one]| zero + one);
        let squares = combined([&weight, &weight], |[x, y]| x * y);
        add(&mut self.squares, &squares);
        add(&mut self.zero, zero);
        self.habituation.add(&weight, habituation);
    }

    /// The sum of the weights.
    #[inline(always)]
    pub(super) fn weight(&self) -> f64 {
        total(&self.weight)
    }

    /// The sum of the squares of the weights.
    #[inline(always)]
    pub(super) fn squares(&self) -> f64 {
        total(&self.squares)
    }

    /// The numbers of the belief; `None` if there is no weight.
    #[inline(always)]
    pub(super) fn moments(&self) -> Option<BeliefMoments> {
        let weight = self.weight();
        if weight <= 0.0 {
            return None;
        }
        Some(BeliefMoments {
            zero: share(total(&self.zero), weight),
            habituation: self.habituation.moments(weight),
            risk: self.risk.moments(weight),
            near: share(total(&self.near), weight),
        })
    }
}

/// A part of a weight as a probability, at most 1 after rounding.
#[inline(always)]
fn share(part: f64, weight: f64) -> f64 {
    let share = part / weight;
    if share < 1.0 { share } else { 1.0 }
}

/// A function of the numbers of each state.
#[inline(always)]
fn combined([x, y]: [&Block; 2], function: impl Fn([f64; 2]) -> f64) -> Block {
    let at = |i: usize| function([x[i], y[i]]);
    [at(0), at(1), at(2), at(3), at(4), at(5), at(6), at(7)]
}

#[inline(always)]
fn add(sums: &mut Block, terms: &Block) {
    *sums = combined([sums, terms], |[sum, term]| sum + term);
}

/// The sum of the accumulators, by halves.
#[inline(always)]
fn total(sums: &Block) -> f64 {
    let half = |i: usize| sums[i] + sums[i + 4];
    (half(0) + half(2)) + (half(1) + half(3))
}

/// The largest of numbers, a multiple of [`SIDE`].
#[inline(always)]
pub(super) fn largest(numbers: &[f64]) -> f64 {
    let larger = |x: f64, y: f64| if x > y { x } else { y };
    let mut most = [f64::NEG_INFINITY; SIDE];
    for block in numbers.as_chunks::<SIDE>().0 {
        for (most, x) in most.iter_mut().zip(block) {
            *most = larger(*most, *x);
        }
    }
    let mut largest = most[0];
    for most in most {
        largest = larger(largest, most);
    }
    largest
}

/// Sums for a mean and a standard deviation.
#[derive(Clone, Copy, Debug)]
struct Spread {
    /// The value from which the others are measured.
    origin: f64,
    /// Sums of the distance from the origin, and of its square.
    first: Block,
    second: Block,
}

impl Spread {
    #[inline(always)]
    fn add(&mut self, weight: &Block, value: &Block) {
        let distance = combined([value, value], |[value, _]| value - self.origin);
        let first = combined([weight, &distance], |[weight, distance]| weight * distance);
        let second = combined([&first, &distance], |[first, distance]| first * distance);
        add(&mut self.first, &first);
        add(&mut self.second, &second);
    }

    #[inline(always)]
    fn moments(&self, weight: f64) -> [f64; 2] {
        let mean = total(&self.first) / weight;
        let variance = total(&self.second) / weight - mean * mean;
        // The root of less than a normal number is 0.
        let deviation = if variance > f64::MIN_POSITIVE { math::root(variance) } else { 0.0 };
        [cut(self.origin + mean, 0.0, 1.0), deviation]
    }
}
