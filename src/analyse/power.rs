//! Minimum detectable differences: what a test would have found with high probability.

use super::interval::{Interval, LEVEL};
use super::noncentral::noncentral_t;
use super::t_test::TTest;
use crate::estimate::root;
use crate::estimate::{chi_squared_of_p, t_of_p};

/// Probability with which the minimum detectable difference is detected.
pub const POWER: f64 = 0.8;

/// Number of seeds per arm below which a table warns and shows the minimum detectable difference.
///
/// **Source**: Agarwal et al., "Deep reinforcement learning at the edge of the statistical
/// precipice", 2021, on comparisons of fewer than ten runs.
pub const FEW_SEEDS: usize = 10;

/// A minimum detectable difference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Detectable {
    /// The difference, by the estimated standard error.
    pub difference: f64,
    /// Its interval: the standard error is an estimate, which few seeds leave uncertain.
    pub interval: Interval,
}

/// The difference that a two-sided t test detects with probability [`POWER`] at this level, with as many seeds
/// and with the standard error of the given test.
///
/// For [`unpaired_t_test`](super::unpaired_t_test) the power is [`POWER`] or more.
///
/// **Source**: Cohen, "Statistical Power Analysis for the Behavioral Sciences", 1988; computed from
/// the noncentral t distribution, without approximation. The interval is that of a standard deviation, from
/// the chi-squared distribution.
pub fn detectable(test: &TTest, level: f64) -> Detectable {
    let bound = t_of_p(level, test.df);
    let below = |bound: f64, shift: f64| noncentral_t(bound, test.df, shift);
    let missed = |shift: f64| below(bound, shift) - below(-bound, shift);
    let shift = root(|shift| missed(shift) - (1.0 - POWER), (0.0, 10.0 + 2.0 * bound));
    let difference = test.standard_error * shift;
    let tail = (1.0 - LEVEL) / 2.0;
    let end = |p: f64| difference * (test.df / chi_squared_of_p(p, test.df)).sqrt();
    Detectable { difference, interval: Interval { low: end(1.0 - tail), high: end(tail) } }
}
