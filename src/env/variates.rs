//! Normal, gamma, beta and Poisson variates, bit-identical on every instruction set.
//!
//! In: parameters and one random word per variate. Out: the variate. Rejection sampling needs an unknown
//! number of words, so each word is expanded into a sequence. The variates of the next lane and the next step
//! then keep their words, and equal seeds give equal noise for any actions.

use crate::kernel::math;

/// Below this exponent, the exponential counts as 0: at any scale of a simulation, it is near the smallest
/// normal number.
const LEAST_EXPONENT: f64 = -700.0;

/// -2 ln u for the uniform number u in bits 1 to 31; see [`deviate`].
#[inline(always)]
pub(super) fn squared_radius(bits: u64) -> f64 {
    // Halfway between multiples of 2^-31, so that u is never 0 and its logarithm is finite.
    let uniform = (f64::from((bits >> 1) as i32 & i32::MAX) + 0.5) * (1.0 / 2_147_483_648.0);
    -2.0 * math::ln(uniform)
}

/// A standard normal deviate from 64 random bits, at most 6.7 in size, by the method of Box and Muller
/// (1958). Bits 32 to 63 give the angle.
#[inline(always)]
pub(super) fn deviate(squared_radius: f64, bits: u64) -> f64 {
    // In [-1/2, 1/2).
    let turns = f64::from((bits >> 32) as i32) * (1.0 / 4_294_967_296.0);
    math::root(squared_radius) * math::cos_turns(turns)
}

/// A sequence of words generated from one word.
///
/// **Source**: Steele, Lea and Flood, "Fast splittable pseudorandom number generators", 2014
/// (SplitMix64).
pub(super) struct Expansion(pub(super) u64);

impl Expansion {
    #[inline(always)]
    pub(super) fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ (mixed >> 31)
    }

    /// A uniform number in (0, 1), so that its logarithm is finite.
    #[inline(always)]
    pub(super) fn open_unit(&mut self) -> f64 {
        ((self.bits() >> 12) as f64 + 0.5) * (1.0 / (1u64 << 52) as f64)
    }

    /// A standard normal deviate.
    #[inline(always)]
    pub(super) fn normal(&mut self) -> f64 {
        let bits = self.bits();
        deviate(squared_radius(bits), bits)
    }
}

/// A number `factor * exp(exponent)`, which may underflow an f64.
struct Scaled {
    factor: f64,
    exponent: f64,
}

impl Scaled {
    #[inline(always)]
    fn ln(&self) -> f64 {
        math::ln(self.factor) + self.exponent
    }
}

/// A trial of a gamma variate with a shape of at least 1 and scale 1, by a deviate and a uniform number.
///
/// **Source**: Marsaglia and Tsang, "A simple method for generating gamma variables", 2000.
struct Trial {
    d: f64,
    root: f64,
    /// The square of the deviate.
    square: f64,
    u: f64,
}

impl Trial {
    #[inline(always)]
    fn new(shape: f64, words: &mut Expansion) -> Trial {
        let d = shape - 1.0 / 3.0;
        let x = words.normal();
        let root = 1.0 + 1.0 / (9.0 * d).sqrt() * x;
        Trial { d, root, square: x * x, u: words.open_unit() }
    }

    #[inline(always)]
    fn v(&self) -> f64 {
        self.root * self.root * self.root
    }

    /// The variate, if the trial is accepted.
    #[inline(always)]
    fn variate(&self) -> f64 {
        self.d * self.v()
    }

    /// Whether a trial with a positive root is accepted by the test that is quick, and nearly always enough.
    #[inline(always)]
    fn is_soon_accepted(&self) -> bool {
        self.u < 1.0 - 0.0331 * self.square * self.square
    }

    /// Whether a trial with a positive root is accepted.
    #[inline(always)]
    fn is_accepted(&self) -> bool {
        let v = self.v();
        math::ln(self.u) < 0.5 * self.square + self.d * (1.0 - v + math::ln(v))
    }
}

/// The shape of the trials for a shape: for one below 1, that of a variate that is multiplied by U^(1/shape).
#[inline(always)]
fn raised(shape: f64) -> f64 {
    if shape < 1.0 { shape + 1.0 } else { shape }
}

