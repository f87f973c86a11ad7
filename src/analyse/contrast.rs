//! One arm against another: every statistic that a table of contrasts shows.

use super::effect_size::{HedgesG, hedges_g, paired_hedges_g};
use super::improvement::{Improvement, improvement, paired_improvement};
use super::moments::Moments;
use super::permutation::{paired_permutation_p, permutation_p};
use super::power::{detectable, paired_detectable};
use super::sample::Sample;
use super::t_test::{TTest, paired_t_test, pooled_sd, student_t_test, welch_t_test};
use super::undefined::{Undefined, finite};

/// How the seeds of two arms are paired.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Design {
    /// Seeds are not paired.
    Independent,
    /// Equal seeds form a pair; seeds that only one arm has are left out.
    Matched,
}

/// The t tests of a design.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Tests {
    /// Tests of independent arms.
    Independent {
        /// Welch's test, which allows different variances: the test to report.
        welch: Result<TTest, Undefined>,
        /// Student's test, which assumes equal variances, as in the paper.
        student: Result<TTest, Undefined>,
    },
    /// The test of matched seeds.
    Matched {
        /// The t test of the differences.
        paired: Result<TTest, Undefined>,
    },
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
    /// The t tests, with the interval of the difference.
    pub tests: Tests,
    /// Hedges' g: the difference in standard deviations.
    pub hedges_g: Result<HedgesG, Undefined>,
    /// Probability that the first arm's policy is better, if larger values are better.
    pub improvement: Result<Improvement, Undefined>,
    /// Exact p value of the difference over all arrangements of the seeds.
    pub permutation_p: Result<f64, Undefined>,
    /// Smallest difference that a test with these numbers of seeds and this spread detects with
    /// probability [`POWER`](super::POWER).
    pub detectable: Result<f64, Undefined>,
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

    /// The test to report: Welch's for independent arms, the paired t test for matched seeds.
    pub fn test(&self) -> Result<TTest, Undefined> {
        match self.tests {
            Tests::Independent { welch, .. } => welch,
            Tests::Matched { paired } => paired,
        }
    }
}

fn independent(first: &[f64], second: &[f64]) -> Contrast {
    let means = means(first, second);
    let student = student_t_test(first, second);
    // The detectable difference is defined only where the test is.
    let shared_sd = student.and_then(|_| pooled_sd(first, second));
    let in_units = || Ok(shared_sd? * detectable(first.len(), second.len())?);
    Contrast {
        design: Design::Independent,
        seeds: (first.len(), second.len()),
        means,
        difference: means.and_then(|(one, two)| finite(one - two)),
        tests: Tests::Independent { welch: welch_t_test(first, second), student },
        hedges_g: hedges_g(first, second),
        improvement: improvement(first, second),
        permutation_p: permutation_p(first, second),
        detectable: in_units(),
    }
}

fn matched(pairs: &[(f64, f64)]) -> Contrast {
    let (first, second): (Vec<f64>, Vec<f64>) = pairs.iter().copied().unzip();
    let means = means(&first, &second);
    let paired = paired_t_test(pairs);
    let in_units = || {
        let sd = paired?.standard_error * (pairs.len() as f64).sqrt();
        Ok(sd * paired_detectable(pairs.len())?)
    };
    Contrast {
        design: Design::Matched,
        seeds: (pairs.len(), pairs.len()),
        means,
        difference: means.and_then(|(one, two)| finite(one - two)),
        tests: Tests::Matched { paired },
        hedges_g: paired_hedges_g(pairs),
        improvement: paired_improvement(pairs),
        permutation_p: paired_permutation_p(pairs),
        detectable: in_units(),
    }
}

fn nothing_matched(reason: Undefined) -> Contrast {
    Contrast {
        design: Design::Matched,
        seeds: (0, 0),
        means: Err(reason),
        difference: Err(reason),
        tests: Tests::Matched { paired: Err(reason) },
        hedges_g: Err(reason),
        improvement: Err(reason),
        permutation_p: Err(reason),
        detectable: Err(reason),
    }
}

fn means(first: &[f64], second: &[f64]) -> Result<(f64, f64), Undefined> {
    Ok((Moments::of(first)?.mean, Moments::of(second)?.mean))
}
