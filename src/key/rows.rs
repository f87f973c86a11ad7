//! Rows of numbers, from which participants are drawn so that their parameters can be correlated.
//!
//! In: a list of TOML tables or the text of a CSV file. Out: [`Rows`], whose text does not depend on the
//! order of columns or the spelling of numbers in the input. It opens no file.

use std::fmt::Write;
use std::ops::Range;

use toml::Spanned;
use toml::de::{DeArray, DeValue};

use super::distribution::{LARGEST_WEIGHT, WEIGHTS, drawn_index, number};
use super::number_range::NumberRange;

/// A column that rows can have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Column {
    /// Its name: a key of the same table.
    pub name: &'static str,
    /// The range of its numbers.
    pub of: NumberRange,
}

/// Rows of numbers, with one number per column and row; empty if no rows are given.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rows {
    /// In the order of the known columns.
    columns: Vec<&'static str>,
    /// Row by row.
    values: Vec<f64>,
    /// One weight per row, above 0; empty for equal weights.
    weights: Vec<f64>,
}

/// Why a value is not a valid list of rows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RowsError {
    /// The position of the faulty value in TOML; `None` for the text of a CSV file.
    pub span: Option<Range<usize>>,
    /// The fault.
    pub says: String,
}

/// The name of the column with the weights.
const WEIGHT: &str = "weight";
/// The word for no rows.
const NONE: &str = "none";
/// Maximum number of rows.
pub const MOST_ROWS: usize = 10_000;

impl Rows {
    /// Whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.columns.is_empty()
    }

    /// The names of the columns.
    pub fn columns(&self) -> &[&'static str] {
        &self.columns
    }

    /// The number of rows.
    pub fn len(&self) -> usize {
        self.values.len().checked_div(self.columns.len()).unwrap_or(0)
    }

    /// The numbers of the row that a share in (0, 1) selects, in the order of the columns; empty if there
    /// are no rows.
    pub fn row(&self, share: f64) -> &[f64] {
        if self.is_empty() {
            return &[];
        }
        let start = drawn_index(&self.weights, self.len(), share) * self.columns.len();
        &self.values[start..start + self.columns.len()]
    }

    /// The smallest and the largest number of a column; `None` if there is no such column.
    pub fn range(&self, column: &str) -> Option<[f64; 2]> {
        let index = self.columns.iter().position(|name| *name == column)?;
        let numbers = self.values.iter().skip(index).step_by(self.columns.len());
        let ends = [f64::INFINITY, f64::NEG_INFINITY];
        Some(numbers.fold(ends, |[least, most], number| [number.min(least), number.max(most)]))
    }

    /// The rows as the text of a CSV file, without a line break at the end; `none` if there are no rows.
    pub fn text(&self) -> String {
        if self.is_empty() {
            return NONE.to_owned();
        }
        let mut text = self.columns.join(",");
        if !self.weights.is_empty() {
            let _ = write!(text, ",{WEIGHT}");
        }
        for (row, numbers) in self.values.chunks(self.columns.len()).enumerate() {
            let weight = self.weights.get(row);
            let numbers: Vec<String> =
                numbers.iter().chain(weight).map(|number| format!("{number:?}")).collect();
            let _ = write!(text, "\n{}", numbers.join(","));
        }
        text
    }

    /// Whether a text in a manifest is the content of a CSV file, rather than its name.
    pub fn is_csv(text: &str) -> bool {
        text.contains('\n')
    }

    /// Whether a text in a manifest is the word for no rows.
    pub fn is_none(text: &str) -> bool {
        text == NONE
    }

    /// The rows in a text of [`Rows::text`].
    pub(super) fn from_text(known: &'static [Column], text: &str) -> Option<Rows> {
        if Rows::is_none(text) { Some(Rows::default()) } else { Rows::from_csv(known, text).ok() }
    }

    /// Reads a CSV file: a line of names, and one line per row.
    ///
    /// **Errors**: the text is not such a file, a column is unknown, or a number is outside its range.
    pub fn from_csv(known: &'static [Column], text: &str) -> Result<Rows, RowsError> {
        let fault = |says: String| RowsError { span: None, says };
        let begin = |names: &csv::StringRecord| {
            Builder::new(known, &names.iter().map(str::to_owned).collect::<Vec<_>>())
        };
        let push = |builder: &mut Builder, record: &csv::StringRecord| {
            for (column, written) in record.iter().enumerate() {
                let number = written.parse().ok().filter(|number: &f64| number.is_finite());
                builder.push(column, number.map(|number| number + 0.0), written)?;
            }
            builder.end_row()
        };
        read_csv(text, begin, push).and_then(Builder::finish).map_err(fault)
    }

    /// Reads a list of tables with equal keys.
    ///
    /// **Errors**: as [`Rows::from_csv`].
    pub fn from_tables(known: &'static [Column], items: &DeArray<'_>) -> Result<Rows, RowsError> {
        let at =
            |node: &Spanned<DeValue<'_>>, says: String| RowsError { span: Some(node.span()), says };
        let first = items.first().and_then(|item| item.get_ref().as_table());
        let names: Vec<String> = first
            .map(|table| table.keys().map(|key| key.get_ref().to_string()).collect())
            .unwrap_or_default();
        let builder = Builder::new(known, &names);
        let mut builder = builder.map_err(|says| match items.first() {
            Some(item) => at(item, says),
            None => RowsError { span: None, says },
        })?;
        for item in items.iter() {
            let table = item.get_ref().as_table();
            let Some(table) = table.filter(|table| table.len() == names.len()) else {
                let says =
                    format!("expected a table with {}, as in the first row", names.join(", "));
                return Err(at(item, says));
            };
            for (column, name) in names.iter().enumerate() {
                let Some(node) = table.get(name.as_str()) else {
                    return Err(at(item, format!("`{name}` is missing; the first row has it")));
                };
                let written = match node.get_ref() {
                    DeValue::Float(float) => float.as_str().to_owned(),
                    DeValue::Integer(integer) => integer.as_str().to_owned(),
                    _ => "something else".to_owned(),
                };
                builder
                    .push(column, number(node.get_ref()), &written)
                    .map_err(|says| at(node, says))?;
            }
            builder.end_row().map_err(|says| at(item, says))?;
        }
        builder.finish().map_err(|says| RowsError { span: None, says })
    }
}

