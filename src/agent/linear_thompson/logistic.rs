//! The mean of a logistic function of a normal variable, to 1e-9.
//!
//! E[1 / (1 + exp(-(c + s X)))] with a standard normal X is smooth in X if s is small, and a steep step if s is large.
//! The trapezoidal rule converges exponentially for both: over X if s is small; over the logistic variable Y
//! otherwise, because the mean is also E[Phi((c - Y) / s)].
//!
//! **Source**: the error of the rule follows from the poles of the integrand; Trefethen and Weideman, "The
//! exponentially convergent trapezoidal rule", SIAM Review 56, 2014.

use std::f64::consts::PI;
use std::sync::OnceLock;

use crate::agent::linear_thompson::normal::NormalTable;

/// The spread from which the rule runs over the logistic variable.
const LARGE: f64 = 8.0;
/// Logarithm of the error of the rule.
const LOG_ERROR: f64 = -23.5;
/// The largest standard normal deviate: both tails beyond it have a probability of 6e-11.
const REACH: f64 = 6.5;
/// The largest logistic variate: both tails beyond it have a probability of 2e-10.
const LOGISTIC_REACH: f64 = 23.0;
/// Distance of nodes of the logistic variable.
const LOGISTIC_STEP: f64 = 0.7;
/// Number of nodes on each side of 0.
const LOGISTIC_NODES: usize = (LOGISTIC_REACH / LOGISTIC_STEP) as usize;

/// The mean of a logistic function of c + s X, for a standard normal X and s of at least 0.
pub fn mean_of_logistic(centre: f64, spread: f64) -> f64 {
    match spread < LARGE {
        true if centre < 0.0 => 1.0 - over_normal(-centre, spread),
        true => over_normal(centre, spread),
        false => over_logistic(centre, spread),
    }
}

/// The distance of nodes at which the rule over X has its error: the smaller of the distances for the density and for
/// the nearest pole of the logistic function, pi / s away from the real axis.
fn step(spread: f64) -> f64 {
    let of_density = PI * (2.0 / -LOG_ERROR).sqrt();
    let pole = PI / spread;
    // A pole beyond the saddle point of the density has no effect of its own.
    let of_pole = 2.0 * PI * pole / (pole * pole / 2.0 - LOG_ERROR);
    if 2.0 * PI / of_density < pole { of_density } else { of_density.min(of_pole) }
}

/// The mean for a centre of at least 0.
fn over_normal(centre: f64, spread: f64) -> f64 {
    let step = step(spread);
    let nodes = (REACH / step) as usize;
    // At n steps from the centre, exp(-x² / 2) is the product of exp(-step² / 2) to the powers 1, 3, 5, …, and
    // exp(-c - s x) and exp(-c + s x) are powers; the second is at most exp(LARGE * REACH).
    let first = libm::exp(-step * step / 2.0);
    let (rise, fall) = (libm::exp(spread * step), libm::exp(-spread * step));
    let (mut weight, mut factor) = (1.0, first);
    let centre = libm::exp(-centre);
    let (mut above, mut below) = (centre, centre);
    let (mut sum, mut weights) = (1.0 / (1.0 + centre), 1.0);
    for _ in 0..nodes {
        weight *= factor;
        factor *= first * first;
        (above, below) = (above * fall, below * rise);
        // The sum of 1 / (1 + above) and 1 / (1 + below).
        sum += weight * (2.0 + above + below) / ((1.0 + above) * (1.0 + below));
        weights += 2.0 * weight;
    }
    // The sum of the weights has the same tails.
    sum / weights
}

/// The weights of the nodes at and above 0, scaled so that their sum over all nodes is 1.
fn logistic_weights() -> &'static [f64; LOGISTIC_NODES + 1] {
    static WEIGHTS: OnceLock<[f64; LOGISTIC_NODES + 1]> = OnceLock::new();
    WEIGHTS.get_or_init(|| {
        let mut weights = [0.0; LOGISTIC_NODES + 1];
        for (node, weight) in weights.iter_mut().enumerate() {
            let tail = libm::exp(-(node as f64) * LOGISTIC_STEP);
            *weight = tail / ((1.0 + tail) * (1.0 + tail));
        }
        let all = weights[0] + 2.0 * weights[1..].iter().sum::<f64>();
        weights.map(|weight| weight / all)
    })
}

