//! Probability of improvement: the probability that a policy of one arm beats a policy of another.

use super::interval::{Interval, NORMAL_CRITICAL};
use super::undefined::{Undefined, at_least};
use crate::estimate::root;

/// Probability that a policy of the first arm has the larger value; a tie counts half.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Improvement {
    /// Probability, 0 to 1.
    pub probability: f64,
    /// Its interval.
    pub interval: Interval,
}

/// Probability of improvement of two independent arms: P(X > Y) + P(X = Y) / 2 over all pairs of
/// seeds, which is the Mann-Whitney statistic divided by its maximum.
///
/// The interval is a score interval. Unlike a bootstrap interval, it has a positive width when the
/// arms do not overlap.
///
/// **Errors**: an arm without values.
///
/// **Source**: Agarwal et al., "Deep reinforcement learning at the edge of the statistical
/// precipice", 2021; interval: Newcombe, "Confidence intervals for an effect size measure based on
/// the Mann-Whitney statistic. Part 2", 2006, method 5.
pub fn improvement(first: &[f64], second: &[f64]) -> Result<Improvement, Undefined> {
    at_least(1, first.len().min(second.len()))?;
    let probability = probability(first, second);
    let interval = score_interval(probability, first.len() as f64, second.len() as f64);
    Ok(Improvement { probability, interval })
}

/// Probability of improvement of pairs: the share of pairs in which the first value is larger; a
/// tie counts half.
///
/// **Errors**: no pairs.
///
/// **Source**: the interval: Wilson, "Probable inference, the law of succession, and statistical
/// inference", 1927.
pub fn paired_improvement(pairs: &[(f64, f64)]) -> Result<Improvement, Undefined> {
    at_least(1, pairs.len())?;
    let n = pairs.len() as f64;
    let probability = pairs.iter().map(|(a, b)| win(*a, *b)).sum::<f64>() / n;
    let z2 = NORMAL_CRITICAL.powi(2);
    let centre = (probability + z2 / (2.0 * n)) / (1.0 + z2 / n);
    let spread = probability * (1.0 - probability) / n + z2 / (4.0 * n * n);
    let half = (z2 * spread).sqrt() / (1.0 + z2 / n);
    let interval = Interval { low: (centre - half).max(0.0), high: (centre + half).min(1.0) };
    Ok(Improvement { probability, interval })
}

fn probability(first: &[f64], second: &[f64]) -> f64 {
    let wins: f64 = first.iter().map(|x| second.iter().map(|y| win(*x, *y)).sum::<f64>()).sum();
    wins / (first.len() * second.len()) as f64
}

fn win(x: f64, y: f64) -> f64 {
    (f64::from(u8::from(x > y)) + f64::from(u8::from(x >= y))) / 2.0
}

/// The range of probabilities p that differ from `seen` by at most z standard deviations at p. The
/// standard deviation is Hanley and McNeil's for exponential values, with the mean of both arms'
/// numbers of seeds in place of each in its numerator.
fn score_interval(seen: f64, n_1: f64, n_2: f64) -> Interval {
    let variance = |p: f64| {
        let balance = (1.0 - p) / (2.0 - p) + p / (1.0 + p);
        p * (1.0 - p) * (1.0 + ((n_1 + n_2) / 2.0 - 1.0) * balance) / (n_1 * n_2)
    };
    let excess = |p: f64| (p - seen).abs() - NORMAL_CRITICAL * variance(p).sqrt();
    // An observed 0 or 1 is itself an end of the interval; only the other end is searched for.
    let inside = seen.clamp(1e-12, 1.0 - 1e-12);
    let low = if seen == 0.0 { 0.0 } else { root(excess, (0.0, inside)) };
    let high = if seen == 1.0 { 1.0 } else { root(excess, (inside, 1.0)) };
    Interval { low, high }
}
