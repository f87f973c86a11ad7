//! Exact permutation tests, which enumerate all arrangements.

use super::undefined::{Undefined, at_least, finite};

/// Largest number of arrangements that is enumerated, in a fraction of a second. It admits two arms
/// of 13 seeds, or 24 pairs.
pub const MOST_ARRANGEMENTS: u64 = 1 << 24;

/// Sums that differ by less than this share of the sum of absolute values count as ties.
const ROUNDING: f64 = 1e-12;

/// Two-sided p value of the difference of means of two independent arms: the share of all
/// assignments of the values to arms of these sizes whose difference is at least as far from 0 as
/// the observed difference.
///
/// **Errors**: an arm without values; more than [`MOST_ARRANGEMENTS`] arrangements.
///
/// **Source**: Fisher, "The Design of Experiments", 1935; Pitman, "Significance tests which may be
/// applied to samples from any populations", 1937.
pub fn permutation_p(first: &[f64], second: &[f64]) -> Result<f64, Undefined> {
    at_least(1, first.len().min(second.len()))?;
    let ways = ways_to_choose(first.len().min(second.len()), first.len() + second.len())?;
    let all = [first, second].concat();
    let mean = finite(all.iter().sum::<f64>())? / all.len() as f64;
    let from_mean: Vec<f64> = all.iter().map(|value| value - mean).collect();
    let size: f64 = finite(from_mean.iter().map(|value| value.abs()).sum())?;
    // The deviations from the common mean sum to opposite numbers in the two arms, so the smaller
    // arm suffices.
    let (smaller, seen) = if first.len() <= second.len() {
        (first.len(), &from_mean[..first.len()])
    } else {
        (second.len(), &from_mean[first.len()..])
    };
    let bound = seen.iter().sum::<f64>().abs() - ROUNDING * size;
    Ok(choices_beyond(bound, &from_mean, smaller, 0.0) as f64 / ways as f64)
}

/// Two-sided p value of the mean difference of pairs: the share of all ways to swap values within
/// pairs whose mean difference is at least as far from 0 as the observed one.
///
/// **Errors**: no pairs; more than [`MOST_ARRANGEMENTS`] arrangements.
///
/// **Source**: Fisher, "The Design of Experiments", 1935.
pub fn paired_permutation_p(pairs: &[(f64, f64)]) -> Result<f64, Undefined> {
    at_least(1, pairs.len())?;
    let ways = 2f64.powi(i32::try_from(pairs.len()).unwrap_or(i32::MAX));
    if ways > MOST_ARRANGEMENTS as f64 {
        return Err(Undefined::Infeasible);
    }
    let differences: Vec<f64> = pairs.iter().map(|(a, b)| a - b).collect();
    let size: f64 = finite(differences.iter().map(|value| value.abs()).sum())?;
    let bound = differences.iter().sum::<f64>().abs() - ROUNDING * size;
    Ok(signs_beyond(bound, &differences, 0.0) as f64 / ways)
}

/// The number of ways to choose `some` of `all`, if they are few enough to enumerate.
fn ways_to_choose(some: usize, all: usize) -> Result<u64, Undefined> {
    let mut ways = 1u64;
    for k in 1..=some as u64 {
        ways = ways * (all as u64 - some as u64 + k) / k;
        if ways > MOST_ARRANGEMENTS {
            return Err(Undefined::Infeasible);
        }
    }
    Ok(ways)
}

/// The number of choices of `some` of the values whose total, `sum` included, is at least as far
/// from 0 as `bound`.
fn choices_beyond(bound: f64, values: &[f64], some: usize, sum: f64) -> u64 {
    match some {
        0 => u64::from(sum.abs() >= bound),
        1 => values.iter().map(|value| u64::from((sum + value).abs() >= bound)).sum(),
        _ => (0..=values.len() - some)
            .map(|at| choices_beyond(bound, &values[at + 1..], some - 1, sum + values[at]))
            .sum(),
    }
}

/// The number of choices of signs of the values whose total, `sum` included, is at least as far
/// from 0 as `bound`.
fn signs_beyond(bound: f64, values: &[f64], sum: f64) -> u64 {
    match values {
        [] => u64::from(sum.abs() >= bound),
        [value, rest @ ..] => {
            signs_beyond(bound, rest, sum + value) + signs_beyond(bound, rest, sum - value)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrangements_by_hand() {
        // Of 20 ways to choose three of six, {1, 2, 3} and {4, 5, 6} are the furthest apart.
        assert_eq!(permutation_p(&[1.0, 2.0, 3.0], &[4.0, 5.0, 6.0]), Ok(2.0 / 20.0));
        // Deviations of 0, 0, 1 and 7 from their mean 2: -2, -2, -1, 5.
        assert_eq!(permutation_p(&[0.0], &[0.0, 1.0, 7.0]), Ok(3.0 / 4.0));
        assert_eq!(permutation_p(&[0.0, 1.0, 7.0], &[0.0]), Ok(3.0 / 4.0));
        // ±1 ±2 ±4 is as far from 0 as 7 in two of eight ways, and as 1 + 2 - 4 = -1 in all.
        assert_eq!(paired_permutation_p(&[(1.0, 0.0), (2.0, 0.0), (4.0, 0.0)]), Ok(2.0 / 8.0));
        assert_eq!(paired_permutation_p(&[(1.0, 0.0), (2.0, 0.0), (0.0, 4.0)]), Ok(1.0));
    }

    #[test]
    fn ties_are_as_extreme_as_what_was_seen_in_spite_of_rounding() {
        let p = permutation_p(&[0.1, 0.2, 0.3], &[0.3, 0.2, 0.1]).unwrap();
        assert_eq!(p, 1.0);
        assert_eq!(permutation_p(&[0.1; 4], &[0.1; 3]), Ok(1.0));
    }

    #[test]
    fn what_takes_too_long_is_reported() {
        assert!(permutation_p(&[0.0; 13], &[1.0; 13]).is_ok());
        assert_eq!(permutation_p(&[0.0; 14], &[1.0; 14]), Err(Undefined::Infeasible));
        assert_eq!(permutation_p(&[0.0; 5000], &[1.0; 5000]), Err(Undefined::Infeasible));
        assert_eq!(paired_permutation_p(&[(0.0, 1.0); 25]), Err(Undefined::Infeasible));
        assert_eq!(permutation_p(&[], &[1.0]), Err(Undefined::NoSeeds));
        assert_eq!(paired_permutation_p(&[]), Err(Undefined::NoSeeds));
    }
}
