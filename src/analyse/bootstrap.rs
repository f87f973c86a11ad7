//! Bootstrap intervals for statistics over several conditions.
//!
//! The conditions are fixed, and seeds are resampled. Equal seeds of two conditions have met the same random
//! numbers, so their values are not independent: a seed is drawn with its values in all conditions. Conditions
//! without a seed in common are resampled separately. Every bootstrap uses the same random stream, so an
//! interval depends on the values alone and not on its position in a report.

use std::collections::BTreeMap;

use super::interval::Interval;
use super::moments::Moments;
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
    /// Its interval, from the deviation of the statistic over [`RESAMPLES`] resamples.
    pub interval: Result<Interval, Undefined>,
}

/// Inter-quartile mean: the mean of the values of all conditions and seeds, without the lowest and
/// the highest quarter (each rounded down to whole values).
///
/// Each condition is weighted by its number of seeds. Its interval resamples seeds, each with its values in
/// all conditions.
///
/// The interval is the statistic ± t(0.975, n - 1) times the deviation of its resamples times
/// sqrt(n / (n - 1)), where n is the smallest number of seeds of a condition: resamples of n values have
/// (n - 1)/n of their variance, and their quantiles alone would be too narrow. `docs/statistics.md` has the
/// coverage.
///
/// **Errors**: no condition, or a condition without values. For the interval: fewer than two seeds
/// in a condition, or no variance.
///
/// **Source**: Agarwal et al., "Deep reinforcement learning at the edge of the statistical
/// precipice", 2021; Efron and Tibshirani, "An Introduction to the Bootstrap", 1993, chapter 13; Davison and
/// Hinkley, "Bootstrap Methods and their Application", 1997, section 3.8, for whole clusters; Hesterberg, "What
/// teachers should know about the bootstrap", 2015, for t intervals with the bootstrap's error.
pub fn interquartile_mean(conditions: &[&Sample]) -> Result<Aggregate, Undefined> {
    let fewest = conditions.iter().map(|sample| sample.n()).min().unwrap_or(0);
    at_least(1, fewest)?;
    let mut sorted: Vec<f64> =
        conditions.iter().flat_map(|sample| sample.values()).copied().collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let value = finite(middle_mean(&sorted, &vec![1; sorted.len()], sorted.len()))?;
    let interval = at_least(2, fewest).and_then(|()| {
        let n = fewest as f64;
        let error = resampled_sd(conditions, sorted)? * (n / (n - 1.0)).sqrt();
        Ok(Interval::around(value, error, n - 1.0))
    });
    Ok(Aggregate { value, interval })
}

