//! Distributions of a number over participants, in the notation of manifests.
//!
//! In: a TOML value, and the range of the number. Out: a [`Distribution`] all of whose draws are in the
//! range, or the reason for its rejection. Draws are quantiles of one uniform number each. A change of the
//! distribution therefore shifts every participant's value a little instead of exchanging participants.

use std::fmt::{self, Write};
use std::ops::Range;

use toml::de::{DeTable, DeValue};

use super::normal;
use super::number_range::NumberRange;

/// How a number is distributed over participants.
#[derive(Clone, Debug, PartialEq)]
pub enum Distribution {
    /// Every participant has the value of the environment.
    Fixed,
    /// Every participant has this value.
    Constant(f64),
    /// Uniform between two ends; the first is below the second.
    Uniform([f64; 2]),
    /// Normal, truncated to its bounds.
    Normal {
        /// Mean before truncation.
        mean: f64,
        /// Standard deviation before truncation, above 0.
        sd: f64,
        /// The bounds; the first is below the second.
        bounds: [f64; 2],
    },
    /// Log-normal, truncated to its bounds.
    LogNormal {
        /// Median before truncation, above 0.
        median: f64,
        /// Standard deviation of the logarithm before truncation, above 0.
        log_sd: f64,
        /// The bounds, at least 0; the first is below the second.
        bounds: [f64; 2],
    },
    /// One of these values.
    Values {
        /// The distinct values.
        values: Vec<f64>,
        /// Their weights, each above 0; empty for equal weights.
        weights: Vec<f64>,
    },
}

/// Why a value is not a valid distribution.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DistributionError {
    /// The position of the faulty value.
    pub span: Range<usize>,
    /// The fault: "expected …, found …" or a clause.
    pub says: String,
    /// The remedy.
    pub help: Option<String>,
}

/// The words that stand for [`Distribution::Fixed`].
const FIXED: &str = "fixed";

impl Distribution {
    /// The description of a distribution of numbers in this range, to follow "expected".
    pub fn expectation(of: NumberRange) -> String {
        format!(
            "{} for all participants, \"fixed\", or a table with `uniform`, `normal`, \
             `log_normal` or `values`",
            of.expectation()
        )
    }

    /// The distribution in a text of [`Distribution::text`].
    pub(super) fn from_text(of: NumberRange, text: &str) -> Option<Distribution> {
        if text == FIXED {
            return Some(Distribution::Fixed);
        }
        let line = format!("d = {text}");
        let document = DeTable::parse(&line).ok()?;
        Distribution::read(of, document.get_ref().get("d")?).ok()
    }

    /// The distribution on one line in the notation of manifests; `fixed` has no quotes.
    pub fn text(&self) -> String {
        let mut out = String::new();
        self.write(&mut out).expect("writing to a string cannot fail");
        out
    }

    fn write(&self, out: &mut String) -> fmt::Result {
        match self {
            Distribution::Fixed => out.write_str(FIXED),
            Distribution::Constant(value) => write!(out, "{value:?}"),
            Distribution::Uniform([from, to]) => write!(out, "{{ uniform = [{from:?}, {to:?}] }}"),
            Distribution::Normal { mean, sd, bounds: [from, to] } => {
                write!(out, "{{ normal = {mean:?}, sd = {sd:?}, from = {from:?}, to = {to:?} }}")
            }
            Distribution::LogNormal { median, log_sd, bounds: [from, to] } => write!(
                out,
                "{{ log_normal = {median:?}, log_sd = {log_sd:?}, from = {from:?}, to = {to:?} }}"
            ),
            Distribution::Values { values, weights } if weights.is_empty() => {
                write!(out, "{{ values = {values:?} }}")
            }
            Distribution::Values { values, weights } => {
                write!(out, "{{ values = {values:?}, weights = {weights:?} }}")
            }
        }
    }

