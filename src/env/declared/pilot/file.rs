//! A CSV file of recorded decisions: its columns as numbers, and expressions of them.
//!
//! Every fault of the file is reported, with line and column.

use std::collections::HashMap;
use std::io::{self, BufRead, BufReader, Read};

use crate::env::declared::expression::Expression;
use crate::env::declared::grammar;
use crate::env::declared::numbers;
use crate::env::declared::pilot::section::WrittenColumn;
use crate::text::{Fault, FaultList, Span, nearest, shortened};

/// Texts that stand for a missing number.
const MISSING: [&str; 6] = ["", "NA", "NaN", "nan", "NULL", "."];
/// Numbers that often stand for a missing one where no number is negative.
const CODES: [f64; 4] = [-9.0, -99.0, -999.0, -9999.0];
/// Maximum number of numbers of a file that are kept; 2 GB.
const MOST_NUMBERS: usize = 1 << 28;

/// What is wrong with a file: sentences with lines and columns.
#[derive(Debug, Default)]
pub struct DataFaults {
    says: Vec<String>,
    count: usize,
}

impl DataFaults {
    /// Maximum number of faults that are shown.
    const MOST: usize = 30;

    pub(in crate::env) fn add(&mut self, says: impl Into<String>) {
        self.count += 1;
        if self.says.len() < Self::MOST {
            self.says.push(says.into());
        }
    }

    pub(in crate::env) fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The faults as those of a file that a manifest names.
    pub(in crate::env) fn list(&self) -> FaultList {
        let mut list = FaultList::default();
        self.says.iter().for_each(|says| list.add(Fault::whole(says.clone())));
        list.leave_out(self.count - self.says.len());
        list
    }

    /// The faults, each a line that begins with the name of the file.
    pub fn text(&self, file: &str) -> String {
        let mut text: String = self.says.iter().map(|says| format!("{file}: {says}\n")).collect();
        let noun = if self.count == 1 { "fault" } else { "faults" };
        let shown = match self.count - self.says.len() {
            0 => String::new(),
            _ => format!(", {} of them shown", self.says.len()),
        };
        text += &format!("{} {noun} in {file}{shown}", self.count);
        text
    }
}

/// The names of a file's columns.
#[derive(Debug)]
pub(in crate::env) struct Header {
    names: Vec<String>,
    /// The names as expressions write them.
    words: Vec<String>,
}

/// An expression of columns.
#[derive(Clone, Debug)]
pub(in crate::env) enum ColumnFormula {
    Column(usize),
    Expression(ColumnExpression),
}

/// An expression with the meanings of its names.
#[derive(Clone, Debug)]
pub(in crate::env) struct ColumnExpression(Expression, Vec<FormulaName>);

/// What a name in an expression of columns means.
#[derive(Clone, Copy, Debug)]
pub(in crate::env) enum FormulaName {
    Column(usize),
    Missing,
    Step,
}

impl Header {
    fn new(names: &csv::StringRecord) -> Header {
        let word = |name: &str| {
            let of = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
            let word: String = name.chars().map(of).collect();
            if word.starts_with(|c: char| c.is_ascii_digit()) { format!("_{word}") } else { word }
        };
        let names: Vec<String> = names.iter().map(str::to_owned).collect();
        let words = names.iter().map(|name| word(name)).collect();
        Header { names, words }
    }

    /// The index of a column by its name.
    pub fn column(&self, name: &str) -> Option<usize> {
        self.names.iter().position(|known| known == name)
    }

