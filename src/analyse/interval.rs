//! Confidence intervals, all of the same level.

use super::moments::{Moments, vary};
use super::undefined::Undefined;
use crate::estimate::t_of_p;

/// Confidence level of every interval.
pub const LEVEL: f64 = 0.95;

/// The z that bounds the central [`LEVEL`] of the standard normal distribution: the limit of
/// [`critical`] for many degrees of freedom.
pub(super) const NORMAL_CRITICAL: f64 = 1.959963984540054;

/// The t that bounds the central [`LEVEL`] of Student's distribution with `df` degrees of freedom.
pub(super) fn critical(df: f64) -> f64 {
    t_of_p(1.0 - LEVEL, df)
}

/// A confidence interval of level [`LEVEL`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interval {
    /// Lower end.
    pub low: f64,
    /// Upper end, at least the lower end.
    pub high: f64,
}

impl Interval {
    /// Whether a number lies inside, the ends included.
    pub fn contains(&self, number: f64) -> bool {
        (self.low..=self.high).contains(&number)
    }

    /// The interval of Student's t around a centre.
    pub(super) fn around(centre: f64, standard_error: f64, df: f64) -> Interval {
        let half = critical(df) * standard_error;
        Interval { low: centre - half, high: centre + half }
    }
}

/// Interval of the mean of shares, which stays between 0 and 1: Student's interval of the logit of the mean, whose
/// standard error is that of the mean divided by m (1 - m).
///
/// **Errors**: fewer than two values, or values without variance.
///
/// **Source**: Agresti, "Categorical Data Analysis", 3rd ed., 2013, section 3.1, for the delta method.
pub fn share_interval(values: &[f64]) -> Result<Interval, Undefined> {
    let Moments { n, mean, sd } = Moments::of(values)?;
    let standard_error = sd? / (n as f64).sqrt();
    vary(standard_error, mean)?;
    let logit = (mean / (1.0 - mean)).ln();
    let error = standard_error / (mean * (1.0 - mean));
    let Interval { low, high } = Interval::around(logit, error, n as f64 - 1.0);
    let share = |logit: f64| 1.0 / (1.0 + (-logit).exp());
    Ok(Interval { low: share(low), high: share(high) })
}

/// Interval of the mean: mean ± t(0.975, n - 1) sd / sqrt(n).
///
/// **Errors**: fewer than two values, or values without variance.
///
/// **Source**: Student, "The probable error of a mean", 1908.
pub fn mean_interval(values: &[f64]) -> Result<Interval, Undefined> {
    let Moments { n, mean, sd } = Moments::of(values)?;
    let standard_error = sd? / (n as f64).sqrt();
    vary(standard_error, mean)?;
    Ok(Interval::around(mean, standard_error, n as f64 - 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_of_shares_stay_between_0_and_1() {
        let values = [0.9, 0.8, 1.0];
        assert!(mean_interval(&values).unwrap().high > 1.0);
        let Interval { low, high } = share_interval(&values).unwrap();
        assert!(
            (low - 0.362870147332).abs() < 1e-9 && (high - 0.993017751843).abs() < 1e-9,
            "{low} {high}"
        );
        assert_eq!(share_interval(&[1.0; 3]), Err(Undefined::NoVariance));
        assert_eq!(share_interval(&[0.0; 3]), Err(Undefined::NoVariance));
        assert_eq!(share_interval(&[0.5]), Err(Undefined::TooFewSeeds { have: 1, need: 2 }));
    }
}
