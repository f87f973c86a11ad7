//! Reads the text of an expression.

use std::ops::Range;

use winnow::ascii::{digit0, digit1, multispace0};
use winnow::combinator::{Infix, Prefix, alt, delimited, expression, opt, repeat};
use winnow::error::{EmptyError, ErrMode};
use winnow::prelude::*;
use winnow::stream::{LocatingSlice, Stateful, Stream, TokenSlice};
use winnow::token::{any, one_of, take_while};

use crate::env::declared::expression::{
    Binary, Expression, ExpressionNode, FUNCTIONS, OPERATORS, PastWindow, Summary, Unary,
    WrittenName,
};
use crate::text::nearest;

/// Maximum length of a text, in bytes.
const LONGEST: usize = 20_000;
/// Maximum number of brackets that contain one another, and of signs before a value and powers in a row.
const DEEPEST: u32 = 100;
const LONGEST_CHAIN: u32 = 20;
/// Maximum number of decisions that a lag or a window reaches back.
pub(super) const FARTHEST: u32 = 10_000;

/// What is wrong with a text.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct GrammarFault {
    /// Where, in bytes.
    pub span: Range<usize>,
    pub says: String,
    pub help: Option<String>,
}

impl GrammarFault {
    fn new(span: Range<usize>, says: impl Into<String>) -> GrammarFault {
        GrammarFault { span, says: says.into(), help: None }
    }

    fn help(self, help: impl Into<String>) -> GrammarFault {
        GrammarFault { help: Some(help.into()), ..self }
    }
}

/// Reads an expression.
///
/// **Errors**: the first fault.
pub(super) fn read(text: &str) -> Result<Expression, GrammarFault> {
    if text.len() > LONGEST {
        let says = format!("the expression has {} bytes; the maximum is {LONGEST}", text.len());
        return Err(GrammarFault::new(0..text.len(), says)
            .help("give its parts names of their own: each is a variable"));
    }
    let lexemes = lexemes(text)?;
    let mut tree = Tree { end: text.trim_end().len(), ..Tree::default() };
    let mut input = Input { input: TokenSlice::new(&lexemes), state: &mut tree };
    let read = whole(&mut input);
    let rest = input.input.next_token().map(|rest| rest.span.clone());
    match (read, rest) {
        (Ok(_), None) => Ok(tree.expression),
        (Ok(_), Some(span)) => Err(tree.fault.unwrap_or_else(|| unexpected(text, span))),
        (Err(_), rest) => {
            Err(tree.fault.unwrap_or_else(|| unexpected(text, rest.unwrap_or(tree.end..tree.end))))
        }
    }
}

/// A fault where an operator was expected.
fn unexpected(text: &str, span: Range<usize>) -> GrammarFault {
    let found = &text[span.clone()];
    let is_value = found.starts_with(|c: char| c.is_ascii_alphanumeric() || c == '_' || c == '(');
    let fault = GrammarFault::new(span, format!("expected an operator, found `{found}`"));
    match found {
        ")" => GrammarFault { says: "`)` closes nothing".to_owned(), ..fault },
        "[" => fault.help("brackets follow a name, as in x[-1], the value of x one decision ago"),
        "<" | "<=" | ">" | ">=" | "==" | "!=" => {
            GrammarFault { says: format!("`{found}` follows another comparison"), ..fault }
                .help("write two comparisons, as in a < b and b < c")
        }
        _ if is_value => fault.help("a product needs `*`"),
        _ => fault,
    }
}

/// A word, number or sign of a text.
#[derive(Clone, Debug, PartialEq)]
struct Lexeme {
    kind: Kind,
    span: Range<usize>,
}

