//! Decision rules that need no training: what researchers compare with.

use std::fmt;
use std::str::FromStr;

use crate::env::{Action, Signal};
use crate::rng::Stream;

/// A decision rule on the inferred context.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rule {
    /// The same action always.
    Fixed(Action),
    /// Any action, each equally likely.
    Random,
    /// A message tailored to the most likely context l.
    Match,
    /// As `Match` where the most likely context has at least this probability, else nothing.
    Threshold(f64),
}

impl Rule {
    /// The names a rule can be written by, for messages.
    pub const NAMES: &'static str = "fixed:<action 0-3>, random, match, threshold:<0.5-1>";

    /// The action for an inferred context; draws from the stream once if the rule is `Random`.
    pub fn choose(self, signal: &Signal, stream: &mut Stream) -> Action {
        match self {
            Rule::Fixed(action) => action,
            Rule::Random => Action::from_low_bits(stream.bits()),
            Rule::Match => Action::tailored_to(signal.likely),
            Rule::Threshold(least) => {
                let p = signal.probability_of_zero;
                if p.max(1.0 - p) >= least {
                    Action::tailored_to(signal.likely)
                } else {
                    Action::NONE
                }
            }
        }
    }
}

/// A text that names no rule.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a rule; the rules are {names}", names = Rule::NAMES)]
pub struct RuleError(String);

impl FromStr for Rule {
    type Err = RuleError;

    fn from_str(text: &str) -> Result<Self, RuleError> {
        let (name, argument) = text.split_once(':').map_or((text, None), |(n, a)| (n, Some(a)));
        let rule = match (name, argument) {
            ("random", None) => Some(Rule::Random),
            ("match", None) => Some(Rule::Match),
            ("fixed", Some(index)) => {
                index.parse().ok().and_then(Action::from_index).map(Rule::Fixed)
            }
            ("threshold", Some(p)) => {
                p.parse().ok().filter(|p| (0.5..=1.0).contains(p)).map(Rule::Threshold)
            }
            _ => None,
        };
        rule.ok_or_else(|| RuleError(text.to_owned()))
    }
}

impl fmt::Display for Rule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Rule::Fixed(action) => write!(f, "fixed:{}", action.index()),
            Rule::Random => f.write_str("random"),
            Rule::Match => f.write_str("match"),
            Rule::Threshold(p) => write!(f, "threshold:{p}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Purpose;

    #[test]
    fn rules_choose_by_the_inferred_context() {
        let mut stream = Stream::new(1, Purpose::TestActions);
        let mut choose = |rule: &str, p: f64| {
            rule.parse::<Rule>().unwrap().choose(&Signal::new(0, p), &mut stream).index()
        };
        assert_eq!(choose("fixed:1", 0.2), 1);
        assert_eq!(choose("match", 0.2), 3);
        assert_eq!(choose("match", 0.8), 2);
        assert_eq!(choose("threshold:0.75", 0.7), 0);
        assert_eq!(choose("threshold:0.75", 0.75), 2);
        assert_eq!(choose("threshold:0.75", 0.1), 3);
        let seen: std::collections::HashSet<usize> =
            (0..100).map(|_| choose("random", 0.5)).collect();
        assert_eq!(seen.len(), 4);
    }

    #[test]
    fn rules_read_back_as_written_and_faults_are_named() {
        for text in ["fixed:0", "random", "match", "threshold:0.9"] {
            assert_eq!(text.parse::<Rule>().unwrap().to_string(), text);
        }
        for text in ["", "fixed", "fixed:4", "fixed:-1", "threshold:0.4", "threshold:NaN", "matc"] {
            assert!(text.parse::<Rule>().is_err(), "{text}");
        }
    }
}
