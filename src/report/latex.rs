//! Tables as LaTeX that fit the page of an article.

use unicode_width::UnicodeWidthStr;

use super::data_table::{DataTable, TableEntry};
use super::escape;
use super::letters::{Tex, tex, undrawn};

/// Maximum number of rows of a table on a single page; longer tables break across pages.
const ROWS_OF_A_PAGE: usize = 40;

/// Maximum number of rows of a LaTeX table; longer tables are data.
const MOST_ROWS: usize = 300;

/// The layouts of a long table, of which the first that fits is used: most letters per line, font
/// size, and whether the table is in landscape. An A4 page has a text width of 16 cm, or 24.7 cm in
/// landscape. A letter of Computer Modern is 3.9 pt wide in the larger size and 3.6 pt in the smaller.
const SETTINGS: [(f64, &str, bool); 4] = [
    (105.0, "footnotesize", false),
    (118.0, "scriptsize", false),
    (170.0, "footnotesize", true),
    (f64::INFINITY, "scriptsize", true),
];

/// Width of the gap between two columns, in letters.
const GAP: f64 = 1.6;

/// Whether a table is short enough for LaTeX. The CSV file has the numbers of every table.
pub fn is_printed(table: &DataTable) -> bool {
    table.rows.len() <= MOST_ROWS
}

/// The table as LaTeX.
pub fn latex(table: &DataTable) -> String {
    if table.rows.len() > ROWS_OF_A_PAGE { over_pages(table) } else { on_a_page(table) }
}

/// A float, scaled down if it is wider than the text.
fn on_a_page(table: &DataTable) -> String {
    let notes = table
        .reasons()
        .map(|reasons| escape::latex(&reasons))
        .map_or_else(String::new, |reasons| format!("  \\par\\footnotesize --: {reasons}\n"));
    format!(
        "{needs}\\begin{{table}}\n  \\centering\n  \
         \\caption{{{caption}}}\n  \\footnotesize\n  \
         \\resizebox{{\\ifdim\\width>\\linewidth\\linewidth\\else\\width\\fi}}{{!}}{{%\n  \
         \\begin{{tabular}}{{{sides}}}\n    \\toprule\n    {headings} \\\\\n    \\midrule\n{rows}\
         \x20   \\bottomrule\n  \\end{{tabular}}}}\n{notes}\\end{{table}}\n",
        needs = needs(table, "booktabs,graphicx"),
        caption = escape::latex(&table.caption),
        sides = sides(table),
        headings = headings(table),
        rows = rows(table),
    )
}

/// A table that breaks between rows and repeats its headings. If it is too wide for the text in
/// small letters, it is set in landscape.
fn over_pages(table: &DataTable) -> String {
    let (size, is_across) = setting(table);
    let (package, begin, end) = match is_across {
        true => (",pdflscape", "\\begin{landscape}\n", "\\end{landscape}\n"),
        false => ("", "", ""),
    };
    let columns = table.shown_columns().count();
    let notes = table
        .reasons()
        .map(|reasons| escape::latex(&reasons))
        .map_or_else(String::new, |reasons| format!("\\par\\noindent --: {reasons}\n"));
    format!(
        "{needs}{begin}\\begingroup\n\\{size}\n\
         \\setlength{{\\tabcolsep}}{{2pt}}\n\\begin{{longtable}}{{{sides}}}\n  \
         \\caption{{{caption}}} \\\\\n  \\toprule\n  {headings} \\\\\n  \\midrule\n  \
         \\endfirsthead\n  \\toprule\n  {headings} \\\\\n  \\midrule\n  \\endhead\n  \\midrule\n  \
         \\multicolumn{{{columns}}}{{r}}{{continued}} \\\\\n  \\endfoot\n  \\bottomrule\n  \
         \\endlastfoot\n{rows}\\end{{longtable}}\n{notes}\\endgroup\n{end}",
        needs = needs(table, &format!("booktabs,longtable{package}")),
        sides = sides(table),
        caption = escape::latex(&table.caption),
        headings = headings(table),
        rows = rows(table),
    )
}

