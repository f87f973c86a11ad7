//! Student's t distribution, exact far into its tails.

use statrs::function::beta::beta_reg;

use super::root::root;

/// Probability that Student's t with `df` degrees of freedom (at least 1) is at least as far from
/// 0 as `t`.
///
/// The incomplete beta function of df / (df + t²) is the probability of the tail itself: nothing
/// is subtracted from 1, so that 1e-30 stays 1e-30.
///
/// **Source**: Abramowitz and Stegun, 1964, 26.7.1 and 26.5.27.
pub(super) fn two_sided_p(t: f64, df: f64) -> f64 {
    beta_reg(df / 2.0, 0.5, df / (df + t * t)).min(1.0)
}

/// The t above 0 that [`two_sided_p`] gives this probability, in (0, 1).
pub(super) fn t_of_p(p: f64, df: f64) -> f64 {
    // Of logarithms, so that a tail of any size is met; the ends are as far as t² is a number.
    root(|ln_t| two_sided_p(ln_t.exp(), df).ln() - p.ln(), (-350.0, 350.0)).exp()
}
