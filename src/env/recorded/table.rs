//! Named columns of numbers, such as the states before decisions.

use crate::env::declared::{DataFaults, Header, header, reader, rows};
use crate::text::{nearest, shortened};

/// Columns of a CSV file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NumberTable {
    /// \[columns\]\[rows\].
    pub columns: Vec<Vec<f64>>,
    /// \[rows\]: the line in the file.
    pub lines: Vec<u32>,
}

impl NumberTable {
    /// These columns of a text.
    ///
    /// **Errors**: every fault: a column or a number is missing, or a field is no number.
    pub fn read(text: &str, names: &[String]) -> Result<NumberTable, DataFaults> {
        let mut reader = reader(text.as_bytes());
        let header = header(&mut reader)?;
        let mut faults = DataFaults::default();
        let mut indices = Vec::new();
        for name in names {
            match header.column(name) {
                Some(index) => indices.push(index),
                None => faults.add(lacking(&header, name, names)),
            }
        }
        if !faults.is_empty() {
            return Err(faults);
        }
        let table = rows(&mut reader, header, None::<usize>, &indices, &|| false)?;
        let column = |index: &usize| -> Vec<f64> {
            (0..table.lines.len()).map(|row| table.number(*index, row)).collect()
        };
        let columns: Vec<Vec<f64>> = indices.iter().map(column).collect();
        for (name, column) in names.iter().zip(&columns) {
            for (line, _) in table.lines.iter().zip(column).filter(|(_, number)| number.is_nan()) {
                faults.add(format!("line {line}: column `{name}` is empty"));
            }
        }
        let lines = table.lines;
        if faults.is_empty() { Ok(NumberTable { columns, lines }) } else { Err(faults) }
    }

    /// The numbers of a row in the first columns.
    pub fn row(&self, row: usize, columns: usize) -> Vec<f64> {
        self.columns[..columns].iter().map(|column| column[row]).collect()
    }
}

/// That there is no column of this name, of those that are read.
fn lacking(header: &Header, name: &str, read: &[String]) -> String {
    let others = header.names().iter().filter(|other| !read.contains(*other));
    let help = match nearest(name, others.map(String::as_str)) {
        Some(near) => format!("did you mean `{}`?", shortened(near)),
        None => format!("its columns are {}", shortened(&header.names().join(", "))),
    };
    format!("line 1: there is no column `{name}`; {help}")
}