#[derive(Clone, Debug, PartialEq)]
enum Kind {
    Number(f64),
    Word(String),
    Sign(&'static str),
}

/// The signs; a sign stands before those that it begins with.
const SIGNS: [&str; 22] = [
    "<=", ">=", "==", "!=", "**", "&&", "||", "<", ">", "+", "-", "*", "/", "%", "^", "(", ")",
    "[", "]", ",", "=", "!",
];

/// Signs of other languages, and what is written here.
const FOREIGN: [(&str, &str); 5] =
    [("**", "^"), ("&&", "and"), ("||", "or"), ("=", "=="), ("!", "not")];

fn lexemes(text: &str) -> Result<Vec<Lexeme>, GrammarFault> {
    let mut input = LocatingSlice::new(text);
    let lexeme = alt((number, word, sign)).with_span();
    let spaced = delimited(multispace0, lexeme, multispace0);
    let spaced = spaced.map(|(kind, span)| Lexeme { kind, span });
    let read: ModalResult<Vec<Lexeme>, EmptyError> = repeat(0.., spaced).parse_next(&mut input);
    let lexemes = read.unwrap_or_default();
    if let Some(found) = input.chars().next() {
        let start = text.len() - input.len();
        let span = start..start + found.len_utf8();
        let shown = if found.is_whitespace() {
            found.escape_unicode().to_string()
        } else {
            found.to_string()
        };
        let fault = GrammarFault::new(span, format!("`{shown}` has no meaning here"));
        return Err(match found {
            '"' | '\'' => fault.help("everything is a number: there are no texts in expressions"),
            '.' => fault.help("a number begins with a digit, as in 0.5"),
            c if c.is_whitespace() => {
                fault.help("this space is not the one of the keyboard: delete it, and type a space")
            }
            '×' | '·' => fault.help("a product is written *"),
            '−' | '–' => fault.help("minus is written -"),
            '≤' | '≥' => fault.help("write <= or >="),
            _ => fault,
        });
    }
    for Lexeme { kind, span } in &lexemes {
        match kind {
            Kind::Number(number) if !number.is_finite() => {
                let says = format!("`{}` is too large for a number", &text[span.clone()]);
                return Err(GrammarFault::new(span.clone(), says));
            }
            Kind::Sign(sign) => {
                if let Some((_, here)) = FOREIGN.iter().find(|(foreign, _)| foreign == sign) {
                    let says = format!("`{sign}` is written `{here}` here");
                    return Err(GrammarFault::new(span.clone(), says));
                }
            }
            _ => {}
        }
    }
    Ok(lexemes)
}

fn number(input: &mut LocatingSlice<&str>) -> ModalResult<Kind, EmptyError> {
    let exponent = (one_of(['e', 'E']), opt(one_of(['+', '-'])), digit1);
    let digits = (digit1, opt(('.', digit0)), opt(exponent)).take();
    let number = digits.map(|text: &str| text.parse().unwrap_or(f64::INFINITY));
    number.map(Kind::Number).parse_next(input)
}

fn word(input: &mut LocatingSlice<&str>) -> ModalResult<Kind, EmptyError> {
    let begins = one_of(|c: char| c.is_ascii_alphabetic() || c == '_');
    let rest = take_while(0.., |c: char| c.is_ascii_alphanumeric() || c == '_');
    let word = (begins, rest).take().map(|text: &str| text.to_owned());
    word.map(Kind::Word).parse_next(input)
}

fn sign(input: &mut LocatingSlice<&str>) -> ModalResult<Kind, EmptyError> {
    for sign in SIGNS {
        if input.starts_with(sign) {
            input.next_slice(sign.len());
            return Ok(Kind::Sign(sign));
        }
    }
    Err(ErrMode::Backtrack(EmptyError))
}

/// The tree as far as it has been read.
#[derive(Debug, Default)]
struct Tree {
    expression: Expression,
    fault: Option<GrammarFault>,
    /// Open brackets, and the number of signs and powers in a row.
    depth: u32,
    chained: u32,
    /// The end of the text, in bytes.
    end: usize,
}

/// A part that has been read: its nodes are the last ones from `first`; its text has this span.
#[derive(Clone, Debug)]
struct Part {
    first: usize,
    span: Range<usize>,
}

type Input<'i> = Stateful<TokenSlice<'i, Lexeme>, &'i mut Tree>;
type Failure = ErrMode<EmptyError>;
type Read<T> = Result<T, Failure>;

const FAILED: Failure = ErrMode::Cut(EmptyError);

impl Tree {
    fn fail<T>(&mut self, fault: GrammarFault) -> Read<T> {
        self.fault.get_or_insert(fault);
        Err(FAILED)
    }