/// A gamma variate with shape above 0 and scale 1.
#[inline(always)]
fn standard_gamma(shape: f64, words: &mut Expansion) -> Scaled {
    let factor = loop {
        let trial = Trial::new(raised(shape), words);
        if trial.root > 0.0 && (trial.is_soon_accepted() || trial.is_accepted()) {
            break trial.variate();
        }
    };
    let exponent = if shape < 1.0 { math::ln(words.open_unit()) / shape } else { 0.0 };
    Scaled { factor, exponent }
}

/// The variate of [`standard_gamma`] if its first trial is accepted, and whether it is. There are no branches.
#[inline(always)]
fn first_standard_gamma(shape: f64, words: &mut Expansion) -> (Scaled, bool) {
    let trial = Trial::new(raised(shape), words);
    let is_accepted = (trial.root > 0.0) & (trial.is_soon_accepted() | trial.is_accepted());
    let is_low = shape < 1.0;
    let after = words.0;
    let exponent = math::ln(words.open_unit()) / shape;
    words.0 = if is_low { words.0 } else { after };
    let exponent = if is_low { exponent } else { 0.0 };
    (Scaled { factor: trial.variate(), exponent }, is_accepted)
}

/// A gamma variate with this mean and standard deviation, both above 0. Returns 0 where U^(1/shape) is below
/// e^-700.
#[inline(always)]
pub(super) fn gamma(mean: f64, deviation: f64, word: u64) -> f64 {
    let ratio = mean / deviation;
    let Scaled { factor, exponent } = standard_gamma(ratio * ratio, &mut Expansion(word));
    let scale = deviation * deviation / mean;
    if exponent < LEAST_EXPONENT {
        return 0.0;
    }
    factor * scale * math::exp(exponent)
}

/// A beta variate X / (X + Y) of gamma variates X and Y of the shapes `alpha` and `beta`, both above 0.
#[inline(always)]
pub(super) fn beta([alpha, beta]: [f64; 2], word: u64) -> f64 {
    let mut words = Expansion(word);
    share(standard_gamma(alpha, &mut words), standard_gamma(beta, &mut words))
}

/// The variate of [`beta`] if the first trials of both gamma variates are accepted, and whether they are. There are no
/// branches, so that compilers vectorise loops.
#[inline(always)]
pub(super) fn first_beta([alpha, beta]: [f64; 2], word: u64) -> (f64, bool) {
    let mut words = Expansion(word);
    let (x, is_x) = first_standard_gamma(alpha, &mut words);
    let (y, is_y) = first_standard_gamma(beta, &mut words);
    (share(x, y), is_x & is_y)
}

/// X / (X + Y). Uses the difference of their logarithms, because both can underflow.
#[inline(always)]
fn share(x: Scaled, y: Scaled) -> f64 {
    let apart = y.ln() - x.ln();
    let share = 1.0 / (1.0 + math::exp(apart));
    if apart > -LEAST_EXPONENT { 0.0 } else { share }
}

/// A Poisson variate with this mean, at least 0.
///
/// **Source**: Hörmann, "The transformed rejection method for generating Poisson random variables", 1993 (PTRS).
/// Below a mean of 10, uniform numbers are multiplied until their product is below e^-mean.
#[inline(always)]
pub(super) fn poisson(mean: f64, words: &mut Expansion) -> f64 {
    if mean < 10.0 {
        let least = math::exp(-mean);
        let mut product = words.open_unit();
        let mut count = 0.0;
        while product > least {
            product *= words.open_unit();
            count += 1.0;
        }
        return count;
    }
    let b = 0.931 + 2.53 * mean.sqrt();
    let a = -0.059 + 0.02483 * b;
    let inverse_alpha = 1.1239 + 1.1328 / (b - 3.4);
    let quick = 0.9277 - 3.6224 / (b - 2.0);
    loop {
        let u = words.open_unit() - 0.5;
        let v = words.open_unit();
        let beside = 0.5 - u.abs();
        let count = ((2.0 * a / beside + b) * u + mean + 0.43).floor();
        if beside >= 0.07 && v <= quick {
            return count;
        }
        if count < 0.0 || (beside < 0.013 && v > beside) {
            continue;
        }
        let accepted = math::ln(v * inverse_alpha / (a / (beside * beside) + b));
        if accepted <= count * math::ln(mean) - mean - ln_factorial(count) {
            return count;
        }
    }
}

/// ln n! of a whole number, with an error below 1e-9.
#[inline(always)]
fn ln_factorial(n: f64) -> f64 {
    if n < 10.0 {
        let product: f64 = (2..=n as u32).map(f64::from).product();
        return math::ln(product);
    }
    stirling(n + 1.0)
}