/// Reads a CSV file: `begin` receives the names of its columns, and `push` each row. Lines that begin with # are
/// comments.
///
/// **Errors**: the text is not such a file, or a function returns an error; errors of rows name the line.
pub fn read_csv<T>(
    text: &str,
    begin: impl FnOnce(&csv::StringRecord) -> Result<T, String>,
    mut push: impl FnMut(&mut T, &csv::StringRecord) -> Result<(), String>,
) -> Result<T, String> {
    let mut reader = csv::ReaderBuilder::new()
        .comment(Some(b'#'))
        .trim(csv::Trim::All)
        .from_reader(text.as_bytes());
    let broken = |error: csv::Error| match error.position() {
        Some(at) => format!("line {}: {error}", at.line()),
        None => error.to_string(),
    };
    let mut read = begin(reader.headers().map_err(broken)?)?;
    for record in reader.records() {
        let record = record.map_err(broken)?;
        let line = record.position().map_or(0, csv::Position::line);
        push(&mut read, &record).map_err(|says| format!("line {line}: {says}"))?;
    }
    Ok(read)
}

/// The target of a column that is read.
#[derive(Clone, Copy)]
enum Target {
    /// The column at this index of the rows.
    Column(usize),
    Weight,
}

/// Rows that are being read.
struct Builder {
    known: &'static [Column],
    targets: Vec<Target>,
    rows: Rows,
    row: Vec<f64>,
}

impl Builder {
    fn new(known: &'static [Column], names: &[String]) -> Result<Builder, String> {
        for (index, name) in names.iter().enumerate() {
            if name != WEIGHT && known.iter().all(|column| column.name != name) {
                let names: Vec<&str> = known.iter().map(|column| column.name).collect();
                return Err(format!(
                    "there is no column `{name}`; the columns are {} and {WEIGHT}",
                    names.join(", ")
                ));
            }
            if names[..index].contains(name) {
                return Err(format!("column `{name}` is listed twice"));
            }
        }
        let used = known.iter().filter(|column| names.iter().any(|name| name == column.name));
        let used: Vec<Column> = used.copied().collect();
        if used.is_empty() {
            return Err("expected rows with at least one parameter".to_owned());
        }
        let target = |name: &String| match used.iter().position(|column| column.name == name) {
            Some(index) => Target::Column(index),
            None => Target::Weight,
        };
        let columns = used.iter().map(|column| column.name).collect();
        Ok(Builder {
            known,
            targets: names.iter().map(target).collect(),
            row: vec![0.0; used.len()],
            rows: Rows { columns, ..Rows::default() },
        })
    }

