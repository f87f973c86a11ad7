//! The noncentral t distribution, and intervals for its noncentrality, here called the shift.

use statrs::function::gamma::gamma_ur;

use super::interval::{Interval, LEVEL};
use super::undefined::{Undefined, finite};
use crate::estimate::root;

/// Positive nodes and weights of the 16-point Gauss-Legendre rule on [-1, 1].
const RULE: [(f64, f64); 8] = [
    (0.09501250983763744, 0.1894506104550685),
    (0.2816035507792589, 0.1826034150449236),
    (0.45801677765722737, 0.16915651939500254),
    (0.6178762444026438, 0.14959598881657674),
    (0.755404408355003, 0.12462897125553387),
    (0.8656312023878318, 0.09515851168249279),
    (0.9445750230732326, 0.06225352393864789),
    (0.9894009349916499, 0.027152459411754096),
];

/// Number of standard deviations beyond which the density is negligible in double precision.
const REACH: f64 = 9.0;

/// Probability that (Z + shift) / S is at most `t`. Z is standard normal, and S² is an independent
/// chi-squared variable divided by its `df` degrees of freedom (a whole number, at least 1). The
/// absolute error is below 1e-12.
///
/// Integrates over S or over Z, whichever makes the integrand smoother.
///
/// **Source**: the definition, as in Johnson, Kotz and Balakrishnan, "Continuous Univariate
/// Distributions", volume 2, 1995, chapter 31.
pub(super) fn noncentral_t(t: f64, df: f64, shift: f64) -> f64 {
    if t < 0.0 {
        1.0 - noncentral_t(-t, df, -shift)
    } else if t < (2.0 * df).sqrt() {
        over_chi(t, df, shift)
    } else {
        over_normal(t, df, shift)
    }
}

/// The integral over U = S sqrt(df), whose density is negligible beyond [`REACH`] of sqrt(df).
fn over_chi(t: f64, df: f64, shift: f64) -> f64 {
    let centre = df.sqrt();
    let constant = (1.0 - df / 2.0) * std::f64::consts::LN_2 - libm::lgamma(df / 2.0);
    let density = |u: f64| (constant + (df - 1.0) * u.ln() - u * u / 2.0).exp();
    let ends = ((centre - REACH - 1.0).max(0.0), centre + REACH);
    integral(|u| density(u) * normal(t * u / centre - shift), ends)
}

/// The integral over Z of the probability that S is at least (Z + shift) / t.
fn over_normal(t: f64, df: f64, shift: f64) -> f64 {
    let density = |z: f64| (-z * z / 2.0).exp() / (2.0 * std::f64::consts::PI).sqrt();
    let beyond = |s: f64| gamma_ur(df / 2.0, (s * s * df / 2.0).max(f64::MIN_POSITIVE));
    // The integrand has a kink where the bound of S is 0. Below the kink, S always exceeds the bound.
    let kink = (-shift).clamp(-REACH, REACH);
    let above = integral(|z| density(z) * beyond((z + shift) / t), (kink, REACH));
    normal(kink) + above
}

/// The standard normal distribution function.
pub(super) fn normal(z: f64) -> f64 {
    0.5 * libm::erfc(-z * std::f64::consts::FRAC_1_SQRT_2)
}

/// The integral between two ends, in panels of length at most 1.
fn integral(function: impl Fn(f64) -> f64, (from, to): (f64, f64)) -> f64 {
    let panels = (to - from).ceil().max(1.0);
    let half = (to - from) / panels / 2.0;
    let panel = |middle: f64| -> f64 {
        let pair = |(node, weight): &(f64, f64)| {
            weight * (function(middle - half * node) + function(middle + half * node))
        };
        RULE.iter().map(pair).sum::<f64>() * half
    };
    (0..panels as u32).map(|i| panel(from + half * f64::from(2 * i + 1))).sum()
}

/// Interval of the shift of the noncentral t distribution that `t` was drawn from.
///
/// **Source**: Steiger and Fouladi, "Noncentrality interval estimation and the evaluation of
/// statistical models", 1997.
pub(super) fn shift_interval(t: f64, df: f64) -> Result<Interval, Undefined> {
    let tail = (1.0 - LEVEL) / 2.0;
    finite(t * t)?;
    let low = shift_of_probability(1.0 - tail, t, df);
    Ok(Interval { low, high: shift_of_probability(tail, t, df) })
}

/// The shift at which a noncentral t is at most `t` with this probability.
fn shift_of_probability(probability: f64, t: f64, df: f64) -> f64 {
    let excess = |shift: f64| noncentral_t(t, df, shift) - probability;
    let mut reach = 4.0 + t.abs();
    while (excess(t - reach) < 0.0 || excess(t + reach) > 0.0) && reach < 1e100 {
        reach *= 2.0;
    }
    root(excess, (t - reach, t + reach))
}
