//! The standard normal distribution, truncated to two bounds, with bit-identical results on every
//! machine.

/// Phi(x), the probability of values below x.
fn below(x: f64) -> f64 {
    0.5 * libm::erfc(-x * std::f64::consts::FRAC_1_SQRT_2)
}

/// The probability between two bounds, which may be infinite.
pub(super) fn mass_between([from, to]: [f64; 2]) -> f64 {
    // By symmetry, computed in the lower tail, where differences are accurate.
    if from > 0.0 { below(-from) - below(-to) } else { below(to) - below(from) }
}

/// The quantile at `share`, in (0, 1), of the distribution truncated to two bounds.
pub(super) fn quantile_between([from, to]: [f64; 2], share: f64) -> f64 {
    if from > 0.0 {
        return -quantile_between([-to, -from], 1.0 - share);
    }
    let (low, high) = (below(from), below(to));
    let probability = low + (high - low) * share;
    // Rounding can give 0 or 1, whose quantiles are infinite. The caller clamps the result to the bounds.
    let probability = probability.clamp(f64::MIN_POSITIVE, 1.0 - f64::EPSILON / 2.0);
    quantile(probability)
}

/// The quantile of the standard normal distribution at a probability in (0, 1).
///
/// **Source**: Wichura, "Algorithm AS 241: the percentage points of the normal distribution", Applied
/// Statistics 37, 1988, routine PPND16; its relative error is about 1e-16.
fn quantile(probability: f64) -> f64 {
    let q = probability - 0.5;
    if q.abs() <= 0.425 {
        let r = 0.180_625 - q * q;
        return q * polynomial(&CENTRE.0, r) / polynomial(&CENTRE.1, r);
    }
    let tail = if q <= 0.0 { probability } else { 1.0 - probability };
    let r = (-libm::log(tail)).sqrt();
    let x = if r <= 5.0 {
        polynomial(&MIDDLE.0, r - 1.6) / polynomial(&MIDDLE.1, r - 1.6)
    } else {
        polynomial(&FAR.0, r - 5.0) / polynomial(&FAR.1, r - 5.0)
    };
    if q < 0.0 { -x } else { x }
}

/// A polynomial of degree 7, the coefficient of the highest power first.
fn polynomial(coefficients: &[f64; 8], x: f64) -> f64 {
    coefficients.iter().fold(0.0, |sum, coefficient| sum * x + coefficient)
}

type Fraction = ([f64; 8], [f64; 8]);

/// For probabilities within 0.425 of 0.5.
const CENTRE: Fraction = (
    [
        2.509_080_928_730_122_7e3,
        3.343_057_558_358_813e4,
        6.726_577_092_700_87e4,
        4.592_195_393_154_987e4,
        1.373_169_376_550_946e4,
        1.971_590_950_306_551_3e3,
        1.331_416_678_917_843_8e2,
        3.387_132_872_796_366_5,
    ],
    [
        5.226_495_278_852_854e3,
        2.872_908_573_572_194_3e4,
        3.930_789_580_009_271e4,
        2.121_379_430_158_659_7e4,
        5.394_196_021_424_751e3,
        6.871_870_074_920_579e2,
        4.231_333_070_160_091e1,
        1.0,
    ],
);

/// For tails with probabilities down to exp(-25).
const MIDDLE: Fraction = (
    [
        7.745_450_142_783_414e-4,
        2.272_384_498_926_918_4e-2,
        2.417_807_251_774_506e-1,
        1.270_458_252_452_368_4,
        3.647_848_324_763_204_5,
        5.769_497_221_460_691,
        4.630_337_846_156_546,
        1.423_437_110_749_683_5,
    ],
    [
        1.050_750_071_644_416_9e-9,
        5.475_938_084_995_345e-4,
        1.519_866_656_361_645_7e-2,
        1.481_039_764_274_800_8e-1,
        6.897_673_349_851e-1,
        1.676_384_830_183_803_8,
        2.053_191_626_637_759,
        1.0,
    ],
);

/// For tails with probabilities below exp(-25).
const FAR: Fraction = (
    [
        2.010_334_399_292_288_1e-7,
        2.711_555_568_743_487_6e-5,
        1.242_660_947_388_078_4e-3,
        2.653_218_952_657_612_4e-2,
        2.965_605_718_285_048_7e-1,
        1.784_826_539_917_291_3,
        5.463_784_911_164_114,
        6.657_904_643_501_103,
    ],
    [
        2.044_263_103_389_939_8e-15,
        1.421_511_758_316_446e-7,
        1.846_318_317_510_054_7e-5,
        7.868_691_311_456_133e-4,
        1.487_536_129_085_061_5e-2,
        1.369_298_809_227_358e-1,
        5.998_322_065_558_88e-1,
        1.0,
    ],
);

#[cfg(test)]
mod tests {
    use statrs::distribution::{ContinuousCDF, Normal};

    use super::*;

    #[test]
    fn quantiles_are_those_of_another_implementation() {
        let normal = Normal::new(0.0, 1.0).unwrap();
        for exponent in 1..300 {
            for probability in [10f64.powi(-exponent), 1.0 - 10f64.powi(-exponent)] {
                if probability == 1.0 {
                    continue;
                }
                let (ours, theirs) = (quantile(probability), normal.inverse_cdf(probability));
                assert!((ours - theirs).abs() < 1e-8 * theirs.abs(), "{ours} {theirs}");
                // And back again.
                let back = below(ours);
                assert!((back / probability - 1.0).abs() < 1e-11, "{probability} {back}");
            }
        }
        for i in 1..1000 {
            let probability = f64::from(i) / 1000.0;
            assert!((below(quantile(probability)) - probability).abs() < 1e-15);
        }
    }

    #[test]
    fn shares_between_bounds_are_those_of_the_whole() {
        for [from, to] in [[-1.0, 2.0], [0.5, 3.0], [-6.0, -5.0], [5.0, f64::INFINITY]] {
            let mass = mass_between([from, to]);
            for share in [1e-6, 0.1, 0.5, 0.9] {
                let x = quantile_between([from, to], share);
                let found = mass_between([from, x]) / mass;
                assert!((found / share - 1.0).abs() < 1e-6, "{from} {to} {share}: {found}");
            }
        }
    }
}