    /// The meaning of a written column.
    ///
    /// **Errors**: it is no expression, or has a name that is no column.
    pub fn formula(&self, written: &WrittenColumn) -> Result<ColumnFormula, Fault> {
        if let Some(index) = self.column(&written.text) {
            return Ok(ColumnFormula::Column(index));
        }
        let expression = grammar::read(&written.text).map_err(|fault| {
            // Words alone are the name of a column that is not there.
            if written.text.chars().all(|c| c.is_alphanumeric() || matches!(c, ' ' | '_' | '.')) {
                return self.unknown(&written.text, written.span);
            }
            let says = format!("`{}`: {}", shortened(&written.text), fault.says);
            let located = Fault::at(written.span, says);
            match self.odd_name(&written.text).or(fault.help) {
                Some(help) => located.help(help),
                None => located,
            }
        })?;
        if expression.windows().next().is_some() || expression.names.iter().any(|one| one.back > 0)
        {
            let says = "an expression of columns has no earlier decisions: write them as a column of the file, or in a fit as a variable of the model";
            return Err(Fault::at(written.span, says));
        }
        let mut names = Vec::new();
        for name in &expression.names {
            let column = self.words.iter().position(|word| *word == name.text);
            names.push(match (column, name.text.as_str()) {
                (Some(column), _) => FormulaName::Column(column),
                (None, "missing") => FormulaName::Missing,
                (None, "step") => FormulaName::Step,
                _ => return Err(self.unknown(&name.text, written.span)),
            });
        }
        Ok(ColumnFormula::Expression(ColumnExpression(expression, names)))
    }

    /// How a column whose name is no word is written in an expression, if a text has the name.
    fn odd_name(&self, text: &str) -> Option<String> {
        let mut odd = self.names.iter().zip(&self.words).filter(|(name, word)| name != word);
        let (name, word) =
            odd.find(|(name, _)| !name.is_empty() && text.contains(name.as_str()))?;
        Some(format!("the column `{}` is `{}` in an expression", shortened(name), shortened(word)))
    }

    fn unknown(&self, name: &str, span: Span) -> Fault {
        let fault = Fault::at(span, format!("the data have no column `{}`", shortened(name)));
        let words = self.names.iter().chain(&self.words).map(String::as_str);
        match nearest(name, words) {
            Some(near) => fault.help(format!("did you mean `{near}`?")),
            None => fault.help(format!("their columns are {}", shortened(&self.names.join(", ")))),
        }
    }

    /// The fault of a file whose first line is a row of data; `None` if most of its fields are no numbers.
    pub fn lacks_names(&self) -> Option<DataFaults> {
        let numbers = self.names.iter().filter(|name| name.parse::<f64>().is_ok()).count();
        (2 * numbers > self.names.len()).then(|| {
            let mut faults = DataFaults::default();
            faults.add("line 1: numbers, where the names of columns are expected: add a first line with the names");
            faults
        })
    }

    /// What to write in the place of this column of probabilities, if all have values that percentages have and none lies
    /// between 0 and 1; empty otherwise.
    pub fn percentages(&self, written: &str, mut values: impl Iterator<Item = f64>) -> String {
        if !values.all(|p| p.is_nan() || p == 0.0 || (1.0..=100.0).contains(&p)) {
            return String::new();
        }
        let own = self.column(written).map(|index| self.words[index].clone());
        format!(
            "; for percentages, write probability = \"{} / 100\"",
            own.unwrap_or(format!("({written})"))
        )
    }

    pub fn names(&self) -> &[String] {
        &self.names
    }

    pub fn name(&self, index: usize) -> &str {
        &self.names[index]
    }
}

impl ColumnFormula {
    /// The columns that it has.
    pub fn columns(&self) -> Vec<usize> {
        match self {
            ColumnFormula::Column(index) => vec![*index],
            ColumnFormula::Expression(ColumnExpression(_, names)) => {
                let column = |name: &FormulaName| match name {
                    FormulaName::Column(index) => Some(*index),
                    FormulaName::Missing | FormulaName::Step => None,
                };
                names.iter().filter_map(column).collect()
            }
        }
    }

    /// The value in a row, at a decision of this number.
    pub fn value(&self, table: &RecordedRows, row: usize, step: usize) -> f64 {
        match self {
            ColumnFormula::Column(index) => table.number(*index, row),
            ColumnFormula::Expression(ColumnExpression(expression, names)) => {
                let name = |index: usize| match names[index] {
                    FormulaName::Column(column) => Some(table.number(column, row)),
                    FormulaName::Missing => Some(f64::NAN),
                    FormulaName::Step => Some(step as f64),
                };
                let value = numbers::constant(expression, &name).unwrap_or(f64::NAN);
                if value.is_finite() { value } else { f64::NAN }
            }
        }
    }
}

