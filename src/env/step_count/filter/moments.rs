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

/// The number of states that sums add side by side, each to an accumulator of its own: the order of additions is the
/// same on every instruction set.
pub(super) const SIDE: usize = 4;

/// Numbers of states side by side.
pub(super) type Block = [f64; SIDE];

/// Sums over states, with weights that are not normalised.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sums {
    weight: Block,
    squares: Block,
    zero: Block,
    near: Block,
    habituation: Spread,
    risk: Spread,
}

impl Sums {
    /// Sums over no states. Habituation and risk are measured from one state's values, so that a single state has no
    /// deviation at all.
    #[inline(always)]
    pub(super) fn from(habituation: f64, risk: f64) -> Sums {
        let none = [0.0; SIDE];
        let of = |origin| Spread { origin, first: none, second: none };
        let (habituation, risk) = (of(habituation), of(risk));
        Sums { weight: none, squares: none, zero: none, near: none, habituation, risk }
    }

    /// Adds states with the weights of context 0 and of context 1.
    #[inline(always)]
    pub(super) fn add(
        &mut self,
        dynamics: &Dynamics,
        [zero, one]: [&Block; 2],
        habituation: &Block,
        risk: &Block,
    ) {
        for i in 0..SIDE {
            let weight = zero[i] + one[i];
            self.weight[i] += weight;
            self.squares[i] += weight * weight;
            self.zero[i] += zero[i];
            self.near[i] += if is_near(dynamics, risk[i]) { weight } else { 0.0 };
            self.habituation.add(i, weight, habituation[i]);
            self.risk.add(i, weight, risk[i]);
        }
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
    pub(super) fn moments(&self) -> Option<Moments> {
        let weight = self.weight();
        (weight > 0.0).then(|| Moments {
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

/// The sum of the accumulators.
#[inline(always)]
fn total([first, second, third, fourth]: &Block) -> f64 {
    (first + second) + (third + fourth)
}

/// The largest of numbers, a multiple of [`SIDE`].
#[inline(always)]
pub(super) fn largest(numbers: &[f64]) -> f64 {
    let larger = |x: f64, y: f64| if x > y { x } else { y };
    let mut most = [f64::NEG_INFINITY; SIDE];
    for block in numbers.as_chunks::<SIDE>().0 {
        most.iter_mut().zip(block).for_each(|(most, x)| *most = larger(*most, *x));
    }
    most.into_iter().fold(f64::NEG_INFINITY, larger)
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
    /// Adds a value to the accumulators at a place.
    #[inline(always)]
    fn add(&mut self, place: usize, weight: f64, value: f64) {
        let distance = value - self.origin;
        self.first[place] += weight * distance;
        self.second[place] += weight * distance * distance;
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
