//! Gamma and beta variates, bit-identical on every instruction set.
//!
//! In: parameters and one random word per variate. Out: the variate. Rejection sampling needs an unknown
//! number of words, so each word is expanded into a sequence. The variates of the next lane and the next step
//! then keep their words, and equal seeds give equal noise for any actions.

use crate::env::step_count::context::{deviate, squared_radius};
use crate::kernel::math;

/// Below this exponent, the exponential counts as 0: at any scale of a simulation, it is near the smallest
/// normal number.
const LEAST_EXPONENT: f64 = -700.0;

/// A sequence of words generated from one word.
///
/// **Source**: Steele, Lea and Flood, "Fast splittable pseudorandom number generators", 2014
/// (SplitMix64).
struct Expansion(u64);

impl Expansion {
    #[inline(always)]
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ (mixed >> 31)
    }

    /// A uniform number in (0, 1), so that its logarithm is finite.
    #[inline(always)]
    fn open_unit(&mut self) -> f64 {
        ((self.bits() >> 12) as f64 + 0.5) * (1.0 / (1u64 << 52) as f64)
    }

    /// A standard normal deviate.
    #[inline(always)]
    fn normal(&mut self) -> f64 {
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

/// A gamma variate with shape above 0 and scale 1.
///
/// **Source**: Marsaglia and Tsang, "A simple method for generating gamma variables", 2000. For a shape below
/// 1, the variate of shape + 1 is multiplied by U^(1/shape).
#[inline(always)]
fn standard_gamma(shape: f64, words: &mut Expansion) -> Scaled {
    let raised = if shape < 1.0 { shape + 1.0 } else { shape };
    let d = raised - 1.0 / 3.0;
    let c = 1.0 / (9.0 * d).sqrt();
    let factor = loop {
        let x = words.normal();
        let root = 1.0 + c * x;
        let u = words.open_unit();
        if root <= 0.0 {
            continue;
        }
        let v = root * root * root;
        let square = x * x;
        if u < 1.0 - 0.0331 * square * square
            || math::ln(u) < 0.5 * square + d * (1.0 - v + math::ln(v))
        {
            break d * v;
        }
    };
    let exponent = if shape < 1.0 { math::ln(words.open_unit()) / shape } else { 0.0 };
    Scaled { factor, exponent }
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

/// A beta variate X / (X + Y) of gamma variates X and Y of the shapes `alpha` and `beta`, both above 0. Uses
/// the difference of their logarithms, because both variates can underflow.
#[inline(always)]
pub(super) fn beta(alpha: f64, beta: f64, word: u64) -> f64 {
    let mut words = Expansion(word);
    let x = standard_gamma(alpha, &mut words).ln();
    let y = standard_gamma(beta, &mut words).ln();
    let apart = y - x;
    if apart > -LEAST_EXPONENT {
        return 0.0;
    }
    1.0 / (1.0 + math::exp(apart))
}

#[cfg(test)]
mod tests {
    use statrs::distribution::{Beta, ContinuousCDF, Gamma, Normal};

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
            let distance = kolmogorov_smirnov(|word| beta(a, b, word), |x| law.cdf(x));
            assert!(distance < CRITICAL, "{a} {b}: {distance}");
        }
    }

    #[test]
    fn extreme_shapes_give_finite_numbers() {
        let mut words = Stream::new(9, Purpose::Environment);
        let mut away = 0;
        for _ in 0..20_000 {
            let word = words.bits();
            away += u32::from(beta(1e-5, 10.0, word) > 1e-9);
            away += u32::from(beta(10.0, 1e-5, word) < 1.0 - 1e-9);
            assert!((0.0..=1.0).contains(&beta(1e-5, 1e-5, word)));
            assert!((beta(4e5, 6e5, word) - 0.4).abs() < 0.01);
            for (mean, deviation) in [(1e-5, 10.0), (1e-5, 1e6), (1e6, 1e-6), (0.1, 10.0)] {
                let steps = gamma(mean, deviation, word);
                assert!(steps.is_finite() && steps >= 0.0, "{mean} {deviation}: {steps}");
            }
        }
        // Nearly all variates of both distributions are at a bound; a share of about 2e-4 is not.
        assert!(away < 30, "{away}");
    }
}