/// ln Gamma(x) for x >= 8 by Stirling's series, with an error below 1e-9.
#[inline(always)]
fn stirling(x: f64) -> f64 {
    let square = 1.0 / (x * x);
    let series = (1.0 / 12.0 - square * (1.0 / 360.0 - square * (1.0 / 1260.0))) / x;
    (x - 0.5) * math::ln(x) - x + 0.918_938_533_204_672_8 + series
}

/// ln Gamma(x) for x > 0, with an error below 1e-9.
#[inline(always)]
fn ln_gamma(x: f64) -> f64 {
    // Gamma(x + 8) = x (x + 1) ... (x + 7) Gamma(x).
    let mut product = x;
    for i in 1..8 {
        product *= x + f64::from(i);
    }
    let (raised, product) = if x >= 8.0 { (x, 1.0) } else { (x + 8.0, product) };
    stirling(raised) - math::ln(product)
}

/// The logarithm of the density of [`gamma`] at `x` >= 0. At 0, it is the logarithm of the probability that the variate
/// underflows. There are no branches, so that compilers vectorise loops.
#[inline(always)]
pub(super) fn ln_gamma_density(mean: f64, deviation: f64, x: f64) -> f64 {
    let ratio = mean / deviation;
    let shape = ratio * ratio;
    // Only variates of a shape below 1 have the factor U^(1/shape).
    let at_zero = if shape < 1.0 { LEAST_EXPONENT * shape } else { f64::MIN };
    let scale = deviation * deviation / mean;
    let is_zero = x <= 0.0;
    let x = if x > f64::MIN_POSITIVE { x } else { f64::MIN_POSITIVE };
    let scaled = x / scale;
    let density = (shape - 1.0) * math::ln(x) - scaled - ln_gamma(shape) - shape * math::ln(scale);
    if is_zero { at_zero } else { density }
}

#[cfg(test)]
mod tests {
    use statrs::distribution::{Beta, ContinuousCDF, Discrete, Gamma, Normal, Poisson};

    use super::*;
    use crate::rng::{Companion, Purpose, Stream};

    const DRAWS: usize = 100_000;

    /// The largest distance between the distribution of draws and another distribution, times the square root
    /// of the number of draws.
    fn kolmogorov_smirnov(draw: impl Fn(u64) -> f64, cdf: impl Fn(f64) -> f64) -> f64 {
        let mut words = Stream::new(8, Purpose::Environment).companion(Companion::StepNoise);
        let mut draws: Vec<f64> = (0..DRAWS).map(|_| draw(words.bits())).collect();
        draws.sort_by(f64::total_cmp);
        let n = DRAWS as f64;
        let distance = |(i, x): (usize, &f64)| {
            let at = cdf(*x);
            (at - i as f64 / n).max((i + 1) as f64 / n - at)
        };
        draws.iter().enumerate().map(distance).fold(0.0, f64::max) * n.sqrt()
    }

    /// The 99.99 % point of Kolmogorov's distribution.
    const CRITICAL: f64 = 2.23;

    #[test]
    fn expanded_words_are_those_of_splitmix64() {
        // The first outputs for seed 1234567 of Vigna's reference implementation (2015).
        let mut words = Expansion(1_234_567);
        let first = [words.bits(), words.bits(), words.bits()];
        assert_eq!(
            first,
            [6_457_827_717_110_365_317, 3_203_168_211_198_807_973, 9_817_491_932_198_370_423]
        );
    }

    #[test]
    fn normal_deviates_have_their_distribution() {
        let normal = Normal::new(0.0, 1.0).unwrap();
        let distance = kolmogorov_smirnov(|word| Expansion(word).normal(), |x| normal.cdf(x));
        assert!(distance < CRITICAL, "{distance}");
    }

