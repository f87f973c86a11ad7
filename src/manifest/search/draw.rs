//! Draws: the values of a hyper-parameter that a search takes from a range or a list.
//!
//! In: an inline table, such as `{ log_uniform = [1e-5, 1e-2] }`. Out: the value at each number of the unit
//! interval. The points of the unit cube come from [`super::points`].

use std::fmt;

use crate::key::{Kind, Value, choices};
use crate::manifest::text::written::list;
use crate::manifest::value::respelt::respelt;
use crate::manifest::value::sweep::{Node, Reader};
use crate::text::{Fault, nearest};

choices! {
    /// How values are drawn.
    pub enum DrawForm {
        /// Numbers between two ends, uniform in their logarithm; whole numbers for a key of whole numbers.
        LogUniform = "log_uniform",
        /// Numbers between two ends.
        Uniform = "uniform",
        /// Whole numbers from one end to the other, both included.
        Integers = "integers",
        /// One of the listed values.
        Choices = "choices",
    }
}

/// A draw of the values of a key.
#[derive(Clone, Debug, PartialEq)]
pub struct Draw {
    form: DrawForm,
    /// The two ends, or the choices.
    values: Vec<Value>,
}

/// The significant digits of a drawn number, which keep it readable.
const DIGITS: i32 = 3;

impl DrawForm {
    /// The kind of the ends for a key of this kind; `None` if the key has no such draw, or for choices.
    pub(in crate::manifest) fn ends(self, kind: Kind) -> Option<Kind> {
        let whole = Kind::Integer { min: 0, max: i64::MAX as u64 };
        let real = Kind::Real { min: f64::MIN, max: f64::MAX };
        match (self, kind.of_numbers()) {
            (
                DrawForm::LogUniform,
                kind @ (Kind::Real { .. } | Kind::PositiveReal { .. } | Kind::Integer { .. }),
            )
            | (DrawForm::Uniform, kind @ (Kind::Real { .. } | Kind::PositiveReal { .. }))
            | (DrawForm::Integers, kind @ Kind::Integer { .. }) => Some(kind),
            (DrawForm::LogUniform | DrawForm::Uniform, Kind::Scalar) => Some(real),
            (DrawForm::Integers, Kind::Scalar) => Some(whole),
            _ => None,
        }
    }
}

impl Draw {
    /// The value at `u`, a number from 0 to below 1.
    pub(in crate::manifest) fn at(&self, u: f64) -> Value {
        match (self.form, self.values.as_slice()) {
            (DrawForm::LogUniform, [Value::Real(from), Value::Real(to)]) => {
                let drawn = from * libm::pow(to / from, u);
                Value::Real(significant(drawn, drawn).clamp(*from, *to))
            }
            (DrawForm::Uniform, [Value::Real(from), Value::Real(to)]) => {
                let drawn = from + (to - from) * u;
                Value::Real(significant(drawn, to - from).clamp(*from, *to))
            }
            (DrawForm::LogUniform, [Value::Integer(from), Value::Integer(to)]) => {
                let drawn = *from as f64 * libm::pow(*to as f64 / *from as f64, u);
                Value::Integer((drawn.round() as u64).clamp(*from, *to))
            }
            (_, [Value::Integer(from), Value::Integer(to)]) if self.form == DrawForm::Integers => {
                let count = (to - from) as f64 + 1.0;
                Value::Integer(from + ((count * u) as u64).min(to - from))
            }
            (_, choices) => {
                let index = (choices.len() as f64 * u) as usize;
                choices[index.min(choices.len() - 1)].clone()
            }
        }
    }
}

/// `x`, rounded to [`DIGITS`] significant digits of a number as large as `size`; never -0.
fn significant(x: f64, size: f64) -> f64 {
    let decimals = (DIGITS - 1 - libm::floor(libm::log10(size.abs())) as i32).clamp(-300, 300);
    let rounded = match u32::try_from(decimals) {
        // The nearest number to decimal digits, as an author would type them.
        Ok(decimals) => format!("{x:.*}", decimals as usize).parse().unwrap_or(x),
        Err(_) => {
            let unit = libm::pow(10.0, f64::from(-decimals));
            (x / unit).round() * unit
        }
    };
    if rounded == 0.0 { 0.0 } else { rounded }
}

/// Writes the draw as a manifest does.
impl fmt::Display for Draw {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{{ {} = {} }}", self.form.word(), list(&self.values))
    }
}

/// Whether a value is a draw: a table of one key that is the word of a form, or nearly so.
pub(in crate::manifest) fn is_draw(node: &Node) -> bool {
    let Some(table) = node.get_ref().as_table() else { return false };
    let mut keys = table.keys().map(|key| key.get_ref().as_ref());
    keys.any(|key| DrawForm::WORDS.contains(&key))
        || (table.len() == 1
            && table
                .keys()
                .any(|key| nearest(key.get_ref(), DrawForm::WORDS.iter().copied()).is_some()))
}

