//! Reads the values of a key: a single value, a list of values, or a range.

use std::collections::HashSet;
use std::fmt;
use std::path::PathBuf;

use serde_json::{Number, Value as Json};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::env::Family;
use crate::key::{Kind, Parameter, Value};
use crate::manifest::parameter::parameter;
use crate::manifest::text::written::share;
use crate::manifest::value::range::{self, MOST_VALUES, MOST_VALUES_IN_ALL, RangeError, Spacing};
use crate::manifest::value::respelt::respelt;
use crate::text::{Fault, FaultList, Span, shortened};

/// A value of the TOML tree with its position in the text.
pub(crate) type Node<'t> = Spanned<DeValue<'t>>;

/// Reads values, and collects faults.
#[derive(Debug)]
pub(in crate::manifest) struct Reader<'t> {
    pub text: &'t str,
    pub faults: FaultList,
    /// Parameters in zips. Their lists may repeat values, because positions of a zip differ as a whole.
    pub zipped: HashSet<Parameter>,
    /// Keys of the environment that stand in another table.
    pub misplaced: Vec<(&'static str, Span)>,
    /// The family of the environment.
    pub family: &'static Family,
    /// Keys of parameters that the environment has beside those in its table: those of the other of a manifest and its
    /// preset.
    pub beside: Vec<&'static str>,
    /// The folder that relative file names start from.
    pub folder: PathBuf,
    /// Answers values that name jobs.
    pub runs: Runs<'t>,
    /// The jobs that values have named, each with the text that stands for it.
    pub named_runs: Vec<(String, String)>,
    /// The number of values that further lists and ranges may have.
    pub values_left: u64,
}

/// Where the values `run:KEY` of a manifest come from: a function from the key of a job to the text of its policy; by
/// default nowhere.
#[derive(Clone, Copy, Default)]
pub struct Runs<'r>(pub Option<&'r PolicyOf<'r>>);

/// Returns the text of the policy of a job; the error says why the job has no policy.
pub type PolicyOf<'r> = dyn Fn(&str) -> Result<String, String> + 'r;

impl fmt::Debug for Runs<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Runs")
    }
}

/// Whether the list of a sweep may repeat a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::manifest) enum Repeats {
    /// A repeated value is a fault.
    Refused,
    /// A repeated value is allowed, because another list of the same zip distinguishes the positions.
    Zipped,
}

/// The parameters that the zips of a document name, as far as the zips can be read.
pub(in crate::manifest) fn zipped(root: &DeTable) -> HashSet<Parameter> {
    let lists = root.get("zip").and_then(|node| node.get_ref().as_array());
    let lists = lists.into_iter().flatten().filter_map(|list| list.get_ref().as_array());
    lists.flatten().filter_map(|name| parameter(name.get_ref().as_str()?)).collect()
}

