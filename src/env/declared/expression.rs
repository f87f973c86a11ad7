//! Expressions: lists of nodes, each behind the nodes that it is computed from.

use std::ops::Range;

/// An expression. The last node is the whole.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Expression {
    /// Every node refers to earlier nodes only, and each is referred to once.
    pub nodes: Vec<ExpressionNode>,
    /// The names in the order of the text.
    pub names: Vec<WrittenName>,
}

/// A part of an expression. Numbers refer to nodes by their index.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum ExpressionNode {
    /// A number.
    Number(f64),
    /// The name at this index of the expression's names.
    WrittenName(usize),
    /// A function of one number.
    Unary(Unary, usize),
    /// A function of two numbers.
    Binary(Binary, [usize; 2]),
    /// The second if the first is true, and otherwise the third.
    If([usize; 3]),
    /// A summary of earlier decisions.
    PastWindow(Box<PastWindow>),
}

/// A name in an expression.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct WrittenName {
    /// The name.
    pub text: String,
    /// How many decisions ago its value is meant; 0 for the present one.
    pub back: u32,
    /// Where it stands in the text of the expression, in bytes.
    pub span: Range<usize>,
}

/// A summary of the values of an expression at earlier decisions.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct PastWindow {
    /// The kind.
    pub summary: Summary,
    /// What is summarised.
    pub of: Expression,
    /// The factor of a value's weight relative to that of the next; `None` for equal weights.
    pub factor: Option<Expression>,
    /// The number of decisions; `None` for all earlier ones.
    pub length: Option<u32>,
    /// Where it stands in the text of the expression, in bytes.
    pub span: Range<usize>,
}

/// The kind of a summary.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Summary {
    /// The sum.
    Sum,
    /// The mean, in which values can have unequal weights.
    Mean,
    /// The number of values that are true.
    Count,
}

/// A function of one number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Unary {
    Minus,
    Not,
    Abs,
    Exp,
    Log,
    Sqrt,
    Sigmoid,
    NormalCdf,
    Floor,
    Round,
}

/// A function of two numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Binary {
    Plus,
    Minus,
    Times,
    Divided,
    Modulo,
    Power,
    Less,
    AtMost,
    Greater,
    AtLeast,
    Equal,
    Unequal,
    And,
    Or,
    Min,
    Max,
    /// The first, or the second where the first is missing.
    Default,
}

/// The functions that a text calls by a name, with the number of their arguments in words.
pub(super) const FUNCTIONS: [(&str, &str); 18] = [
    ("if", "a condition and two values"),
    ("min", "two values or more"),
    ("max", "two values or more"),
    ("clip", "a value, the least and the most"),
    ("floor", "one value"),
    ("round", "one value"),
    ("abs", "one value"),
    ("exp", "one value"),
    ("log", "one value"),
    ("sqrt", "one value"),
    ("sigmoid", "one value"),
    ("normal_cdf", "one value"),
    ("sum", "a value, and a number of decisions or nothing"),
    ("mean", "a value, and a number of decisions or nothing"),
    ("count", "a condition, and a number of decisions or nothing"),
    ("discounted_mean", "a value, a factor and a number of decisions"),
    ("default", "a value, and what stands for it where it is missing"),
    ("not", "one value"),
];

/// The words of operators, which cannot be names.
pub(super) const OPERATORS: [&str; 3] = ["and", "or", "not"];

impl Unary {
    /// The function of this name.
    pub fn named(name: &str) -> Option<Unary> {
        Some(match name {
            "abs" => Unary::Abs,
            "exp" => Unary::Exp,
            "log" => Unary::Log,
            "sqrt" => Unary::Sqrt,
            "sigmoid" => Unary::Sigmoid,
            "normal_cdf" => Unary::NormalCdf,
            "floor" => Unary::Floor,
            "round" => Unary::Round,
            _ => return None,
        })
    }
}

impl Expression {
    /// The expression of a number.
    pub fn number(value: f64) -> Expression {
        Expression { nodes: vec![ExpressionNode::Number(value)], names: Vec::new() }
    }

    /// The windows in the expression.
    pub fn windows(&self) -> impl Iterator<Item = &PastWindow> {
        self.nodes.iter().filter_map(|node| match node {
            ExpressionNode::PastWindow(window) => Some(&**window),
            _ => None,
        })
    }
}