    /// The quantile at `share`, which is in (0, 1); `None` for [`Distribution::Fixed`].
    pub fn quantile(&self, share: f64) -> Option<f64> {
        let cut = |x: f64, [from, to]: [f64; 2]| x.max(from).min(to);
        match self {
            Distribution::Fixed => None,
            Distribution::Constant(value) => Some(*value),
            Distribution::Uniform([from, to]) => {
                Some(cut(from + (to - from) * share, [*from, *to]))
            }
            Distribution::Normal { mean, sd, bounds } => {
                let standard = bounds.map(|bound| (bound - mean) / sd);
                Some(cut(mean + sd * normal::quantile_between(standard, share), *bounds))
            }
            Distribution::LogNormal { median, log_sd, bounds } => {
                let centre = libm::log(*median);
                let standard = bounds.map(|bound| (libm::log(bound) - centre) / log_sd);
                let log = centre + log_sd * normal::quantile_between(standard, share);
                Some(cut(libm::exp(log), *bounds))
            }
            Distribution::Values { values, weights } => {
                Some(values[drawn_index(weights, values.len(), share)])
            }
        }
    }

    /// The smallest and the largest value of a participant; `None` for [`Distribution::Fixed`].
    pub fn range(&self) -> Option<[f64; 2]> {
        match self {
            Distribution::Fixed => None,
            Distribution::Constant(value) => Some([*value; 2]),
            Distribution::Uniform(bounds)
            | Distribution::Normal { bounds, .. }
            | Distribution::LogNormal { bounds, .. } => Some(*bounds),
            Distribution::Values { values, .. } => {
                let least = values.iter().copied().fold(f64::INFINITY, f64::min);
                Some([least, values.iter().copied().fold(f64::NEG_INFINITY, f64::max)])
            }
        }
    }
}

/// Maximum weight; it keeps sums of weights finite.
pub(super) const LARGEST_WEIGHT: f64 = 1e9;
/// The description of weights in messages.
pub(super) const WEIGHTS: &str = "a number above 0 and at most 1e9";

/// The index, in a list of `count` entries, that a share in (0, 1) selects; without weights, all entries
/// have equal weights.
pub(super) fn drawn_index(weights: &[f64], count: usize, share: f64) -> usize {
    let last = count - 1;
    if weights.is_empty() {
        return ((share * count as f64) as usize).min(last);
    }
    let mut left = share * weights.iter().sum::<f64>();
    for (index, weight) in weights.iter().enumerate() {
        left -= weight;
        if left < 0.0 {
            return index;
        }
    }
    last
}

/// The number in a TOML value; whole numbers are converted.
pub(super) fn number(value: &DeValue<'_>) -> Option<f64> {
    let number = match value {
        DeValue::Float(float) => float.as_str().parse().ok(),
        DeValue::Integer(integer) => {
            i64::from_str_radix(integer.as_str(), integer.radix()).ok().map(|whole| whole as f64)
        }
        _ => None,
    };
    // Adding 0 turns -0 into 0.
    number.filter(|number: &f64| number.is_finite()).map(|number| number + 0.0)
}