impl<'t> Reader<'t> {
    pub fn new(text: &'t str) -> Reader<'t> {
        Reader {
            text,
            faults: FaultList::default(),
            zipped: HashSet::new(),
            misplaced: Vec::new(),
            family: Family::first(),
            beside: Vec::new(),
            folder: PathBuf::new(),
            runs: Runs::default(),
            named_runs: Vec::new(),
            values_left: MOST_VALUES_IN_ALL,
        }
    }

    /// Reports the keys of a table that it cannot have; `place` says where they stand.
    pub(in crate::manifest) fn only_keys(&mut self, place: &str, keys: &[&str], table: &DeTable) {
        for key in table.keys().filter(|key| !keys.contains(&key.get_ref().as_ref())) {
            let found = shortened(key.get_ref());
            let message = format!("unknown key `{found}` in {place}");
            self.faults.add(Fault::at(key.span().into(), message).one_of("its", keys, &found));
        }
    }

    /// The values of the key `name` in `node`; empty, with faults reported, if any value is faulty.
    pub fn sweep(&mut self, name: &str, kind: Kind, repeats: Repeats, node: &Node) -> Vec<Value> {
        match node.get_ref() {
            DeValue::Array(items) => {
                let first = items.first().map(Spanned::get_ref);
                let is_value = match kind {
                    Kind::RealPair { .. }
                    | Kind::Reals { .. }
                    | Kind::Counts { .. }
                    | Kind::Widths { .. }
                    | Kind::Words { .. } => first.is_none_or(|first| !first.is_array()),
                    Kind::Rows(_) => first.is_some_and(DeValue::is_table),
                    // A list without words and lists is one value if the key takes lists of numbers.
                    Kind::AnyOf(kinds) => {
                        kinds.iter().any(|kind| matches!(kind, Kind::Reals { .. }))
                            && items.iter().all(|item| number(item).is_some())
                    }
                    _ => false,
                };
                if is_value {
                    return self.value(name, kind, node).into_iter().collect();
                }
                if items.is_empty() {
                    let expected = kind.expectation();
                    let message = format!("`{name}`: a sweep cannot be empty");
                    let fault = Fault::at(node.span().into(), message);
                    self.faults.add(fault.help(format!("list at least one value: {expected}")));
                }
                if !self.count_in(name, items.len(), node) {
                    return Vec::new();
                }
                let read = |reader: &mut Self, item: &Node| reader.value(name, kind, item);
                match repeats {
                    Repeats::Refused => self.distinct(name, items.iter(), read),
                    Repeats::Zipped => self.all(items.iter(), read),
                }
            }
            DeValue::Table(table) if kind == Kind::Scalar => {
                self.range(name, ends_kind(table), node, table)
            }
            DeValue::Table(table) if !matches!(kind, Kind::Distribution(_)) => {
                self.range(name, kind.of_numbers(), node, table)
            }
            _ => self.value(name, kind, node).into_iter().collect(),
        }
    }

    /// The results of `read` for all items; empty if it fails on any item.
    fn all<'n, T>(
        &mut self,
        items: impl Iterator<Item = &'n Node<'n>>,
        read: impl Fn(&mut Self, &Node) -> Option<T>,
    ) -> Vec<T> {
        let before = self.faults.len();
        let values: Vec<T> = items.filter_map(|item| read(self, item)).collect();
        if self.faults.len() > before { Vec::new() } else { values }
    }

