//! Values of keys, and their types and ranges.

use std::fmt;
use std::hash::{Hash, Hasher};

use serde::{Serialize, Serializer};

use super::content::{Content, ContentForm};
use super::distribution::Distribution;
use super::number_range::NumberRange;
use super::rows::{Column, Rows};
use crate::text::quoted;

/// A single value of a key.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Value {
    /// A finite number; never -0, so that equal values have equal bits.
    Real(f64),
    /// A whole number.
    Integer(u64),
    /// A whole number below 0.
    Negative(i64),
    /// `true` or `false`.
    Flag(bool),
    /// One of the key's choices.
    Choice(&'static str),
    /// Two finite numbers, for context 0 and context 1.
    RealPair([f64; 2]),
    /// A list of finite numbers, never -0.
    Reals(Vec<f64>),
    /// A list of whole numbers, such as the widths of layers, input side first.
    Wholes(Vec<u32>),
    /// A text that the author chooses.
    Text(String),
    /// A list of texts, such as the words of a command.
    Words(Vec<String>),
    /// The distribution of a number over participants, serialised as text, which manifests also accept.
    #[serde(serialize_with = "distribution_text")]
    Distribution(Distribution),
    /// Rows from which participants are drawn, serialised as the text of a CSV file.
    #[serde(serialize_with = "rows_text")]
    Rows(Rows),
    /// The text of a file, serialised as its digest.
    #[serde(serialize_with = "content_name")]
    Content(Content),
}

fn distribution_text<S: Serializer>(of: &Distribution, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(&of.text())
}

fn rows_text<S: Serializer>(rows: &Rows, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(&rows.text())
}

fn content_name<S: Serializer>(content: &Content, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(&content.name())
}

// Values are finite and never -0, so equality is reflexive and agrees with the bits.
impl Eq for Value {}

impl Hash for Value {
    fn hash<H: Hasher>(&self, state: &mut H) {
        match self {
            Value::Real(real) => real.to_bits().hash(state),
            Value::Integer(whole) => whole.hash(state),
            Value::Negative(whole) => whole.hash(state),
            Value::Flag(flag) => flag.hash(state),
            Value::Choice(word) => word.hash(state),
            Value::RealPair(pair) => pair.map(f64::to_bits).hash(state),
            Value::Reals(reals) => reals.iter().for_each(|real| real.to_bits().hash(state)),
            Value::Wholes(wholes) => wholes.hash(state),
            Value::Text(text) => text.hash(state),
            Value::Words(words) => words.hash(state),
            Value::Distribution(distribution) => distribution.text().hash(state),
            Value::Rows(rows) => rows.text().hash(state),
            Value::Content(content) => content.name().hash(state),
        }
    }
}

impl fmt::Display for Value {
    /// Writes the value as a manifest does; the text parses to an equal value.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Value::Real(real) => write!(f, "{real:?}"),
            Value::Integer(whole) => write!(f, "{whole}"),
            Value::Negative(whole) => write!(f, "{whole}"),
            Value::Flag(flag) => write!(f, "{flag}"),
            Value::Choice(word) => write!(f, "\"{word}\""),
            Value::RealPair([first, second]) => write!(f, "[{first:?}, {second:?}]"),
            Value::Reals(reals) => write!(f, "{reals:?}"),
            Value::Wholes(wholes) => write!(f, "{wholes:?}"),
            Value::Text(text) => f.write_str(&quoted(text)),
            Value::Words(words) => {
                let words: Vec<String> = words.iter().map(|word| quoted(word)).collect();
                write!(f, "[{}]", words.join(", "))
            }
            Value::Distribution(Distribution::Fixed) => {
                write!(f, "\"{}\"", Distribution::Fixed.text())
            }
            Value::Distribution(distribution) => f.write_str(&distribution.text()),
            // The text has only names, numbers, commas and line breaks.
            Value::Rows(rows) => write!(f, "\"{}\"", rows.text().replace('\n', "\\n")),
            Value::Content(content) => content.fmt(f),
        }
    }
}

/// Whether a text has at most `most` characters and no control characters.
fn is_plain(text: &str, most: usize) -> bool {
    text.chars().count() <= most && !text.chars().any(char::is_control)
}

/// Maximum absolute value of numbers in keys without a specific range.
const LARGEST: f64 = 1e6;