/// The rows of a file.
#[derive(Debug)]
pub(in crate::env) struct RecordedRows {
    pub header: Header,
    /// By column of the file; empty where the column is not used, else \[rows\], NaN for a missing number.
    numbers: Vec<Vec<f64>>,
    /// The people in the order of their first rows.
    pub people: Vec<String>,
    /// \[rows\]: the index of the person.
    pub person: Vec<u32>,
    /// \[rows\]: the line in the file.
    pub lines: Vec<u32>,
}

impl RecordedRows {
    pub(in crate::env) fn number(&self, column: usize, row: usize) -> f64 {
        self.numbers[column][row]
    }

    /// A note for each column whose only negative number is a usual code for a missing one, which these formulas read as a
    /// number in two rows or more.
    pub(in crate::env) fn codes(
        &self,
        formulas: &[&ColumnFormula],
        is_used: impl Fn(usize) -> bool,
    ) -> Vec<String> {
        let mut columns: Vec<usize> = formulas.iter().flat_map(|one| one.columns()).collect();
        columns.sort_unstable();
        columns.dedup();
        let note = |column: &usize| {
            let numbers = &self.numbers[*column];
            let code = *numbers.iter().find(|number| **number < 0.0)?;
            let is_other = |number: &f64| *number < 0.0 && *number != code;
            if !CODES.contains(&code) || numbers.iter().any(is_other) {
                return None;
            }
            let reads = |formula: &&&ColumnFormula, row| {
                formula.columns().contains(column) && !formula.value(self, row, 0).is_nan()
            };
            let mut rows = (0..numbers.len()).filter(|row| {
                numbers[*row] == code
                    && is_used(*row)
                    && formulas.iter().any(|one| reads(&one, *row))
            });
            let line = self.lines[rows.next()?];
            let count = rows.count() + 1;
            let (name, word) = (shortened(self.header.name(*column)), &self.header.words[*column]);
            (count > 1).then(|| {
                format!(
                    "`{name}` is {code} in {count} rows, the first in line {line}, which looks like a code for a missing \
                     number: write \"if({word} == {code}, missing, {word})\""
                )
            })
        };
        columns.iter().filter_map(note).collect()
    }
}

/// The header of a file.
///
/// **Errors**: it has none, two columns of one name, or fields that other signs separate.
pub(in crate::env) fn header(
    reader: &mut csv::Reader<LineEnds<impl Read>>,
) -> Result<Header, DataFaults> {
    let mut faults = DataFaults::default();
    let names = match reader.headers() {
        Ok(names) => names.clone(),
        Err(error) => {
            faults.add(broken(&error, &csv::StringRecord::new()));
            return Err(faults);
        }
    };
    let mut names: csv::StringRecord = names;
    if let Some(plain) = names.get(0).and_then(|name| name.strip_prefix('\u{feff}')) {
        let plain = plain.trim_matches('"').to_owned();
        names = [plain].into_iter().chain(names.iter().skip(1).map(str::to_owned)).collect();
    }
    if names.is_empty() || names.len() == 1 && names[0].is_empty() {
        faults.add("line 1: expected the names of columns, and the file is empty");
    }
    if let Some(open) = reader.get_ref().open_quote(&names, 1) {
        return Err(open);
    }
    // Names may have commas, and a name between commas may have a semicolon.
    let separates = |sign: char| {
        names.iter().flat_map(str::chars).filter(|c| *c == sign).count() >= names.len().max(1)
    };
    let signs = [(';', "semicolons"), ('\t', "tabs")];
    if let Some((_, sign)) = signs.into_iter().find(|(sign, _)| separates(*sign)) {
        faults.add(format!(
            "line 1: its fields are separated by {sign}: save it with commas between fields and points in numbers"
        ));
    }
    for (index, name) in names.iter().enumerate() {
        if !name.is_empty() && names.iter().take(index).any(|known| known == name) {
            faults.add(format!("line 1: column `{}` is listed twice", shortened(name)));
        }
    }
    let header = Header::new(&names);
    // A name that is listed twice is a number of a row, if there are no names.
    if faults.is_empty() { Ok(header) } else { Err(header.lacks_names().unwrap_or(faults)) }
}

