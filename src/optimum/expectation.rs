//! The mean over the context signal of the best that can be chosen on seeing it, in closed form.

use std::array;
use std::f64::consts::FRAC_1_SQRT_2;

use crate::env::Belief;

use super::Prospects;

/// Pieces of the tabulated function between a number and its half: 2 to this power.
const PIECES_LOG2: u32 = 8;
/// How often 1/2 is halved before the table ends.
const HALVINGS: u32 = 20;
/// Pieces of the table.
const PIECES: usize = (HALVINGS as usize) << PIECES_LOG2;
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
    Inferred(BetterOf),
    Likely { error: f64 },
    Ignorant,
}

impl Expectation {
    pub fn new(belief: Belief) -> Expectation {
        match belief {
            Belief::Certain => Expectation::Certain,
            Belief::Inferred { sigma } => Expectation::Inferred(BetterOf::new(sigma)),
            Belief::Likely { error } => Expectation::Likely { error },
            Belief::Ignorant => Expectation::Ignorant,
        }
    }

    /// The mean value of the best choice; the baseline reward aside.
    pub fn of_best(&self, prospects: &Prospects) -> f64 {
        let Prospects { nothing, untailored, suitable, unsuitable } = *prospects;
        let [mean] = self.of_best_each([nothing], [untailored], [suitable], [unsuitable]);
        mean
    }

    /// [`Expectation::of_best`] in several states, given what each choice brings in each.
    #[inline(always)]
    pub fn of_best_each<const N: usize>(
        &self,
        nothing: [f64; N],
        untailored: [f64; N],
        suitable: [f64; N],
        unsuitable: [f64; N],
    ) -> [f64; N] {
        let plain: [f64; N] = array::from_fn(|i| larger(nothing[i], untailored[i]));
        let better: [f64; N] = array::from_fn(|i| larger(suitable[i], unsuitable[i]));
        let worse: [f64; N] = array::from_fn(|i| smaller(suitable[i], unsuitable[i]));
        match self {
            Expectation::Certain => array::from_fn(|i| larger(plain[i], better[i])),
            Expectation::Likely { error } => {
                array::from_fn(|i| larger(plain[i], (1.0 - error) * better[i] + error * worse[i]))
            }
            Expectation::Ignorant => {
                array::from_fn(|i| larger(plain[i], (better[i] + worse[i]) / 2.0))
            }
            Expectation::Inferred(mean) => {
                let rest: [f64; N] =
                    array::from_fn(|i| (better[i] - plain[i]) / (better[i] - worse[i]));
                let mean = mean.at_each(rest);
                // Where the plain choice is best, the other mean has no meaning but is below the better.
                array::from_fn(|i| larger(worse[i] + (better[i] - worse[i]) * mean[i], plain[i]))
            }
        }
    }
}

/// The larger of two numbers, or the second if one is NaN: one instruction, unlike [`f64::max`].
#[inline(always)]
fn larger(x: f64, y: f64) -> f64 {
    if x > y { x } else { y }
}

/// The smaller of two numbers, or the second if one is NaN.
#[inline(always)]
fn smaller(x: f64, y: f64) -> f64 {
    if x < y { x } else { y }
}

/// The mean of the larger of 1 - x and the probability of the likelier context, as a function of x.
///
/// Cubic pieces that agree with the closed form in values and slopes, because the closed form would
/// take most of the time of an induction. They are shorter towards 0, as doubles are: x matters there
/// by its logarithm. A piece that is not within [`PRECISION`] of the closed form is not used.
#[derive(Clone, Debug)]
pub(super) struct BetterOf {
    sigma: f64,
    /// By the leading bits of x: coefficients, the constant first; NaN where a piece is not precise.
    /// The last is for x from 1/2 on.
    pieces: Box<[[f64; 4]; PIECES + 1]>,
}

impl BetterOf {
    /// Bits of a double that tell places within a piece.
    const WITHIN: u32 = f64::MANTISSA_DIGITS - 1 - PIECES_LOG2;
    /// Where the table begins.
    const LEAST: f64 = 0.5 / (1_u32 << HALVINGS) as f64;
    /// Its leading bits.
    const FIRST: usize = (Self::LEAST.to_bits() >> Self::WITHIN) as usize;
    /// Bits of a mantissa.
    const MANTISSA: u64 = (1 << (f64::MANTISSA_DIGITS - 1)) - 1;

