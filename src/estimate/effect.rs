//! Estimates with their standard errors, intervals and p-values.

use super::student::{t_of_p, two_sided_p};
use crate::job::Effect;

/// The probability outside of a confidence interval.
const OUTSIDE: f64 = 0.05;

/// An effect without a standard error yet.
pub(super) fn unfinished(
    value: f64,
    degrees_of_freedom: f64,
    decisions: u64,
    residual_sd: f64,
) -> Effect {
    Effect {
        value,
        standard_error: f64::NAN,
        degrees_of_freedom,
        low: f64::NAN,
        high: f64::NAN,
        p_value: f64::NAN,
        decisions,
        residual_sd,
        truth: None,
        treatment_variance: None,
        effective_sample_size: None,
    }
}

/// An effect with this standard error, and with the interval and the p-value that follow from it.
///
/// **Errors**: the standard error is 0 or not a number, or a number is too large to be stored.
pub(crate) fn with_standard_error(effect: Effect, standard_error: f64) -> Result<Effect, String> {
    if standard_error.is_nan() {
        return Err("its standard error is not a number".to_owned());
    }
    if standard_error <= 0.0 {
        return Err("its standard error is 0".to_owned());
    }
    let (value, df) = (effect.value, effect.degrees_of_freedom);
    let (low, high) = {
        let half = t_of_p(OUTSIDE, df) * standard_error;
        (value - half, value + half)
    };
    let numbers = [value, standard_error, low, high, effect.residual_sd];
    // The negation holds for NaN, too.
    if !numbers.iter().all(|number| number.abs() < 1e300) {
        return Err("its numbers are too large".to_owned());
    }
    let p_value = two_sided_p(value / standard_error, df);
    Ok(Effect { standard_error, low, high, p_value, ..effect })
}
