//! The mean over the context signal of the best that can be chosen on seeing it, in closed form.

use std::f64::consts::FRAC_1_SQRT_2;

use crate::env::Belief;

use super::Prospects;

/// Pieces of the tabulated function on [1/2, 1].
const PIECES: usize = 4096;
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
                let turn = (plain - worse) / (better - worse);
                worse + (better - worse) * mean.at(turn)
            }
        }
    }
}

/// The mean of the larger of u and the probability of the likelier context, as a function of u.
///
/// Cubic pieces that agree with the closed form in values and slopes, because the closed form would
/// take most of the time of an induction. A piece that is not within [`PRECISION`] of it is not used.
#[derive(Clone, Debug)]
pub(super) struct BetterOf {
    sigma: f64,
    /// The probability that the likelier context is the true one: the mean for u up to 1/2.
    right: f64,
    /// Mean and slope at the ends of the pieces; the slope is the probability that u is the larger.
    ends: Vec<[f64; 2]>,
    is_precise: Vec<bool>,
}

impl BetterOf {
    fn new(sigma: f64) -> Self {
        let end = |i: usize| closed_form(sigma, 0.5 + i as f64 / (2 * PIECES) as f64);
        let ends: Vec<[f64; 2]> = (0..=PIECES).map(end).collect();
        let right = ends[0][0];
        let mut table = BetterOf { sigma, right, ends, is_precise: vec![true; PIECES] };
        let is_precise = |piece: usize| {
            [0.3, 0.5, 0.7].into_iter().all(|part| {
                let [exact, _] =
                    closed_form(sigma, 0.5 + (piece as f64 + part) / (2 * PIECES) as f64);
                (table.cubic(piece, part) - exact).abs() < PRECISION
            })
        };
        table.is_precise = (0..PIECES).map(is_precise).collect();
        table
    }

    /// The mean for this u, at most 1.
    fn at(&self, u: f64) -> f64 {
        if u <= 0.5 {
            return self.right;
        }
        let pieces = (u - 0.5) * (2 * PIECES) as f64;
        let piece = (pieces as usize).min(PIECES - 1);
        if self.is_precise[piece] {
            self.cubic(piece, pieces - piece as f64)
        } else {
            closed_form(self.sigma, u)[0]
        }
    }

    /// The cubic of a piece (Hermite's), `part` of the way from its lower end.
    fn cubic(&self, piece: usize, part: f64) -> f64 {
        let ([from, rise_from], [to, rise_to]) = (self.ends[piece], self.ends[piece + 1]);
        let width = 1.0 / (2 * PIECES) as f64;
        let (rise_from, rise_to, rest) = (rise_from * width, rise_to * width, 1.0 - part);
        let line = rest * from + part * to;
        let bends = rest * (rise_from - (to - from)) - part * (rise_to - (to - from));
        line + part * rest * bends
    }
}

/// The mean of the larger of u and p, and the probability that p is below u.
///
/// **Source**: with |x - 1/2| = y the likelier context has the log-odds y / sigma^2, and it is the
/// true one with probability Phi((1/2 - t) / sigma) and y > t, the wrong one with probability
/// Phi((-1/2 - t) / sigma) and y > t.
fn closed_form(sigma: f64, u: f64) -> [f64; 2] {
    if u >= 1.0 {
        return [1.0, 1.0];
    }
    let least = if u > 0.5 { sigma * sigma * libm::log(u / (1.0 - u)) } else { 0.0 };
    let (right, wrong) = (normal((0.5 - least) / sigma), normal((-0.5 - least) / sigma));
    let below = 1.0 - right - wrong;
    [right + below * u, below]
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
            for i in 0..10_000 {
                let u = 0.45 + f64::from(i) * 5.5e-5;
                let difference = (mean.at(u) - closed_form(sigma, u)[0]).abs();
                assert!(difference < 2.0 * PRECISION, "{sigma} {u}: {difference}");
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
        let right = likely.probability_of_zero(&Signal::new(0, 0.9));
        assert_eq!(values[2], f64::max(4.0, right * 10.0 - (1.0 - right) * 20.0));
    }
}
