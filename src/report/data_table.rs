//! A table of numbers and words, and its forms: CSV, Markdown, LaTeX.

use super::escape;
use crate::job::distinct;
use crate::key::shortened;

/// A table.
#[derive(Clone, Debug, PartialEq)]
pub struct DataTable {
    /// The caption.
    pub caption: String,
    /// Its columns.
    pub columns: Vec<TableColumn>,
    /// Its rows, with one entry per column.
    pub rows: Vec<Vec<TableEntry>>,
}

/// A column.
#[derive(Clone, Debug, PartialEq)]
pub struct TableColumn {
    /// Its name in files, such as `mean_return`.
    pub name: String,
    /// Its heading for readers.
    pub heading: String,
    /// Where it is shown.
    pub reach: Reach,
}

/// Where a column is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reach {
    /// Everywhere.
    Everywhere,
    /// Only in CSV.
    Data,
}

/// Reason for a missing published number. A column with only this reason is hidden from readers.
const NOT_PUBLISHED: &str = "not published";

/// An entry of a table.
#[derive(Clone, Debug, PartialEq)]
pub enum TableEntry {
    /// Text, in files and for readers.
    Text {
        /// The text with the names of keys.
        exact: String,
        /// The displayed form.
        shown: String,
    },
    /// A number with its displayed form.
    Number {
        /// The number.
        value: f64,
        /// The displayed form.
        shown: String,
    },
    /// The reason for a missing number.
    Missing(String),
}

impl TableEntry {
    /// Text, for readers with short digests of files.
    pub fn text(text: impl Into<String>) -> TableEntry {
        let exact = text.into();
        TableEntry::Text { shown: shortened(&exact), exact }
    }

    /// A name: in files the key, for readers the label.
    pub fn name(key: impl Into<String>, label: impl Into<String>) -> TableEntry {
        TableEntry::Text { exact: key.into(), shown: label.into() }
    }

    /// A number shown with `decimals` decimals.
    pub fn number(value: f64, decimals: usize) -> TableEntry {
        TableEntry::Number { value, shown: shown(value, decimals) }
    }

    /// The number, or the reason for its absence.
    pub fn of<E: ToString>(value: Result<f64, E>, decimals: usize) -> TableEntry {
        match value {
            Ok(value) => TableEntry::number(value, decimals),
            Err(reason) => TableEntry::Missing(reason.to_string()),
        }
    }

    /// A p value.
    pub fn p<E: ToString>(value: Result<f64, E>) -> TableEntry {
        match value {
            Ok(value) => TableEntry::Number { value, shown: p_value(value) },
            Err(reason) => TableEntry::Missing(reason.to_string()),
        }
    }

    /// The published entry, or the note that no number is published.
    pub fn published(entry: Option<TableEntry>) -> TableEntry {
        entry.unwrap_or_else(|| TableEntry::Missing(NOT_PUBLISHED.to_owned()))
    }

    /// The displayed form; a dash for a missing number.
    pub fn shown(&self) -> &str {
        match self {
            TableEntry::Text { shown, .. } | TableEntry::Number { shown, .. } => shown,
            TableEntry::Missing(_) => "–",
        }
    }

    /// The form for programs, with every digit; empty for a missing number.
    fn exact(&self) -> String {
        match self {
            TableEntry::Text { exact, .. } => exact.clone(),
            // Adding 0 removes the sign of −0.
            TableEntry::Number { value, .. } => (value + 0.0).to_string(),
            TableEntry::Missing(_) => String::new(),
        }
    }
}

/// The text of a number with `decimals` decimals. Zero has no sign.
pub fn rounded(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(digits) if digits.chars().all(|c| matches!(c, '0' | '.')) => digits.to_owned(),
        Some(_) | None => text,
    }
}

/// The text of a number with `decimals` decimals and a true minus sign. A number that would read 0 has two
/// significant digits, and very small and very large numbers have an exponent.
pub fn shown(value: f64, decimals: usize) -> String {
    /// Beyond this size, a number has no digit after its point.
    const LARGE: f64 = 1e15;
    const SMALL: f64 = 1e-4;
    let size = value.abs();
    let text = format!("{value:.decimals$}");
    let reads_zero = text.chars().all(|c| matches!(c, '-' | '0' | '.'));
    signed(&match size {
        size if size.is_nan() => "not a number".to_owned(),
        size if size >= LARGE && size.is_finite() => exponential(value, 5),
        0.0 => text.trim_start_matches('-').to_owned(),
        size if reads_zero && size < SMALL => exponential(value, 1),
        size if reads_zero => {
            let decimals = (1.0 - size.log10().floor()) as usize;
            format!("{value:.decimals$}").trim_end_matches('0').to_owned()
        }
        _ => text,
    })
}

