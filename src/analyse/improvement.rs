//! Probability of improvement: how likely a policy of one arm beats one of another.

use super::interval::{Interval, NORMAL_CRITICAL};
use super::root::root;
use super::undefined::{Undefined, at_least};

/// Probability that a policy of the first arm has the larger value, a tie counting half.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Improvement {
    /// Probability, 0 to 1.
    pub probability: f64,
    /// Its interval.
    pub interval: Interval,
}

/// Probability of improvement of two independent arms: P(X > Y) + P(X = Y) / 2 over all pairs of
/// seeds, which is the Mann-Whitney statistic over its largest value.
///
/// The interval is that of a score; unlike a bootstrap it keeps a width where arms do not overlap.
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

/// Probability of improvement of pairs: the share of pairs in which the first is larger, a tie
/// counting half.
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

/// The probabilities from which the one seen is not further than z of their standard deviations,
/// that of exponential values (Hanley and McNeil) with the mean of both arms' numbers in it.
fn score_interval(seen: f64, n_1: f64, n_2: f64) -> Interval {
    let variance = |p: f64| {
        let balance = (1.0 - p) / (2.0 - p) + p / (1.0 + p);
        p * (1.0 - p) * (1.0 + ((n_1 + n_2) / 2.0 - 1.0) * balance) / (n_1 * n_2)
    };
    let excess = |p: f64| (p - seen).abs() - NORMAL_CRITICAL * variance(p).sqrt();
    // Where 0 or 1 was seen, that is a solution of its own; the other one is looked for.
    let inside = seen.clamp(1e-12, 1.0 - 1e-12);
    let low = if seen == 0.0 { 0.0 } else { root(excess, (0.0, inside)) };
    let high = if seen == 1.0 { 1.0 } else { root(excess, (inside, 1.0)) };
    Interval { low, high }
}
