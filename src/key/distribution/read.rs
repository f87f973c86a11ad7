//! Reads distributions from TOML.

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::{Distribution, DistributionError, FIXED, LARGEST_WEIGHT, WEIGHTS, number};
use crate::key::normal;
use crate::key::number_range::NumberRange;

/// Minimum probability that a normal distribution must have between its bounds; tails below it are inexact.
const LEAST_MASS: f64 = 1e-9;

/// Maximum number of values of a list.
const MOST_VALUES: usize = 10_000;

/// The forms of a table: the key that names the form, and the other keys of the form.
const SHAPES: [(&str, &[&str]); 4] = [
    ("uniform", &[]),
    ("normal", &["sd", "from", "to"]),
    ("log_normal", &["log_sd", "from", "to"]),
    ("values", &["weights"]),
];

impl Distribution {
    /// Reads a TOML value; `of` is the range of the numbers.
    ///
    /// **Errors**: the value is not a distribution, or has draws outside the range.
    pub fn read(
        of: NumberRange,
        node: &Spanned<DeValue<'_>>,
    ) -> Result<Distribution, DistributionError> {
        let reader = Reader { of };
        match node.get_ref() {
            DeValue::Table(table) => reader.table(node, table),
            DeValue::String(word) if word == FIXED => Ok(Distribution::Fixed),
            _ => reader.admitted(node).map(Distribution::Constant),
        }
    }
}

/// Reads distributions of numbers in a range.
struct Reader {
    of: NumberRange,
}

type Node<'t> = Spanned<DeValue<'t>>;

fn fault(node: &Node<'_>, says: impl Into<String>) -> DistributionError {
    DistributionError { span: node.span(), says: says.into(), help: None }
}

fn found(node: &Node<'_>) -> String {
    match node.get_ref() {
        DeValue::Array(items) => format!("a list of {}", items.len()),
        DeValue::Table(_) => "a table".to_owned(),
        DeValue::String(text) => format!("{text:?}"),
        DeValue::Integer(number) => number.as_str().to_owned(),
        DeValue::Float(number) => number.as_str().to_owned(),
        DeValue::Boolean(flag) => flag.to_string(),
        DeValue::Datetime(_) => "a date or time".to_owned(),
    }
}

impl Reader {
    fn admits(&self, number: f64) -> bool {
        self.of.admits(number)
    }

    /// A number in the range.
    fn admitted(&self, node: &Node<'_>) -> Result<f64, DistributionError> {
        let admitted = number(node.get_ref()).filter(|number| self.admits(*number));
        admitted.ok_or_else(|| {
            let expected = match node.get_ref() {
                DeValue::Integer(_) | DeValue::Float(_) => self.of.expectation(),
                _ => Distribution::expectation(self.of),
            };
            fault(node, format!("expected {expected}, found {}", found(node)))
        })
    }

    /// A number above 0, without an upper limit.
    fn positive(&self, node: &Node<'_>) -> Result<f64, DistributionError> {
        let positive = number(node.get_ref()).filter(|number| *number > 0.0);
        positive
            .ok_or_else(|| fault(node, format!("expected a number above 0, found {}", found(node))))
    }

    /// A weight; the maximum keeps sums of weights finite.
    fn weight(&self, node: &Node<'_>) -> Result<f64, DistributionError> {
        let weight = self.positive(node)?;
        if weight > LARGEST_WEIGHT {
            let message = format!("expected {WEIGHTS}, found {}", found(node));
            return Err(fault(node, message));
        }
        Ok(weight)
    }

    fn table(
        &self,
        node: &Node<'_>,
        table: &DeTable<'_>,
    ) -> Result<Distribution, DistributionError> {
        let has = |name: &str| table.contains_key(name);
        let mut shapes = SHAPES.iter().filter(|(name, _)| has(name));
        let (Some((shape, beside)), None) = (shapes.next(), shapes.next()) else {
            let says = "expected exactly one of `uniform`, `normal`, `log_normal` and `values`";
            return Err(DistributionError {
                help: Some("as in { normal = 0.1, sd = 0.05, from = 0, to = 0.3 }".to_owned()),
                ..fault(node, says)
            });
        };
        for key in table.keys() {
            let known = key.get_ref() == shape || beside.contains(&key.get_ref().as_ref());
            if !known {
                let keys: Vec<String> =
                    [shape].into_iter().chain(*beside).map(|key| format!("`{key}`")).collect();
                return Err(DistributionError {
                    span: key.span(),
                    says: format!("unknown key `{}` beside `{shape}`", key.get_ref()),
                    help: Some(format!("its keys are {}", keys.join(", "))),
                });
            }
        }
        let part = &table[*shape];
        match *shape {
            "uniform" => self.uniform(part),
            "values" => self.values(part, table.get("weights")),
            _ => self.bell(node, shape, table),
        }
    }

