//! The file of people: one row per person, with the weights of the models of the outcome.

use std::sync::Arc;

use crate::env::oralytics::feature::Feature;
use crate::key::{ContentForm, read_csv};

/// The form of the file.
pub static PEOPLE: ContentForm = ContentForm {
    what: "a CSV file of people",
    parse: |text| Ok(Arc::new(Table::parse(text)?)),
    canonical: None,
    help: Some(
        "experiments/oralytics/people.py makes the published people from the authors' repositories; the files \
         synthetic_*.csv beside it are invented people",
    ),
};

/// The most people of a file.
const MOST_PEOPLE: usize = 10_000;

/// The columns beside the weights.
const OTHERS: [&str; 6] =
    ["person", "model", "sigma", "app_open_probability", "start_day", "end_day"];
/// The prefixes of the columns of weights.
const PREFIXES: [&str; 8] = [
    "bernoulli",
    "amount",
    "effect_bernoulli",
    "effect_amount",
    "effect_small_bernoulli",
    "effect_small_amount",
    "effect_smaller_bernoulli",
    "effect_smaller_amount",
];
/// The models of the amount, by their names in the column `model`.
const MODELS: [&str; 2] = ["zero_infl", "sqrt_norm"];

/// The rows of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    pub(super) columns: Vec<String>,
    /// \[people, columns\]; NaN for empty fields and texts.
    numbers: Vec<f64>,
    /// For each person, whether the amount is the square of a normal variate; `None` if the file does not say so.
    pub(super) squares: Vec<Option<bool>>,
}

impl Table {
    /// Reads the text of a file.
    ///
    /// **Errors**: it is not of this form; the text names the line.
    pub fn parse(text: &str) -> Result<Table, String> {
        let table = read_csv(text, Table::begin, Table::push)?;
        if table.squares.is_empty() {
            return Err("expected at least one person".to_owned());
        }
        Ok(table)
    }

    fn begin(names: &csv::StringRecord) -> Result<Table, String> {
        let columns: Vec<String> = names.iter().map(str::to_owned).collect();
        for (index, name) in columns.iter().enumerate() {
            if !OTHERS.contains(&name.as_str()) && !is_weight(name) {
                return Err(format!(
                    "there is no column `{name}`; docs/oralytics.md lists the columns"
                ));
            }
            if columns[..index].contains(name) {
                return Err(format!("column `{name}` is listed twice"));
            }
        }
        Ok(Table { columns, numbers: Vec::new(), squares: Vec::new() })
    }

    fn push(&mut self, record: &csv::StringRecord) -> Result<(), String> {
        if self.squares.len() == MOST_PEOPLE {
            return Err(format!("expected at most {MOST_PEOPLE} people"));
        }
        let mut is_square = None;
        for (name, written) in self.columns.iter().zip(record) {
            let number = match name.as_str() {
                "person" | "start_day" | "end_day" => f64::NAN,
                _ if written.is_empty() => f64::NAN,
                "model" => {
                    let index = MODELS.iter().position(|model| *model == written);
                    let [zero, square] = MODELS;
                    let says = || format!("`model`: expected {zero} or {square}, found {written}");
                    is_square = Some(index.ok_or_else(says)? == 1);
                    f64::NAN
                }
                _ => {
                    let number = written.parse().ok().filter(|number: &f64| number.abs() <= 1e6);
                    let says =
                        || format!("`{name}`: expected a number from -1e6 to 1e6, found {written}");
                    number.ok_or_else(says)?
                }
            };
            let least_and_most = match name.as_str() {
                "app_open_probability" => (0.0, 1.0),
                "sigma" => (0.0, f64::INFINITY),
                _ => (f64::NEG_INFINITY, f64::INFINITY),
            };
            if number < least_and_most.0 || number > least_and_most.1 {
                return Err(format!("`{name}`: {written} is out of range"));
            }
            self.numbers.push(number);
        }
        self.squares.push(is_square);
        Ok(())
    }

    /// The number of people.
    pub(super) fn len(&self) -> usize {
        self.squares.len()
    }

    /// A person's number in a column; `None` if the column is missing or empty.
    pub(super) fn number(&self, person: usize, column: &str) -> Option<f64> {
        let index = self.columns.iter().position(|name| name == column)?;
        Some(self.numbers[person * self.columns.len() + index]).filter(|number| !number.is_nan())
    }
}

/// The column of a weight.
pub(super) fn column(prefix: &str, feature: Feature) -> String {
    format!("{prefix}_{}", feature.column())
}

/// Whether a column has weights.
fn is_weight(name: &str) -> bool {
    let has_weight =
        |prefix: &&str| Feature::ALL.iter().any(|feature| column(prefix, *feature) == name);
    PREFIXES.iter().any(has_weight)
}
