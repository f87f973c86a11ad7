//! Hedges' g: a difference in standard deviations, corrected for few seeds.

use super::interval::Interval;
use super::noncentral::shift_interval;
use super::t_test::{paired_t_test, student_t_test};
use super::undefined::{Undefined, at_least};

/// A standardised difference of means.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HedgesG {
    /// Difference divided by the standard deviation, times the bias correction.
    pub g: f64,
    /// Interval of the standardised difference; exact for normal values.
    pub interval: Interval,
}

/// Hedges' g of two independent arms: (mean 1 - mean 2) / pooled sd, times J(n1 + n2 - 2).
///
/// The interval contains the standardised differences that are compatible with the observed t, by
/// the noncentral t distribution. Approximate formulas for the variance of g are not used: they are
/// far off with three to ten seeds and differences of many standard deviations.
///
/// **Errors**: fewer than two values in an arm, or no variance in either arm.
///
/// **Source**: Hedges, "Distribution theory for Glass's estimator of effect size and related
/// estimators", 1981; the interval: Steiger and Fouladi, 1997.
pub fn hedges_g(first: &[f64], second: &[f64]) -> Result<HedgesG, Undefined> {
    let test = student_t_test(first, second)?;
    standardise(test.t, test.df, (1.0 / first.len() as f64 + 1.0 / second.len() as f64).sqrt())
}

/// Hedges' g of pairs: mean difference / sd of the differences, times J(n - 1). Its unit is the
/// standard deviation of the differences, so it is not comparable with the g of independent arms.
///
/// **Errors**: fewer than three pairs (with two pairs, the expectation of g is infinite), or
/// differences without variance.
///
/// **Source**: as [`hedges_g`].
pub fn paired_hedges_g(pairs: &[(f64, f64)]) -> Result<HedgesG, Undefined> {
    at_least(3, pairs.len())?;
    let test = paired_t_test(pairs)?;
    standardise(test.t, test.df, 1.0 / (pairs.len() as f64).sqrt())
}

/// Hedges' g from t; `scale` converts t to a difference in standard deviations.
fn standardise(t: f64, df: f64, scale: f64) -> Result<HedgesG, Undefined> {
    let Interval { low, high } = shift_interval(t, df)?;
    let interval = Interval { low: low * scale, high: high * scale };
    Ok(HedgesG { g: t * scale * correction(df), interval })
}

/// J(df) = Γ(df / 2) / (sqrt(df / 2) Γ((df - 1) / 2)), for at least two degrees of freedom.
fn correction(df: f64) -> f64 {
    let half = df / 2.0;
    (libm::lgamma(half) - libm::lgamma(half - 0.5)).exp() / half.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_correction_by_hand() {
        // Γ(1) / Γ(1/2), and Γ(3/2) / (sqrt(3/2) Γ(1)).
        let root_of_pi = std::f64::consts::PI.sqrt();
        assert!((correction(2.0) - 1.0 / root_of_pi).abs() < 1e-15);
        assert!((correction(3.0) - root_of_pi / 6f64.sqrt()).abs() < 1e-15);
    }

    #[test]
    fn too_few_seeds_are_reported() {
        let pairs = [(1.0, 2.0), (2.0, 2.5)];
        let few = Undefined::TooFewSeeds { have: 2, need: 3 };
        assert_eq!(paired_hedges_g(&pairs), Err(few));
        assert_eq!(hedges_g(&[1.0; 3], &[2.0; 3]), Err(Undefined::NoVariance));
    }
}