    fn push(&mut self, column: usize, number: Option<f64>, written: &str) -> Result<(), String> {
        match self.targets[column] {
            Target::Weight => {
                let weight = number.filter(|weight| *weight > 0.0 && *weight <= LARGEST_WEIGHT);
                let says = || format!("`{WEIGHT}`: expected {WEIGHTS}, found {written}");
                self.rows.weights.push(weight.ok_or_else(says)?);
            }
            Target::Column(index) => {
                let name = self.rows.columns[index];
                let of =
                    self.known.iter().find(|column| column.name == name).map(|column| column.of);
                let of = of.expect("a known column");
                let admitted = number.filter(|number| of.admits(*number));
                let says = || format!("`{name}`: expected {}, found {written}", of.expectation());
                self.row[index] = admitted.ok_or_else(says)?;
            }
        }
        Ok(())
    }

    fn end_row(&mut self) -> Result<(), String> {
        if self.rows.len() == MOST_ROWS {
            return Err(format!("expected at most {MOST_ROWS} rows"));
        }
        self.rows.values.extend_from_slice(&self.row);
        Ok(())
    }

    fn finish(mut self) -> Result<Rows, String> {
        if self.rows.values.is_empty() {
            return Err("expected at least one row".to_owned());
        }
        // Equal weights are stored as no weights.
        if self.rows.weights.iter().all(|weight| *weight == self.rows.weights[0]) {
            self.rows.weights.clear();
        }
        Ok(self.rows)
    }
}

#[cfg(test)]
mod tests {
    use toml::de::DeTable;

    use crate::key::Kind;

    use super::*;

    const KNOWN: &[Column] = &[
        Column { name: "delta_d", of: Kind::PROBABILITY.number_range() },
        Column { name: "rho_2", of: Kind::ANY_REAL.number_range() },
    ];

    fn tables(text: &str) -> Result<Rows, String> {
        let line = format!("rows = {text}");
        let document = DeTable::parse(&line).unwrap();
        let rows = document.get_ref()["rows"].get_ref().as_array().unwrap();
        Rows::from_tables(KNOWN, rows).map_err(|error| error.says)
    }

    #[test]
    fn tables_and_csv_files_of_the_same_rows_are_one() {
        let rows = tables(
            "[{ rho_2 = 100, delta_d = 1e-1, weight = 3 }, { delta_d = 0.2, rho_2 = -50, weight = 1 }]",
        );
        let csv = Rows::from_csv(KNOWN, "weight, rho_2,delta_d\r\n3,1e2,0.10\n1,\"-50\", 0.2\n\n");
        let rows = rows.unwrap();
        assert_eq!(Ok(&rows), csv.as_ref());
        assert_eq!(rows.text(), "delta_d,rho_2,weight\n0.1,100.0,3.0\n0.2,-50.0,1.0");
        assert_eq!(Rows::from_text(KNOWN, &rows.text()), Some(rows.clone()));
        assert_eq!((rows.len(), rows.columns()), (2, &["delta_d", "rho_2"][..]));
        assert_eq!((rows.row(0.7), rows.row(0.8)), (&[0.1, 100.0][..], &[0.2, -50.0][..]));
        assert_eq!((rows.range("rho_2"), rows.range("rho_1")), (Some([-50.0, 100.0]), None));
        assert_eq!(Rows::default().text(), "none");
        assert_eq!(Rows::from_text(KNOWN, "none"), Some(Rows::default()));
        assert!(Rows::default().row(0.5).is_empty());
    }

    #[test]
    fn faults_say_where_they_are() {
        let csv = |text| Rows::from_csv(KNOWN, text).unwrap_err().says;
        assert_eq!(
            csv("delta_d\n0.1\n1.5\n"),
            "line 3: `delta_d`: expected a number from 0 to 1, found 1.5"
        );
        assert_eq!(csv("weight\n1\n"), "expected rows with at least one parameter");
        assert_eq!(csv("delta_d\n"), "expected at least one row");
        assert_eq!(csv("delta_d,delta_d\n0,0\n"), "column `delta_d` is listed twice");
        assert_eq!(
            csv("delta_d,weight\n0,0\n"),
            "line 2: `weight`: expected a number above 0 and at most 1e9, found 0"
        );
        assert!(csv("delta_d,rho_2\n0\n").contains("line 2"));
        assert!(csv("delta\n0\n").starts_with("there is no column `delta`; the columns are"));
        assert_eq!(
            tables("[{ delta_d = 0.1 }, { rho_2 = 1 }]").unwrap_err(),
            "`delta_d` is missing; the first row has it"
        );
        assert_eq!(
            tables("[{ delta_d = \"a\" }]").unwrap_err(),
            "`delta_d`: expected a number from 0 to 1, found something else"
        );
        let many = format!("delta_d\n{}", "0\n".repeat(MOST_ROWS + 1));
        assert_eq!(csv(&many), "line 10002: expected at most 10000 rows");
    }
}