    /// The results of `read` for all items; empty if it fails on any item, or if two results are equal.
    pub fn distinct<'n, T: Eq + std::hash::Hash + Clone + std::fmt::Display>(
        &mut self,
        name: &str,
        items: impl Iterator<Item = &'n Node<'n>>,
        read: impl Fn(&mut Self, &Node) -> Option<T>,
    ) -> Vec<T> {
        let before = self.faults.len();
        let mut values = Vec::new();
        let mut seen = HashSet::new();
        for item in items {
            let Some(value) = read(self, item) else { continue };
            if !seen.insert(value.clone()) {
                let message = format!("`{name}`: {value} is listed twice");
                self.faults.add(Fault::at(item.span().into(), message));
            }
            values.push(value);
        }
        if self.faults.len() > before { Vec::new() } else { values }
    }

    /// A single value of `kind`.
    pub fn value(&mut self, name: &str, kind: Kind, node: &Node) -> Option<Value> {
        match kind {
            Kind::Distribution(of) => return self.distribution(name, of, node),
            Kind::Rows(known) => return self.rows(name, known, node),
            Kind::Content(form) => return self.content(name, form, node),
            _ => {}
        }
        let value = read(kind, node);
        if value.is_none() {
            self.unexpected(name, kind, node);
        }
        value
    }

    /// Reports that `node` is not of `kind`, at the faulty entry if it is a list.
    fn unexpected(&mut self, name: &str, kind: Kind, node: &Node) {
        let entry_kind = match kind {
            Kind::Counts { max, .. } | Kind::Widths { max, .. } => {
                Kind::Integer { min: 1, max: max.into() }
            }
            Kind::RealPair { min, max } | Kind::Reals { min, max, .. } => Kind::Real { min, max },
            other => other,
        };
        let entries = node.get_ref().as_array().filter(|_| entry_kind != kind);
        let faulty = entries
            .and_then(|entries| entries.iter().find(|entry| read(entry_kind, entry).is_none()));
        let (expected, faulty) = match faulty {
            Some(entry) => (entry_kind.expectation(), entry),
            None => (kind.expectation(), node),
        };
        let found = match faulty.get_ref() {
            DeValue::Array(items) if !items.is_empty() => format!("a list of {}", items.len()),
            _ => self.found(faulty),
        };
        let message = format!("`{name}`: expected {expected}, found {found}");
        let fault = Fault::at(faulty.span().into(), message);
        self.faults.add(hint(fault, kind, faulty));
    }

    /// Reports that `name` should be `expected`.
    pub fn expected(&mut self, name: &str, expected: &str, node: &Node) {
        self.faults.add(unexpected(self.text, name, expected, node));
    }

    /// A short description of the value in the text.
    pub fn found(&self, node: &Node) -> String {
        const MOST: usize = 40;
        match node.get_ref() {
            DeValue::Array(items) if items.is_empty() => "an empty list".to_owned(),
            DeValue::Array(_) => "a list".to_owned(),
            DeValue::Table(_) => "a table".to_owned(),
            DeValue::Datetime(_) => "a date or time".to_owned(),
            DeValue::String(_) | DeValue::Integer(_) | DeValue::Float(_) | DeValue::Boolean(_) => {
                let written = self.text.get(node.span()).unwrap_or("something else");
                let short: String = written.chars().take(MOST).collect();
                if short.len() < written.len() { format!("{short}…") } else { short }
            }
        }
    }

    fn range(&mut self, name: &str, kind: Kind, node: &Node, table: &DeTable) -> Vec<Value> {
        let step_kind = match kind {
            Kind::Real { .. } | Kind::PositiveReal { .. } => Kind::PositiveReal { max: f64::MAX },
            Kind::Integer { .. } => Kind::Integer { min: 1, max: i64::MAX as u64 },
            Kind::Flag
            | Kind::Choice(_)
            | Kind::RealPair { .. }
            | Kind::Reals { .. }
            | Kind::Counts { .. }
            | Kind::Widths { .. }
            | Kind::Text { .. }
            | Kind::Words { .. }
            | Kind::Scalar
            | Kind::Distribution(_)
            | Kind::Rows(_)
            | Kind::Content(_)
            | Kind::AnyOf(_) => {
                self.expected(name, &kind.expectation(), node);
                return Vec::new();
            }
        };
        const KEYS: [&str; 5] = ["from", "to", "step", "count", "scale"];
        let before = self.faults.len();
        self.only_keys(&format!("the range of `{name}`"), &KEYS, table);
        // A misspelt third key is not read beside one that stands there.
        let is_spaced = table.contains_key("step") || table.contains_key("count");
        let table = &*respelt(table, if is_spaced { &KEYS[..2] } else { &KEYS });
        self.range_keys(name, node, table);
        let mut part = |key: &str, kind: Kind| {
            let node = table.get(key)?;
            self.value(&format!("{name}.{key}"), kind, node)
        };
        let ends = (part("from", kind), part("to", kind));
        let step = part("step", step_kind);
        let count = part("count", Kind::Integer { min: 2, max: MOST_VALUES });
        let scale = part("scale", Kind::Choice(&["linear", "log"]));
        if self.faults.len() > before {
            return Vec::new();
        }
        match list(ends, step, count, scale, self.values_left) {
            Some(Ok(values)) => {
                self.values_left -= values.len() as u64;
                values
            }
            Some(Err(error)) => {
                self.faults.add(Fault::at(node.span().into(), format!("`{name}`: {error}")));
                Vec::new()
            }
            None => Vec::new(),
        }
    }

    /// Counts the items of a list, and reports if they exceed the number that the manifest may still have.
    pub fn count_in(&mut self, name: &str, items: usize, node: &Node) -> bool {
        match self.values_left.checked_sub(items as u64) {
            Some(left) => self.values_left = left,
            None => {
                let message = format!("`{name}`: {}", RangeError::TooManyInAll);
                self.faults.add(Fault::at(node.span().into(), message));
                return false;
            }
        }
        true
    }

    /// Reports keys that are missing or mutually exclusive in a range.
    fn range_keys(&mut self, name: &str, node: &Node, table: &DeTable) {
        let has = |key: &str| table.contains_key(key);
        let problem = match (has("from") && has("to"), has("step"), has("count"), has("scale")) {
            (false, ..) => "needs `from` and `to`",
            (true, true, true, _) => "takes `step` or `count`, not both",
            (true, false, false, _) => "needs `step` or `count`",
            (true, true, false, true) => "takes `scale` only with `count`",
            (true, true, false, false) | (true, false, true, _) => return,
        };
        let fault = Fault::at(node.span().into(), format!("a range of `{name}` {problem}"));
        self.faults.add(fault.help(
            "write { from = 0.1, to = 0.4, step = 0.1 } or { from = 1e-4, to = 1e-2, count = 3, \
             scale = \"log\" }",
        ));
    }
}