/// Comments on what a document needs for the table: packages, encodings, and another program for letters that pdflatex
/// refuses.
fn needs(table: &DataTable, packages: &str) -> String {
    let reasons = table.reasons().unwrap_or_default();
    let shown = table.shown_columns().flat_map(|index| {
        let entries = table.rows.iter().map(move |row| row[index].shown());
        entries.chain([table.columns[index].heading.as_str()])
    });
    let texts: Vec<&str> = shown.chain([table.caption.as_str(), reasons.as_str()]).collect();
    let letters = || texts.iter().flat_map(|text| text.chars());
    // The last encoding is that of the document's text.
    let encodings: [&'static str; 3] = ["T5", "T2A", "T1"];
    let has =
        |encoding: &&'static str| letters().any(|letter| tex(letter) == Tex::Encoded(encoding));
    let used: Vec<&str> = encodings.into_iter().filter(has).collect();
    let fonts = match used.as_slice() {
        [] => String::new(),
        [.., "T1"] => format!(" and \\usepackage[{}]{{fontenc}}", used.join(",")),
        _ => format!(" and \\usepackage[{},T1]{{fontenc}}", used.join(",")),
    };
    let undrawn: String = undrawn(texts.iter().copied()).into_iter().collect();
    let programs = match undrawn.as_str() {
        "" => String::new(),
        undrawn => format!("% Needs LuaLaTeX or XeLaTeX, and a font with {undrawn}\n"),
    };
    format!("% Needs \\usepackage{{{packages}}}{fonts}.\n{programs}")
}

/// The font size of a long table, and whether it is set in landscape.
fn setting(table: &DataTable) -> (&'static str, bool) {
    let letters: f64 = table
        .shown_columns()
        .map(|index| {
            let entries = table.rows.iter().map(|row| row[index].shown().width());
            let heading = table.columns[index].heading.width();
            entries.fold(heading, usize::max) as f64 + GAP
        })
        .sum();
    let fitting = SETTINGS.into_iter().find(|(most, ..)| letters <= *most);
    let (_, size, is_across) = fitting.unwrap_or(SETTINGS[SETTINGS.len() - 1]);
    (size, is_across)
}

fn sides(table: &DataTable) -> String {
    table.shown_columns().map(|index| if table.is_numeric(index) { 'r' } else { 'l' }).collect()
}

fn headings(table: &DataTable) -> String {
    let headings = table.shown_columns().map(|index| escape::latex(&table.columns[index].heading));
    headings.collect::<Vec<_>>().join(" & ")
}

fn rows(table: &DataTable) -> String {
    let indices: Vec<usize> = table.shown_columns().collect();
    let row = |row: &Vec<TableEntry>| {
        let entries = indices.iter().map(|index| escape::latex(row[*index].shown()));
        format!("    {} \\\\\n", entries.collect::<Vec<_>>().join(" & "))
    };
    table.rows.iter().map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(rows: usize) -> DataTable {
        let mut table = DataTable::new("A & B", &[("arm", "Arm"), ("mean", "Mean")]);
        table.rows = vec![vec![TableEntry::text("=x|y"), TableEntry::number(-1.25, 1)]; rows];
        table
    }

    #[test]
    fn a_short_table_is_a_float_no_wider_than_the_text() {
        let mut table = table(39);
        table
            .rows
            .push(vec![TableEntry::text("z"), TableEntry::Missing("no seed completed".to_owned())]);
        let written = latex(&table);
        assert!(written.starts_with("% Needs \\usepackage{booktabs,graphicx}.\n"));
        assert!(written.contains("\\caption{A \\& B}"));
        assert!(written.contains("=x|y & $-$1.2 \\\\\n"));
        assert!(written.contains("\\ifdim\\width>\\linewidth"));
        assert!(written.contains("\\footnotesize --: no seed completed\n\\end{table}"));
    }

    #[test]
    fn a_table_says_what_its_letters_need() {
        let first = |text: &str| {
            let mut table = table(1);
            table.rows.push(vec![TableEntry::text(text), TableEntry::number(1.0, 1)]);
            let written = latex(&table);
            written.lines().take_while(|line| line.starts_with('%')).collect::<Vec<_>>().join("|")
        };
        let packages = "% Needs \\usepackage{booktabs,graphicx}";
        assert_eq!(first("λ → Señal"), format!("{packages}."));
        assert_eq!(first("łąka"), format!("{packages} and \\usepackage[T1]{{fontenc}}."));
        let both = format!("{packages} and \\usepackage[T5,T2A,T1]{{fontenc}}.");
        assert_eq!(first("агент ế"), both);
        let other = "% Needs LuaLaTeX or XeLaTeX, and a font with 日本";
        assert_eq!(first("日本"), format!("{packages}.|{other}"));
    }

    #[test]
    fn a_long_table_continues_over_pages_and_data_are_not_printed() {
        let written = latex(&table(41));
        assert!(written.starts_with("% Needs \\usepackage{booktabs,longtable}.\n"));
        assert!(written.contains("\\endhead") && !written.contains("\\begin{table}"));
        assert_eq!(written.matches("=x|y").count(), 41);
        assert!(is_printed(&table(300)) && !is_printed(&table(301)));
    }

    #[test]
    fn a_wider_long_table_has_smaller_letters_or_lies_across_the_page() {
        let set_table = |letters: usize| {
            let mut table = table(41);
            table.rows[7][0] = TableEntry::text("m".repeat(letters));
            setting(&table)
        };
        assert_eq!(
            [set_table(10), set_table(105)],
            [("footnotesize", false), ("scriptsize", false)]
        );
        assert_eq!(
            [set_table(130), set_table(180)],
            [("footnotesize", true), ("scriptsize", true)]
        );
        let mut wide = table(41);
        wide.rows[7][0] = TableEntry::text("m".repeat(130));
        assert!(latex(&wide).starts_with("% Needs \\usepackage{booktabs,longtable,pdflscape}.\n"));
        assert!(latex(&wide).ends_with("\\endgroup\n\\end{landscape}\n"));
    }
}