fn over_logistic(centre: f64, spread: f64) -> f64 {
    let table = NormalTable::shared();
    let [zero, others @ ..] = logistic_weights();
    let (at, step) = (centre / spread, LOGISTIC_STEP / spread);
    let mut sum = zero * table.below(at);
    for (node, weight) in (1..).zip(others) {
        let away = f64::from(node) * step;
        sum += weight * (table.below(at + away) + table.below(at - away));
    }
    sum
}

/// The derivatives of [`mean_of_logistic`] by the centre and by the spread, which is above 0.
pub fn slopes_of_logistic(centre: f64, spread: f64) -> [f64; 2] {
    if spread >= LARGE {
        let [zero, others @ ..] = logistic_weights();
        let table = NormalTable::shared();
        let slope = |weight: f64, node: f64| {
            let z = (centre - node * LOGISTIC_STEP) / spread;
            let by_centre = weight * table.density(z) / spread;
            [by_centre, -by_centre * z]
        };
        let mut sum = slope(*zero, 0.0);
        for (node, weight) in (1..).zip(others) {
            for node in [f64::from(node), -f64::from(node)] {
                let more = slope(*weight, node);
                sum = [sum[0] + more[0], sum[1] + more[1]];
            }
        }
        return sum;
    }
    // The slope of the logistic function has double poles at the same places.
    let step = step(spread) / 2.0;
    let (mut sum, mut weights) = ([0.0; 2], 0.0);
    let nodes = (REACH / step) as i64;
    for node in -nodes..=nodes {
        let x = node as f64 * step;
        let weight = libm::exp(-x * x / 2.0);
        let tail = libm::exp(-(centre + spread * x).abs());
        let slope = weight * tail / ((1.0 + tail) * (1.0 + tail));
        sum = [sum[0] + slope, sum[1] + x * slope];
        weights += weight;
    }
    sum.map(|sum| sum / weights)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn logistic(x: f64) -> f64 {
        1.0 / (1.0 + libm::exp(-x))
    }

    /// The mean by a rule with tiny steps.
    fn plain(centre: f64, spread: f64) -> f64 {
        let step = 1e-3_f64.min(0.02 / spread.max(1e-9));
        let nodes = (9.0 / step) as i64;
        let density = |x: f64| libm::exp(-x * x / 2.0) / (2.0 * PI).sqrt();
        let at = |node: i64| {
            let x = node as f64 * step;
            density(x) * logistic(centre + spread * x)
        };
        (-nodes..=nodes).map(at).sum::<f64>() * step
    }

    #[test]
    fn slopes_are_those_of_the_mean() {
        for spread in [0.1, 0.6, 1.7, 4.0, 7.9, 9.0, 26.0] {
            for centre in [-7.0, -1.0986, 0.0, 2.0, 13.0] {
                let step = 1e-3;
                let by_centre =
                    (plain(centre + step, spread) - plain(centre - step, spread)) / (2.0 * step);
                let by_spread =
                    (plain(centre, spread + step) - plain(centre, spread - step)) / (2.0 * step);
                let found = slopes_of_logistic(centre, spread);
                assert!(
                    (found[0] - by_centre).abs() < 1e-6,
                    "{centre} {spread}: {found:?} {by_centre}"
                );
                assert!(
                    (found[1] - by_spread).abs() < 1e-6,
                    "{centre} {spread}: {found:?} {by_spread}"
                );
            }
        }
    }

    #[test]
    fn means_are_exact_to_a_billionth() {
        let mut largest = 0.0_f64;
        for spread in [
            0.0, 1e-6, 0.1, 0.3, 0.45, 0.6, 1.0, 1.2, 1.5, 1.7, 2.5, 4.0, 6.0, 7.99, 8.0, 8.01,
            26.0, 100.0,
        ] {
            for centre in [
                -800.0, -60.0, -7.0, -2.5, -1.0986, -0.6, -0.3, 0.0, 0.35, 0.9, 2.0, 13.0, 80.0,
                800.0,
            ] {
                let error = (mean_of_logistic(centre, spread) - plain(centre, spread)).abs();
                assert!(error < 1e-9, "{centre} {spread}: {error:e}");
                largest = largest.max(error);
            }
        }
        assert!(largest < 4e-10, "{largest:e}");
    }
}