/// The single value of a key of another file than a manifest, whose text is `text`; adds a fault and returns
/// `None` if it is not of `kind`.
pub(crate) fn single(
    text: &str,
    name: &str,
    kind: Kind,
    node: &Node,
    faults: &mut FaultList,
) -> Option<Value> {
    let mut reader = Reader::new(text);
    let value = reader.value(name, kind, node);
    faults.append(reader.faults);
    value
}

/// The fault of a value in `text` that should be `expected`.
pub(crate) fn unexpected(text: &str, name: &str, expected: &str, node: &Node) -> Fault {
    let found = Reader::new(text).found(node);
    Fault::at(node.span().into(), format!("`{name}`: expected {expected}, found {found}"))
}

/// The kind of the numbers in a range of scalars: whole if both ends are whole.
fn ends_kind(table: &DeTable) -> Kind {
    let is_whole = |end| table.get(end).is_some_and(|node: &Node| node.get_ref().is_integer());
    match is_whole("from") && is_whole("to") {
        true => Kind::Integer { min: 0, max: i64::MAX as u64 },
        false => Kind::Real { min: f64::MIN, max: f64::MAX },
    }
}

/// The values of a range from its parts; `None` if a part is missing.
fn list(
    ends: (Option<Value>, Option<Value>),
    step: Option<Value>,
    count: Option<Value>,
    scale: Option<Value>,
    most: u64,
) -> Option<Result<Vec<Value>, RangeError>> {
    match (ends.0?, ends.1?) {
        (Value::Integer(from), Value::Integer(to)) => {
            let spacing = spacing(step.and_then(whole_of), count, scale)?;
            Some(wrap(range::integers(from, to, spacing, most), Value::Integer))
        }
        (Value::Real(from), Value::Real(to)) => {
            let spacing = spacing(step.and_then(real_of), count, scale)?;
            Some(wrap(range::reals(from, to, spacing, most), Value::Real))
        }
        _ => None,
    }
}

fn spacing<N>(step: Option<N>, count: Option<Value>, scale: Option<Value>) -> Option<Spacing<N>> {
    match (step, count.and_then(whole_of), scale) {
        (Some(step), ..) => Some(Spacing::Step(step)),
        (None, Some(count), Some(Value::Choice("log"))) => Some(Spacing::Log(count)),
        (None, Some(count), _) => Some(Spacing::Linear(count)),
        (None, None, _) => None,
    }
}