    /// Appends a node to parts that stand one behind the other.
    fn push(&mut self, node: ExpressionNode, first: usize, span: Range<usize>) -> Part {
        self.expression.nodes.push(node);
        Part { first, span }
    }

    fn last(&self) -> usize {
        self.expression.nodes.len() - 1
    }

    fn unary(&mut self, function: Unary, of: Part) -> Read<Part> {
        let node = ExpressionNode::Unary(function, self.last());
        Ok(self.push(node, of.first, of.span))
    }

    fn binary(&mut self, function: Binary, one: &Part, other: &Part) -> Read<Part> {
        let node = ExpressionNode::Binary(function, [other.first - 1, self.last()]);
        Ok(self.push(node, one.first, one.span.start..other.span.end))
    }

    /// Takes the last part out of the expression.
    fn take(&mut self, part: &Part) -> Expression {
        let mut nodes = self.expression.nodes.split_off(part.first);
        let mut names = Vec::new();
        for node in &mut nodes {
            match node {
                ExpressionNode::WrittenName(index) => {
                    names.push(self.expression.names[*index].clone());
                    *index = names.len() - 1;
                }
                ExpressionNode::Unary(_, of) => *of -= part.first,
                ExpressionNode::Binary(_, of) => of.iter_mut().for_each(|of| *of -= part.first),
                ExpressionNode::If(of) => of.iter_mut().for_each(|of| *of -= part.first),
                ExpressionNode::Number(_) | ExpressionNode::PastWindow(_) => {}
            }
        }
        // The names of the part are the last ones.
        self.expression.names.truncate(self.expression.names.len() - names.len());
        Expression { nodes, names }
    }
}

fn whole(input: &mut Input<'_>) -> Read<Part> {
    expression(operand).prefix(prefix).infix(infix).parse_next(input)
}

fn peek<'i>(input: &Input<'i>) -> Option<&'i Lexeme> {
    input.input.peek_token()
}

fn prefix<'i>(input: &mut Input<'i>) -> Read<Prefix<Input<'i>, Part, Failure>> {
    let prefix: Prefix<Input<'i>, Part, Failure> = match peek(input).map(|lexeme| &lexeme.kind) {
        Some(Kind::Sign("-")) => Prefix(14, |input, of| input.state.unary(Unary::Minus, of)),
        Some(Kind::Sign("+")) => Prefix(14, |_, of| Ok(of)),
        Some(Kind::Word(word)) if word == "not" => {
            Prefix(6, |input, of| input.state.unary(Unary::Not, of))
        }
        _ => return Err(ErrMode::Backtrack(EmptyError)),
    };
    chain(input)?;
    any.parse_next(input)?;
    Ok(prefix)
}

fn infix<'i>(input: &mut Input<'i>) -> Read<Infix<Input<'i>, Part, Failure>> {
    macro_rules! folds {
        ($side:ident, $power:expr, $function:ident) => {
            Infix::$side($power, |input, one, other| {
                input.state.binary(Binary::$function, &one, &other)
            })
        };
    }
    let word = match peek(input).map(|lexeme| &lexeme.kind) {
        Some(Kind::Sign(sign)) => sign,
        Some(Kind::Word(word)) => word.as_str(),
        _ => return Err(ErrMode::Backtrack(EmptyError)),
    };
    if word != "^" {
        input.state.chained = 0;
    }
    let infix: Infix<Input<'i>, Part, Failure> = match word {
        "or" => folds!(Left, 2, Or),
        "and" => folds!(Left, 4, And),
        "<" => folds!(Neither, 8, Less),
        "<=" => folds!(Neither, 8, AtMost),
        ">" => folds!(Neither, 8, Greater),
        ">=" => folds!(Neither, 8, AtLeast),
        "==" => folds!(Neither, 8, Equal),
        "!=" => folds!(Neither, 8, Unequal),
        "+" => folds!(Left, 10, Plus),
        "-" => folds!(Left, 10, Minus),
        "*" => folds!(Left, 12, Times),
        "/" => folds!(Left, 12, Divided),
        "%" => folds!(Left, 12, Modulo),
        "^" => {
            chain(input)?;
            folds!(Right, 16, Power)
        }
        _ => return Err(ErrMode::Backtrack(EmptyError)),
    };
    any.parse_next(input)?;
    Ok(infix)
}