/// A reader of a CSV file.
pub(in crate::env) fn reader<R: Read>(from: R) -> csv::Reader<LineEnds<R>> {
    let from = BufReader::with_capacity(1 << 16, from);
    let from = LineEnds { from, held: false, has_odd_quotes: false, is_over: false };
    csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(from)
}

/// A text whose lines end with line feeds alone: after a carriage return as well, the reader of CSV counts a line too few.
pub(in crate::env) struct LineEnds<R> {
    from: BufReader<R>,
    /// Whether the last byte was a carriage return.
    held: bool,
    /// Whether the number of quotes so far is odd.
    has_odd_quotes: bool,
    /// Whether all was read.
    is_over: bool,
}

impl<R> LineEnds<R> {
    /// The fault of a record whose last field goes on to the end of the file, because nothing closes its quote.
    fn open_quote(&self, last: &csv::StringRecord, line: u64) -> Option<DataFaults> {
        let is_open =
            self.is_over && self.has_odd_quotes && last.iter().next_back().is_some_and(is_long);
        is_open.then(|| {
            let mut faults = DataFaults::default();
            faults.add(format!(
                "line {line}: a quote opens here, and none closes it: remove it or close it"
            ));
            faults
        })
    }
}

impl<R: Read> Read for LineEnds<R> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let mut written = 0;
        while written == 0 && !out.is_empty() {
            let bytes = self.from.fill_buf()?;
            if bytes.is_empty() {
                if std::mem::take(&mut self.held) {
                    (out[0], written) = (b'\r', 1);
                }
                self.is_over = true;
                return Ok(written);
            }
            let mut used = 0;
            while used < bytes.len() && written < out.len() {
                let byte = bytes[used];
                if std::mem::take(&mut self.held) && byte != b'\n' {
                    out[written] = b'\r';
                    written += 1;
                    continue;
                }
                used += 1;
                self.held = byte == b'\r';
                if !self.held {
                    out[written] = byte;
                    written += 1;
                }
            }
            self.from.consume(used);
        }
        let quotes = out[..written].iter().filter(|byte| **byte == b'"').count();
        self.has_odd_quotes ^= quotes % 2 == 1;
        Ok(written)
    }
}

/// What is wrong with a record; of a row with another number of fields, the fields are known.
fn broken(error: &csv::Error, fields: &csv::StringRecord) -> String {
    let line = error.position().map_or(1, csv::Position::line);
    match error.kind() {
        csv::ErrorKind::UnequalLengths { expected_len, len, .. } => {
            let quote = if fields.iter().any(is_long) { LATE_QUOTE } else { "" };
            format!("line {line}: {len} fields, and line 1 has {expected_len}{quote}")
        }
        csv::ErrorKind::Utf8 { .. } => {
            format!("line {line}: not in UTF-8: save the file as UTF-8")
        }
        _ => format!("line {line}: {error}"),
    }
}