fn wrap<N>(
    values: Result<Vec<N>, RangeError>,
    value: fn(N) -> Value,
) -> Result<Vec<Value>, RangeError> {
    values.map(|values| values.into_iter().map(value).collect())
}

fn whole_of(value: Value) -> Option<u64> {
    if let Value::Integer(whole) = value { Some(whole) } else { None }
}

fn real_of(value: Value) -> Option<f64> {
    if let Value::Real(real) = value { Some(real) } else { None }
}

/// The value of `node`, if it is of `kind`.
pub(in crate::manifest) fn read(kind: Kind, node: &Node) -> Option<Value> {
    // Distributions, rows and files have readers of their own, with more precise messages.
    let has_own = matches!(kind, Kind::Distribution(_) | Kind::Rows(_) | Kind::Content(_));
    let value = kind.value(&json(node).filter(|_| !has_own)?)?;
    Some(value).filter(|value| kind.admits(value))
}

/// The value of a text, as a manifest writes it; `None` for a text that is no value.
pub(crate) fn written_value(text: &str) -> Option<Json> {
    json(&DeValue::parse(text).ok()?)
}

/// The value of `node` as JSON; `None` for tables and dates.
fn json(node: &Node) -> Option<Json> {
    match node.get_ref() {
        DeValue::Boolean(flag) => Some(Json::Bool(*flag)),
        DeValue::String(text) => Some(Json::String(text.clone().into_owned())),
        DeValue::Integer(_) => signed(node).map(Json::from),
        DeValue::Float(_) => Number::from_f64(number(node)?).map(Json::Number),
        DeValue::Array(items) => items.iter().map(json).collect::<Option<_>>().map(Json::Array),
        DeValue::Table(_) | DeValue::Datetime(_) => None,
    }
}

/// The number in `node`; whole numbers are converted.
pub(in crate::manifest) fn number(node: &Node) -> Option<f64> {
    match node.get_ref() {
        DeValue::Float(float) => float.as_str().parse().ok(),
        DeValue::Integer(integer) => {
            i64::from_str_radix(integer.as_str(), integer.radix()).ok().map(|whole| whole as f64)
        }
        _ => None,
    }
}

/// The non-negative whole number in `node`.
pub(in crate::manifest) fn whole(node: &Node) -> Option<u64> {
    u64::try_from(signed(node)?).ok()
}

/// The whole number in `node`.
fn signed(node: &Node) -> Option<i64> {
    let integer = node.get_ref().as_integer()?;
    i64::from_str_radix(integer.as_str(), integer.radix()).ok()
}

fn hint(fault: Fault, kind: Kind, node: &Node) -> Fault {
    match (kind, node.get_ref()) {
        (Kind::Choice(words), DeValue::String(found)) => {
            fault.nearest(found, words.iter().copied())
        }
        (Kind::AnyOf(kinds), _) => kinds.iter().fold(fault, |fault, kind| match kind {
            Kind::Choice(_) => hint(fault, *kind, node),
            _ => fault,
        }),
        (
            Kind::Real { .. } | Kind::PositiveReal { .. } | Kind::Integer { .. },
            DeValue::String(text),
        ) if text.parse::<f64>().is_ok() => fault.help("numbers are written without quotes"),
        (Kind::Real { min, max: 1.0 }, _) if min >= 0.0 => match number(node) {
            Some(percent) if (2.0..=100.0).contains(&percent) => {
                fault.help(format!("{percent} % is written {}", share(percent)))
            }
            _ => fault,
        },
        (Kind::Flag, DeValue::String(text)) if text.parse::<bool>().is_ok() => {
            fault.help("true and false are written without quotes")
        }
        (Kind::Integer { .. }, DeValue::Float(_)) => {
            fault.help("whole numbers are written without a fraction or exponent, as 50")
        }
        _ => fault,
    }
}
