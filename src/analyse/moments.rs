//! Mean and standard deviation over seeds.

use super::undefined::{Undefined, at_least, finite};

/// Mean and standard deviation of some values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moments {
    /// Number of values, at least 1.
    pub n: usize,
    /// Mean.
    pub mean: f64,
    /// Standard deviation (divisor n - 1), 0 if all values are equal; undefined for one value.
    pub sd: Result<f64, Undefined>,
}

impl Moments {
    /// Moments of these values.
    ///
    /// **Errors**: no values, or numbers out of range.
    pub fn of(values: &[f64]) -> Result<Moments, Undefined> {
        at_least(1, values.len())?;
        let (mean, sd) = mean_and_sd(values);
        let sd = sd.ok_or(Undefined::TooFewSeeds { have: 1, need: 2 });
        Ok(Moments { n: values.len(), mean: finite(mean)?, sd: sd.and_then(finite) })
    }
}

/// Mean and standard deviation (divisor n - 1) of at least one value. A single value has no
/// standard deviation. Equal values have exactly their value as mean, and standard deviation 0.
pub fn mean_and_sd(values: &[f64]) -> (f64, Option<f64>) {
    let n = values.len() as f64;
    let sd = |squares: f64| (values.len() > 1).then(|| (squares / (n - 1.0)).sqrt());
    if let Some(first) = values.first().filter(|first| values.iter().all(|value| value == *first)) {
        return (*first, sd(0.0));
    }
    let mean = values.iter().sum::<f64>() / n;
    (mean, sd(values.iter().map(|value| (value - mean).powi(2)).sum()))
}

/// Checks that a standard error exceeds the rounding error of values of this size.
///
/// **Source**: the rule of R's `t.test` ("data are essentially constant"), ten times the machine epsilon.
pub(super) fn vary(standard_error: f64, size: f64) -> Result<(), Undefined> {
    if finite(standard_error)? > 10.0 * f64::EPSILON * finite(size)?.abs() {
        Ok(())
    } else {
        Err(Undefined::NoVariance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_by_hand() {
        let moments = Moments::of(&[2.0, 4.0, 9.0]).unwrap();
        assert_eq!((moments.n, moments.mean, moments.sd), (3, 5.0, Ok(13f64.sqrt())));
    }

    #[test]
    fn equal_values_have_no_deviation_whatever_rounding_does() {
        assert_ne!([0.1; 3].iter().sum::<f64>() / 3.0, 0.1);
        assert_eq!(mean_and_sd(&[0.1; 3]), (0.1, Some(0.0)));
    }

    #[test]
    fn too_few_and_too_large_values_are_reported() {
        assert_eq!(Moments::of(&[]), Err(Undefined::NoSeeds));
        let one = Moments::of(&[7.0]).unwrap();
        assert_eq!((one.mean, one.sd), (7.0, Err(Undefined::TooFewSeeds { have: 1, need: 2 })));
        assert_eq!(Moments::of(&[f64::MAX, f64::MAX, 0.0]), Err(Undefined::OutOfRange));
        assert_eq!(Moments::of(&[1e200, 0.0]).unwrap().sd, Err(Undefined::OutOfRange));
        assert_eq!(vary(1e-14, 100.0), Err(Undefined::NoVariance));
    }
}
