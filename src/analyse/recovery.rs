//! The recovered share of a loss.

use super::contrast::SeedPairing;
use super::interval::{Interval, critical};
use super::moments::{Moments, vary};
use super::sample::Sample;
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
/// - mean of `without`) / (optimum - mean of `without`). Of matched samples, the seeds of both count.
///
/// The interval contains every share R for which the t test of the design does not reject the hypothesis that
/// the mean of `with` is (1 - R) times the mean of `without` plus R times the optimum.
///
/// **Errors**: a sample is empty, no seed is in both of two matched samples, or the mean of `without` is not
/// below the optimum.
///
/// **Source**: Fieller, "Some problems in interval estimation", 1954; [`unpaired_t_test`](super::unpaired_t_test)
/// for the degrees of freedom of independent samples.
pub fn recovered(
    with: &Sample,
    without: &Sample,
    optimum: f64,
    design: SeedPairing,
) -> Result<Recovered, Undefined> {
    let (of_with, of_without): (Vec<f64>, Vec<f64>) = match design {
        SeedPairing::Independent => (with.values().to_vec(), without.values().to_vec()),
        SeedPairing::Matched => with.matched(without)?.into_iter().unzip(),
    };
    let (with, without) = (Moments::of(&of_with)?, Moments::of(&of_without)?);
    let (gain, loss) = (with.mean - without.mean, optimum - without.mean);
    if loss <= 0.0 {
        return Err(Undefined::NoLoss);
    }
    let share = finite(gain / loss)?;
    let interval = at_least(2, with.n.min(without.n)).and_then(|()| {
        // Squared standard errors of the means, and their covariance.
        let squared = |moments: &Moments| Ok(moments.sd?.powi(2) / moments.n as f64);
        let covariance = match design {
            SeedPairing::Independent => 0.0,
            SeedPairing::Matched => {
                let pairs = of_with.iter().zip(&of_without);
                let products = pairs.map(|(one, other)| (one - with.mean) * (other - without.mean));
                let n = with.n as f64;
                products.sum::<f64>() / (n - 1.0) / n
            }
        };
        let errors = [squared(&with)?, squared(&without)?, covariance];
        interval(errors, (gain, loss), critical((with.n.min(without.n) - 1) as f64))
    });
    Ok(Recovered { share, interval })
}

/// The shares R with (gain - R loss)² <= t² (of_with - 2 (1 - R) covariance + (1 - R)² of_without), a quadratic
/// inequality in R.
fn interval(
    [of_with, of_without, covariance]: [f64; 3],
    (gain, loss): (f64, f64),
    t: f64,
) -> Result<Interval, Undefined> {
    if of_with == 0.0 && of_without == 0.0 {
        return Err(Undefined::NoVariance);
    }
    let square = loss * loss - t * t * of_without;
    if square <= 0.0 {
        return Err(Undefined::NoLoss);
    }
    let linear = gain * loss + t * t * (covariance - of_without);
    let constant = gain * gain - t * t * (of_with - 2.0 * covariance + of_without);
    let root = finite((linear * linear - square * constant).max(0.0).sqrt())?;
    // Seeds that all recover the same share leave nothing but rounding errors.
    vary(root / square, 1.0)?;
    Ok(Interval { low: (linear - root) / square, high: (linear + root) / square })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analyse::sample::sample;
    use crate::analyse::t_test;

    /// The share of independent samples.
    fn share_of(with: &[f64], without: &[f64], optimum: f64) -> Result<Recovered, Undefined> {
        recovered(&sample(with), &sample(without), optimum, SeedPairing::Independent)
    }

    #[test]
    fn the_share_is_that_by_hand() {
        // The means are 90 and 60, and the optimum is 100: 30 of 40 are recovered.
        let found = share_of(&[88.0, 92.0], &[58.0, 62.0], 100.0).unwrap();
        assert_eq!(found.share, 0.75);
        let nothing = share_of(&[60.0, 61.0], &[60.0, 61.0], 100.0).unwrap();
        assert_eq!(nothing.share, 0.0);
        assert_eq!(share_of(&[1.0], &[100.0], 100.0), Err(Undefined::NoLoss));
        assert_eq!(share_of(&[], &[1.0], 100.0), Err(Undefined::NoSeeds));
        let one = share_of(&[90.0], &[60.0], 100.0).unwrap();
        assert_eq!(one.interval, Err(Undefined::TooFewSeeds { have: 1, need: 2 }));
    }

    #[test]
    fn a_loss_without_spread_leaves_the_interval_of_the_mean() {
        // Student's t with 2 degrees of freedom is 4.302653; the standard error of the mean is 1.
        let root = 3f64.sqrt();
        let with = [90.0 - root, 90.0, 90.0 + root];
        for design in [SeedPairing::Independent, SeedPairing::Matched] {
            let found = recovered(&sample(&with), &sample(&[60.0; 3]), 100.0, design).unwrap();
            let Interval { low, high } = found.interval.unwrap();
            assert!((low - (0.75 - 4.302653 / 40.0)).abs() < 1e-6, "{low}");
            assert!((high - (0.75 + 4.302653 / 40.0)).abs() < 1e-6, "{high}");
        }
    }

    #[test]
    fn the_ends_of_the_interval_are_where_the_test_just_rejects() {
        let (with, without) = ([3100.0, 3050.0, 3180.0, 3120.0], [2700.0, 2900.0, 2760.0, 2650.0]);
        let optimum = 3300.0;
        for design in [SeedPairing::Independent, SeedPairing::Matched] {
            let found = recovered(&sample(&with), &sample(&without), optimum, design).unwrap();
            let Interval { low, high } = found.interval.unwrap();
            assert!(low < found.share && found.share < high);
            for end in [low, high] {
                // The other side of the hypothesis, seed by seed.
                let rest = without.map(|value| (1.0 - end) * value + end * optimum);
                let test = t_test(&sample(&with), &sample(&rest), design).unwrap();
                assert!((test.p - 0.05).abs() < 1e-9, "{design:?}: {}", test.p);
            }
            // If the loss is not significantly above 0, the interval of the share is unbounded.
            let noisy = sample(&[3290.0, 3200.0, 3390.0, 3280.0]);
            let noisy = recovered(&sample(&with), &noisy, optimum, design).unwrap();
            assert_eq!(noisy.interval, Err(Undefined::NoLoss));
        }
    }
}
