//! The recovered share of a loss.

use super::interval::{Interval, critical};
use super::moments::Moments;
use super::undefined::{Undefined, at_least, finite};

/// A recovered share of a loss, with its interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Recovered {
    /// The share: 0 for nothing, 1 for the whole loss, above 1 beyond the optimum.
    pub share: f64,
    /// Its interval.
    pub interval: Result<Interval, Undefined>,
}

/// The share of the loss of `without` against a known optimum that `with` recovers: (mean of `with`
/// - mean of `without`) / (optimum - mean of `without`). The samples are independent.
///
/// The interval contains every share R for which Welch's t test does not reject the hypothesis that
/// the mean of `with` is (1 - R) times the mean of `without` plus R times the optimum. The degrees
/// of freedom are computed at the estimated share.
///
/// **Errors**: a sample is empty, or the mean of `without` is not below the optimum.
///
/// **Source**: Fieller, "Some problems in interval estimation", 1954; Welch, "The generalization of
/// 'Student's' problem when several different population variances are involved", 1947.
pub fn recovered(with: &[f64], without: &[f64], optimum: f64) -> Result<Recovered, Undefined> {
    let (with, without) = (Moments::of(with)?, Moments::of(without)?);
    let (gain, loss) = (with.mean - without.mean, optimum - without.mean);
    if loss <= 0.0 {
        return Err(Undefined::NoLoss);
    }
    let share = finite(gain / loss)?;
    Ok(Recovered { share, interval: interval(&with, &without, gain, loss) })
}

fn interval(
    with: &Moments,
    without: &Moments,
    gain: f64,
    loss: f64,
) -> Result<Interval, Undefined> {
    at_least(2, with.n.min(without.n))?;
    // Squared standard errors of the means.
    let squared = |moments: &Moments| Ok(moments.sd?.powi(2) / moments.n as f64);
    let (of_with, of_without): (f64, f64) = (squared(with)?, squared(without)?);
    let left = 1.0 - gain / loss;
    let parts = [(of_with, with.n), (left * left * of_without, without.n)];
    let all: f64 = parts.iter().map(|(part, _)| part).sum();
    if all == 0.0 {
        return Err(Undefined::NoVariance);
    }
    let inverse_df: f64 = parts.iter().map(|(part, n)| part.powi(2) / (*n as f64 - 1.0)).sum();
    let t = critical(all * all / inverse_df);
    // (gain - R loss)^2 <= t^2 (of_with + (1 - R)^2 of_without), a quadratic inequality in R.
    let square = loss * loss - t * t * of_without;
    if square <= 0.0 {
        return Err(Undefined::NoLoss);
    }
    let linear = gain * loss - t * t * of_without;
    let constant = gain * gain - t * t * (of_with + of_without);
    let root = finite((linear * linear - square * constant).max(0.0).sqrt())?;
    Ok(Interval { low: (linear - root) / square, high: (linear + root) / square })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_share_is_that_by_hand() {
        // The means are 90 and 60, and the optimum is 100: 30 of 40 are recovered.
        let found = recovered(&[88.0, 92.0], &[58.0, 62.0], 100.0).unwrap();
        assert_eq!(found.share, 0.75);
        let nothing = recovered(&[60.0, 61.0], &[60.0, 61.0], 100.0).unwrap();
        assert_eq!(nothing.share, 0.0);
        assert_eq!(recovered(&[1.0], &[100.0], 100.0), Err(Undefined::NoLoss));
        assert_eq!(recovered(&[], &[1.0], 100.0), Err(Undefined::NoSeeds));
        let one = recovered(&[90.0], &[60.0], 100.0).unwrap();
        assert_eq!(one.interval, Err(Undefined::TooFewSeeds { have: 1, need: 2 }));
    }

    #[test]
    fn a_loss_without_spread_leaves_the_interval_of_the_mean() {
        // Student's t with 2 degrees of freedom is 4.302653; the standard error of the mean is 1.
        let root = 3f64.sqrt();
        let found = recovered(&[90.0 - root, 90.0, 90.0 + root], &[60.0; 3], 100.0).unwrap();
        let Interval { low, high } = found.interval.unwrap();
        assert!((low - (0.75 - 4.302653 / 40.0)).abs() < 1e-6, "{low}");
        assert!((high - (0.75 + 4.302653 / 40.0)).abs() < 1e-6, "{high}");
    }

    #[test]
    fn the_ends_of_the_interval_are_where_the_test_just_rejects() {
        let (with, without) = ([3100.0, 3050.0, 3180.0, 3120.0], [2700.0, 2900.0, 2760.0, 2650.0]);
        let optimum = 3300.0;
        let found = recovered(&with, &without, optimum).unwrap();
        let Interval { low, high } = found.interval.unwrap();
        assert!(low < found.share && found.share < high);
        let (m, b) = (Moments::of(&with).unwrap(), Moments::of(&without).unwrap());
        let errors = [m, b].map(|moments| moments.sd.unwrap().powi(2) / 4.0);
        let t = |share: f64| {
            let off = m.mean - (1.0 - share) * b.mean - share * optimum;
            off.abs() / (errors[0] + (1.0 - share).powi(2) * errors[1]).sqrt()
        };
        assert!((t(low) - t(high)).abs() < 1e-6);
        // Between the critical t with 6 and with 3 degrees of freedom.
        assert!((2.4469..3.1825).contains(&t(low)), "{}", t(low));
        // If the loss is not significantly above 0, the interval of the share is unbounded.
        let noisy = recovered(&with, &[3290.0, 3200.0, 3390.0], optimum).unwrap();
        assert_eq!(noisy.interval, Err(Undefined::NoLoss));
    }

    // Two arms of ten seeds with a known share of 0.8; 95 % of the intervals contain it.
    #[test]
    fn intervals_hold_the_true_share_as_often_as_they_say() {
        use crate::rng::{Purpose, Stream};
        let mut stream = Stream::new(1, Purpose::Bootstrap);
        let mut draw = |mean: f64, sd: f64| -> Vec<f64> {
            // Sums of twelve uniform numbers are about normal, with variance 1.
            let mut normal = || (0..12).map(|_| stream.unit()).sum::<f64>() - 6.0;
            (0..10).map(|_| mean + sd * normal()).collect()
        };
        let mut held = 0;
        for _ in 0..2000 {
            let (with, without) = (draw(3100.0, 40.0), draw(2700.0, 120.0));
            let found = recovered(&with, &without, 3200.0).unwrap();
            held += i32::from(found.interval.unwrap().contains(0.8));
        }
        // The expected number is 1900, with a standard deviation of 10.
        assert!((held - 1900).abs() < 40, "{held}");
    }
}
