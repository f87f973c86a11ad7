//! Distributions that a variable is drawn from.

use crate::env::declared::numbers::{self, sigmoid, truth};
use crate::env::variates::{Expansion, beta, gamma, poisson};
use crate::kernel::math;

/// A distribution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum DrawLaw {
    /// Normal, by mean and standard deviation.
    Gaussian,
    /// 1 with a probability, and otherwise 0.
    Bernoulli,
    /// The same by the logit of the probability.
    BernoulliLogit,
    /// Between two numbers.
    Uniform,
    /// By the mean.
    Poisson,
    /// By the logarithm of the mean.
    PoissonLog,
    /// 0 with a probability by its logit, and otherwise Poisson by the logarithm of the mean.
    ZeroInflatedPoisson,
    /// By mean and standard deviation.
    Gamma,
    /// By both shapes.
    Beta,
    /// By mean and standard deviation of the logarithm.
    Lognormal,
    /// The index of a weight, in proportion to the weights.
    Categorical,
    /// The same by logarithms of weights.
    CategoricalLogit,
}

/// How a model writes a distribution.
#[derive(Debug)]
pub(super) struct Form {
    /// The name in a model.
    pub name: &'static str,
    /// The parameters as keys, in the order of a list; empty if there are as many as the author writes.
    pub keys: &'static [&'static str],
    pub distribution: DrawLaw,
    /// The least and the most of each parameter.
    pub ranges: &'static [(f64, f64)],
}

const ANY: (f64, f64) = (f64::MIN, f64::MAX);
const POSITIVE: (f64, f64) = (f64::MIN_POSITIVE, f64::MAX);
const AT_LEAST_0: (f64, f64) = (0.0, f64::MAX);
/// Means of counts are exact as floats.
const MEAN: (f64, f64) = (0.0, 1e9);
const LOG_MEAN: (f64, f64) = (f64::MIN, 20.7);

/// Every form, those of one name one behind the other.
pub(super) static FORMS: [Form; 12] = {
    use DrawLaw::*;
    [
        form("gaussian", &["mean", "sd"], Gaussian, &[ANY, AT_LEAST_0]),
        form("bernoulli", &["probability"], Bernoulli, &[(0.0, 1.0)]),
        form("bernoulli", &["logit"], BernoulliLogit, &[ANY]),
        form("uniform", &["low", "high"], Uniform, &[ANY, ANY]),
        form("poisson", &["mean"], Poisson, &[MEAN]),
        form("poisson", &["log_mean"], PoissonLog, &[LOG_MEAN]),
        form("zero_inflated_poisson", &["zero", "log_mean"], ZeroInflatedPoisson, &[ANY, LOG_MEAN]),
        form("gamma", &["mean", "sd"], Gamma, &[POSITIVE, POSITIVE]),
        form("beta", &["alpha", "beta"], Beta, &[POSITIVE, POSITIVE]),
        form("lognormal", &["log_mean", "log_sd"], Lognormal, &[(-700.0, 700.0), AT_LEAST_0]),
        form("categorical", &["weights"], Categorical, &[AT_LEAST_0]),
        form("categorical", &["logits"], CategoricalLogit, &[ANY]),
    ]
};

const fn form(
    name: &'static str,
    keys: &'static [&'static str],
    distribution: DrawLaw,
    ranges: &'static [(f64, f64)],
) -> Form {
    Form { name, keys, distribution, ranges }
}

