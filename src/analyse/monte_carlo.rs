//! Numbers over simulated trials: the p-value against trials under the null hypothesis, and the error of any number.

use super::interval::Interval;
use super::operating::MonteCarloMean;
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

/// A number over trials with its Monte Carlo interval, from its values without each of some groups of trials, by Student's t.
/// Without an interval for fewer than two groups, and where all of them give the same number but for rounding, as a share
/// of no trial does.
///
/// **Source**: Shao and Wu, "A general theory for jackknife variance estimation", Annals of Statistics 17, 1989, for groups,
/// with which numbers that are not smooth, such as a median, have an error, too.
pub fn jackknife(value: f64, without_each: &[f64]) -> MonteCarloMean {
    let groups = without_each.len() as f64;
    let interval = at_least(2, without_each.len()).and_then(|()| {
        if without_each.iter().all(|one| (one - value).abs() <= 1e-12 * value.abs()) {
            return Err(Undefined::NoMonteCarloError);
        }
        let mean = without_each.iter().sum::<f64>() / groups;
        let squares = without_each.iter().map(|one| (one - mean) * (one - mean)).sum::<f64>();
        Ok(Interval::around(value, ((groups - 1.0) / groups * squares).sqrt(), groups - 1.0))
    });
    MonteCarloMean { value, interval }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_jackknife_of_a_mean_is_its_standard_error() {
        // Of 1, 2 and 6: s²/n = 7/3.
        let Interval { low, high } = jackknife(3.0, &[4.0, 3.5, 1.5]).interval.unwrap();
        let half = crate::estimate::t_of_p(0.05, 2.0) * (7.0_f64 / 3.0).sqrt();
        assert!((low - 3.0 + half).abs() < 1e-12 && (high - 3.0 - half).abs() < 1e-12);
        let none = jackknife(3.0, &[]).interval;
        assert_eq!(none, Err(Undefined::NoSeeds));
        // No trial of any group counts, or all do: no interval of no length.
        for share in [0.0, 1.0] {
            let same = jackknife(share, &[share; 20]).interval;
            assert_eq!(same, Err(Undefined::NoMonteCarloError));
        }
        assert_eq!(jackknife(0.1, &[0.1 + 1e-16; 3]).interval, Err(Undefined::NoMonteCarloError));
    }

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