/// The ends of an interval with at least `decimals` decimals, and more if the ends would read the same.
pub fn shown_ends(low: f64, high: f64, decimals: usize) -> [String; 2] {
    /// More digits than this are rounding errors.
    const DIGITS: f64 = 12.0;
    let show_ends = |decimals| [low, high].map(|end| shown(end, decimals));
    if low == high {
        return show_ends(decimals);
    }
    let size = low.abs().max(high.abs());
    let most = (DIGITS - size.log10().floor()).clamp(0.0, 300.0) as usize;
    let differ = (decimals..=most).map(show_ends).find(|[low, high]| low != high);
    differ.unwrap_or_else(|| show_ends(decimals))
}

/// The text of a number with a true minus sign before it.
pub fn signed(text: &str) -> String {
    match text.strip_prefix('-') {
        Some(digits) => format!("−{digits}"),
        None => text.to_owned(),
    }
}

/// A number with at most `digits` digits after its first, and an exponent: `1.5e6`.
pub fn exponential(number: f64, digits: usize) -> String {
    let text = format!("{number:.digits$e}");
    match text.split_once('e') {
        Some((mantissa, power)) if mantissa.contains('.') => {
            format!("{}e{power}", mantissa.trim_end_matches('0').trim_end_matches('.'))
        }
        _ => text,
    }
}

/// The displayed form of a p value.
pub fn p_value(p: f64) -> String {
    match p {
        p if p < 0.0001 => "<0.0001".to_owned(),
        p if p < 0.01 => format!("{p:.4}"),
        p => format!("{p:.3}"),
    }
}

impl DataTable {
    /// An empty table. `columns` holds names and headings; a column whose name begins with `.`
    /// appears only in CSV.
    pub fn new(caption: impl Into<String>, columns: &[(&str, &str)]) -> DataTable {
        let column = |(name, heading): &(&str, &str)| TableColumn {
            reach: if name.starts_with('.') { Reach::Data } else { Reach::Everywhere },
            name: name.trim_start_matches('.').to_owned(),
            heading: (*heading).to_owned(),
        };
        DataTable {
            caption: caption.into(),
            columns: columns.iter().map(column).collect(),
            rows: Vec::new(),
        }
    }

    /// Positions of the columns that readers see.
    pub fn shown_columns(&self) -> impl Iterator<Item = usize> {
        let columns = self.columns.iter().enumerate();
        let shown = columns.filter(|(_, column)| column.reach == Reach::Everywhere);
        shown.map(|(index, _)| index).filter(|index| !self.is_unpublished(*index))
    }

    /// Whether a column is for published numbers but has none.
    fn is_unpublished(&self, index: usize) -> bool {
        let is_missing = |entry: &TableEntry| *entry == TableEntry::published(None);
        !self.rows.is_empty() && self.rows.iter().all(|row| is_missing(&row[index]))
    }

    /// Whether a column holds numbers and no text.
    pub fn is_numeric(&self, index: usize) -> bool {
        let mut entries = self.rows.iter().map(|row| &row[index]);
        entries.clone().any(|entry| matches!(entry, TableEntry::Number { .. }))
            && entries
                .all(|entry| !matches!(entry, TableEntry::Text { shown, .. } if !shown.is_empty()))
    }

    /// The table as CSV, every digit kept.
    pub fn csv(&self) -> String {
        let names: Vec<String> =
            self.columns.iter().map(|column| escape::csv(&column.name)).collect();
        let mut out = names.join(",") + "\n";
        for row in &self.rows {
            let entries: Vec<String> =
                row.iter().map(|entry| escape::csv(&entry.exact())).collect();
            out += &(entries.join(",") + "\n");
        }
        out
    }