/// The type and range of a key's values; ranges include both ends unless stated otherwise.
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
    /// A list of finite numbers.
    Reals {
        /// The shortest list.
        least: usize,
        /// The longest list.
        most: usize,
        /// The smallest of each.
        min: f64,
        /// The largest of each.
        max: f64,
    },
    /// A list of strictly increasing whole numbers, each at least 1; it may be empty.
    Counts {
        /// The longest list.
        most: usize,
        /// The largest number.
        max: u32,
    },
    /// A list of at least one layer width, each at least 1.
    Widths {
        /// The longest list.
        most: usize,
        /// The largest width.
        max: u32,
    },
    /// A text of 1 to `most` characters without control characters.
    Text {
        /// The most characters.
        most: usize,
    },
    /// A list of at least one text without control characters; the first text is not empty.
    Words {
        /// The longest list.
        most: usize,
        /// The most characters of each.
        longest: usize,
    },
    /// `true` or `false`, a number, or a text without control characters.
    Scalar,
    /// A distribution of a number over participants, with all draws in this range.
    Distribution(NumberRange),
    /// Rows from which participants are drawn, with a subset of these columns.
    Rows(&'static [Column]),
    /// The text of a file of this form, or none.
    Content(&'static ContentForm),
    /// Any of these kinds, whose values differ in their types; texts and numbers have at most one of them.
    AnyOf(&'static [Kind]),
}

impl Kind {
    /// A probability or a fraction.
    pub const PROBABILITY: Kind = Kind::Real { min: 0.0, max: 1.0 };
    /// A number from -1e6 to 1e6.
    pub const ANY_REAL: Kind = Kind::Real { min: -LARGEST, max: LARGEST };
    /// A number from 0 to 1e6.
    pub const NON_NEGATIVE: Kind = Kind::Real { min: 0.0, max: LARGEST };
    /// A number above 0, up to 1e6.
    pub const POSITIVE: Kind = Kind::PositiveReal { max: LARGEST };
    /// Two numbers from -1e6 to 1e6.
    pub const ANY_REAL_PAIR: Kind = Kind::RealPair { min: -LARGEST, max: LARGEST };
    /// A number of episodes.
    pub const EPISODES: Kind = Kind::Integer { min: 1, max: 10_000_000 };

    /// Maximum length of the text of a [`Kind::Scalar`].
    pub const LONGEST_TEXT: usize = 1000;

    /// The range of the numbers of a real-valued kind.
    ///
    /// # Panics
    /// If the kind is neither `Real` nor `PositiveReal`.
    pub const fn number_range(self) -> NumberRange {
        match self {
            Kind::Real { min, max } => NumberRange { min: Some(min), max },
            Kind::PositiveReal { max } => NumberRange { min: None, max },
            _ => panic!("not a kind of single numbers with a fraction"),
        }
    }

    /// Whether a value has this type and lies in this range.
    pub fn admits(self, value: &Value) -> bool {
        match (self, value) {
            (Kind::Real { .. } | Kind::PositiveReal { .. }, Value::Real(x)) => {
                self.number_range().admits(*x)
            }
            (Kind::Integer { min, max }, Value::Integer(n)) => (min..=max).contains(n),
            (Kind::RealPair { min, max }, Value::RealPair(pair)) => {
                pair.iter().all(|x| (min..=max).contains(x))
            }
            (Kind::Widths { most, max }, Value::Wholes(widths)) => {
                let inside = widths.iter().all(|width| (1..=max).contains(width));
                inside && (1..=most).contains(&widths.len())
            }
            (Kind::Reals { least, most, min, max }, Value::Reals(reals)) => {
                let inside = reals.iter().all(|x| (min..=max).contains(x));
                inside && (least..=most).contains(&reals.len())
            }
            (Kind::Counts { most, max }, Value::Wholes(counts)) => {
                let inside = counts.iter().all(|count| (1..=max).contains(count));
                inside && counts.len() <= most && counts.is_sorted_by(|one, next| one < next)
            }
            (Kind::Flag | Kind::Scalar, Value::Flag(_)) => true,
            (Kind::Scalar, Value::Real(x)) => x.is_finite(),
            (Kind::Scalar, Value::Integer(n)) => i64::try_from(*n).is_ok(),
            (Kind::Scalar, Value::Negative(n)) => *n < 0,
            (Kind::Scalar, Value::Text(text)) => is_plain(text, Kind::LONGEST_TEXT),
            (Kind::Text { most }, Value::Text(text)) => !text.is_empty() && is_plain(text, most),
            (Kind::Words { most, longest }, Value::Words(words)) => {
                let has_first = words.first().is_some_and(|first| !first.trim().is_empty());
                has_first && words.len() <= most && words.iter().all(|word| is_plain(word, longest))
            }
            (Kind::Choice(words), Value::Choice(word)) => words.contains(word),
            (Kind::Distribution(of), Value::Distribution(distribution)) => {
                distribution.range().into_iter().flatten().all(|end| of.admits(end))
            }
            (Kind::Rows(known), Value::Rows(rows)) => known.iter().all(|column| {
                rows.range(column.name).into_iter().flatten().all(|end| column.of.admits(end))
            }),
            // The text was parsed when it was read.
            (Kind::Content(_), Value::Content(_)) => true,
            (Kind::AnyOf(kinds), value) => kinds.iter().any(|kind| kind.admits(value)),
            _ => false,
        }
    }

    /// The value with which a job is smallest: the least number or list, `false`, or the first word.
    /// `None` for kinds that do not determine the size of a job, such as real numbers.
    pub fn smallest(self) -> Option<Value> {
        match self {
            Kind::Integer { min, .. } => Some(Value::Integer(min)),
            Kind::Flag => Some(Value::Flag(false)),
            Kind::Choice(words) => words.first().copied().map(Value::Choice),
            Kind::Widths { .. } => Some(Value::Wholes(vec![1])),
            Kind::AnyOf(kinds) => kinds.iter().find_map(|kind| kind.smallest()),
            _ => None,
        }
    }

    /// The description of the values, to follow "expected".
    pub fn expectation(self) -> String {
        match self {
            Kind::Real { .. } | Kind::PositiveReal { .. } => self.number_range().expectation(),
            Kind::Integer { min, max } => format!("a whole number from {min} to {max}"),
            Kind::Flag => "true or false".to_owned(),
            Kind::Choice(words) => {
                let quoted: Vec<_> = words.iter().map(|word| format!("\"{word}\"")).collect();
                quoted.join(" or ")
            }
            Kind::RealPair { min, max } => {
                format!("two numbers from {min} to {max}, as in [0.1, 0.1]")
            }
            Kind::Reals { least, most, min, max } => {
                format!("a list of {least} to {most} numbers, each from {min} to {max}")
            }
            Kind::Counts { most, max } => {
                format!("a list of at most {most} whole numbers from 1 to {max}, smallest first")
            }
            Kind::Widths { most, max } => {
                format!("a list of 1 to {most} layer widths, each a whole number from 1 to {max}")
            }
            Kind::Text { most } => {
                format!("a text of 1 to {most} characters in quotes, without control characters")
            }
            Kind::Words { most, longest } => format!(
                "a list of 1 to {most} texts of at most {longest} characters, as in [\"python\", \
                 \"train.py\"]"
            ),
            Kind::Scalar => {
                let most = Kind::LONGEST_TEXT;
                format!("true, false, a number, or a text of at most {most} characters")
            }
            Kind::Distribution(of) => Distribution::expectation(of),
            Kind::Rows(_) => "\"none\", a list of tables, or the name of a CSV file".to_owned(),
            Kind::Content(form) => form.expectation(),
            Kind::AnyOf(kinds) => {
                kinds.iter().map(|kind| kind.expectation()).collect::<Vec<_>>().join(", or ")
            }
        }
    }

    /// The kind of a sweep's range, or of its draws: the only kind of numbers among those of [`Kind::AnyOf`].
    pub fn of_numbers(self) -> Kind {
        let is_number = |kind: &&Kind| {
            matches!(kind, Kind::Real { .. } | Kind::PositiveReal { .. } | Kind::Integer { .. })
        };
        match self {
            Kind::AnyOf(kinds) => kinds.iter().find(is_number).copied().unwrap_or(self),
            kind => kind,
        }
    }

    /// The value in the JSON of a canonical form; `None` if it has another type.
    pub fn value(self, json: &serde_json::Value) -> Option<Value> {
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
            Kind::Reals { .. } => {
                json.as_array()?.iter().map(real).collect::<Option<_>>().map(Value::Reals)
            }
            Kind::Counts { .. } | Kind::Widths { .. } => {
                let width = |json: &serde_json::Value| u32::try_from(json.as_u64()?).ok();
                json.as_array()?.iter().map(width).collect::<Option<_>>().map(Value::Wholes)
            }
            Kind::Text { .. } => json.as_str().map(|text| Value::Text(text.to_owned())),
            Kind::Words { .. } => {
                let word = |json: &serde_json::Value| json.as_str().map(str::to_owned);
                json.as_array()?.iter().map(word).collect::<Option<_>>().map(Value::Words)
            }
            Kind::Scalar => match json {
                serde_json::Value::Bool(flag) => Some(Value::Flag(*flag)),
                serde_json::Value::Number(number) => match (number.as_u64(), number.as_i64()) {
                    (Some(whole), _) => Some(Value::Integer(whole)),
                    (None, Some(whole)) => Some(Value::Negative(whole)),
                    (None, None) => real(json).map(Value::Real),
                },
                serde_json::Value::String(text) => Some(Value::Text(text.clone())),
                _ => None,
            },
            Kind::Distribution(of) => {
                Distribution::from_text(of, json.as_str()?).map(Value::Distribution)
            }
            Kind::Rows(known) => Rows::from_text(known, json.as_str()?).map(Value::Rows),
            Kind::Content(_) => Content::named(json.as_str()?).map(Value::Content),
            Kind::AnyOf(kinds) => {
                let read = || kinds.iter().filter_map(|kind| kind.value(json));
                read().find(|value| self.admits(value)).or_else(|| read().next())
            }
        }
    }
}
