//! Values of keys, and the types and ranges that they come from.

use std::fmt;
use std::hash::{Hash, Hasher};

use serde::Serialize;

/// A single value of a key.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Value {
    /// A finite number; never -0, so that equal values have equal bits.
    Real(f64),
    /// A whole number.
    Integer(u64),
    /// `true` or `false`.
    Flag(bool),
    /// One of the key's choices.
    Choice(&'static str),
    /// Two finite numbers, for context 0 and context 1.
    RealPair([f64; 2]),
    /// Widths of layers, input side first.
    Widths(Vec<u32>),
}

// Values are finite and never -0, so equality is reflexive and agrees with the bits.
impl Eq for Value {}

impl Hash for Value {
    fn hash<H: Hasher>(&self, state: &mut H) {
        match self {
            Value::Real(real) => real.to_bits().hash(state),
            Value::Integer(whole) => whole.hash(state),
            Value::Flag(flag) => flag.hash(state),
            Value::Choice(word) => word.hash(state),
            Value::RealPair(pair) => pair.map(f64::to_bits).hash(state),
            Value::Widths(widths) => widths.hash(state),
        }
    }
}

impl fmt::Display for Value {
    /// Writes the value as a manifest does; it reads back equal.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Value::Real(real) => write!(f, "{real:?}"),
            Value::Integer(whole) => write!(f, "{whole}"),
            Value::Flag(flag) => write!(f, "{flag}"),
            Value::Choice(word) => write!(f, "\"{word}\""),
            Value::RealPair([first, second]) => write!(f, "[{first:?}, {second:?}]"),
            Value::Widths(widths) => write!(f, "{widths:?}"),
        }
    }
}

/// The largest number that a key without a range of its own takes.
const LARGEST: f64 = 1e6;

/// The type of a key's values, with their range (both ends included unless said).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// A finite number.
    Real {
        /// The smallest.
        min: f64,
        /// The largest.
        max: f64,
    },
    /// A finite number above 0.
    PositiveReal {
        /// The largest.
        max: f64,
    },
    /// A whole number.
    Integer {
        /// The smallest.
        min: u64,
        /// The largest.
        max: u64,
    },
    /// `true` or `false`.
    Flag,
    /// One of these words.
    Choice(&'static [&'static str]),
    /// Two finite numbers.
    RealPair {
        /// The smallest of each.
        min: f64,
        /// The largest of each.
        max: f64,
    },
    /// A list of at least one layer width, each at least 1.
    Widths {
        /// The longest list.
        most: usize,
        /// The largest width.
        max: u32,
    },
}

impl Kind {
    /// A probability or a fraction.
    pub const PROBABILITY: Kind = Kind::Real { min: 0.0, max: 1.0 };
    /// A number of any size that a simulation can be expected to have.
    pub const ANY_REAL: Kind = Kind::Real { min: -LARGEST, max: LARGEST };
    /// A number from 0 of any size that a simulation can be expected to have.
    pub const NON_NEGATIVE: Kind = Kind::Real { min: 0.0, max: LARGEST };
    /// A number above 0 of any size that a simulation can be expected to have.
    pub const POSITIVE: Kind = Kind::PositiveReal { max: LARGEST };
    /// Two numbers of any size that a simulation can be expected to have.
    pub const ANY_REAL_PAIR: Kind = Kind::RealPair { min: -LARGEST, max: LARGEST };
    /// A number of episodes.
    pub const EPISODES: Kind = Kind::Integer { min: 1, max: 10_000_000 };

    /// Whether a value has this type and lies in this range.
    pub fn admits(self, value: &Value) -> bool {
        match (self, value) {
            (Kind::Real { min, max }, Value::Real(x)) => (min..=max).contains(x),
            (Kind::PositiveReal { max }, Value::Real(x)) => *x > 0.0 && *x <= max,
            (Kind::Integer { min, max }, Value::Integer(n)) => (min..=max).contains(n),
            (Kind::RealPair { min, max }, Value::RealPair(pair)) => {
                pair.iter().all(|x| (min..=max).contains(x))
            }
            (Kind::Widths { most, max }, Value::Widths(widths)) => {
                let inside = widths.iter().all(|width| (1..=max).contains(width));
                inside && (1..=most).contains(&widths.len())
            }
            (Kind::Flag, Value::Flag(_)) => true,
            (Kind::Choice(words), Value::Choice(word)) => words.contains(word),
            _ => false,
        }
    }

    /// The values in words, to follow "expected".
    pub fn expectation(self) -> String {
        match self {
            Kind::Real { min, max } => format!("a number from {min} to {max}"),
            Kind::PositiveReal { max } => format!("a number above 0 and at most {max}"),
            Kind::Integer { min, max } => format!("a whole number from {min} to {max}"),
            Kind::Flag => "true or false".to_owned(),
            Kind::Choice(words) => {
                let quoted: Vec<_> = words.iter().map(|word| format!("\"{word}\"")).collect();
                quoted.join(" or ")
            }
            Kind::RealPair { min, max } => {
                format!("two numbers from {min} to {max}, as in [0.1, 0.1]")
            }
            Kind::Widths { most, max } => {
                format!("a list of 1 to {most} layer widths, each a whole number from 1 to {max}")
            }
        }
    }

    /// The value that a canonical form writes as this JSON; `None` if it is of another type.
    pub(super) fn value(self, json: &serde_json::Value) -> Option<Value> {
        // Adding 0 turns -0 into 0.
        let real = |json: &serde_json::Value| json.as_f64().map(|real| real + 0.0);
        match self {
            Kind::Real { .. } | Kind::PositiveReal { .. } => real(json).map(Value::Real),
            Kind::Integer { .. } => json.as_u64().map(Value::Integer),
            Kind::Flag => json.as_bool().map(Value::Flag),
            Kind::Choice(words) => {
                words.iter().find(|word| json == **word).map(|word| Value::Choice(word))
            }
            Kind::RealPair { .. } => {
                let [first, second] = json.as_array()?.as_slice() else { return None };
                Some(Value::RealPair([real(first)?, real(second)?]))
            }
            Kind::Widths { .. } => {
                let width = |json: &serde_json::Value| u32::try_from(json.as_u64()?).ok();
                json.as_array()?.iter().map(width).collect::<Option<_>>().map(Value::Widths)
            }
        }
    }
}