    /// The table as Markdown.
    pub fn markdown(&self) -> String {
        let indices: Vec<usize> = self.shown_columns().collect();
        let headings = indices.iter().map(|index| escape::markdown(&self.columns[*index].heading));
        let rules =
            indices.iter().map(|index| if self.is_numeric(*index) { "---:" } else { "---" });
        let mut out = format!("{}\n\n", escape::markdown(&self.caption));
        out += &format!("| {} |\n", headings.collect::<Vec<_>>().join(" | "));
        out += &format!("| {} |\n", rules.collect::<Vec<_>>().join(" | "));
        for row in &self.rows {
            let entries = indices.iter().map(|index| escape::markdown(row[*index].shown()));
            out += &format!("| {} |\n", entries.collect::<Vec<_>>().join(" | "));
        }
        if let Some(reasons) = self.reasons() {
            out += &format!("\n–: {}\n", escape::markdown(&reasons));
        }
        out
    }

    /// The reasons for missing numbers in displayed columns, if any.
    pub fn reasons(&self) -> Option<String> {
        let indices: Vec<usize> = self.shown_columns().collect();
        let entries = self.rows.iter().flat_map(|row| indices.iter().map(|index| &row[*index]));
        let reasons = distinct(entries.filter_map(|entry| match entry {
            TableEntry::Missing(reason) => Some(reason.as_str()),
            TableEntry::Text { .. } | TableEntry::Number { .. } => None,
        }));
        (!reasons.is_empty()).then(|| reasons.join("; "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_table_in_two_formats() {
        let mut table = DataTable::new("A & B", &[("arm", "Arm"), ("mean", "Mean"), (".n", "n")]);
        table.rows.push(vec![
            TableEntry::text("=x|y"),
            TableEntry::number(-1.25, 1),
            TableEntry::number(3.0, 0),
        ]);
        let missing = TableEntry::Missing("no seed completed".to_owned());
        table.rows.push(vec![TableEntry::text("z"), missing, TableEntry::number(0.0, 0)]);
        assert_eq!(table.csv(), "arm,mean,n\n'=x|y,-1.25,3\nz,,0\n");
        assert_eq!(
            table.markdown(),
            "A &amp; B\n\n| Arm | Mean |\n| --- | ---: |\n| =x\\|y | −1.2 |\n| z | – |\n\n–: no seed \
             completed\n"
        );
    }

    #[test]
    fn a_number_reads_0_only_if_it_is_and_ends_that_differ_read_differently() {
        let all = [0.0, -0.0, 7.46, -0.3, 0.05, 0.04, 3.2e-7, -1e-300, 1e300, f64::INFINITY];
        let texts = all.map(|value| shown(value, 0)).join(" ");
        assert_eq!(texts, "0 0 7 −0.3 0.05 0.04 3.2e-7 −1e-300 1e300 inf");
        assert_eq!([shown(0.0, 1), shown(-0.04, 1), shown(0.06, 1)], ["0.0", "−0.04", "0.1"]);
        assert_eq!([shown(12_345_678.9, 1), shown(-1e15, 1)], ["12345678.9", "−1e15"]);
        assert_eq!(shown_ends(500.0, 501.0, 0), ["500", "501"]);
        assert_eq!(shown_ends(499.999_8, 500.000_1, 1), ["499.9998", "500.0001"]);
        assert_eq!(shown_ends(-3.0, -3.0, 1), ["−3.0", "−3.0"]);
        assert_eq!(shown_ends(0.3, 0.300_000_000_000_000_04, 1), ["0.3", "0.3"]);
        assert_eq!(shown_ends(0.0, 0.0, 1), ["0.0", "0.0"]);
        assert_eq!(shown_ends(f64::NEG_INFINITY, f64::INFINITY, 1), ["−inf", "inf"]);
    }

    #[test]
    fn readers_see_no_column_of_which_nothing_was_published() {
        let mut table = DataTable::new("", &[("arm", "Arm"), ("published", "Published")]);
        table.rows.push(vec![TableEntry::text("a"), TableEntry::published(None)]);
        assert_eq!(table.shown_columns().collect::<Vec<_>>(), [0]);
        assert_eq!(table.csv(), "arm,published\na,\n");
        table.rows.push(vec![
            TableEntry::text("b"),
            TableEntry::published(Some(TableEntry::number(1.0, 0))),
        ]);
        assert_eq!(table.shown_columns().collect::<Vec<_>>(), [0, 1]);
    }
}
