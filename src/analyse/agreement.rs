//! Agreement of our numbers with published ones, given the uncertainty of both.

use super::interval::Interval;
use super::moments::{Moments, vary};
use super::t_test::{TTest, unpaired_t_test};
use super::undefined::{Undefined, finite};
use crate::estimate::t_of_p;

/// A number with its uncertainty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UncertainNumber {
    /// The number.
    pub value: f64,
    /// Its standard error, above 0.
    pub standard_error: f64,
    /// Degrees of freedom of the standard error, at least 1.
    pub df: f64,
}

impl UncertainNumber {
    /// The mean of some values.
    ///
    /// **Errors**: fewer than two values, or values without variance.
    pub fn of_mean(values: &[f64]) -> Result<UncertainNumber, Undefined> {
        let Moments { n, mean, sd } = Moments::of(values)?;
        let standard_error = sd? / (n as f64).sqrt();
        vary(standard_error, mean)?;
        Ok(UncertainNumber { value: mean, standard_error, df: n as f64 - 1.0 })
    }

    /// The difference that a t test compares with 0.
    pub fn of_test(test: &TTest) -> UncertainNumber {
        let TTest { difference: value, standard_error, df, .. } = *test;
        UncertainNumber { value, standard_error, df }
    }

    /// The difference of the means of two independent arms, with Satterthwaite's degrees of freedom.
    ///
    /// **Errors**: fewer than two values in an arm, or no variance in either arm.
    ///
    /// **Source**: Welch, "The generalization of 'Student's' problem when several different population
    /// variances are involved", 1947.
    pub fn of_difference(first: &[f64], second: &[f64]) -> Result<UncertainNumber, Undefined> {
        let TTest { difference: value, standard_error, .. } = unpaired_t_test(first, second)?;
        let part = |values: &[f64]| -> Result<(f64, f64), Undefined> {
            let Moments { n, sd, .. } = Moments::of(values)?;
            // Shares of the variance avoid fourth powers of deviations, which could overflow or underflow.
            let share = (sd? / standard_error).powi(2) / n as f64;
            Ok((share, n as f64 - 1.0))
        };
        let ((share_1, free_1), (share_2, free_2)) = (part(first)?, part(second)?);
        let df = 1.0 / (share_1.powi(2) / free_1 + share_2.powi(2) / free_2);
        Ok(UncertainNumber { value, standard_error, df })
    }

    /// The estimate of a difference that is published with only the p value of its two-sided t
    /// test. The standard error is the value that yields this p.
    ///
    /// For a p printed as 0.00000, pass the upper bound of the values that are printed so.
    ///
    /// **Errors**: the difference is 0, `p` is not strictly between 0 and 1, or `df` is below 1.
    pub fn of_published(difference: f64, p: f64, df: f64) -> Result<UncertainNumber, Undefined> {
        if difference == 0.0 || !(p > 0.0 && p < 1.0) || !(df >= 1.0 && df.is_finite()) {
            return Err(Undefined::OutOfRange);
        }
        let standard_error = finite(difference.abs() / t_of_p(p, df))?;
        Ok(UncertainNumber { value: finite(difference)?, standard_error, df })
    }
}

/// Whether chance can explain the difference between two estimates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The joint interval contains 0.
    Inside,
    /// The joint interval excludes 0.
    Outside,
}

/// The comparison of two estimates of one quantity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Agreement {
    /// The first minus the second.
    pub difference: f64,
    /// Joint interval of the difference.
    pub interval: Interval,
    /// The verdict.
    pub verdict: Verdict,
    /// The smallest margin within which two one-sided t tests at 5 % find the estimates equivalent.
    pub equivalence_bound: f64,
}

/// Compares two independent estimates. The joint standard error is the root of the sum of squares;
/// its degrees of freedom follow Welch and Satterthwaite.
///
/// **Errors**: numbers out of range.
///
/// **Source**: Satterthwaite, "An approximate distribution of estimates of variance components",
/// 1946.
pub fn agreement(
    first: &UncertainNumber,
    second: &UncertainNumber,
) -> Result<Agreement, Undefined> {
    let (part_1, part_2) = (first.standard_error.powi(2), second.standard_error.powi(2));
    let share = part_1 / (part_1 + part_2);
    let df = finite(1.0 / (share.powi(2) / first.df + (1.0 - share).powi(2) / second.df))?;
    judged(first.value - second.value, (part_1 + part_2).sqrt(), df)
}

/// Level of each of the two one-sided tests.
const ONE_SIDED: f64 = 0.05;

/// The agreement for a difference with its joint standard error.
///
/// **Source**: Schuirmann, "A comparison of the two one-sided tests procedure and the power approach for
/// assessing the equivalence of average bioavailability", 1987, for the equivalence bound.
fn judged(difference: f64, standard_error: f64, df: f64) -> Result<Agreement, Undefined> {
    let difference = finite(difference)?;
    let interval = Interval::around(difference, finite(standard_error)?, df);
    let verdict = if interval.contains(0.0) { Verdict::Inside } else { Verdict::Outside };
    let equivalence_bound = difference.abs() + t_of_p(2.0 * ONE_SIDED, df) * standard_error;
    Ok(Agreement { difference, interval, verdict, equivalence_bound })
}