/// Reads the rows: the column of people, and these columns as numbers. Without a column of people, all rows are of one.
///
/// **Errors**: every fault of the rows.
pub(in crate::env) fn rows(
    reader: &mut csv::Reader<LineEnds<impl Read>>,
    header: Header,
    person: impl Into<Option<usize>>,
    used: &[usize],
    stop: &dyn Fn() -> bool,
) -> Result<RecordedRows, DataFaults> {
    let person = person.into();
    let mut faults = DataFaults::default();
    let mut used = used.to_vec();
    used.sort_unstable();
    used.dedup();
    let mut table = RecordedRows {
        numbers: vec![Vec::new(); header.names.len()],
        header,
        people: Vec::new(),
        person: Vec::new(),
        lines: Vec::new(),
    };
    let mut known: HashMap<String, u32> = HashMap::new();
    let mut record = csv::StringRecord::new();
    let most = MOST_NUMBERS / used.len().max(1);
    loop {
        let read = reader.read_record(&mut record);
        let line = record.position().map_or(0, csv::Position::line);
        if let Some(open) = reader.get_ref().open_quote(&record, line) {
            return Err(open);
        }
        match read {
            Ok(true) => {}
            Ok(false) => break,
            Err(error) => {
                let is_row = matches!(error.kind(), csv::ErrorKind::UnequalLengths { .. });
                faults.add(broken(&error, &record));
                if is_row {
                    continue;
                }
                break;
            }
        }
        if table.person.len() == most {
            faults.add(format!("more than {most} rows: fit a part of the people"));
            break;
        }
        if table.person.len().is_multiple_of(65_536) && stop() {
            break;
        }
        let name = person.map_or("", |person| &record[person]);
        if let Some(person) = person.filter(|_| name.is_empty()) {
            let column = table.header.name(person);
            faults.add(format!("line {line}: column `{column}` is empty, and names the person"));
        }
        if is_long(name) {
            faults.add(format!("line {line}: the name of the person has a line break{LATE_QUOTE}"));
        }
        let next = known.len() as u32;
        let index = match known.get(name) {
            Some(index) => *index,
            None => {
                known.insert(name.to_owned(), next);
                table.people.push(name.to_owned());
                next
            }
        };
        table.person.push(index);
        table.lines.push(u32::try_from(line).unwrap_or(u32::MAX));
        for column in &used {
            let written = &record[*column];
            let number = number(written).unwrap_or_else(|why| {
                let name = shortened(table.header.name(*column));
                let shown = shortened(written);
                faults.add(format!(
                    "line {line}: column `{name}` has `{shown}`, expected a number{why}"
                ));
                f64::NAN
            });
            table.numbers[*column].push(number);
        }
    }
    if table.person.is_empty() && faults.is_empty() {
        faults.add("expected at least one row of data");
    }
    if faults.is_empty() { Ok(table) } else { Err(faults) }
}

/// What is said of a field with a line break.
const LATE_QUOTE: &str = "; a quote that opens in this line closes in a later one";

fn is_long(field: &str) -> bool {
    field.contains('\n')
}

/// The number of a field; NaN where it is missing.
///
/// **Errors**: what to do about a text.
fn number(written: &str) -> Result<f64, &'static str> {
    if let Some(number) = written.parse().ok().filter(|number: &f64| number.is_finite()) {
        return Ok(number + 0.0);
    }
    if MISSING.contains(&written) {
        return Ok(f64::NAN);
    }
    let is_like = |text: &str| text.parse::<f64>().is_ok();
    Err(match written {
        "TRUE" | "True" | "true" | "T" => return Ok(1.0),
        "FALSE" | "False" | "false" | "F" => return Ok(0.0),
        text if is_long(text) => LATE_QUOTE,
        text if text.contains(',') && is_like(&text.replacen(',', ".", 1)) => {
            " with a point, not a comma"
        }
        text if ["yes", "no", "y", "n"].contains(&&*text.to_lowercase()) => {
            "; write 1 for yes and 0 for no in the file"
        }
        text if text.strip_suffix('%').is_some_and(|number| is_like(number.trim())) => {
            " without a sign for percent; 60 % as a probability is 0.6"
        }
        text if text.contains(['-', '/', ':', '.'])
            && text.chars().filter(char::is_ascii_digit).count() >= 4 =>
        {
            "; a date or time must become a number, such as the day of the study"
        }
        _ => "; leave the field empty where it is missing, and write a number for each word",
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_dates_commas_and_missing_fields_are_told_apart() {
        assert_eq!(number("-1.5e3"), Ok(-1500.0));
        assert!(number("NA").unwrap().is_nan() && number("").unwrap().is_nan());
        assert_eq!(number("TRUE"), Ok(1.0));
        assert!(number("3,5").unwrap_err().contains("point"));
        assert!(number("2024-05-01").unwrap_err().contains("date"));
        assert!(number("often").unwrap_err().contains("empty"));
        assert!(number("inf").is_err());
    }

    #[test]
    fn a_header_says_what_separates_its_fields() {
        let said = |text: &str| {
            header(&mut reader(text.as_bytes())).err().map(|faults| faults.text("t.csv"))
        };
        // A name with a comma, as an export with decimal commas has it.
        let both = said("id;day;\"minutes, before\";sent\n1;0;2,5;1\n").unwrap();
        assert!(both.contains("line 1: its fields are separated by semicolons"), "{both}");
        assert!(said("id\tday\tminutes, sent\n").unwrap().contains("separated by tabs"));
        assert_eq!(said("id,\"a;b\",c\n"), None);
    }
}
