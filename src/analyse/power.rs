//! The smallest difference that a comparison with a given number of seeds can detect.

use super::interval::critical;
use super::noncentral::noncentral_t;
use super::root::root;
use super::undefined::{Undefined, at_least};

/// Probability with which the minimum detectable difference is detected.
pub const POWER: f64 = 0.8;

/// Number of seeds per arm below which a table warns and shows the minimum detectable difference.
///
/// **Source**: Agarwal et al., "Deep reinforcement learning at the edge of the statistical
/// precipice", 2021, on comparisons of fewer than ten runs.
pub const FEW_SEEDS: usize = 10;

/// The standardised difference (in pooled standard deviations) that Student's two-sided t test with
/// these numbers of seeds detects with probability [`POWER`] at the level
/// 1 - [`LEVEL`](super::LEVEL).
///
/// **Errors**: fewer than two seeds in an arm.
///
/// **Source**: Cohen, "Statistical Power Analysis for the Behavioral Sciences", 1988; computed from
/// the noncentral t distribution, without approximation.
pub fn detectable(first: usize, second: usize) -> Result<f64, Undefined> {
    at_least(2, first.min(second))?;
    let scale = (1.0 / first as f64 + 1.0 / second as f64).sqrt();
    Ok(detectable_shift((first + second - 2) as f64) * scale)
}

/// As [`detectable`], for the paired t test, in standard deviations of the differences.
///
/// **Errors**: fewer than two pairs.
pub fn paired_detectable(pairs: usize) -> Result<f64, Undefined> {
    at_least(2, pairs)?;
    Ok(detectable_shift((pairs - 1) as f64) / (pairs as f64).sqrt())
}

/// The shift of t that is detected with probability [`POWER`].
fn detectable_shift(df: f64) -> f64 {
    let bound = critical(df);
    let missed = |shift: f64| noncentral_t(bound, df, shift) - noncentral_t(-bound, df, shift);
    root(|shift| missed(shift) - (1.0 - POWER), (0.0, 10.0 + 2.0 * bound))
}
