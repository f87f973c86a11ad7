//! The mean of the best action value over the context draw, in closed form.

use std::f64::consts::FRAC_1_SQRT_2;

use crate::env::Belief;

use super::action_values::ActionValues;

/// The number of table pieces per halving of the argument, as a power of 2.
const PIECES_LOG2: u32 = 8;
/// The number of halvings, from 1/2 down, that the table covers.
const HALVINGS: u32 = 20;
/// The number of pieces in the table.
const PIECES: usize = (HALVINGS as usize) << PIECES_LOG2;
/// The largest error of a table piece relative to the closed form, as an absolute difference.
const PRECISION: f64 = 1e-11;

/// The mean value of the best action under what the agent believes about the context.
///
/// If the likelier context has probability p, tailoring to it is worth p S + (1 - p) F. S is the
/// value of a suitable message, and F is the value of an unsuitable message. For S > F, this grows
/// with p, so the best action changes once: at the p where tailoring is worth as much as the better
/// of the other two actions. For S < F, it is best to tailor to the less likely context, which
/// swaps S and F.
#[derive(Clone, Debug)]
pub(super) enum Expectation {
    /// The context is known.
    Certain,
    /// The probability of the context is known; see [`BetterOf`].
    Inferred(BetterOf),
    /// The likelier context is known.
    Likely {
        /// The probability that the likelier context is not the true context.
        error: f64,
    },
    /// Both contexts are equally likely to the agent.
    Ignorant,
}

impl Expectation {
    /// The expectation for an agent with this belief.
    pub fn new(belief: Belief) -> Expectation {
        match belief {
            Belief::Certain => Expectation::Certain,
            Belief::Inferred { sigma } => Expectation::Inferred(BetterOf::new(sigma)),
            // Prior probabilities of both contexts are equal, so both errors are the same.
            Belief::Likely { errors: [error, _] } => Expectation::Likely { error },
            Belief::Ignorant { .. } => Expectation::Ignorant,
        }
    }

    /// The mean of the best action value over the context draws of one step.
    #[inline(always)]
    pub fn of_best(&self, values: &ActionValues) -> f64 {
        let ActionValues { nothing, untailored, suitable, unsuitable } = *values;
        let plain = larger(nothing, untailored);
        let (better, worse) =
            if suitable > unsuitable { (suitable, unsuitable) } else { (unsuitable, suitable) };
        let tailored = match self {
            Expectation::Certain => better,
            Expectation::Likely { error } => (1.0 - error) * better + error * worse,
            Expectation::Ignorant => (better + worse) / 2.0,
            Expectation::Inferred(_) if plain >= better => plain,
            Expectation::Inferred(mean) => {
                let stake = better - worse;
                worse + stake * mean.at((better - plain) / stake)
            }
        };
        larger(plain, tailored)
    }
}

/// The larger of two numbers, compiled to one instruction, unlike [`f64::max`].
#[inline(always)]
fn larger(x: f64, y: f64) -> f64 {
    if x > y { x } else { y }
}

/// The mean of max(1 - x, probability of the likelier context), as a function of x > 0.
///
/// The function is a table of cubics that match the closed form in values and slopes, because evaluating the
/// closed form would dominate the time of the induction. Like doubles, the pieces get shorter towards 0,
/// where the function depends on the logarithm of x.
#[derive(Clone, Debug)]
pub(super) struct BetterOf {
    sigma: f64,
    /// Coefficients by the leading bits of x below 1/2, with the constant first; NaN where a piece would
    /// differ from the closed form by more than [`PRECISION`].
    pieces: Box<[[f64; 4]; PIECES]>,
    /// The value for x >= 1/2: the probability that the likelier context is the true context.
    right: f64,
}

impl BetterOf {
    /// The number of bits of an f64 that give the position within a piece.
    const WITHIN: u32 = f64::MANTISSA_DIGITS - 1 - PIECES_LOG2;
    /// The start of the table.
    const LEAST: f64 = 0.5 / (1_u32 << HALVINGS) as f64;
    /// The leading bits of the start.
    const FIRST: usize = (Self::LEAST.to_bits() >> Self::WITHIN) as usize;
    /// The mask of the mantissa.
    const MANTISSA: u64 = (1 << (f64::MANTISSA_DIGITS - 1)) - 1;

    fn new(sigma: f64) -> Self {
        let mut pieces = Box::new([[f64::NAN; 4]; PIECES]);
        for (i, piece) in pieces.iter_mut().enumerate() {
            *piece = cubic(sigma, i).unwrap_or(*piece);
        }
        let [right, _] = closed_form(sigma, 0.5);
        BetterOf { sigma, pieces, right }
    }

    /// The start of a piece.
    fn beginning(piece: usize) -> f64 {
        f64::from_bits(((Self::FIRST + piece) as u64) << Self::WITHIN)
    }