/// The mean of `total` values without the lowest and the highest quarter. `times` counts how often each of the
/// different values occurs; values ascend, and are added in this order.
fn middle_mean(sorted: &[f64], times: &[u32], total: usize) -> f64 {
    let cut = total / 4;
    let (mut below, mut left) = (cut, total - 2 * cut);
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

/// The deviation of the middle mean over resamples. `sorted` has the values of all conditions in ascending order.
///
/// Seeds are drawn until every condition has as many values as before; what it has in excess is left out.
/// Where all conditions have the same seeds, that takes as many draws as there are seeds. A resample is counted
/// rather than sorted: how often it has each of the different values.
fn resampled_sd(conditions: &[&Sample], mut sorted: Vec<f64>) -> Result<f64, Undefined> {
    let total = sorted.len();
    sorted.dedup_by(|one, other| one.total_cmp(other).is_eq());
    let groups = groups(conditions, &sorted);
    let mut stream = Stream::new(STREAM, Purpose::Bootstrap);
    let mut times = vec![0_u32; sorted.len()];
    // The numbers of values that the conditions still lack.
    let mut lacks = vec![0; conditions.len()];
    let mut seen = Vec::with_capacity(RESAMPLES);
    for _ in 0..RESAMPLES {
        times.fill(0);
        conditions.iter().zip(&mut lacks).for_each(|(sample, lacks)| *lacks = sample.n());
        for seeds in &groups {
            let n = u32::try_from(seeds.len()).map_err(|_| Undefined::OutOfRange)?;
            let mut left: usize = seeds.iter().map(Vec::len).sum();
            while left > 0 {
                for (rank, condition) in &seeds[stream.below(n) as usize] {
                    if lacks[*condition] > 0 {
                        times[*rank as usize] += 1;
                        lacks[*condition] -= 1;
                        left -= 1;
                    }
                }
            }
        }
        seen.push(finite(middle_mean(&sorted, &times, total))?);
    }
    if seen.iter().all(|mean| *mean == seen[0]) {
        // Equal resamples carry no information about the width.
        return Err(Undefined::NoVariance);
    }
    Moments::of(&seen)?.sd
}

/// A seed's values: the rank of each among the different values, and its condition.
type SeedValues = Vec<(u32, usize)>;

/// The seeds of each group of conditions that are linked by seeds. Seeds are in the order of their ranks, so
/// that the interval does not depend on their numbers.
fn groups(conditions: &[&Sample], sorted: &[f64]) -> Vec<Vec<SeedValues>> {
    let mut seeds: BTreeMap<u64, (usize, SeedValues)> = BTreeMap::new();
    // The group of each condition: the first condition that it is linked to.
    let mut group_of: Vec<usize> = (0..conditions.len()).collect();
    for (index, sample) in conditions.iter().enumerate() {
        for (seed, value) in sample.seeds().iter().zip(sample.values()) {
            let rank = sorted.partition_point(|other| other.total_cmp(value).is_lt()) as u32;
            let (first, ranks) = seeds.entry(*seed).or_insert((index, Vec::new()));
            ranks.push((rank, index));
            let (one, other) = (group_of[*first], group_of[index]);
            if one != other {
                let (kept, merged) = (one.min(other), one.max(other));
                group_of.iter_mut().filter(|group| **group == merged).for_each(|it| *it = kept);
            }
        }
    }
    let mut groups = vec![Vec::new(); conditions.len()];
    for (first, mut ranks) in seeds.into_values() {
        ranks.sort_unstable();
        groups[group_of[first]].push(ranks);
    }
    groups.retain(|seeds| !seeds.is_empty());
    groups.iter_mut().for_each(|seeds| seeds.sort_unstable());
    groups
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The coverage of the interval: the share of intervals that contain the true value 0, for conditions
    /// with equal true means and `seeds` normally distributed seeds each, whose values correlate between
    /// conditions.
    fn coverage(conditions: usize, seeds: u64, correlation: f64, rounds: usize) -> f64 {
        // Resampling uses another stream.
        let mut stream = Stream::new(STREAM + 1, Purpose::Bootstrap);
        let mut normal = || {
            let (radius, angle) = (1.0 - stream.unit(), stream.unit());
            (-2.0 * radius.ln()).sqrt() * (std::f64::consts::TAU * angle).cos()
        };
        let holds = |_: &usize| {
            let common: Vec<f64> = (0..seeds).map(|_| normal()).collect();
            let mut arm = |_| {
                let value = |(seed, common): (u64, &f64)| {
                    (seed, correlation.sqrt() * common + (1.0 - correlation).sqrt() * normal())
                };
                Sample::new((0..).zip(&common).map(value), 0, 0).unwrap()
            };
            let arms: Vec<Sample> = (0..conditions).map(&mut arm).collect();
            let mean = interquartile_mean(&arms.iter().collect::<Vec<_>>()).unwrap();
            mean.interval.unwrap().contains(0.0)
        };
        (0..rounds).filter(holds).count() as f64 / rounds as f64
    }

    #[test]
    fn of_one_condition_with_few_seeds_the_interval_is_that_of_the_mean() {
        let arm = Sample::new([(1, 1.0), (2, 5.0), (3, 2.0)], 0, 0).unwrap();
        let interval = interquartile_mean(&[&arm]).unwrap().interval.unwrap();
        let mean = arm.interval().unwrap();
        // The deviation of 10,000 resamples is uncertain by 1 %.
        let width = mean.high - mean.low;
        assert!((interval.low - mean.low).abs() < 0.02 * width, "{interval:?} {mean:?}");
        assert!((interval.high - mean.high).abs() < 0.02 * width, "{interval:?} {mean:?}");
    }

    #[test]
    fn seeds_that_conditions_share_are_drawn_together() {
        let sample =
            |first: u64, values: [f64; 4]| Sample::new((first..).zip(values), 0, 0).unwrap();
        let interval = |arms: &[Sample]| {
            interquartile_mean(&arms.iter().collect::<Vec<_>>()).unwrap().interval.unwrap()
        };
        let values = [1.0, 5.0, 2.0, 9.0];
        let alone = interval(&[sample(0, values)]);
        // A second arm with the same values adds nothing, unless its seeds are others.
        assert_eq!(interval(&[sample(0, values), sample(0, values)]), alone);
        let apart = interval(&[sample(0, values), sample(4, values)]);
        assert!(apart.high - apart.low < 0.9 * (alone.high - alone.low), "{apart:?} {alone:?}");
        // One shared seed links two arms.
        assert_ne!(interval(&[sample(0, values), sample(3, values)]), apart);
    }

    #[test]
    fn intervals_over_conditions_with_common_seeds_hold_the_truth() {
        for (seeds, correlation) in [(3, 0.0), (3, 1.0), (10, 0.0), (10, 0.3), (10, 1.0)] {
            let covered = coverage(4, seeds, correlation, 400);
            // Drawing within conditions would give 62 % for ten seeds at a correlation of 1. The standard
            // deviation is 1 %.
            assert!((0.91..=1.0).contains(&covered), "{seeds}, {correlation}: {covered}");
        }
    }
}