impl Reader<'_> {
    /// The draw of the key `name` in `node`, which [`is_draw`]; reports faults.
    pub fn draw(&mut self, name: &str, kind: Kind, node: &Node) -> Option<Draw> {
        let words = DrawForm::WORDS;
        let table = node.get_ref().as_table()?;
        self.only_keys(&format!("the draw of `{name}`"), words, table);
        let table = &*respelt(table, words);
        if table.len() > 1 {
            let message = format!("a draw of `{name}` has one key");
            let fault = Fault::at(node.span().into(), message);
            self.faults.add(fault.help(format!("write one of {}", words.join(", "))));
            return None;
        }
        let (word, of) = words.iter().find_map(|word| Some((word, table.get(*word)?)))?;
        let form = DrawForm::named(word)?;
        let values = match form {
            DrawForm::Choices => self.choices(name, kind, of)?,
            DrawForm::LogUniform | DrawForm::Uniform | DrawForm::Integers => {
                self.ends(name, kind, form, of)?
            }
        };
        Some(Draw { form, values })
    }

    /// At least two distinct values of `kind`.
    fn choices(&mut self, name: &str, kind: Kind, node: &Node) -> Option<Vec<Value>> {
        let items = node.get_ref().as_array().map_or(&[][..], |items| &items[..]);
        if items.len() < 2 {
            let expected = format!("a list of at least two values, each {}", kind.expectation());
            self.expected(&format!("{name}.choices"), &expected, node);
            return None;
        }
        if !self.count_in(name, items.len(), node) {
            return None;
        }
        let values =
            self.distinct(name, items.iter(), |reader, item| reader.value(name, kind, item));
        (values.len() == items.len()).then_some(values)
    }

    /// The two ends of a draw, the lower one first.
    fn ends(&mut self, name: &str, kind: Kind, form: DrawForm, node: &Node) -> Option<Vec<Value>> {
        let word = form.word();
        let Some(of_ends) = form.ends(kind) else {
            let message = format!("`{name}`: {word} does not draw {}", kind.expectation());
            let help = match kind {
                Kind::Integer { .. } => "write { integers = [1, 10] } or { log_uniform = [1, 10] }",
                Kind::Real { .. } | Kind::PositiveReal { .. } => "write { uniform = [0.1, 1.0] }",
                _ => "write { choices = […] } with the values themselves",
            };
            self.faults.add(Fault::at(node.span().into(), message).help(help));
            return None;
        };
        let items = node.get_ref().as_array().map_or(&[][..], |items| &items[..]);
        let [from, to] = items else {
            self.expected(&format!("{name}.{word}"), "two ends, as in [1e-5, 1e-2]", node);
            return None;
        };
        let part = |reader: &mut Self, end: &Node| reader.value(name, of_ends, end);
        let (from, to) = (part(self, from), part(self, to));
        let (from, to) = (from?, to?);
        let number = |value: &Value| match value {
            Value::Real(real) => *real,
            Value::Integer(whole) => *whole as f64,
            _ => f64::NAN,
        };
        let problem = match (number(&from), number(&to)) {
            (low, high) if low >= high => "the first end must be below the second",
            (low, _) if low <= 0.0 && form == DrawForm::LogUniform => {
                "log_uniform needs ends above 0"
            }
            (low, high) if !(high - low).is_finite() => "the ends are too far apart",
            _ => return Some(vec![from, to]),
        };
        self.faults.add(Fault::at(node.span().into(), format!("`{name}`: {problem}")));
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn draw(form: DrawForm, values: &[Value]) -> Draw {
        Draw { form, values: values.to_vec() }
    }

    fn reals(form: DrawForm, from: f64, to: f64, u: f64) -> f64 {
        match draw(form, &[Value::Real(from), Value::Real(to)]).at(u) {
            Value::Real(real) => real,
            other => panic!("{other}"),
        }
    }

    #[test]
    fn numbers_are_drawn_between_their_ends_with_three_digits() {
        // 1e-5 × 1000^u.
        assert_eq!(reals(DrawForm::LogUniform, 1e-5, 1e-2, 0.0), 1e-5);
        assert_eq!(reals(DrawForm::LogUniform, 1e-5, 1e-2, 0.5), 3.16e-4);
        assert_eq!(reals(DrawForm::LogUniform, 1e-5, 1e-2, 1.0 - f64::EPSILON), 1e-2);
        assert_eq!(reals(DrawForm::LogUniform, 1e3, 1e5, 0.5), 1e4);
        // The digits are those of the width, 0.099.
        assert_eq!(reals(DrawForm::Uniform, 0.9, 0.999, 0.5), 0.9495);
        assert_eq!(reals(DrawForm::Uniform, -1.0, 1.0, 0.123_456), -0.75);
        assert!(reals(DrawForm::Uniform, -1.0, 1.0, 0.5).is_sign_positive());
        // Rounding stays inside the ends.
        assert_eq!(reals(DrawForm::Uniform, 0.123_456, 0.223_456, 0.0), 0.123_456);
    }

    #[test]
    fn whole_numbers_and_choices_have_equal_shares() {
        let whole = draw(DrawForm::Integers, &[Value::Integer(3), Value::Integer(6)]);
        let drawn: Vec<Value> = (0..8).map(|i| whole.at(f64::from(i) / 8.0)).collect();
        let expected = [3, 3, 4, 4, 5, 5, 6, 6].map(Value::Integer);
        assert_eq!(drawn, expected);
        let log = draw(DrawForm::LogUniform, &[Value::Integer(16), Value::Integer(256)]);
        assert_eq!(log.at(0.5), Value::Integer(64));
        let choices = draw(DrawForm::Choices, &[Value::Flag(true), Value::Flag(false)]);
        assert_eq!([choices.at(0.49), choices.at(0.5)], [true, false].map(Value::Flag));
    }
}
