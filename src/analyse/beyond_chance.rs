//! The share of trials whose p-value against simulated trials without an effect is small, with an interval that counts
//! the chance of both.

use super::interval::{Interval, NORMAL_CRITICAL};
use super::monte_carlo::monte_carlo_p;
use super::noncentral::normal;
use super::operating::MonteCarloMean;
use super::undefined::Undefined;
use crate::manifest::kind::DidItLearn;

/// Trials whose p-value is at most this show more than chance.
pub const ALPHA: f64 = 0.05;

/// The fewest other trials without the effect that can give a p-value of [`ALPHA`].
const FEWEST: usize = DidItLearn::FEWEST;

/// Trials judged by trials without an effect.
#[derive(Clone, Debug, PartialEq)]
pub struct BeyondChance {
    /// The p-values of the trials.
    pub p_values: Vec<f64>,
    /// The share of them that is at most [`ALPHA`].
    pub share: Result<MonteCarloMean, Undefined>,
}

/// Judges trials, with their seeds and numbers, by those of trials without an effect.
///
/// A trial and its twin of the same seed have the same people and random numbers, so that the twin is no chance result.
///
/// The interval of the share holds each shift of a normal distribution with which the share differs by at most 1.96
/// standard deviations from its mean. The variance is that of the share among the trials, plus that of the quantiles of
/// the trials without an effect, minus twice the covariance that twins give both. Few trials without an effect make the
/// level of the test smaller than [`ALPHA`], such as 0.033 with 59 of them; the interval is that of the share at
/// [`ALPHA`]. A share below chance scales the tails of the unshifted distribution.
///
/// **Errors**: no trials, or too few others without the effect for a p-value of [`ALPHA`].
///
/// **Source**: Wilson, 1927, for the variance at each shift; Hsieh and Turnbull, "Nonparametric and semiparametric
/// estimation of the receiver operating characteristic curve", Annals of Statistics 24, 1996, for the variance of a
/// share beyond an estimated quantile, here without twins.
pub fn beyond_chance(trials: &[(u64, f64)], references: &[(u64, f64)]) -> BeyondChance {
    let (mut p_values, mut levels, mut fewest) = (Vec::new(), 0.0, usize::MAX);
    let mut twins = Vec::new();
    for (seed, number) in trials {
        let others = references.iter().filter(|(other, _)| other != seed);
        let others: Vec<f64> = others.map(|(_, other)| *other).collect();
        let twin = references.iter().find(|(other, _)| other == seed);
        twins.extend(twin.map(|(_, twin)| (*number, *twin)));
        if let Ok(p) = monte_carlo_p(*number, &others) {
            let draws = (others.len() + 1) as f64;
            levels += 2.0 * (ALPHA / 2.0 * draws + 1e-9).floor() / draws;
            fewest = fewest.min(others.len());
            p_values.push(p);
        }
    }
    let n = p_values.len() as f64;
    let share = match fewest {
        usize::MAX => Err(Undefined::NoSeeds),
        have if have < FEWEST => Err(Undefined::TooFewReferences { have, need: FEWEST }),
        _ => {
            let value = p_values.iter().filter(|p| **p <= ALPHA).count() as f64 / n;
            let model = Model::new(levels / n, [n, references.len() as f64], &twins);
            Ok(MonteCarloMean { value, interval: Ok(model.interval(value)) })
        }
    };
    BeyondChance { p_values, share }
}

/// The distribution of the share if trials are a shift of a normal distribution.
struct Model {
    /// The quantile of the normal distribution at which a tail has half of the level.
    quantile: f64,
    /// The numbers of trials, and of trials without an effect.
    n: [f64; 2],
    /// Twins, as a share of the trials times those without an effect, and their correlation.
    twins: f64,
    correlation: f64,
    /// Numbers in the upper tail, of equal probabilities.
    nodes: [f64; 24],
}

/// The mean and variance of the share at a shift.
struct At {
    mean: f64,
    variance: f64,
}