/// Counts a sign before a value, or a power: each is read within the one before.
fn chain(input: &mut Input<'_>) -> Read<()> {
    input.state.chained += 1;
    match peek(input) {
        Some(lexeme) if input.state.chained > LONGEST_CHAIN => {
            let says = format!("more than {LONGEST_CHAIN} signs and powers in a row");
            let help = "give the parts of the expression names of their own";
            let fault = GrammarFault::new(lexeme.span.clone(), says).help(help);
            input.state.fail(fault)
        }
        _ => Ok(()),
    }
}

/// Whether a lexeme stands before the value that it changes.
fn is_prefix(kind: &Kind) -> bool {
    match kind {
        Kind::Sign(sign) => matches!(*sign, "-" | "+"),
        Kind::Word(word) => word == "not",
        Kind::Number(_) => false,
    }
}

fn operand(input: &mut Input<'_>) -> Read<Part> {
    let Some(lexeme) = peek(input) else {
        let end = input.state.end;
        let says = "the expression ends where a value is expected";
        return input.state.fail(GrammarFault::new(end..end, says));
    };
    // A sign before a value is read elsewhere.
    if is_prefix(&lexeme.kind) {
        return Err(ErrMode::Backtrack(EmptyError));
    }
    any.parse_next(input)?;
    let span = lexeme.span.clone();
    let first = input.state.expression.nodes.len();
    match &lexeme.kind {
        Kind::Number(number) => Ok(input.state.push(ExpressionNode::Number(*number), first, span)),
        Kind::Sign("(") => {
            open(input, &span)?;
            let inner = whole(input)?;
            let end = close(input, &span, ")")?;
            Ok(Part { span: span.start..end, ..inner })
        }
        Kind::Word(word) if OPERATORS.contains(&word.as_str()) => {
            let says = format!("`{word}` stands where a value is expected");
            input.state.fail(GrammarFault::new(span, says))
        }
        Kind::Word(word) => match peek(input).map(|next| &next.kind) {
            Some(Kind::Sign("(")) => call(input, word, &span),
            Some(Kind::Sign("[")) => lag(input, word, &span),
            _ => Ok(name(input, word, 0, span)),
        },
        Kind::Sign(sign) => {
            let says = format!("`{sign}` stands where a value is expected");
            input.state.fail(GrammarFault::new(span, says))
        }
    }
}

fn name(input: &mut Input<'_>, text: &str, back: u32, span: Range<usize>) -> Part {
    let expression = &mut input.state.expression;
    let (index, first) = (expression.names.len(), expression.nodes.len());
    expression.names.push(WrittenName { text: text.to_owned(), back, span: span.clone() });
    input.state.push(ExpressionNode::WrittenName(index), first, span)
}

/// Enters a bracket at this span.
fn open(input: &mut Input<'_>, span: &Range<usize>) -> Read<()> {
    input.state.depth += 1;
    if input.state.depth > DEEPEST {
        let says = format!("more than {DEEPEST} brackets within one another");
        let help = "give the inner parts names of their own";
        return input.state.fail(GrammarFault::new(span.clone(), says).help(help));
    }
    Ok(())
}

