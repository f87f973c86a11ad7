//! Files of numbers beside a model: people, and rows that are replayed.

use std::collections::HashSet;
use std::ops::Range;
use std::sync::Arc;

use crate::key::{ContentForm, MOST_BYTES, MOST_ROWS, read_csv};

/// The form of a file of people.
pub static PEOPLE: ContentForm = ContentForm {
    what: "a CSV file with one row per person",
    parse: |text| Ok(Arc::new(Numbers::people(text)?)),
    canonical: None,
    shipped: &[],
    help: Some(
        "the columns are the names that the model uses and does not declare; docs/models.md has an example",
    ),
    most_bytes: MOST_BYTES,
};

/// The form of a file of rows.
pub static REPLAY: ContentForm = ContentForm {
    what: "a CSV file of rows by person",
    parse: |text| Ok(Arc::new(Numbers::replay(text)?)),
    canonical: None,
    shipped: &[],
    help: Some("its columns are `person` and those of the model's [replay]"),
    most_bytes: MOST_BYTES,
};

/// The column that names people.
const PERSON: &str = "person";
/// Maximum number of replayed rows; a file has 10 MB at most.
const MOST_REPLAYED: usize = 1_000_000;

/// Numbers in named columns.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Numbers {
    /// The names of the columns, without that of people.
    columns: Vec<String>,
    /// For each column, the line and the text of the first field that is not a number.
    texts: Vec<Option<(u64, String)>>,
    /// \[rows, columns\]; NaN for empty fields and texts.
    numbers: Vec<f64>,
    /// \[rows\]: the name of the person; empty without such a column.
    people: Vec<String>,
    rows: usize,
    /// The people in the order of their first rows, each with the range of rows; empty without names.
    runs: Vec<(String, Range<usize>)>,
}

impl Numbers {
    /// Reads a file of people.
    pub fn people(text: &str) -> Result<Numbers, String> {
        Numbers::read(text, MOST_ROWS, "people")
    }

    fn replay(text: &str) -> Result<Numbers, String> {
        let numbers = Numbers::read(text, MOST_REPLAYED, "rows")?;
        if numbers.people.is_empty() {
            return Err(format!("there is no column `{PERSON}`"));
        }
        let mut seen = HashSet::new();
        if let Some((name, _)) = numbers.runs.iter().find(|(name, _)| !seen.insert(name)) {
            return Err(format!("the rows of person {name} do not follow one another"));
        }
        Ok(numbers)
    }

    /// Numbers without names of columns or people, \[rows, columns\].
    pub fn of(columns: usize, numbers: Vec<f64>) -> Numbers {
        let rows = numbers.len().checked_div(columns).unwrap_or(0);
        let columns = vec![String::new(); columns];
        Numbers { texts: vec![None; columns.len()], columns, numbers, rows, ..Numbers::default() }
    }

    fn read(text: &str, most: usize, what: &str) -> Result<Numbers, String> {
        let mut line = 1;
        let begin = |names: &csv::StringRecord| {
            let all: Vec<&str> = names.iter().collect();
            let twice = all.iter().enumerate().find(|(index, name)| all[..*index].contains(name));
            if let Some((_, name)) = twice {
                return Err(format!("column `{name}` is listed twice"));
            }
            let own: Vec<String> =
                all.iter().filter(|name| **name != PERSON).map(|name| (*name).to_owned()).collect();
            let person = all.iter().position(|name| *name == PERSON);
            Ok((
                Numbers { texts: vec![None; own.len()], columns: own, ..Numbers::default() },
                person,
            ))
        };
        let push = |(numbers, person): &mut (Numbers, Option<usize>),
                    record: &csv::StringRecord| {
            line = record.position().map_or(line + 1, csv::Position::line);
            if numbers.rows == most {
                return Err(format!("expected at most {most} {what}"));
            }
            numbers.rows += 1;
            let mut column = 0;
            for (index, written) in record.iter().enumerate() {
                if Some(index) == *person {
                    numbers.people.push(written.to_owned());
                    continue;
                }
                let number = written.parse().ok().filter(|number: &f64| number.is_finite());
                if number.is_none() && !written.is_empty() {
                    numbers.texts[column].get_or_insert((line, written.to_owned()));
                }
                numbers.numbers.push(number.unwrap_or(f64::NAN));
                column += 1;
            }
            Ok(())
        };
        let (mut numbers, _) = read_csv(text, begin, push)?;
        if numbers.rows == 0 {
            return Err("expected a line of names and at least one row below it".to_owned());
        }
        let mut start = 0;
        for rows in numbers.people.chunk_by(|one, other| one == other) {
            numbers.runs.push((rows[0].clone(), start..start + rows.len()));
            start += rows.len();
        }
        Ok(numbers)
    }

    /// The number of rows.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// The names of the columns.
    pub fn columns(&self) -> &[String] {
        &self.columns
    }

    /// The index of a column.
    ///
    /// **Errors**: there is no such column, or it has a text.
    pub fn column(&self, name: &str) -> Result<usize, ColumnFault> {
        let index = self.columns.iter().position(|known| known == name);
        let index = index.ok_or(ColumnFault::Missing)?;
        match &self.texts[index] {
            Some((line, text)) => Err(ColumnFault::Text(*line, text.clone())),
            None => Ok(index),
        }
    }

    /// The number in a row and column; NaN for an empty field.
    #[inline]
    pub fn number(&self, row: usize, column: usize) -> f64 {
        self.numbers[row * self.columns.len() + column]
    }

    /// The name of the person of a row; its number from 1 without names.
    pub fn person(&self, row: usize) -> String {
        self.people.get(row).cloned().unwrap_or_else(|| (row + 1).to_string())
    }

    /// The people in the order of their first rows, each with the range of rows.
    pub fn by_person(&self) -> &[(String, Range<usize>)] {
        &self.runs
    }
}

/// Why a column cannot be used.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum ColumnFault {
    /// The file has no such column.
    Missing,
    /// This line has this text.
    Text(u64, String),
}