mod read;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::key::Kind;

    const SHARE: NumberRange = Kind::PROBABILITY.number_range();
    const REAL: NumberRange = Kind::ANY_REAL.number_range();
    const POSITIVE: NumberRange = Kind::POSITIVE.number_range();

    fn read(of: NumberRange, text: &str) -> Result<Distribution, String> {
        let line = format!("d = {text}");
        let document = DeTable::parse(&line).unwrap();
        Distribution::read(of, &document.get_ref()["d"]).map_err(|error| error.says)
    }

    #[test]
    fn every_shape_is_read_and_written_the_same() {
        for (text, range) in [
            ("0.25", [0.25, 0.25]),
            ("{ uniform = [0.05, 0.15] }", [0.05, 0.15]),
            ("{ normal = 0.1, sd = 0.05, from = 0.0, to = 0.3 }", [0.0, 0.3]),
            ("{ log_normal = 0.1, log_sd = 0.5, from = 0.0, to = 1.0 }", [0.0, 1.0]),
            ("{ values = [0.5, 0.25] }", [0.25, 0.5]),
            ("{ values = [0.5, 0.25], weights = [1.0, 3.0] }", [0.25, 0.5]),
        ] {
            let distribution = read(SHARE, text).unwrap();
            assert_eq!(distribution.text(), text);
            assert_eq!(Distribution::from_text(SHARE, text), Some(distribution.clone()));
            assert_eq!(distribution.range(), Some(range), "{text}");
        }
        assert_eq!(read(SHARE, "\"fixed\""), Ok(Distribution::Fixed));
        assert_eq!(Distribution::from_text(SHARE, "fixed"), Some(Distribution::Fixed));
        // Bounds that are left out are the bounds of the key, and equal weights are dropped.
        let bounds = read(SHARE, "{ normal = 0.5, sd = 2 }").unwrap();
        assert_eq!(bounds.text(), "{ normal = 0.5, sd = 2.0, from = 0.0, to = 1.0 }");
        let equal = read(SHARE, "{ values = [0, 1], weights = [2, 2] }").unwrap();
        assert_eq!(equal.text(), "{ values = [0.0, 1.0] }");
    }

    #[test]
    fn what_has_draws_outside_the_range_is_refused() {
        for (of, text, says) in [
            (SHARE, "1.5", "expected a number from 0 to 1, found 1.5"),
            (SHARE, "{ uniform = [0.5, 1.5] }", "expected a number from 0 to 1, found 1.5"),
            (
                SHARE,
                "{ uniform = [0.5, 0.5] }",
                "the lower end 0.5 must be below the upper end 0.5",
            ),
            (SHARE, "{ uniform = 0.5 }", "expected two numbers, found 0.5"),
            (SHARE, "{ normal = 0.5, sd = 0 }", "expected a number above 0, found 0"),
            (SHARE, "{ normal = 0.5, sd = 1, to = 2 }", "expected a number from 0 to 1, found 2"),
            (
                SHARE,
                "{ normal = 9, sd = 0.1 }",
                "almost no part of the distribution is between 0 and 1",
            ),
            (SHARE, "{ normal = 0.5 }", "`normal` needs `sd`"),
            (SHARE, "{ normal = 0.5, log_sd = 1 }", "unknown key `log_sd` beside `normal`"),
            (SHARE, "{ log_normal = 0, log_sd = 1 }", "expected a number above 0, found 0"),
            (SHARE, "{ values = [] }", "expected a list of 1 to 10000 numbers, found a list of 0"),
            (SHARE, "{ values = [0.5, 0.5] }", "0.5 is listed twice"),
            (
                SHARE,
                "{ values = [0.5, 1], weights = [1] }",
                "expected one weight for each of 2 values, found a list of 1",
            ),
            (
                POSITIVE,
                "{ normal = 1, sd = 1 }",
                "`normal` needs `from`, because the value must be above 0",
            ),
            (
                SHARE,
                "{ from = 0, to = 1, count = 3 }",
                "expected exactly one of `uniform`, `normal`, `log_normal` and `values`",
            ),
        ] {
            assert_eq!(read(of, text).unwrap_err(), says, "{text}");
        }
    }

    #[test]
    fn quantiles_are_those_worked_by_hand() {
        let quantile = |of, text: &str, share| read(of, text).unwrap().quantile(share).unwrap();
        assert_eq!(quantile(SHARE, "0.25", 0.9), 0.25);
        assert!((quantile(SHARE, "{ uniform = [0.2, 0.6] }", 0.25) - 0.3).abs() < 1e-15);
        let values = "{ values = [0.5, 0.25], weights = [1, 3] }";
        assert_eq!(
            [0.2, 0.26, 0.99].map(|share| quantile(SHARE, values, share)),
            [0.5, 0.25, 0.25]
        );
        let equal = "{ values = [0.1, 0.2, 0.3] }";
        assert_eq!([0.1, 0.5, 0.999].map(|share| quantile(SHARE, equal, share)), [0.1, 0.2, 0.3]);
        // Half of a normal distribution: its median is the upper quartile of the whole.
        let half = quantile(REAL, "{ normal = 0, sd = 2, from = 0 }", 0.5);
        assert!((half - 2.0 * 0.674_489_750_196_081_7).abs() < 1e-12, "{half}");
        // Far in the upper tail, where 1 - Phi loses all digits: scipy's truncnorm.ppf(0.5, 4.5, 6).
        let tail = quantile(REAL, "{ normal = 0, sd = 1, from = 4.5, to = 6 }", 0.5);
        assert!((tail - 4.645_127_814_942_5).abs() < 1e-9, "{tail}");
        let log =
            quantile(Kind::NON_NEGATIVE.number_range(), "{ log_normal = 2, log_sd = 0.5 }", 0.75);
        assert!((log - 2.0 * (0.5 * 0.674_489_750_196_081_7_f64).exp()).abs() < 1e-9, "{log}");
    }
}