impl DrawLaw {
    /// How a model writes the distribution.
    pub fn form(self) -> &'static Form {
        let form = FORMS.iter().find(|form| form.distribution == self);
        form.expect("every distribution has a form")
    }

    /// Whether the number of parameters is the author's choice.
    pub fn is_list(self) -> bool {
        matches!(self, DrawLaw::Categorical | DrawLaw::CategoricalLogit)
    }

    /// The least and the most of the parameter at an index.
    pub fn range(self, index: usize) -> (f64, f64) {
        let ranges = self.form().ranges;
        ranges[index.min(ranges.len() - 1)]
    }

    /// Draws numbers by their parameters, \[numbers\] each, and a word for each, of this stream; NaN where the parameters are not valid.
    #[inline(always)]
    pub fn draw(
        self,
        parameters: &[&[f64]],
        (words, stream): (&[u64], u64),
        valid: &[bool],
        out: &mut [f64],
    ) {
        /// Draws the numbers that are valid.
        macro_rules! each {
            (|$i:ident, $words:ident| $draw:expr) => {
                for ($i, out) in out.iter_mut().enumerate() {
                    #[allow(unused_mut, reason = "some laws take one word")]
                    let mut $words = Expansion(words[$i] ^ stream);
                    *out = if valid[$i] { $draw } else { f64::NAN };
                }
            };
        }
        /// Draws all numbers, of which those that are not valid become NaN. There are no branches, so that compilers
        /// vectorise the loop.
        macro_rules! all {
            ([$one:ident], |$words:ident| $draw:expr) => {
                for ((out, word), $one) in out.iter_mut().zip(words).zip($one.iter().copied()) {
                    let mut $words = Expansion(word ^ stream);
                    *out = $draw;
                }
                retain(out, valid);
            };
            ([$one:ident, $other:ident], |$words:ident| $draw:expr) => {
                let both = $one.iter().copied().zip($other.iter().copied());
                for ((out, word), ($one, $other)) in out.iter_mut().zip(words).zip(both) {
                    let mut $words = Expansion(word ^ stream);
                    *out = $draw;
                }
                retain(out, valid);
            };
        }
        match (self, parameters) {
            (DrawLaw::Gaussian, [mean, sd]) => {
                all!([mean, sd], |words| mean + sd * words.normal());
            }
            (DrawLaw::Lognormal, [mean, sd]) => {
                all!([mean, sd], |words| numbers::exp(mean + sd * words.normal()));
            }
            (DrawLaw::Bernoulli, [p]) => {
                all!([p], |words| truth(words.open_unit() < p));
            }
            (DrawLaw::BernoulliLogit, [logit]) => {
                all!([logit], |words| truth(words.open_unit() < sigmoid(logit)));
            }
            (DrawLaw::Uniform, [low, high]) => {
                // Nothing lies between bounds in the wrong order.
                all!([low, high], |words| {
                    let drawn = low + (high - low) * words.open_unit();
                    if high < low { f64::NAN } else { drawn }
                });
            }
            (DrawLaw::Poisson, [mean]) => each!(|i, words| poisson(mean[i], &mut words)),
            (DrawLaw::PoissonLog, [log]) => {
                each!(|i, words| poisson(math::exp(log[i]), &mut words));
            }
            (DrawLaw::ZeroInflatedPoisson, [zero, log]) => {
                // The means, or -1 for a 0 that no count draws.
                all!([zero, log], |words| {
                    let is_zero = words.open_unit() < sigmoid(zero);
                    if is_zero { -1.0 } else { math::exp(log) }
                });
                for ((out, word), valid) in out.iter_mut().zip(words).zip(valid) {
                    if *valid {
                        let mut words = Expansion(word ^ stream);
                        words.open_unit();
                        *out = if *out < 0.0 { 0.0 } else { poisson(*out, &mut words) };
                    }
                }
            }
            (DrawLaw::Gamma, [mean, sd]) => {
                each!(|i, words| gamma(mean[i], sd[i], words.bits()));
            }
            (DrawLaw::Beta, [one, other]) => {
                each!(|i, words| beta([one[i], other[i]], words.bits()));
            }
            (DrawLaw::Categorical, weights) => each!(|i, words| {
                chosen(weights.iter().map(|weight| weight[i]), words.open_unit())
            }),
            (DrawLaw::CategoricalLogit, logits) => each!(|i, words| {
                let most = logits.iter().fold(f64::MIN, |most, logit| most.max(logit[i]));
                let weights = logits.iter().map(|logit| math::exp(logit[i] - most));
                chosen(weights, words.open_unit())
            }),
            _ => unreachable!("a model has read the parameters of a distribution"),
        }
    }
}

/// Replaces the numbers that are not valid by NaN.
#[inline(always)]
fn retain(numbers: &mut [f64], valid: &[bool]) {
    for (number, valid) in numbers.iter_mut().zip(valid) {
        *number = if *valid { *number } else { f64::NAN };
    }
}

/// The index of the weight in which a share of the sum of all falls; NaN if no weight is above 0.
#[inline(always)]
fn chosen(weights: impl Iterator<Item = f64> + Clone, share: f64) -> f64 {
    let all: f64 = weights.clone().sum();
    if !(all > 0.0 && all <= f64::MAX) {
        return f64::NAN;
    }
    let (mut before, mut last) = (0.0, 0.0);
    for (index, weight) in weights.enumerate() {
        if weight > 0.0 {
            last = index as f64;
        }
        before += weight;
        if share * all < before {
            return index as f64;
        }
    }
    last
}
