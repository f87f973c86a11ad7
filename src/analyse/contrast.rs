//! One arm against another: every statistic that a table of contrasts shows.

use super::effect_size::{HedgesG, hedges_g, paired_hedges_g};
use super::improvement::{Improvement, improvement, paired_improvement};
use super::moments::Moments;
use super::permutation::{paired_permutation_p, permutation_p};
use super::sample::Sample;
use super::t_test::{TTest, paired_t_test, student_t_test, unpaired_t_test};
use super::undefined::{Undefined, finite};

/// How the seeds of two arms are paired.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SeedPairing {
    /// Seeds are not paired.
    Independent,
    /// Equal seeds form a pair; seeds that only one arm has are left out.
    Matched,
}

/// The comparison of two arms. Differences are the first minus the second.
#[derive(Clone, Debug, PartialEq)]
pub struct Contrast {
    /// How the seeds are paired.
    pub design: SeedPairing,
    /// Numbers of compared seeds of each arm.
    pub seeds: (usize, usize),
    /// Means of the compared seeds of each arm.
    pub means: Result<(f64, f64), Undefined>,
    /// Difference of the means.
    pub difference: Result<f64, Undefined>,
    /// The test to report, with the interval of the difference: the t test of the differences of matched seeds,
    /// or [`unpaired_t_test`].
    pub test: Result<TTest, Undefined>,
    /// Student's test: of the differences of matched seeds, or of independent arms with equal variances, as in
    /// the paper.
    pub student: Result<TTest, Undefined>,
    /// Hedges' g: the difference in standard deviations.
    pub hedges_g: Result<HedgesG, Undefined>,
    /// Probability that the first arm's policy is better, if larger values are better.
    pub improvement: Result<Improvement, Undefined>,
    /// Exact p value of the difference over all arrangements of the seeds.
    pub permutation_p: Result<f64, Undefined>,
}

impl SeedPairing {
    /// The design of two arms: matched if the seeds of one are among those of the other, at least two; else
    /// independent. It depends on the seeds that the arms were given, not on those that have a value yet.
    pub fn of(first: &Sample, second: &Sample) -> SeedPairing {
        let (few, many) = match first.given().len() <= second.given().len() {
            true => (first.given(), second.given()),
            false => (second.given(), first.given()),
        };
        let are_shared = few.len() > 1 && few.iter().all(|seed| many.binary_search(seed).is_ok());
        if are_shared { SeedPairing::Matched } else { SeedPairing::Independent }
    }

    /// The samples as this design compares them: of matched seeds, those that both have.
    pub fn compared(self, first: &Sample, second: &Sample) -> (Sample, Sample) {
        match self {
            SeedPairing::Independent => (first.clone(), second.clone()),
            SeedPairing::Matched => (first.shared_with(second), second.shared_with(first)),
        }
    }
}

/// The test to report of two arms.
///
/// **Errors**: as [`paired_t_test`] and [`unpaired_t_test`], or no seed in common.
pub fn t_test(first: &Sample, second: &Sample, design: SeedPairing) -> Result<TTest, Undefined> {
    match design {
        SeedPairing::Independent => unpaired_t_test(first.values(), second.values()),
        SeedPairing::Matched => paired_t_test(&first.matched(second)?),
    }
}

impl Contrast {
    /// Compares the first sample with the second.
    pub fn new(first: &Sample, second: &Sample, design: SeedPairing) -> Contrast {
        match design {
            SeedPairing::Independent => independent(first.values(), second.values()),
            SeedPairing::Matched => matched(first.matched(second)),
        }
    }
}

fn independent(first: &[f64], second: &[f64]) -> Contrast {
    let means = means(first, second);
    Contrast {
        design: SeedPairing::Independent,
        seeds: (first.len(), second.len()),
        means,
        difference: means.and_then(|(one, two)| finite(one - two)),
        test: unpaired_t_test(first, second),
        student: student_t_test(first, second),
        hedges_g: hedges_g(first, second),
        improvement: improvement(first, second),
        permutation_p: permutation_p(first, second),
    }
}

fn matched(pairs: Result<Vec<(f64, f64)>, Undefined>) -> Contrast {
    let pairs = pairs.as_deref().map_err(|reason| *reason);
    let means = pairs.and_then(|pairs| {
        let (first, second): (Vec<f64>, Vec<f64>) = pairs.iter().copied().unzip();
        means(&first, &second)
    });
    let (paired, n) = (pairs.and_then(paired_t_test), pairs.map_or(0, <[_]>::len));
    Contrast {
        design: SeedPairing::Matched,
        seeds: (n, n),
        means,
        difference: means.and_then(|(one, two)| finite(one - two)),
        test: paired,
        student: paired,
        hedges_g: pairs.and_then(paired_hedges_g),
        improvement: pairs.and_then(paired_improvement),
        permutation_p: pairs.and_then(paired_permutation_p),
    }
}

fn means(first: &[f64], second: &[f64]) -> Result<(f64, f64), Undefined> {
    Ok((Moments::of(first)?.mean, Moments::of(second)?.mean))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_are_matched_where_those_of_one_arm_are_among_those_of_the_other() {
        let make_sample = |seeds: std::ops::Range<u64>| {
            Sample::new(seeds.map(|seed| (seed, seed as f64)), 0, 0).unwrap()
        };
        let is_matched =
            |one: &Sample, other: &Sample| SeedPairing::of(one, other) == SeedPairing::Matched;
        assert!(is_matched(&make_sample(1..11), &make_sample(1..11)));
        assert!(is_matched(&make_sample(1..13), &make_sample(1..3)));
        assert!(!is_matched(&make_sample(1..13), &make_sample(1..2)), "a single pair");
        assert!(!is_matched(&make_sample(1..6), &make_sample(6..11)), "other seeds");
        // What has a value yet does not count.
        assert!(is_matched(
            &make_sample(1..3).with_given(1..11),
            &make_sample(5..11).with_given(1..11)
        ));
        assert!(!is_matched(
            &make_sample(1..2).with_given(1..4),
            &make_sample(4..5).with_given(4..7)
        ));
    }
}