/// Leaves the bracket at `opened`; returns the end of the sign that closes it.
fn close(input: &mut Input<'_>, opened: &Range<usize>, sign: &'static str) -> Read<usize> {
    match peek(input) {
        Some(Lexeme { kind: Kind::Sign(found), span }) if *found == sign => {
            any.parse_next(input)?;
            input.state.depth -= 1;
            Ok(span.end)
        }
        Some(Lexeme { kind: Kind::Sign(","), span }) => {
            let says = "`,` stands outside of the arguments of a function";
            input.state.fail(GrammarFault::new(span.clone(), says))
        }
        Some(Lexeme { kind: Kind::Sign("<" | "<=" | ">" | ">=" | "==" | "!="), span }) => {
            let fault = GrammarFault::new(span.clone(), "a comparison follows another comparison");
            input.state.fail(fault.help("write two comparisons, as in a < b and b < c"))
        }
        Some(Lexeme { span, .. }) => {
            let says = "expected an operator or a closing bracket";
            input.state.fail(GrammarFault::new(span.clone(), says))
        }
        None => {
            let says = "this bracket is not closed";
            input.state.fail(GrammarFault::new(opened.clone(), says))
        }
    }
}

/// A whole number from 1 to [`FARTHEST`], or a fault.
fn whole_number(input: &mut Input<'_>, what: &str) -> Read<u32> {
    let end = input.state.end;
    let span = peek(input).map_or(end..end, |lexeme| lexeme.span.clone());
    match peek(input) {
        Some(Lexeme { kind: Kind::Number(number), .. })
            if *number >= 1.0 && *number <= f64::from(FARTHEST) && number.fract() == 0.0 =>
        {
            any.parse_next(input)?;
            Ok(*number as u32)
        }
        _ => {
            let says = format!("{what}: expected a whole number from 1 to {FARTHEST}");
            input.state.fail(GrammarFault::new(span, says))
        }
    }
}

/// The value of a name some decisions ago; the bracket is the next lexeme.
fn lag(input: &mut Input<'_>, text: &str, span: &Range<usize>) -> Read<Part> {
    let bracket = peek(input).map_or(span.clone(), |bracket| bracket.span.clone());
    any.parse_next(input)?;
    open(input, &bracket)?;
    if peek(input).map(|lexeme| &lexeme.kind) != Some(&Kind::Sign("-")) {
        let says = format!("`{text}[`: expected a minus and a number of decisions");
        let help = format!("{text}[-1] is the value of `{text}` one decision ago");
        return input.state.fail(GrammarFault::new(bracket, says).help(help));
    }
    any.parse_next(input)?;
    let back = whole_number(input, "the lag")?;
    if let Some(Lexeme { kind: Kind::Sign(","), span: comma }) = peek(input) {
        let fault = GrammarFault::new(comma.clone(), "a lag has one number");
        let help = format!("default({text}[-{back}], 0) is 0 where there is no earlier decision");
        return input.state.fail(fault.help(help));
    }
    let end = close(input, &bracket, "]")?;
    Ok(name(input, text, back, span.start..end))
}

