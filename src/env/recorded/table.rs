//! Named columns of numbers, such as the states before decisions.

use crate::env::declared::{DataFaults, Header, header, reader, rows};
use crate::text::{nearest, shortened};

/// What a column of a table may lack.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MayLack {
    /// Nothing: a file without the column is a fault, and so is an empty field.
    Nothing,
    /// Numbers: an empty field is NaN.
    Numbers,
    /// Itself: without the column, every row has this number. An empty field is a fault unless this number is NaN.
    Column(f64),
}

/// Columns of a CSV file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NumberTable {
    /// \[columns\]\[rows\].
    pub columns: Vec<Vec<f64>>,
    /// \[rows\]: the line in the file.
    pub lines: Vec<u32>,
    /// The names of all columns of the file.
    pub names: Vec<String>,
}

/// The records of a text, with all their fields.
///
/// **Errors**: the text is no CSV.
pub fn records(text: &str) -> csv::Result<Vec<csv::StringRecord>> {
    reader(text.as_bytes()).into_records().collect()
}

impl NumberTable {
    /// These columns of a text, which may have no rows.
    ///
    /// **Errors**: every fault: a column or a number is missing, or a field is no number.
    pub fn read(text: &str, columns: &[(&str, MayLack)]) -> Result<NumberTable, DataFaults> {
        let is_empty = reader(text.as_bytes()).into_records().next().is_none();
        let mut reader = reader(text.as_bytes());
        let header = header(&mut reader)?;
        let mut faults = DataFaults::default();
        let indices: Vec<_> = columns.iter().map(|(name, _)| header.column(name)).collect();
        for ((name, lack), index) in columns.iter().zip(&indices) {
            if index.is_none() && !matches!(lack, MayLack::Column(_)) {
                faults.add(lacking(&header, name, columns));
            }
        }
        if !faults.is_empty() {
            return Err(faults);
        }
        let names = header.names().to_vec();
        if is_empty {
            let columns = vec![Vec::new(); columns.len()];
            return Ok(NumberTable { columns, lines: Vec::new(), names });
        }
        let used: Vec<usize> = indices.iter().copied().flatten().collect();
        let table = rows(&mut reader, header, None::<usize>, &used, &|| false)?;
        let count = table.lines.len();
        let mut read = Vec::with_capacity(columns.len());
        for ((name, lack), index) in columns.iter().zip(indices) {
            let number = match lack {
                MayLack::Nothing => 0.0,
                MayLack::Numbers => f64::NAN,
                MayLack::Column(number) => *number,
            };
            let column: Vec<f64> = match index {
                Some(index) => (0..count).map(|row| table.number(index, row)).collect(),
                None => vec![number; count],
            };
            let empty = column.iter().zip(&table.lines).filter(|(field, _)| field.is_nan());
            for (_, line) in empty.filter(|_| !number.is_nan()) {
                faults.add(format!("line {line}: column `{name}` is empty"));
            }
            read.push(column);
        }
        let table = NumberTable { columns: read, lines: table.lines, names };
        if faults.is_empty() { Ok(table) } else { Err(faults) }
    }
}

/// That there is no column of this name, of those that are read.
fn lacking(header: &Header, name: &str, read: &[(&str, MayLack)]) -> String {
    let is_read = |other: &String| read.iter().any(|(name, _)| name == other);
    let others = header.names().iter().filter(|other| !is_read(other));
    let help = match nearest(name, others.map(String::as_str)) {
        Some(near) => format!("did you mean `{}`?", shortened(near)),
        None => format!("its columns are {}", shortened(&header.names().join(", "))),
    };
    format!("line 1: there is no column `{name}`; {help}")
}