    #[test]
    fn poisson_variates_have_their_distribution() {
        for mean in [0.0, 0.3, 4.0, 9.9, 10.0, 33.3, 120.0, 250.0, 4000.0] {
            let mut words = Stream::new(8, Purpose::Environment).companion(Companion::StepNoise);
            let mut counts = std::collections::BTreeMap::new();
            for _ in 0..DRAWS {
                *counts.entry(poisson(mean, &mut Expansion(words.bits())) as u64).or_insert(0) += 1;
            }
            if mean == 0.0 {
                assert!(counts.keys().eq([&0]));
                continue;
            }
            // Pearson's statistic over counts with at least 20 expected draws, and one cell for the others.
            let law = Poisson::new(mean).unwrap();
            let (mut statistic, mut cells, mut rest) = (0.0, 0.0, DRAWS as f64);
            let mut seen = 0;
            for count in 0..(mean * 2.0 + 40.0) as u64 {
                let expected = law.pmf(count) * DRAWS as f64;
                if expected >= 20.0 {
                    let found = counts.get(&count).copied().unwrap_or(0);
                    statistic += (f64::from(found) - expected).powi(2) / expected;
                    (cells, rest, seen) = (cells + 1.0, rest - expected, seen + found);
                }
            }
            let others = f64::from(DRAWS as i32 - seen);
            if rest > 1.0 {
                statistic += (others - rest).powi(2) / rest;
            }
            // Five standard deviations of a chi-squared variate.
            assert!(
                statistic < cells + 5.0 * f64::sqrt(2.0 * cells),
                "{mean}: {statistic} {cells}"
            );
        }
    }

    #[test]
    fn logarithms_of_factorials_are_exact() {
        for n in [0, 1, 2, 9, 10, 11, 57, 1000, 1_000_000] {
            let exact = statrs::function::factorial::ln_factorial(n);
            assert!((ln_factorial(n as f64) - exact).abs() < 1e-9 * exact.max(1.0), "{n}");
        }
    }

    #[test]
    fn gamma_variates_have_their_distribution() {
        for (mean, deviation) in [
            (170.1, 10.0),
            (17.6, 10.0),
            (2.0, 3.0),
            (10.0, 10.0),
            (33.1, 25.0),
            (0.1, 0.3),
            (1e3, 10.0),
        ] {
            let shape = (mean / deviation) * (mean / deviation);
            let law = Gamma::new(shape, mean / (deviation * deviation)).unwrap();
            let distance = kolmogorov_smirnov(|word| gamma(mean, deviation, word), |x| law.cdf(x));
            assert!(distance < CRITICAL, "{mean} {deviation}: {distance}");
        }
    }

    #[test]
    fn beta_variates_have_their_distribution() {
        for (a, b) in [
            (1.5, 8.5),
            (5.5, 4.5),
            (0.9, 9.1),
            (9.5, 0.5),
            (0.55, 0.45),
            (65.0, 35.0),
            (36.0, 14.0),
            (0.05, 0.5),
            (1.0, 1.0),
        ] {
            let law = Beta::new(a, b).unwrap();
            let distance = kolmogorov_smirnov(|word| beta([a, b], word), |x| law.cdf(x));
            assert!(distance < CRITICAL, "{a} {b}: {distance}");
        }
    }

    #[test]
    fn first_trials_are_those_of_beta_variates() {
        let mut words = Stream::new(10, Purpose::Environment);
        let mut accepted = 0;
        for _ in 0..2000 {
            for shapes in [[1.5, 8.5], [9.5, 0.5], [0.05, 0.5], [65.0, 35.0], [1e-5, 10.0]] {
                let word = words.bits();
                let (first, is_accepted) = first_beta(shapes, word);
                assert!(!is_accepted || first.to_bits() == beta(shapes, word).to_bits());
                accepted += u32::from(is_accepted);
            }
        }
        assert!((9000..10_000).contains(&accepted), "{accepted}");
    }

    #[test]
    fn extreme_shapes_give_finite_numbers() {
        let mut words = Stream::new(9, Purpose::Environment);
        let mut away = 0;
        for _ in 0..20_000 {
            let word = words.bits();
            away += u32::from(beta([1e-5, 10.0], word) > 1e-9);
            away += u32::from(beta([10.0, 1e-5], word) < 1.0 - 1e-9);
            assert!((0.0..=1.0).contains(&beta([1e-5, 1e-5], word)));
            assert!((beta([4e5, 6e5], word) - 0.4).abs() < 0.01);
            for (mean, deviation) in [(1e-5, 10.0), (1e-5, 1e6), (1e6, 1e-6), (0.1, 10.0)] {
                let steps = gamma(mean, deviation, word);
                assert!(steps.is_finite() && steps >= 0.0, "{mean} {deviation}: {steps}");
            }
        }
        // Nearly all variates of both distributions are at a bound; a share of about 2e-4 is not.
        assert!(away < 30, "{away}");
    }
}
