//! Stratified bootstrap: intervals for statistics over several conditions.
//!
//! Seeds are resampled within each condition; the conditions are fixed. Every bootstrap uses the same
//! random stream, so an interval depends on the values alone and not on its position in a report.

use super::interval::{Interval, LEVEL};
use super::quantile::quantile_of_sorted;
use super::sample::Sample;
use super::undefined::{Undefined, at_least, finite};
use crate::rng::{Purpose, Stream};

/// Number of bootstrap resamples.
pub const RESAMPLES: usize = 10_000;

/// Number of the stream of [`Purpose::Bootstrap`] that resampling uses.
const STREAM: u64 = 0;

/// A statistic over several conditions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aggregate {
    /// The statistic of the original values.
    pub value: f64,
    /// Percentile interval of the statistic over [`RESAMPLES`] resamples.
    pub interval: Result<Interval, Undefined>,
}

/// Inter-quartile mean: the mean of the values of all conditions and seeds, without the lowest and
/// the highest quarter (each rounded down to whole values).
///
/// Each condition is weighted by its number of seeds.
///
/// With few seeds per condition the interval is too narrow, however many conditions there are:
/// resamples of n values have (n - 1)/n of their variance. `docs/statistics.md` has the coverage.
///
/// **Errors**: no condition, or a condition without values. For the interval: fewer than two seeds
/// in a condition, or no variance.
///
/// **Source**: Agarwal et al., "Deep reinforcement learning at the edge of the statistical
/// precipice", 2021; Efron and Tibshirani, "An Introduction to the Bootstrap", 1993, chapter 13.
pub fn interquartile_mean(conditions: &[&Sample]) -> Result<Aggregate, Undefined> {
    let strata: Vec<&[f64]> = conditions.iter().map(|sample| sample.values()).collect();
    at_least(1, strata.iter().map(|values| values.len()).min().unwrap_or(0))?;
    let mut sorted = strata.concat();
    sorted.sort_unstable_by(f64::total_cmp);
    let value = finite(middle_mean(&sorted, &vec![1; sorted.len()]))?;
    Ok(Aggregate { value, interval: percentile_interval(&strata, &sorted) })
}

/// The mean without the lowest and the highest quarter. `times` counts how often each value occurs; values
/// ascend, and are added in this order.
fn middle_mean(sorted: &[f64], times: &[u32]) -> f64 {
    let cut = sorted.len() / 4;
    let (mut below, mut left) = (cut, sorted.len() - 2 * cut);
    let middle = left as f64;
    let mut sum = -0.0;
    for (value, times) in sorted.iter().zip(times) {
        let mut times = *times as usize;
        if below > 0 {
            let skipped = times.min(below);
            (below, times) = (below - skipped, times - skipped);
        }
        while times > 0 && left > 0 {
            sum += value;
            (times, left) = (times - 1, left - 1);
        }
        if left == 0 {
            break;
        }
    }
    sum / middle
}

/// Percentile interval of the middle mean, with resampling within strata. `sorted` has the values of all
/// strata in ascending order.
///
/// A resample is counted rather than sorted: how often it has each of the values.
fn percentile_interval(strata: &[&[f64]], sorted: &[f64]) -> Result<Interval, Undefined> {
    at_least(2, strata.iter().map(|values| values.len()).min().unwrap_or(0))?;
    let ranks = ranks(strata);
    let mut stream = Stream::new(STREAM, Purpose::Bootstrap);
    let mut times = vec![0_u32; sorted.len()];
    let mut seen = Vec::with_capacity(RESAMPLES);
    for _ in 0..RESAMPLES {
        times.fill(0);
        for ranks in &ranks {
            let n = u32::try_from(ranks.len()).map_err(|_| Undefined::OutOfRange)?;
            for _ in ranks {
                times[ranks[stream.below(n) as usize] as usize] += 1;
            }
        }
        seen.push(finite(middle_mean(sorted, &times))?);
    }
    seen.sort_unstable_by(f64::total_cmp);
    if seen[0] == seen[RESAMPLES - 1] {
        // Equal resamples carry no information about the width.
        return Err(Undefined::NoVariance);
    }
    let tail = (1.0 - LEVEL) / 2.0;
    let [low, high] = [tail, 1.0 - tail].map(|share| quantile_of_sorted(&seen, share));
    Ok(Interval { low, high })
}

/// For each stratum, the ranks of its values among the values of all strata. They ascend, so that the
/// interval does not depend on which seed had which value.
fn ranks(strata: &[&[f64]]) -> Vec<Vec<u32>> {
    let all = strata.iter().enumerate();
    let all = all.flat_map(|(place, values)| values.iter().map(move |value| (*value, place)));
    let mut all: Vec<(f64, usize)> = all.collect();
    all.sort_unstable_by(|(one, _), (other, _)| one.total_cmp(other));
    let mut ranks: Vec<Vec<u32>> = vec![Vec::new(); strata.len()];
    for (rank, (_, place)) in (0..).zip(&all) {
        ranks[*place].push(rank);
    }
    ranks
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The coverage of the interval: the share of intervals that contain the true value 0, for
    /// conditions with equal true means and `seeds` normally distributed seeds each.
    fn coverage(conditions: usize, seeds: usize, rounds: usize) -> f64 {
        // Resampling uses another stream.
        let mut stream = Stream::new(STREAM + 1, Purpose::Bootstrap);
        let mut normal = || {
            let (radius, angle) = (1.0 - stream.unit(), stream.unit());
            (-2.0 * radius.ln()).sqrt() * (std::f64::consts::TAU * angle).cos()
        };
        let holds = |_: &usize| {
            let arms: Vec<Sample> = (0..conditions)
                .map(|_| Sample::new((0..seeds as u64).map(|seed| (seed, normal())), 0, 0).unwrap())
                .collect();
            let mean = interquartile_mean(&arms.iter().collect::<Vec<_>>()).unwrap();
            mean.interval.unwrap().contains(0.0)
        };
        (0..rounds).filter(holds).count() as f64 / rounds as f64
    }

    #[test]
    fn of_three_seeds_the_interval_is_their_range_and_holds_the_truth_in_three_of_four() {
        let arm = Sample::new([(1, 1.0), (2, 5.0), (3, 2.0)], 0, 0).unwrap();
        let interval = interquartile_mean(&[&arm]).unwrap().interval.unwrap();
        assert_eq!((interval.low, interval.high), (1.0, 5.0));
        // All three seeds are on one side of the true value with probability 2/8. The standard
        // deviation of the coverage is 2 %.
        let covered = coverage(1, 3, 500);
        assert!((0.69..0.81).contains(&covered), "{covered}");
    }
}
