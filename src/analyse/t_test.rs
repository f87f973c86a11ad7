//! Student's, the unpaired and the paired t test, with the interval of the difference.

use super::interval::Interval;
use super::moments::{Moments, vary};
use super::undefined::{Undefined, at_least, finite};
use crate::estimate::two_sided_p;

/// A two-sided t test that a difference of means is 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TTest {
    /// Difference of means, the first minus the second.
    pub difference: f64,
    /// Its standard error, above 0.
    pub standard_error: f64,
    /// Degrees of freedom, at least 1.
    pub df: f64,
    /// Difference over standard error.
    pub t: f64,
    /// Two-sided p value, not corrected for multiple tests; 0 only below 1e-307.
    pub p: f64,
    /// Interval of the difference.
    pub interval: Interval,
}

impl TTest {
    /// `size` is the magnitude of the values, by which the test separates variance from rounding error.
    fn new(difference: f64, standard_error: f64, df: f64, size: f64) -> Result<TTest, Undefined> {
        vary(standard_error, size)?;
        let difference = finite(difference)?;
        let t = finite(difference / standard_error)?;
        let interval = Interval::around(difference, standard_error, df);
        Ok(TTest { difference, standard_error, df, t, p: two_sided_p(t, df), interval })
    }
}

/// Student's t test of two independent arms, which assumes equal variances.
///
/// **Errors**: fewer than two values in an arm, or no variance in either arm.
///
/// **Source**: Student, "The probable error of a mean", 1908; Fisher, 1925.
pub fn student_t_test(first: &[f64], second: &[f64]) -> Result<TTest, Undefined> {
    let ([one, two], [var_1, var_2]) = both(first, second)?;
    let (free_1, free_2) = (one.n as f64 - 1.0, two.n as f64 - 1.0);
    let pooled = finite(((free_1 * var_1 + free_2 * var_2) / (free_1 + free_2)).sqrt())?;
    let standard_error = pooled * (1.0 / one.n as f64 + 1.0 / two.n as f64).sqrt();
    let df = (one.n + two.n - 2) as f64;
    TTest::new(one.mean - two.mean, standard_error, df, one.mean.abs().max(two.mean.abs()))
}

/// The t test of two independent arms whose variances may differ: Welch's standard error, with one degree of
/// freedom less than the smaller arm has seeds.
///
/// It never rejects more often than its level, whatever the variances of normal seeds. Satterthwaite's degrees
/// of freedom, which are estimated, reject too often where one arm has few seeds.
///
/// **Errors**: fewer than two values in an arm, or no variance in either arm.
///
/// **Source**: Mickey and Brown, "Bounds on the distribution functions of the Behrens-Fisher statistic", 1966;
/// Welch, "The generalization of 'Student's' problem when several different population variances are
/// involved", 1947, for the standard error.
pub fn unpaired_t_test(first: &[f64], second: &[f64]) -> Result<TTest, Undefined> {
    let ([one, two], [var_1, var_2]) = both(first, second)?;
    let standard_error = (var_1 / one.n as f64 + var_2 / two.n as f64).sqrt();
    let df = (one.n.min(two.n) - 1) as f64;
    TTest::new(one.mean - two.mean, standard_error, df, one.mean.abs().max(two.mean.abs()))
}

/// Student's t test of the differences of pairs.
///
/// **Errors**: fewer than two pairs, or differences without variance.
///
/// **Source**: Student, "The probable error of a mean", 1908.
pub fn paired_t_test(pairs: &[(f64, f64)]) -> Result<TTest, Undefined> {
    at_least(2, pairs.len())?;
    let differences: Vec<f64> = pairs.iter().map(|(a, b)| a - b).collect();
    let Moments { n, mean, sd } = Moments::of(&differences)?;
    // The rounding error of a difference depends on the size of its operands.
    let size = pairs.iter().map(|(a, b)| a.abs().max(b.abs())).fold(0.0, f64::max);
    TTest::new(mean, sd? / (n as f64).sqrt(), n as f64 - 1.0, size)
}

/// Moments and variances of two arms of at least two values.
fn both(first: &[f64], second: &[f64]) -> Result<([Moments; 2], [f64; 2]), Undefined> {
    at_least(2, first.len().min(second.len()))?;
    let (one, two) = (Moments::of(first)?, Moments::of(second)?);
    let variances = [finite(one.sd?.powi(2))?, finite(two.sd?.powi(2))?];
    Ok(([one, two], variances))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounding_is_not_taken_for_variance() {
        let pairs: Vec<(f64, f64)> =
            [3.0f64, 1001.7, 47.3].map(|x| (x * 1.1 + 0.1, x * 1.1)).to_vec();
        let differences: Vec<f64> = pairs.iter().map(|(a, b)| a - b).collect();
        assert!(Moments::of(&differences).unwrap().sd.unwrap() > 0.0);
        assert_eq!(paired_t_test(&pairs), Err(Undefined::NoVariance));
    }

    #[test]
    fn degenerate_arms_have_a_stated_answer() {
        let few = Err(Undefined::TooFewSeeds { have: 1, need: 2 });
        for test in [student_t_test, unpaired_t_test] {
            assert_eq!(test(&[], &[1.0, 2.0]), Err(Undefined::NoSeeds));
            assert_eq!(test(&[1.0], &[1.0, 2.0]), few);
            assert_eq!(test(&[1.0, 1.0], &[2.0, 2.0]), Err(Undefined::NoVariance));
            assert_eq!(test(&[1e160, 0.0], &[1.0, 2.0]), Err(Undefined::OutOfRange));
            let one_constant = test(&[1.0, 1.0], &[2.0, 3.0, 4.0]).unwrap();
            assert_eq!(one_constant.difference, -2.0);
        }
        assert_eq!(paired_t_test(&[(1.0, 2.0)]), few);
        assert_eq!(unpaired_t_test(&[1.0, 1.0], &[2.0, 3.0, 4.0]).unwrap().df, 1.0);
    }
}