/// The uncertainty of a number that is published without one, on the assumption that its seeds vary
/// as much as ours.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Likeness {
    /// Standard error of the published number.
    pub published_error: f64,
    /// Standard error of our number minus the published one.
    pub joint_error: f64,
    /// Degrees of freedom of the joint standard error.
    pub df: f64,
}

impl Likeness {
    /// The likeness of a mean (one arm) or of a difference of means (two arms). `arms` holds our
    /// values of each arm, `seeds` is the number of seeds behind each published mean, and
    /// `reading_sd` is the standard deviation of the error in reading the published number.
    ///
    /// The variance of an arm affects both numbers but is estimated once, from our n values. The
    /// joint variance is therefore the sum over arms of sd² (1/n + 1/seeds). It has the n - 1
    /// degrees of freedom of sd²; two arms are combined by Satterthwaite's formula. The reading
    /// error adds a known variance, which the degrees of freedom ignore. Including it would raise
    /// the degrees of freedom, and with few seeds the intervals would be too narrow where the
    /// reading error is about as large as the standard error.
    ///
    /// **Errors**: fewer than two values in an arm, or no arm with variance.
    pub fn new(arms: &[&[f64]], seeds: f64, reading_sd: f64) -> Result<Likeness, Undefined> {
        let (mut joint, mut published, mut squares) = (0.0, 0.0, 0.0);
        let mut size = 0.0_f64;
        for values in arms {
            let Moments { n, mean, sd } = Moments::of(values)?;
            let (n, variance) = (n as f64, sd?.powi(2));
            let part = variance * (1.0 / n + 1.0 / seeds);
            (joint, published) = (joint + part, published + variance / seeds);
            squares += part.powi(2) / (n - 1.0);
            size = size.max(mean.abs());
        }
        vary(joint.sqrt(), size)?;
        let with_reading = |variance: f64| finite((variance + reading_sd.powi(2)).sqrt());
        Ok(Likeness {
            published_error: with_reading(published)?,
            joint_error: with_reading(joint)?,
            df: finite(joint.powi(2) / squares)?,
        })
    }

    /// The agreement of our number with the published one, given our number minus the published one.
    ///
    /// **Errors**: numbers out of range.
    pub fn agreement(&self, difference: f64) -> Result<Agreement, Undefined> {
        judged(difference, self.joint_error, self.df)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_variance_that_is_estimated_once_counts_its_degrees_of_freedom_once() {
        // The standard deviation is 4: 16 (1/3 + 1/3) = 32/3, with two degrees of freedom.
        let of_one = Likeness::new(&[&[96.0, 100.0, 104.0]], 3.0, 0.0).unwrap();
        assert!((of_one.published_error - (16f64 / 3.0).sqrt()).abs() < 1e-12);
        assert!((of_one.joint_error - (32f64 / 3.0).sqrt()).abs() < 1e-12);
        assert!((of_one.df - 2.0).abs() < 1e-12);
        // A reading error of 2 adds 4 to both variances.
        let read = Likeness::new(&[&[96.0, 100.0, 104.0]], 3.0, 2.0).unwrap();
        assert!((read.published_error - (28f64 / 3.0).sqrt()).abs() < 1e-12);
        assert!((read.joint_error - (44f64 / 3.0).sqrt()).abs() < 1e-12);
        assert!((read.df - 2.0).abs() < 1e-12);
        // With equal variances, the degrees of freedom of two arms add up.
        let of_two = Likeness::new(&[&[96.0, 100.0, 104.0], &[1.0, 5.0, 9.0]], 3.0, 0.0).unwrap();
        assert!((of_two.joint_error - (64f64 / 3.0).sqrt()).abs() < 1e-12);
        assert!((of_two.df - 4.0).abs() < 1e-12);
        // The 97.5 % quantile of t with 2 degrees of freedom is 4.302653.
        let width = of_one.agreement(10.0).unwrap().interval.high - 10.0;
        assert!((width - 4.302_652_729_7 * (32f64 / 3.0).sqrt()).abs() < 1e-8);
    }

    #[test]
    fn what_does_not_vary_says_nothing_of_a_published_number() {
        let compare = |arms: &[&[f64]]| Likeness::new(arms, 3.0, 8.0);
        assert_eq!(compare(&[&[5.0; 3]]), Err(Undefined::NoVariance));
        assert_eq!(compare(&[&[5.0]]), Err(Undefined::TooFewSeeds { have: 1, need: 2 }));
        assert_eq!(compare(&[&[5.0, 6.0], &[]]), Err(Undefined::NoSeeds));
        // One arm with variance is enough, as for a t test.
        assert!((compare(&[&[5.0; 3], &[5.0, 6.0]]).unwrap().df - 1.0).abs() < 1e-12);
    }
}