/// The largest shift.
const LARGEST: f64 = 12.0;

impl Model {
    fn new(level: f64, n: [f64; 2], twins: &[(f64, f64)]) -> Model {
        let correlation = correlation(twins).clamp(0.0, 0.999_999);
        let twins = twins.len() as f64 / (n[0] * n[1]);
        let node = |at: usize| quantile((at as f64 + 0.5) / 24.0 * level / 2.0);
        let nodes = std::array::from_fn(node);
        Model { quantile: quantile(level / 2.0), n, twins, correlation, nodes }
    }

    /// The mean and variance of the share at a shift; between -1 and 0, the unshifted tails times the shift plus 1.
    fn at(&self, shift: f64) -> At {
        let (scale, shift) = ((1.0 + shift).min(1.0), shift.max(0.0));
        let z = self.quantile;
        let tail = normal(-z);
        let mean = scale * (normal(shift - z) + normal(-shift - z));
        // How the share changes with the share of the other trials in the upper and in the lower tail.
        let slopes = [shift - z, shift + z].map(|x| scale * ((z * z - x * x) / 2.0).exp());
        let [upper, lower] = slopes;
        let of_tails = (upper * upper + lower * lower) * tail * (1.0 - tail)
            - 2.0 * upper * lower * tail * tail;
        let shared: f64 = match self.twins * self.correlation > 0.0 {
            true => self.shared(shift, tail).iter().zip(slopes).map(|(of, slope)| of * slope).sum(),
            false => 0.0,
        };
        let variance = mean * (1.0 - mean) / self.n[0] + of_tails / self.n[1]
            - 2.0 * self.twins * (scale * shared - (upper + lower) * tail * mean);
        At { mean, variance: variance.max(0.0) }
    }

    /// The probabilities that a trial counts and its twin is in the upper, or in the lower tail.
    fn shared(&self, shift: f64, tail: f64) -> [f64; 2] {
        let (rho, rest) = (self.correlation, (1.0 - self.correlation.powi(2)).sqrt());
        let counts = |twin: f64| {
            let mean = shift + rho * twin;
            normal((mean - self.quantile) / rest) + normal((-mean - self.quantile) / rest)
        };
        [1.0, -1.0].map(|side| {
            let sum: f64 = self.nodes.iter().map(|twin| counts(side * twin)).sum();
            sum / self.nodes.len() as f64 * tail
        })
    }

    /// The interval of the share at [`ALPHA`].
    fn interval(&self, share: f64) -> Interval {
        let holds = |shift: f64| {
            let At { mean, variance } = self.at(shift);
            (share - mean).abs() <= NORMAL_CRITICAL * variance.sqrt() + 1e-9
        };
        // The shift at which the share is its mean lies inside.
        let middle = bisected([-1.0, LARGEST], |shift| self.at(shift).mean < share);
        let low = bisected([-1.0, middle], |shift| !holds(shift));
        let high = bisected([middle, LARGEST], holds);
        let z = quantile(ALPHA / 2.0);
        let at_alpha = |shift: f64| {
            let (scale, shift) = ((1.0 + shift).min(1.0), shift.max(0.0));
            scale * (normal(shift - z) + normal(-shift - z))
        };
        Interval {
            low: if share == 0.0 { 0.0 } else { at_alpha(low) },
            high: if share == 1.0 { 1.0 } else { at_alpha(high) },
        }
    }
}

/// Where a condition that is true below and false above changes.
fn bisected([mut low, mut high]: [f64; 2], is_below: impl Fn(f64) -> bool) -> f64 {
    for _ in 0..40 {
        let middle = f64::midpoint(low, high);
        if is_below(middle) { low = middle } else { high = middle }
    }
    f64::midpoint(low, high)
}

/// The z above which a normal number lies with this probability.
fn quantile(p: f64) -> f64 {
    bisected([-40.0, 40.0], |z| normal(-z) > p)
}