/// A function with its arguments; the bracket is the next lexeme.
fn call(input: &mut Input<'_>, function: &str, span: &Range<usize>) -> Read<Part> {
    let Some((_, takes)) = FUNCTIONS.iter().find(|(known, _)| *known == function) else {
        let names = FUNCTIONS.map(|(name, _)| name);
        let says = format!("there is no function `{function}`");
        let fault = GrammarFault::new(span.clone(), says);
        return input.state.fail(match nearest(function, names) {
            Some(name) => fault.help(format!("did you mean `{name}`?")),
            None => fault.help(format!("the functions are {}", names.join(", "))),
        });
    };
    let bracket = peek(input).map_or(span.clone(), |bracket| bracket.span.clone());
    any.parse_next(input)?;
    open(input, &bracket)?;
    let mut parts = vec![whole(input)?];
    let is_window = matches!(function, "sum" | "mean" | "count" | "discounted_mean");
    let mut length = None;
    while let Some(Lexeme { kind: Kind::Sign(","), .. }) = peek(input) {
        any.parse_next(input)?;
        let is_length = parts.len() == 1 + usize::from(function == "discounted_mean");
        if is_window && is_length {
            length = Some(whole_number(input, "the number of decisions")?);
            break;
        }
        parts.push(whole(input)?);
    }
    let end = close(input, &bracket, ")")?;
    let whole = span.start..end;
    let tree = &mut *input.state;
    let part = match (function, &parts[..], length) {
        ("if", [_, one, other], _) => {
            let indices = [one.first - 1, other.first - 1, tree.last()];
            Some(tree.push(ExpressionNode::If(indices), parts[0].first, whole.clone()))
        }
        ("min", [_, _, ..], _) => Some(fold(tree, Binary::Min, &parts)),
        ("max", [_, _, ..], _) => Some(fold(tree, Binary::Max, &parts)),
        ("clip", [value, least, most], _) => {
            // min(max(value, least), most), whose nodes stand in another order.
            let most = tree.take(most);
            let part = tree.binary(Binary::Max, value, least)?;
            let most = insert(tree, most);
            Some(tree.binary(Binary::Min, &part, &most)?)
        }
        ("default", [one, other], _) => Some(tree.binary(Binary::Default, one, other)?),
        ("not", [of], _) => Some(tree.unary(Unary::Not, of.clone())?),
        ("sum", [of], _) => Some(window(tree, Summary::Sum, of, None, length, &whole)),
        ("mean", [of], _) => Some(window(tree, Summary::Mean, of, None, length, &whole)),
        ("count", [of], _) => Some(window(tree, Summary::Count, of, None, length, &whole)),
        ("discounted_mean", [of, factor], Some(_)) => {
            let factor = Some(tree.take(factor));
            Some(window(tree, Summary::Mean, of, factor, length, &whole))
        }
        (_, [of], _) => match Unary::named(function) {
            Some(unary) => Some(tree.unary(unary, of.clone())?),
            None => None,
        },
        _ => None,
    };
    match part {
        Some(part) => Ok(Part { span: whole, ..part }),
        None => {
            let says = format!("`{function}` takes {takes}");
            input.state.fail(GrammarFault::new(whole, says))
        }
    }
}

/// Parts that stand one behind the other, joined by a function from the first to the last.
fn fold(tree: &mut Tree, function: Binary, parts: &[Part]) -> Part {
    let rest: Vec<Expression> = parts[2..].iter().rev().map(|part| tree.take(part)).collect();
    let mut joined = joined(tree, function, &parts[0], &parts[1]);
    for next in rest.into_iter().rev() {
        let next = insert(tree, next);
        joined = self::joined(tree, function, &joined, &next);
    }
    joined
}

fn joined(tree: &mut Tree, function: Binary, one: &Part, other: &Part) -> Part {
    let node = ExpressionNode::Binary(function, [other.first - 1, tree.last()]);
    tree.push(node, one.first, one.span.start..other.span.end)
}

/// Puts an expression behind the nodes.
fn insert(tree: &mut Tree, expression: Expression) -> Part {
    let (first, names) = (tree.expression.nodes.len(), tree.expression.names.len());
    tree.expression.names.extend(expression.names);
    tree.expression.nodes.extend(expression.nodes.into_iter().map(|node| match node {
        ExpressionNode::WrittenName(index) => ExpressionNode::WrittenName(index + names),
        ExpressionNode::Unary(function, of) => ExpressionNode::Unary(function, of + first),
        ExpressionNode::Binary(function, of) => {
            ExpressionNode::Binary(function, of.map(|of| of + first))
        }
        ExpressionNode::If(of) => ExpressionNode::If(of.map(|of| of + first)),
        other => other,
    }));
    Part { first, span: 0..0 }
}

fn window(
    tree: &mut Tree,
    summary: Summary,
    of: &Part,
    factor: Option<Expression>,
    length: Option<u32>,
    span: &Range<usize>,
) -> Part {
    let expression = tree.take(of);
    let window = PastWindow { summary, of: expression, factor, length, span: span.clone() };
    tree.push(ExpressionNode::PastWindow(Box::new(window)), of.first, span.clone())
}
