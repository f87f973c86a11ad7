//! The mean over the context signal of the best that can be chosen on seeing it, in closed form.

use std::f64::consts::FRAC_1_SQRT_2;

use crate::env::Belief;

use super::Prospects;

/// Pieces of the tabulated function between a number and its half: 2 to this power.
const PIECES_LOG2: u32 = 8;
/// How often 1/2 is halved before the table ends.
const HALVINGS: u32 = 20;
/// How far a piece may be from the closed form, as a share of what is at stake.
const PRECISION: f64 = 1e-11;

/// The mean value of choosing the best action on what a belief will be.
///
/// Tailoring to the likelier context, whose probability is p, brings p S + (1 - p) F: S if it suits,
/// F if not. That grows with p where S > F, so the best choice changes once, at the p that makes it
/// worth as much as the best choice that is not tailored; where S < F it is best to tailor to the
/// other context, which exchanges S and F.
#[derive(Clone, Debug)]
pub(super) enum Expectation {
    Certain,
    Inferred(Box<BetterOf>),
    Likely { error: f64 },
    Ignorant,
}

impl Expectation {
    pub fn new(belief: Belief) -> Expectation {
        match belief {
            Belief::Certain => Expectation::Certain,
            Belief::Inferred { sigma } => Expectation::Inferred(Box::new(BetterOf::new(sigma))),
            Belief::Likely { error } => Expectation::Likely { error },
            Belief::Ignorant => Expectation::Ignorant,
        }
    }

    /// The mean value of the best choice; the baseline reward aside.
    pub fn of_best(&self, prospects: &Prospects) -> f64 {
        let plain = prospects.nothing.max(prospects.untailored);
        let better = prospects.suitable.max(prospects.unsuitable);
        let worse = prospects.suitable.min(prospects.unsuitable);
        match self {
            Expectation::Certain => plain.max(better),
            Expectation::Likely { error } => plain.max((1.0 - error) * better + error * worse),
            Expectation::Ignorant => plain.max((better + worse) / 2.0),
            Expectation::Inferred(_) if plain >= better => plain,
            Expectation::Inferred(mean) => {
                let rest = (better - plain) / (better - worse);
                worse + (better - worse) * mean.at(rest)
            }
        }
    }
}

/// The mean of the larger of 1 - x and the probability of the likelier context, as a function of x.
///
/// Cubic pieces that agree with the closed form in values and slopes, because the closed form would
/// take most of the time of an induction. They are shorter towards 0, as doubles are: x matters there
/// by its logarithm. A piece that is not within [`PRECISION`] of the closed form is not used.
#[derive(Clone, Debug)]
pub(super) struct BetterOf {
    sigma: f64,
    /// The probability that the likelier context is the true one: the mean for x from 1/2 on.
    right: f64,
    /// By the leading bits of x. `None` where a piece is not precise.
    pieces: Vec<Option<[f64; 4]>>,
}

impl BetterOf {
    /// Bits of a double that tell places within a piece.
    const WITHIN: u32 = f64::MANTISSA_DIGITS - 1 - PIECES_LOG2;

    fn new(sigma: f64) -> Self {
        let [right, _] = closed_form(sigma, 0.5);
        let pieces = (0..u64::from(HALVINGS) << PIECES_LOG2).map(|piece| cubic(sigma, piece));
        BetterOf { sigma, right, pieces: pieces.collect() }
    }

    /// Where a piece begins.
    fn beginning(piece: u64) -> f64 {
        f64::from_bits((Self::first() + piece) << Self::WITHIN)
    }

    /// The leading bits of where the table begins.
    fn first() -> u64 {
        (0.5 / f64::from(1 << HALVINGS)).to_bits() >> Self::WITHIN
    }

    /// The mean for this x, at least 0.
    fn at(&self, x: f64) -> f64 {
        if x >= 0.5 {
            return self.right;
        }
        let bits = x.to_bits();
        let piece = (bits >> Self::WITHIN).wrapping_sub(Self::first());
        match self.pieces.get(piece as usize) {
            Some(Some(cubic)) => {
                let within = bits & ((1 << Self::WITHIN) - 1);
                value(cubic, within as f64 / (1_u64 << Self::WITHIN) as f64)
            }
            _ => closed_form(self.sigma, x)[0],
        }
    }
}

/// The cubic of a piece (Hermite's), from its constant on; `None` if it is not precise.
fn cubic(sigma: f64, piece: u64) -> Option<[f64; 4]> {
    let (from, to) = (BetterOf::beginning(piece), BetterOf::beginning(piece + 1));
    let width = to - from;
    let ([at_from, slope_from], [at_to, slope_to]) =
        (closed_form(sigma, from), closed_form(sigma, to));
    let (rise, rise_from, rise_to) = (at_to - at_from, slope_from * width, slope_to * width);
    let bends = [3.0 * rise - 2.0 * rise_from - rise_to, rise_from + rise_to - 2.0 * rise];
    let cubic = [at_from, rise_from, bends[0], bends[1]];
    let is_precise = |part: f64| {
        let [exact, _] = closed_form(sigma, from + part * width);
        (value(&cubic, part) - exact).abs() < PRECISION
    };
    [0.3, 0.5, 0.7].into_iter().all(is_precise).then_some(cubic)
}