/// Pearson's correlation; 0 of fewer than four pairs or without variance.
fn correlation(pairs: &[(f64, f64)]) -> f64 {
    let n = pairs.len() as f64;
    let mean = |number: fn(&(f64, f64)) -> f64| pairs.iter().map(number).sum::<f64>() / n;
    let (one, other) = (mean(|pair| pair.0), mean(|pair| pair.1));
    let sum = |product: &dyn Fn(f64, f64) -> f64| -> f64 {
        pairs.iter().map(|(x, y)| product(x - one, y - other)).sum()
    };
    let found = sum(&|x, y| x * y) / (sum(&|x, _| x * x) * sum(&|_, y| y * y)).sqrt();
    if pairs.len() > 3 && found.is_finite() { found } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// How often the interval holds the true share, of trials and references with this correlation of twins, in %.
    fn coverage([n, m]: [u64; 2], twins: Option<f64>, shift: f64) -> f64 {
        const ROUNDS: u32 = 4000;
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut draw = || {
            let (radius, angle): (f64, f64) = (1.0 - rng.random::<f64>(), rng.random());
            (-2.0 * radius.ln()).sqrt() * (std::f64::consts::TAU * angle).cos()
        };
        let z = quantile(ALPHA / 2.0);
        let truth = normal(shift - z) + normal(-shift - z);
        let holds = |_: &u32| {
            let trials: Vec<(u64, f64)> = (0..n).map(|seed| (seed, draw())).collect();
            let reference = |at: u64| match (twins, trials.get(at as usize)) {
                (Some(rho), Some((seed, twin))) => {
                    (*seed, rho * twin + (1.0 - rho * rho).sqrt() * draw())
                }
                _ => (n + at, draw()),
            };
            let references: Vec<(u64, f64)> = (0..m).map(reference).collect();
            let shifted: Vec<(u64, f64)> = trials.iter().map(|(s, x)| (*s, x + shift)).collect();
            let found = beyond_chance(&shifted, &references).share.unwrap();
            let Interval { low, high } = found.interval.unwrap();
            (low - 1e-9..=high + 1e-9).contains(&truth)
        };
        100.0 * (0..ROUNDS).filter(holds).count() as f64 / f64::from(ROUNDS)
    }

    #[test]
    fn the_interval_holds_the_share_of_null_studies_and_of_shifted_ones() {
        for (n, twins, shift) in [
            ([200, 200], None, 0.0),
            ([200, 200], Some(0.7), 0.0),
            ([60, 60], None, 0.0),
            ([60, 60], Some(0.5), 0.0),
            ([100, 59], None, 0.0),
            ([200, 200], Some(0.7), 2.2),
        ] {
            let found = coverage(n, twins, shift);
            assert!((93.0..=97.0).contains(&found), "{n:?} {twins:?} {shift}: {found:.1} %");
        }
    }

    #[test]
    fn too_few_references_are_refused_and_ends_are_exact() {
        let make_trials = |n: u64, shift: f64| -> Vec<(u64, f64)> {
            (0..n).map(|seed| (seed, seed as f64 + shift)).collect()
        };
        let refused = beyond_chance(&make_trials(39, 100.0), &make_trials(39, 0.0)).share;
        assert_eq!(refused, Err(Undefined::TooFewReferences { have: 38, need: 39 }));
        let all = beyond_chance(&make_trials(40, 100.0), &make_trials(40, 0.0)).share.unwrap();
        assert_eq!((all.value, all.interval.unwrap().high), (1.0, 1.0));
        assert!(all.interval.unwrap().low > ALPHA);
        // The middle of the references: none is beyond them.
        let middle: Vec<(u64, f64)> = (100..120).map(|seed| (seed, 20.5)).collect();
        let none = beyond_chance(&middle, &make_trials(40, 0.0)).share.unwrap();
        assert_eq!((none.value, none.interval.unwrap().low), (0.0, 0.0));
    }
}
