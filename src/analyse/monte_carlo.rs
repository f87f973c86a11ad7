//! The p-value of a number against numbers that were simulated under the null hypothesis.

use super::undefined::{Undefined, at_least};

/// The two-sided p-value of a number against draws of its distribution under the null hypothesis: twice the smaller of
/// the shares of draws at least and at most as large, the number itself counted among the draws; at most 1.
///
/// **Source**: Davison and Hinkley, "Bootstrap Methods and their Application", 1997, section 4.2.5.
pub fn monte_carlo_p(number: f64, draws: &[f64]) -> Result<f64, Undefined> {
    at_least(1, draws.len())?;
    if number.is_nan() || draws.iter().any(|draw| draw.is_nan()) {
        return Err(Undefined::OutOfRange);
    }
    let share = |counts: &dyn Fn(&&f64) -> bool| {
        (1 + draws.iter().filter(counts).count()) as f64 / (1 + draws.len()) as f64
    };
    let tail = share(&|draw| **draw >= number).min(share(&|draw| **draw <= number));
    Ok((2.0 * tail).min(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn p_values_by_hand() {
        let draws: Vec<f64> = (1..=19).map(f64::from).collect();
        // No draw is larger, so that the number is the largest of twenty.
        assert_eq!(monte_carlo_p(19.5, &draws), Ok(0.1));
        assert_eq!(monte_carlo_p(0.0, &draws), Ok(0.1));
        // 18 and 19 are at least as large.
        assert_eq!(monte_carlo_p(18.0, &draws), Ok(0.3));
        assert_eq!(monte_carlo_p(10.0, &draws), Ok(1.0));
        assert_eq!(monte_carlo_p(1.0, &[]), Err(Undefined::NoSeeds));
        assert_eq!(monte_carlo_p(f64::NAN, &draws), Err(Undefined::OutOfRange));
    }
}
