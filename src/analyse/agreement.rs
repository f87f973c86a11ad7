//! Whether two numbers with their uncertainties agree: ours and a published one.

use super::interval::Interval;
use super::moments::{Moments, vary};
use super::student::t_of_p;
use super::t_test::TTest;
use super::undefined::{Undefined, finite};

/// A number and how uncertain it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The number.
    pub value: f64,
    /// Its standard error, above 0.
    pub standard_error: f64,
    /// Degrees of freedom of the standard error, at least 1.
    pub df: f64,
}

impl Estimate {
    /// The mean of some values.
    ///
    /// **Errors**: fewer than two values, or values that do not differ.
    pub fn of_mean(values: &[f64]) -> Result<Estimate, Undefined> {
        let Moments { n, mean, sd } = Moments::of(values)?;
        let standard_error = sd? / (n as f64).sqrt();
        vary(standard_error, mean)?;
        Ok(Estimate { value: mean, standard_error, df: n as f64 - 1.0 })
    }

    /// A difference that a t test was made of.
    pub fn of_test(test: &TTest) -> Estimate {
        let TTest { difference: value, standard_error, df, .. } = *test;
        Estimate { value, standard_error, df }
    }

    /// A difference that is published with the p value of its two-sided t test alone: the standard
    /// error is what makes that p.
    ///
    /// A p printed as 0.00000 is to be given as the largest number that is printed so.
    ///
    /// **Errors**: a difference of 0, a p that is not between 0 and 1, fewer than one degree of
    /// freedom.
    pub fn of_published(difference: f64, p: f64, df: f64) -> Result<Estimate, Undefined> {
        if difference == 0.0 || !(p > 0.0 && p < 1.0) || !(df >= 1.0 && df.is_finite()) {
            return Err(Undefined::OutOfRange);
        }
        let standard_error = finite(difference.abs() / t_of_p(p, df))?;
        Ok(Estimate { value: finite(difference)?, standard_error, df })
    }
}

/// Whether the difference of two estimates can be chance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// 0 lies in the joint interval.
    Inside,
    /// It does not.
    Outside,
}

/// Two estimates of one quantity, compared.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Agreement {
    /// The first minus the second.
    pub difference: f64,
    /// Joint interval of the difference.
    pub interval: Interval,
    /// What it says.
    pub verdict: Verdict,
}

/// Compares two independent estimates: the joint standard error is the root of the sum of squares,
/// its degrees of freedom Welch and Satterthwaite's.
///
/// **Errors**: numbers out of range.
///
/// **Source**: Satterthwaite, "An approximate distribution of estimates of variance components",
/// 1946.
pub fn agreement(first: &Estimate, second: &Estimate) -> Result<Agreement, Undefined> {
    let (part_1, part_2) = (first.standard_error.powi(2), second.standard_error.powi(2));
    let share = part_1 / (part_1 + part_2);
    let df = finite(1.0 / (share.powi(2) / first.df + (1.0 - share).powi(2) / second.df))?;
    let difference = finite(first.value - second.value)?;
    let interval = Interval::around(difference, finite((part_1 + part_2).sqrt())?, df);
    let verdict = if interval.contains(0.0) { Verdict::Inside } else { Verdict::Outside };
    Ok(Agreement { difference, interval, verdict })
}
