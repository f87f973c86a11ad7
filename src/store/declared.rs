//! The columns of queries as SQL declares them: types, and names that differ.
//!
//! SQLite types every value, not every column, and its views declare no types for expressions. The types of
//! the public views are those of `docs/store.md`.

use std::collections::{HashMap, HashSet};

use rusqlite::{Connection, Result};

use super::export::columns;
use super::read::Reader;
use super::sandbox::add_functions;

/// The declared type of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColumnType {
    /// Whole numbers.
    Integer,
    /// Numbers.
    Real,
    /// Text.
    Text,
    /// Values of several types, like the values of parameters.
    Several,
    /// An expression, whose type SQL does not declare.
    Undeclared,
}

/// The declaration of columns with values of several types.
const SEVERAL: &str = "ANY";

impl ColumnType {
    /// The type that a declaration has by the rules of SQLite.
    fn of(declaration: &str) -> ColumnType {
        let declaration = declaration.to_ascii_uppercase();
        let has = |words: &[&str]| words.iter().any(|word| declaration.contains(word));
        match () {
            () if declaration == SEVERAL => ColumnType::Several,
            () if has(&["INT"]) => ColumnType::Integer,
            () if has(&["CHAR", "CLOB", "TEXT"]) => ColumnType::Text,
            () if has(&["REAL", "FLOA", "DOUB"]) => ColumnType::Real,
            () => ColumnType::Undeclared,
        }
    }
}

impl Reader {
    /// The declared types of the columns of a query that [`Reader::query`] answers, in order.
    pub fn column_types(&self, sql: &str, count: usize) -> Vec<ColumnType> {
        // A query that cannot be declared as a view, like EXPLAIN, declares no types.
        let mut types = self.declared(sql).unwrap_or_default();
        types.resize(count, ColumnType::Undeclared);
        types
    }

    /// Declares the query as a view of empty tables that have the names and types of the store's tables and
    /// views, because views that are tables declare types for all their columns.
    fn declared(&self, sql: &str) -> Result<Vec<ColumnType>> {
        let shape = Connection::open_in_memory()?;
        add_functions(&shape)?;
        let mut schema = self.connection.prepare(
            "SELECT name, iif(type = 'table', sql, NULL) FROM sqlite_schema
             WHERE type IN ('table', 'view') AND substr(name, 1, 7) <> 'sqlite_'",
        )?;
        let mut rows = schema.query([])?;
        while let Some(row) = rows.next()? {
            match row.get::<_, Option<String>>(1)? {
                Some(table) => shape.execute_batch(&table)?,
                None => shape.execute_batch(&self.view_as_table(&row.get::<_, String>(0)?)?)?,
            }
        }
        const ANSWER: &str = "\"the answer to a query\"";
        shape.execute_batch(&format!("CREATE TEMP VIEW {ANSWER} AS {sql}"))?;
        let mut answer = shape.prepare(&format!("PRAGMA temp.table_info({ANSWER})"))?;
        let types = answer.query_map([], |row| Ok(ColumnType::of(row.get_ref(2)?.as_str()?)))?;
        types.collect()
    }

    /// The SQL of a table with the columns of a view.
    fn view_as_table(&self, view: &str) -> Result<String> {
        let documented: HashMap<&str, &str> = columns()
            .filter(|column| column.view == view)
            .map(|column| (column.name, column.kind))
            .collect();
        let quoted = |name: &str| format!("\"{}\"", name.replace('"', "\"\""));
        let mut info = self.connection.prepare(&format!("PRAGMA table_info({})", quoted(view)))?;
        let columns = info.query_map([], |row| {
            let (name, of_sqlite): (String, String) = (row.get(1)?, row.get(2)?);
            let kind = match documented.get(name.as_str()) {
                Some(kind @ (&"integer" | &"real" | &"text")) => kind,
                Some(_) => SEVERAL,
                None => &of_sqlite,
            };
            Ok(format!("{} {kind}", quoted(&name)))
        })?;
        let columns: Vec<String> = columns.collect::<Result<_>>()?;
        Ok(format!("CREATE TABLE {} ({})", quoted(view), columns.join(", ")))
    }
}

/// The names of a query's columns, in which a name that occurs again gets a number: `value`, `value_2`. As in
/// SQL, upper and lower case are the same.
pub(super) fn distinct(names: &[&str]) -> Vec<String> {
    let mut taken: HashSet<String> = names.iter().map(|name| name.to_ascii_lowercase()).collect();
    let mut counts: HashMap<String, u32> = HashMap::new();
    let numbered = |name: &&str| {
        let lower = name.to_ascii_lowercase();
        let count = counts.entry(lower.clone()).or_insert(0);
        *count += 1;
        if *count == 1 {
            return (*name).to_owned();
        }
        while !taken.insert(format!("{lower}_{count}")) {
            *count += 1;
        }
        format!("{name}_{count}")
    };
    names.iter().map(numbered).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::{Store, VIEWS};

    #[test]
    fn repeated_names_are_numbered_and_hit_no_other_name() {
        assert_eq!(distinct(&["a", "b"]), ["a", "b"]);
        assert_eq!(distinct(&["a", "a", "b", "a"]), ["a", "a_2", "b", "a_3"]);
        assert_eq!(distinct(&["a", "a", "a_2"]), ["a", "a_3", "a_2"]);
        assert_eq!(distinct(&["value", "Value", "VALUE_2"]), ["value", "Value_3", "VALUE_2"]);
        assert_eq!(distinct(&["", ""]), ["", "_2"]);
    }

    #[test]
    fn every_column_of_every_view_has_its_documented_type() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("jitai.sqlite");
        drop(Store::open(&path).unwrap());
        let reader = Reader::open(&path).unwrap();
        for view in VIEWS {
            let documented = columns().filter(|column| column.view == view);
            let documented: Vec<ColumnType> = documented
                .map(|column| match column.kind {
                    "integer" => ColumnType::Integer,
                    "real" => ColumnType::Real,
                    "text" => ColumnType::Text,
                    _ => ColumnType::Several,
                })
                .collect();
            let sql = format!("SELECT * FROM {view}");
            assert_eq!(reader.column_types(&sql, documented.len()), documented, "{view}");
        }
    }

    #[test]
    fn a_query_has_the_types_of_the_columns_that_it_selects() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("jitai.sqlite");
        drop(Store::open(&path).unwrap());
        let reader = Reader::open(&path).unwrap();
        use ColumnType::{Integer, Real, Several, Text, Undeclared};
        for (sql, expected) in [
            (
                "SELECT sigma, seed AS s, status, max(value) FROM run_summary JOIN metric USING (job_key);",
                &[Real, Integer, Text, Undeclared][..],
            ),
            (
                "WITH m AS (SELECT value AS v FROM metric) SELECT v, v FROM m -- twice",
                &[Real, Real],
            ),
            ("SELECT value FROM parameter", &[Several]),
            ("SELECT (SELECT step FROM decision), CAST('1' AS REAL)", &[Integer, Real]),
            ("SELECT length FROM test_episode", &[Integer]),
            ("EXPLAIN SELECT 1", &[Undeclared]),
            ("PRAGMA table_info(metric)", &[Undeclared]),
        ] {
            assert_eq!(reader.column_types(sql, expected.len()), expected, "{sql}");
        }
    }
}
