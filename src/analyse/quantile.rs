//! Quantiles, among them the lower-quartile return.

use super::undefined::{Undefined, at_least};
use crate::job::metric::quantile_of_sorted;

/// The quantile at `share`, from 0 to 1, by linear interpolation between the ordered values.
///
/// **Errors**: no values, or a value or share that is out of range.
///
/// **Source**: Hyndman and Fan, "Sample quantiles in statistical packages", 1996, definition 7: the
/// default of NumPy and R.
pub fn quantile(values: &[f64], share: f64) -> Result<f64, Undefined> {
    at_least(1, values.len())?;
    if !(0.0..=1.0).contains(&share) || values.iter().any(|value| !value.is_finite()) {
        return Err(Undefined::OutOfRange);
    }
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    Ok(quantile_of_sorted(&sorted, share))
}

/// Lower quartile of the returns of a policy's test episodes: a quarter of the participants have a
/// lower return. It is a metric of one policy; intervals and tests are over seeds.
///
/// **Errors**: no values, or values that are not finite.
pub fn lower_quartile(returns: &[f64]) -> Result<f64, Undefined> {
    quantile(returns, 0.25)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quartiles_by_hand() {
        assert_eq!(lower_quartile(&[4.0, 1.0, 3.0, 2.0]), Ok(1.75));
        assert_eq!(lower_quartile(&[7.0]), Ok(7.0));
        assert_eq!(quantile(&[1.0, 2.0, 3.0], 1.0), Ok(3.0));
        assert_eq!(quantile(&[5.0, 5.0], 0.3), Ok(5.0));
    }

    #[test]
    fn what_has_no_quantile_is_reported() {
        assert_eq!(lower_quartile(&[]), Err(Undefined::NoSeeds));
        assert_eq!(lower_quartile(&[1.0, f64::NAN]), Err(Undefined::OutOfRange));
        assert_eq!(quantile(&[1.0], 1.5), Err(Undefined::OutOfRange));
    }
}