/// The value of a cubic, `part` of the way from the beginning of its piece.
fn value(cubic: &[f64; 4], part: f64) -> f64 {
    let [a, b, c, d] = cubic;
    a + part * (b + part * (c + part * d))
}

/// The mean of the larger of 1 - x and p, and its slope: less the probability that p is the smaller.
///
/// **Source**: with |z - 1/2| = y of the feature z the likelier context has the log-odds y / sigma^2,
/// and it is the true one with probability Phi((1/2 - t) / sigma) and y > t, the wrong one with
/// probability Phi((-1/2 - t) / sigma) and y > t.
fn closed_form(sigma: f64, x: f64) -> [f64; 2] {
    if x <= 0.0 {
        return [1.0, -1.0];
    }
    let least = if x < 0.5 { sigma * sigma * libm::log((1.0 - x) / x) } else { 0.0 };
    let (right, wrong) = (normal((0.5 - least) / sigma), normal((-0.5 - least) / sigma));
    let below = 1.0 - right - wrong;
    [right + below * (1.0 - x), -below]
}

/// The distribution function of the standard normal distribution.
fn normal(x: f64) -> f64 {
    0.5 * libm::erfc(-FRAC_1_SQRT_2 * x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::Signal;
    use crate::manifest::Environment;

    /// The mean over features on a fine grid, of the best of four values for each.
    fn by_quadrature(sigma: f64, prospects: &Prospects) -> f64 {
        let (from, to, steps) = (-0.5 - 9.0 * sigma, 1.5 + 9.0 * sigma, 200_000);
        let width = (to - from) / f64::from(steps);
        let density = |x: f64, mean: f64| {
            let z = (x - mean) / sigma;
            (-0.5 * z * z).exp() / (sigma * (2.0 * std::f64::consts::PI).sqrt())
        };
        let mean = |i: i32| {
            let x = from + (f64::from(i) + 0.5) * width;
            let (zero, one) = (density(x, 0.0), density(x, 1.0));
            let p = zero / (zero + one);
            let tailored = |p: f64| p * prospects.suitable + (1.0 - p) * prospects.unsuitable;
            let best = prospects.nothing.max(prospects.untailored);
            best.max(tailored(p)).max(tailored(1.0 - p)) * (zero + one) / 2.0 * width
        };
        (0..steps).map(mean).sum()
    }

    #[test]
    fn the_closed_form_is_the_integral_over_the_signal() {
        for (nothing, untailored, suitable, unsuitable) in [
            (1.0, 4.0, 10.0, -20.0),
            (1.0, -1.0, 10.0, 0.5),
            (3.0, 2.0, 2.5, 0.0),
            (1.0, 4.0, -10.0, 12.0),
            (0.0, 0.0, 5.0, 5.0),
            (0.0, 0.0, 5.0, -5.0),
        ] {
            let prospects = Prospects { nothing, untailored, suitable, unsuitable };
            for sigma in [0.2, 0.6, 1.0, 3.0] {
                let ours = Expectation::new(Belief::Inferred { sigma }).of_best(&prospects);
                let integral = by_quadrature(sigma, &prospects);
                assert!((ours - integral).abs() < 1e-7, "{sigma} {prospects:?}: {ours} {integral}");
            }
        }
    }

    #[test]
    fn the_pieces_are_the_closed_form_for_every_noise() {
        for sigma in [1e-3, 0.05, 0.4, 1.0, 2.0, 30.0, 1e6] {
            let mean = BetterOf::new(sigma);
            for i in 0..20_000 {
                let x = 0.55 * libm::exp(-f64::from(i) * 1e-3);
                let difference = (mean.at(x) - closed_form(sigma, x)[0]).abs();
                assert!(difference < 2.0 * PRECISION, "{sigma} {x}: {difference}");
            }
            assert_eq!(mean.at(0.0), 1.0);
        }
    }

    #[test]
    fn knowing_more_is_never_worse() {
        let prospects =
            Prospects { nothing: 1.0, untailored: 4.0, suitable: 10.0, unsuitable: -20.0 };
        let environment = Environment::paper(0.8);
        let of = |scenario: &str| {
            let belief = Belief::new(&environment, &scenario.parse().unwrap());
            Expectation::new(belief).of_best(&prospects)
        };
        let values = ["C", "P", "L", "T"].map(of);
        assert!(values.windows(2).all(|pair| pair[0] >= pair[1]), "{values:?}");
        assert_eq!((values[0], values[3]), (10.0, 4.0));
        let likely = Belief::new(&environment, &"L".parse().unwrap());
        let right = likely.probability_of_zero(&Signal::new(0, 0.9));
        assert_eq!(values[2], f64::max(4.0, right * 10.0 - (1.0 - right) * 20.0));
    }
}
