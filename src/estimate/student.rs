//! Student's t distribution, accurate far into its tails.

use statrs::function::beta::beta_reg;
use statrs::function::gamma::gamma_lr;

use super::root::root;

/// Probability that Student's t with `df` degrees of freedom (at least 1) is at least as far from
/// 0 as `t`.
///
/// The incomplete beta function of df / (df + t²) is the tail probability itself. Nothing is
/// subtracted from 1, so tiny probabilities such as 1e-30 keep their precision.
///
/// **Source**: Abramowitz and Stegun, 1964, 26.7.1 and 26.5.27.
pub(crate) fn two_sided_p(t: f64, df: f64) -> f64 {
    beta_reg(df / 2.0, 0.5, df / (df + t * t)).min(1.0)
}

/// The positive t whose [`two_sided_p`] is `p`, which lies in (0, 1).
pub(crate) fn t_of_p(p: f64, df: f64) -> f64 {
    // The search is over ln t, so that it reaches tails of any size; t² is finite at both ends.
    root(|ln_t| two_sided_p(ln_t.exp(), df).ln() - p.ln(), (-350.0, 350.0)).exp()
}

/// The number below which a chi-squared variable with `df` degrees of freedom lies with probability `p`, which
/// is in (0, 1).
pub(crate) fn chi_squared_of_p(p: f64, df: f64) -> f64 {
    root(|ln_x| gamma_lr(df / 2.0, ln_x.exp() / 2.0) - p, (-100.0, 20.0)).exp()
}