    fn uniform(&self, node: &Node<'_>) -> Result<Distribution, DistributionError> {
        let items = node.get_ref().as_array().map_or(&[][..], |items| &items[..]);
        let [from, to] = items else {
            return Err(fault(node, format!("expected two numbers, found {}", found(node))));
        };
        let ends = [self.admitted(from)?, self.admitted(to)?];
        self.ordered(ends, node).map(Distribution::Uniform)
    }

    fn ordered(&self, ends: [f64; 2], node: &Node<'_>) -> Result<[f64; 2], DistributionError> {
        if ends[0] < ends[1] {
            return Ok(ends);
        }
        Err(fault(
            node,
            format!("the lower end {} must be below the upper end {}", ends[0], ends[1]),
        ))
    }

    fn values(
        &self,
        node: &Node<'_>,
        weights: Option<&Node<'_>>,
    ) -> Result<Distribution, DistributionError> {
        let items = node.get_ref().as_array().map_or(&[][..], |items| &items[..]);
        if !(1..=MOST_VALUES).contains(&items.len()) {
            let expected = format!("a list of 1 to {MOST_VALUES} numbers");
            return Err(fault(node, format!("expected {expected}, found {}", found(node))));
        }
        let values = items.iter().map(|item| self.admitted(item)).collect::<Result<Vec<_>, _>>()?;
        let mut seen = std::collections::HashSet::new();
        for (value, item) in values.iter().zip(items) {
            if !seen.insert(value.to_bits()) {
                return Err(fault(item, format!("{value} is listed twice")));
            }
        }
        let Some(weights) = weights else {
            return Ok(Distribution::Values { values, weights: Vec::new() });
        };
        let items = weights.get_ref().as_array().map_or(&[][..], |items| &items[..]);
        if items.len() != values.len() {
            let expected = format!("one weight for each of {} values", values.len());
            return Err(fault(weights, format!("expected {expected}, found {}", found(weights))));
        }
        let given = items.iter().map(|item| self.weight(item)).collect::<Result<Vec<_>, _>>()?;
        // Equal weights are stored as no weights.
        let equal = given.iter().all(|weight| *weight == given[0]);
        Ok(Distribution::Values { values, weights: if equal { Vec::new() } else { given } })
    }

    /// A normal or log-normal distribution.
    fn bell(
        &self,
        node: &Node<'_>,
        shape: &str,
        table: &DeTable<'_>,
    ) -> Result<Distribution, DistributionError> {
        let is_log = shape == "log_normal";
        let spread = if is_log { "log_sd" } else { "sd" };
        let Some(sd) = table.get(spread) else {
            return Err(fault(node, format!("`{shape}` needs `{spread}`")));
        };
        let sd = self.positive(sd)?;
        let centre = &table[shape];
        let centre = match is_log {
            true => self.positive(centre)?,
            false => number(centre.get_ref()).ok_or_else(|| {
                fault(centre, format!("expected a number, found {}", found(centre)))
            })?,
        };
        let NumberRange { min: least, max: most } = self.of;
        let least = least.map(|least| if is_log { least.max(0.0) } else { least });
        let from = match (table.get("from"), least) {
            (Some(from), _) => self.admitted(from)?,
            (None, Some(least)) => least,
            (None, None) => {
                let says = format!("`{shape}` needs `from`, because the value must be above 0");
                return Err(fault(node, says));
            }
        };
        if is_log && from < 0.0 {
            return Err(fault(&table["from"], "a log-normal distribution has no values below 0"));
        }
        let to = table.get("to").map_or(Ok(most), |to| self.admitted(to))?;
        let bounds = self.ordered([from, to], node)?;
        let standard = match is_log {
            true => bounds.map(|bound| (libm::log(bound) - libm::log(centre)) / sd),
            false => bounds.map(|bound| (bound - centre) / sd),
        };
        if normal::mass_between(standard).partial_cmp(&LEAST_MASS).is_none_or(|order| order.is_lt())
        {
            let says = format!("almost no part of the distribution is between {from} and {to}");
            return Err(fault(node, says));
        }
        Ok(match is_log {
            true => Distribution::LogNormal { median: centre, log_sd: sd, bounds },
            false => Distribution::Normal { mean: centre, sd, bounds },
        })
    }
}