    fn new(sigma: f64) -> Self {
        let mut pieces = Box::new([[f64::NAN; 4]; PIECES + 1]);
        for (i, piece) in pieces[..PIECES].iter_mut().enumerate() {
            *piece = cubic(sigma, i).unwrap_or(*piece);
        }
        // The probability that the likelier context is the true one.
        let [right, _] = closed_form(sigma, 0.5);
        pieces[PIECES] = [right, 0.0, 0.0, 0.0];
        BetterOf { sigma, pieces }
    }

    /// Where a piece begins.
    fn beginning(piece: usize) -> f64 {
        f64::from_bits(((Self::FIRST + piece) as u64) << Self::WITHIN)
    }

    /// The mean for each x; of no meaning for those that are not above 0.
    #[inline(always)]
    fn at_each<const N: usize>(&self, x: [f64; N]) -> [f64; N] {
        let inside = x.map(|x| if x > Self::LEAST { x } else { Self::LEAST });
        let inside = inside.map(|x| if x < 0.5 { x } else { 0.5 });
        let piece = inside.map(|x| (x.to_bits() >> Self::WITHIN) as usize - Self::FIRST);
        let cubics = piece.map(|piece| self.pieces[piece.min(PIECES)]);
        // The bits within a piece behind the 1 of a number from 1 to 2.
        let within = inside.map(|x| (x.to_bits() << PIECES_LOG2) & Self::MANTISSA);
        let part = within.map(|bits| f64::from_bits(1.0_f64.to_bits() | bits) - 1.0);
        let [a, b, c, d]: [[f64; N]; 4] = array::from_fn(|k| cubics.map(|cubic| cubic[k]));
        let tabulated: [f64; N] = array::from_fn(|i| value(&[a[i], b[i], c[i], d[i]], part[i]));
        // Without a branch for each.
        let is_left_out = |i: usize| tabulated[i].is_nan() | ((x[i] > 0.0) & (x[i] < Self::LEAST));
        if (0..N).fold(false, |any, i| any | is_left_out(i)) {
            let exact = |i: usize| closed_form(self.sigma, x[i])[0];
            return array::from_fn(|i| if is_left_out(i) { exact(i) } else { tabulated[i] });
        }
        tabulated
    }
}

/// The cubic of a piece (Hermite's), from its constant on; `None` if it is not precise.
fn cubic(sigma: f64, piece: usize) -> Option<[f64; 4]> {
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
#[inline(always)]
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
    use crate::env::ContextDraw;
    use crate::env::Environment;

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
                let difference = (mean.at_each([x])[0] - closed_form(sigma, x)[0]).abs();
                assert!(difference < 2.0 * PRECISION, "{sigma} {x}: {difference}");
            }
        }
    }

    #[test]
    fn several_states_have_what_each_has_alone() {
        // Among them all equal, and tailoring that is as good either way, or hardly better than none.
        let nothing = [0.0, 7.0, 0.0, 2.0, 3.0, 1.0, 0.0];
        let untailored = [4.0, -3.0, 9.999_999_9, 2.0, 3.0, 0.0, -1.0];
        let suitable = [10.0, 6.0, 10.0, -20.0, 3.0, 5.0, 5e-324];
        let unsuitable = [-20.0, 6.0, -20.0, 12.0, 3.0, 5.0, -20.0];
        let beliefs = [
            Belief::Certain,
            Belief::Inferred { sigma: 0.8 },
            Belief::Inferred { sigma: 1e-3 },
            Belief::Likely { error: 0.2 },
            Belief::Ignorant,
        ];
        for belief in beliefs {
            let expectation = Expectation::new(belief);
            let each = expectation.of_best_each(nothing, untailored, suitable, unsuitable);
            for (i, ours) in each.into_iter().enumerate() {
                let alone = Prospects {
                    nothing: nothing[i],
                    untailored: untailored[i],
                    suitable: suitable[i],
                    unsuitable: unsuitable[i],
                };
                assert_eq!(ours.to_bits(), expectation.of_best(&alone).to_bits(), "{belief:?} {i}");
                let plain = f64::max(nothing[i], untailored[i]);
                let better = f64::max(suitable[i], unsuitable[i]);
                let most = plain.max(better) + 1e-12;
                assert!((plain..=most).contains(&ours), "{belief:?} {i}: {ours}");
            }
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
        let right = likely.probability_of_zero(&ContextDraw::new(0, 0.9));
        assert_eq!(values[2], f64::max(4.0, right * 10.0 - (1.0 - right) * 20.0));
    }
}
