//! Functions of numbers, in which NaN stands for a missing value.

use crate::env::declared::expression::{Binary, Expression, ExpressionNode, Unary};
use crate::kernel::math;

/// The value of a function of one number.
#[inline(always)]
pub(super) fn unary(function: Unary, x: f64) -> f64 {
    match function {
        Unary::Minus => -x,
        Unary::Not => known(truth(x == 0.0), x),
        Unary::Abs => x.abs(),
        Unary::Exp => exp(x),
        Unary::Log => log(x),
        Unary::Sqrt => x.sqrt(),
        Unary::Sigmoid => known(sigmoid(x), x),
        Unary::NormalCdf => normal_cdf(x),
        Unary::Floor => x.floor(),
        Unary::Round => round(x),
    }
}

/// The value of a function of two numbers.
#[inline(always)]
pub(super) fn binary(function: Binary, x: f64, y: f64) -> f64 {
    match function {
        Binary::Plus => x + y,
        Binary::Minus => x - y,
        Binary::Times => x * y,
        Binary::Divided => divided(x, y),
        Binary::Modulo => modulo(x, y),
        Binary::Power => power(x, y),
        Binary::Less => both(truth(x < y), x, y),
        Binary::AtMost => both(truth(x <= y), x, y),
        Binary::Greater => both(truth(x > y), x, y),
        Binary::AtLeast => both(truth(x >= y), x, y),
        Binary::Equal => both(truth(x == y), x, y),
        Binary::Unequal => both(truth(x != y), x, y),
        Binary::And => both(truth((x != 0.0) & (y != 0.0)), x, y),
        Binary::Or => both(truth((x != 0.0) | (y != 0.0)), x, y),
        Binary::Min => both(if y < x { y } else { x }, x, y),
        Binary::Max => both(if y > x { y } else { x }, x, y),
        Binary::Default => {
            if x.is_nan() {
                y
            } else {
                x
            }
        }
    }
}

/// The second value where the first is true, the third where it is not, and missing where it is.
#[inline(always)]
pub(super) fn select(condition: f64, one: f64, other: f64) -> f64 {
    let chosen = if condition != 0.0 { one } else { other };
    if condition.is_nan() { f64::NAN } else { chosen }
}

/// 1 or 0.
#[inline(always)]
pub(super) fn truth(is_true: bool) -> f64 {
    if is_true { 1.0 } else { 0.0 }
}

/// 1 / (1 + e^-x).
#[inline(always)]
pub(super) fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + math::exp(-x))
}

/// The value, or missing where its argument is.
#[inline(always)]
fn known(value: f64, x: f64) -> f64 {
    if x.is_nan() { f64::NAN } else { value }
}

#[inline(always)]
fn both(value: f64, x: f64, y: f64) -> f64 {
    if x.is_nan() | y.is_nan() { f64::NAN } else { value }
}

/// A quotient; missing where the divisor is 0.
#[inline(always)]
pub(super) fn divided(x: f64, y: f64) -> f64 {
    if y == 0.0 { f64::NAN } else { x / y }
}

/// x - y floor(x / y), which has the sign of y; missing where y is 0.
#[inline(always)]
fn modulo(x: f64, y: f64) -> f64 {
    let whole = (x / y).floor();
    if y == 0.0 { f64::NAN } else { x - y * whole }
}

/// e^x; infinite above 709, and 0 below -708.
#[inline(always)]
pub(super) fn exp(x: f64) -> f64 {
    let value = math::exp(x);
    let value = if x > 709.0 { f64::INFINITY } else { value };
    let value = if x < -708.0 { 0.0 } else { value };
    known(value, x)
}

/// The natural logarithm; missing for numbers that are not above 0.
#[inline(always)]
fn log(x: f64) -> f64 {
    let value = math::ln(x);
    let is_normal = (f64::MIN_POSITIVE..=f64::MAX).contains(&x);
    if is_normal { value } else { f64::NAN }
}

/// Half a unit is rounded away from 0.
#[inline(always)]
fn round(x: f64) -> f64 {
    let whole = x.trunc();
    let rest = x - whole;
    let away = if x < 0.0 { -1.0 } else { 1.0 };
    if rest.abs() >= 0.5 { whole + away } else { whole }
}

/// x^y; missing for negative x unless y is whole, and for 0 with negative y.
fn power(x: f64, y: f64) -> f64 {
    if x.is_nan() | y.is_nan() | ((x == 0.0) & (y < 0.0)) {
        return f64::NAN;
    }
    if y == 2.0 {
        return x * x;
    }
    libm::pow(x, y)
}

/// The distribution function of the standard normal distribution.
fn normal_cdf(x: f64) -> f64 {
    0.5 * libm::erfc(-x * std::f64::consts::FRAC_1_SQRT_2)
}

/// The value of an expression without variables; `None` if it has others than `known` gives.
pub(super) fn constant(
    expression: &Expression,
    parameter: &dyn Fn(usize) -> Option<f64>,
) -> Option<f64> {
    let mut values = Vec::with_capacity(expression.nodes.len());
    for node in &expression.nodes {
        values.push(match node {
            ExpressionNode::Number(value) => *value,
            ExpressionNode::WrittenName(index) => parameter(*index)?,
            ExpressionNode::Unary(function, of) => unary(*function, values[*of]),
            ExpressionNode::Binary(function, [x, y]) => binary(*function, values[*x], values[*y]),
            ExpressionNode::If([condition, one, other]) => {
                select(values[*condition], values[*one], values[*other])
            }
            ExpressionNode::PastWindow(_) => return None,
        });
    }
    values.last().copied()
}

/// A range for messages.
pub(super) fn range_in_words(least: f64, most: f64) -> String {
    match (least, most) {
        (f64::MIN, f64::MAX) => "a finite number".to_owned(),
        (f64::MIN_POSITIVE, f64::MAX) => "a number above 0".to_owned(),
        (least, f64::MAX) => format!("a number of at least {least}"),
        (f64::MIN, most) => format!("a number of at most {most}"),
        (least, most) => format!("a number from {least} to {most}"),
    }
}
