//! The value of a parameter as a single number or text.

use std::fmt;

use crate::key::Value;

/// A parameter's value in a form that SQL and conditions can hold. Numbers are equal if their values are.
#[derive(Clone, Debug)]
pub enum Scalar {
    /// A number with a fraction.
    Real(f64),
    /// An integer; flags are 0 and 1.
    Integer(i64),
    /// A word, or a list as JSON text (`[128,128]`).
    Text(String),
}

impl Scalar {
    /// The value if it is a number.
    pub fn number(&self) -> Option<f64> {
        match self {
            Scalar::Real(real) => Some(*real),
            Scalar::Integer(whole) => Some(*whole as f64),
            Scalar::Text(_) => None,
        }
    }
}

impl PartialEq for Scalar {
    fn eq(&self, other: &Scalar) -> bool {
        match (self, other) {
            (Scalar::Integer(one), Scalar::Integer(other)) => one == other,
            (Scalar::Text(one), Scalar::Text(other)) => one == other,
            (one, other) => one.number().is_some_and(|one| Some(one) == other.number()),
        }
    }
}

impl From<&Value> for Scalar {
    fn from(value: &Value) -> Scalar {
        match value {
            Value::Real(real) => Scalar::Real(*real),
            Value::Integer(whole) => i64::try_from(*whole)
                .map_or_else(|_| Scalar::Text(whole.to_string()), Scalar::Integer),
            Value::Flag(flag) => Scalar::Integer(i64::from(*flag)),
            Value::Choice(word) => Scalar::Text((*word).to_owned()),
            Value::Negative(whole) => Scalar::Integer(*whole),
            Value::Text(text) => Scalar::Text(text.clone()),
            Value::RealPair(_) | Value::Reals(_) | Value::Wholes(_) | Value::Words(_) => {
                let json = serde_json::to_string(value).expect("values are finite");
                Scalar::Text(json)
            }
            Value::Distribution(distribution) => Scalar::Text(distribution.text()),
            Value::Rows(rows) => Scalar::Text(rows.text()),
            Value::Content(content) => Scalar::Text(content.name()),
        }
    }
}

impl fmt::Display for Scalar {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            // From 1e-4 to 1e15 without an exponent, as `arm_summary` writes it.
            Scalar::Real(number) if *number != 0.0 && !(1e-4..1e15).contains(&number.abs()) => {
                write!(f, "{number:e}")
            }
            Scalar::Real(number) => write!(f, "{number}"),
            Scalar::Integer(number) => write!(f, "{number}"),
            Scalar::Text(text) => f.write_str(text),
        }
    }
}
