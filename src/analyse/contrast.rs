//! One arm against another: every statistic that a table of contrasts shows.

use std::collections::BTreeSet;

use super::effect_size::{HedgesG, hedges_g, paired_hedges_g};
use super::improvement::{Improvement, improvement, paired_improvement};
use super::moments::Moments;
use super::permutation::{paired_permutation_p, permutation_p};
use super::sample::Sample;
use super::t_test::{TTest, paired_t_test, student_t_test, unpaired_t_test};
use super::undefined::{Undefined, finite};

/// How the seeds of two arms are paired.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Design {
    /// Seeds are not paired.
    Independent,
    /// Equal seeds form a pair; seeds that only one arm has are left out.
    Matched,
}

/// The comparison of two arms. Differences are the first minus the second.
#[derive(Clone, Debug, PartialEq)]
pub struct Contrast {
    /// How the seeds are paired.
    pub design: Design,
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

impl Design {
    /// The design of two arms: matched if both were given the same seeds, independent otherwise.
    pub fn of(first: &Sample, second: &Sample) -> Design {
        // A seed without a value is known by its number alone.
        let all = first.seeds().iter().chain(second.seeds()).collect::<BTreeSet<_>>().len();
        let is_shared = first.declared() == second.declared() && all <= first.declared();
        if is_shared { Design::Matched } else { Design::Independent }
    }
}

/// The test to report of two arms.
///
/// **Errors**: as [`paired_t_test`] and [`unpaired_t_test`], or no seed in common.
pub fn t_test(first: &Sample, second: &Sample, design: Design) -> Result<TTest, Undefined> {
    match design {
        Design::Independent => unpaired_t_test(first.values(), second.values()),
        Design::Matched => paired_t_test(&first.matched(second)?),
    }
}

impl Contrast {
    /// Compares the first sample with the second.
    pub fn new(first: &Sample, second: &Sample, design: Design) -> Contrast {
        match design {
            Design::Independent => independent(first.values(), second.values()),
            Design::Matched => match first.matched(second) {
                Ok(pairs) => matched(&pairs),
                Err(reason) => nothing_matched(reason),
            },
        }
    }
}

fn independent(first: &[f64], second: &[f64]) -> Contrast {
    let means = means(first, second);
    Contrast {
        design: Design::Independent,
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

fn matched(pairs: &[(f64, f64)]) -> Contrast {
    let (first, second): (Vec<f64>, Vec<f64>) = pairs.iter().copied().unzip();
    let means = means(&first, &second);
    let paired = paired_t_test(pairs);
    Contrast {
        design: Design::Matched,
        seeds: (pairs.len(), pairs.len()),
        means,
        difference: means.and_then(|(one, two)| finite(one - two)),
        test: paired,
        student: paired,
        hedges_g: paired_hedges_g(pairs),
        improvement: paired_improvement(pairs),
        permutation_p: paired_permutation_p(pairs),
    }
}

fn nothing_matched(reason: Undefined) -> Contrast {
    Contrast {
        design: Design::Matched,
        seeds: (0, 0),
        means: Err(reason),
        difference: Err(reason),
        test: Err(reason),
        student: Err(reason),
        hedges_g: Err(reason),
        improvement: Err(reason),
        permutation_p: Err(reason),
    }
}

fn means(first: &[f64], second: &[f64]) -> Result<(f64, f64), Undefined> {
    Ok((Moments::of(first)?.mean, Moments::of(second)?.mean))
}