    #[inline(always)]
    fn at(&self, x: f64) -> f64 {
        if x >= 0.5 {
            return self.right;
        }
        if x >= Self::LEAST {
            let piece = (x.to_bits() >> Self::WITHIN) as usize - Self::FIRST;
            // The bits within a piece become the mantissa of a number from 1 to 2.
            let within = (x.to_bits() << PIECES_LOG2) & Self::MANTISSA;
            let part = f64::from_bits(1.0_f64.to_bits() | within) - 1.0;
            let tabulated = value(&self.pieces[piece], part);
            if !tabulated.is_nan() {
                return tabulated;
            }
        }
        closed_form(self.sigma, x)[0]
    }
}

/// Hermite's cubic for a piece, with the constant first; `None` if it is not precise enough.
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

/// The value of a cubic at the position `part` of its piece, in [0, 1).
#[inline(always)]
fn value(cubic: &[f64; 4], part: f64) -> f64 {
    let [a, b, c, d] = cubic;
    a + part * (b + part * (c + part * d))
}

/// The mean of max(1 - x, p), where p is the probability of the likelier context, for x > 0; and its
/// derivative, which is minus the probability that p < 1 - x.
///
/// **Source**: at distance y of the feature from 1/2, the log-odds of the likelier context are y / sigma^2.
/// With probability Phi((1/2 - t) / sigma), y > t and the likelier context is the true one; with probability
/// Phi((-1/2 - t) / sigma), y > t and it is the wrong one.
fn closed_form(sigma: f64, x: f64) -> [f64; 2] {
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
    use crate::env::StepCount;

    /// The mean of the best of four values, by quadrature over the feature on a fine grid.
    fn by_quadrature(sigma: f64, values: &ActionValues) -> f64 {
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
            let tailored = |p: f64| p * values.suitable + (1.0 - p) * values.unsuitable;
            let best = values.nothing.max(values.untailored);
            best.max(tailored(p)).max(tailored(1.0 - p)) * (zero + one) / 2.0 * width
        };
        (0..steps).map(mean).sum()
    }

    #[test]
    fn the_closed_form_is_the_integral_over_the_context_draw() {
        for (nothing, untailored, suitable, unsuitable) in [
            (1.0, 4.0, 10.0, -20.0),
            (1.0, -1.0, 10.0, 0.5),
            (3.0, 2.0, 2.5, 0.0),
            (1.0, 4.0, -10.0, 12.0),
            (0.0, 0.0, 5.0, 5.0),
            (0.0, 0.0, 5.0, -5.0),
        ] {
            let values = ActionValues { nothing, untailored, suitable, unsuitable };
            for sigma in [0.2, 0.6, 1.0, 3.0] {
                let ours = Expectation::new(Belief::Inferred { sigma }).of_best(&values);
                let integral = by_quadrature(sigma, &values);
                assert!((ours - integral).abs() < 1e-7, "{sigma} {values:?}: {ours} {integral}");
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
        }
    }

    #[test]
    fn the_mean_is_between_the_best_that_is_not_tailored_and_the_best_of_all() {
        let beliefs = [
            Belief::Certain,
            Belief::Inferred { sigma: 0.8 },
            Belief::Inferred { sigma: 1e-3 },
            Belief::Inferred { sigma: 1e6 },
            Belief::Likely { errors: [0.2; 2] },
            Belief::Ignorant { zero: 0.5 },
        ];
        // Includes equal values, tailoring that is equally good either way, and tailoring that is hardly
        // better than no message.
        for (nothing, untailored, suitable, unsuitable) in [
            (0.0, 4.0, 10.0, -20.0),
            (7.0, -3.0, 6.0, 6.0),
            (0.0, 9.999_999_9, 10.0, -20.0),
            (2.0, 2.0, -20.0, 12.0),
            (3.0, 3.0, 3.0, 3.0),
            (1.0, 0.0, 5.0, 5.0),
            (0.0, -1.0, 5e-324, -20.0),
        ] {
            let values = ActionValues { nothing, untailored, suitable, unsuitable };
            let plain = f64::max(nothing, untailored);
            let most = plain.max(suitable).max(unsuitable) + 1e-12;
            for belief in beliefs {
                let ours = Expectation::new(belief).of_best(&values);
                assert!((plain..=most).contains(&ours), "{belief:?} {values:?}: {ours}");
            }
        }
    }

    #[test]
    fn knowing_more_is_never_worse() {
        let action_values =
            ActionValues { nothing: 1.0, untailored: 4.0, suitable: 10.0, unsuitable: -20.0 };
        let environment = StepCount::paper(0.8);
        let expect_best = |scenario: &str| {
            let belief = Belief::new(&environment, &scenario.parse().unwrap());
            Expectation::new(belief).of_best(&action_values)
        };
        let values = ["C", "P", "L", "T"].map(expect_best);
        assert!(values.windows(2).all(|pair| pair[0] >= pair[1]), "{values:?}");
        assert_eq!((values[0], values[3]), (10.0, 4.0));
        let likely = Belief::new(&environment, &"L".parse().unwrap());
        let right = likely.probability_of_zero(&ContextDraw::new(0, 0.9));
        assert_eq!(values[2], f64::max(4.0, right * 10.0 - (1.0 - right) * 20.0));
    }
}
