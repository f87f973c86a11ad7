//! User queries: single statements that only read the store.

use std::ops::ControlFlow;

use rusqlite::types::{ToSqlOutput, ValueRef};
use rusqlite::{Error, ErrorCode, InterruptHandle, Row, Statement};

use super::declared::distinct;
use super::error::is_damage;
use super::export::VIEWS;
use super::read::Reader;
use crate::job::counted;

/// Why a query failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum QueryError {
    /// The text contains no statement.
    #[error("the query is empty; try `SELECT * FROM run_summary`")]
    Empty,
    /// The text contains several statements.
    #[error("expected one statement, found several; run them one at a time")]
    Several,
    /// The statement does more than read the store.
    #[error(
        "a query may only read this store: SELECT, WITH, VALUES, EXPLAIN and PRAGMA table_info"
    )]
    NotAllowed,
    /// No table or view has the name.
    #[error("no such table: {name}; the views are {}", VIEWS.join(", "))]
    NoSuchTable {
        /// The name.
        name: String,
    },
    /// The view is newer than the store.
    #[error("the store is of an earlier version, without the view {view}; `jitai run` adds it")]
    LaterView {
        /// The view.
        view: String,
    },
    /// An error in the SQL at a known place.
    #[error("{message} at line {line}, column {column}\n  {text}\n  {:>column$}{help}", "^")]
    Sql {
        /// The message of SQLite.
        message: String,
        /// The line of the error, from 1.
        line: usize,
        /// The column of the error, in characters from 1.
        column: usize,
        /// The text of the line.
        text: String,
        /// Existing names to use instead, if known; each line follows a line break.
        help: String,
    },
    /// The values do not fit the parameters of the SQL.
    #[error("{0}")]
    Parameters(String),
    /// [`Interrupter::interrupt`] was called.
    #[error("the query was interrupted")]
    Interrupted,
    /// A value of the result, or the memory needed to compute it, is too large.
    #[error("the query exceeds the memory limit of queries; select fewer rows or columns")]
    TooLarge,
    /// The content of the file is damaged.
    #[error("the store is damaged: {reason}; `jitai doctor` reports which runs are intact")]
    Damaged {
        /// The damage.
        reason: String,
    },
    /// SQLite failed in another way.
    #[error("the query failed: {0}")]
    Sqlite(#[source] rusqlite::Error),
}

/// A value of a result.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SqlValue<'a> {
    /// No value.
    Null,
    /// A whole number.
    Integer(i64),
    /// A number with a fraction.
    Real(f64),
    /// Text.
    Text(&'a str),
    /// Bytes, including text that is not UTF-8.
    Blob(&'a [u8]),
}

/// A part of the result of a query; the variants are in order of occurrence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Answer<'a> {
    /// The names of the columns, at least one; comes first and only once. No two names are equal: a name that
    /// the SQL repeats, in upper or lower case, gets a number, as in `value_2`.
    Columns(&'a [&'a str]),
    /// A row, with one value per column.
    Row(&'a [SqlValue<'a>]),
}

/// A handle that interrupts the running query of a [`Reader`] from any thread.
pub struct Interrupter(InterruptHandle);

impl Interrupter {
    /// Ends the running query, if any, with [`QueryError::Interrupted`].
    pub fn interrupt(&self) {
        self.0.interrupt();
    }
}

impl Reader {
    /// Runs a query and calls `on_part` with each part of the result, until the end or until `on_part`
    /// returns `Break`.
    ///
    /// **Errors**: the SQL is faulty, is not exactly one statement, does more than read the store, or was
    /// interrupted. `on_part` may have been called before the error.
    pub fn query(
        &self,
        sql: &str,
        on_part: impl FnMut(Answer<'_>) -> ControlFlow<()>,
    ) -> Result<(), QueryError> {
        self.query_with(sql, &[], on_part)
    }

    /// [`Reader::query`] of SQL with parameters. Each has a value, with its name unless parameters are `?`.
    ///
    /// **Errors**: also values that do not fit the parameters.
    pub fn query_with(
        &self,
        sql: &str,
        values: &[(Option<&str>, SqlValue<'_>)],
        mut on_part: impl FnMut(Answer<'_>) -> ControlFlow<()>,
    ) -> Result<(), QueryError> {
        let mut statement = self.bound(sql, values)?;
        let columns = statement.column_count();
        if columns == 0 {
            // A statement without columns is either empty or has an effect other than a result.
            return Err(if is_empty(&statement) {
                QueryError::Empty
            } else {
                QueryError::NotAllowed
            });
        }
        if !statement.readonly() {
            return Err(QueryError::NotAllowed);
        }
        let names = distinct(&statement.column_names().collect::<Vec<_>>());
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        if on_part(Answer::Columns(&names)).is_break() {
            return Ok(());
        }
        let mut rows = statement.raw_query();
        while let Some(row) = rows.next().map_err(|error| self.explain(error, sql))? {
            let values = self::values(row, columns).map_err(|error| self.explain(error, sql))?;
            if on_part(Answer::Row(&values)).is_break() {
                break;
            }
        }
        Ok(())
    }

    /// The name that the columns of a query repeat, in upper or lower case; `None` if all differ.
    ///
    /// **Errors**: the SQL is faulty, or values do not fit its parameters.
    pub fn repeated_name(
        &self,
        sql: &str,
        values: &[(Option<&str>, SqlValue<'_>)],
    ) -> Result<Option<String>, QueryError> {
        let statement = self.bound(sql, values)?;
        let names: Vec<&str> = statement.column_names().collect();
        let written = distinct(&names);
        let repeated = names.iter().zip(written).find(|(name, written)| **name != written);
        Ok(repeated.map(|(name, _)| (*name).to_owned()))
    }

    /// The SQL with literals instead of parameters, for [`Reader::column_types`]: literals round numbers.
    pub fn written_out(&self, sql: &str, values: &[(Option<&str>, SqlValue<'_>)]) -> String {
        let bound = self.bound(sql, values).ok().and_then(|bound| bound.expanded_sql());
        bound.unwrap_or_else(|| sql.to_owned())
    }

    /// The prepared query with the values of its parameters.
    fn bound(
        &self,
        sql: &str,
        values: &[(Option<&str>, SqlValue<'_>)],
    ) -> Result<Statement<'_>, QueryError> {
        let failed = |error| self.explain(error, sql);
        let mut statement = self.connection.prepare(sql).map_err(failed)?;
        let count = statement.parameter_count();
        if values.len() != count {
            let (expected, found) = (counted(count, "parameter"), counted(values.len(), "value"));
            let message = format!("the query has {expected}, found {found}");
            return Err(QueryError::Parameters(message));
        }
        for (index, (name, value)) in values.iter().enumerate() {
            let index = match name {
                None => index + 1,
                Some(name) => [":", "@", "$"]
                    .iter()
                    .find_map(|sign| statement.parameter_index(&format!("{sign}{name}")).ok()?)
                    .ok_or_else(|| {
                        QueryError::Parameters(format!("the query has no parameter :{name}"))
                    })?,
            };
            let value = match *value {
                SqlValue::Null => ValueRef::Null,
                SqlValue::Integer(whole) => ValueRef::Integer(whole),
                SqlValue::Real(real) => ValueRef::Real(real),
                SqlValue::Text(text) => ValueRef::Text(text.as_bytes()),
                SqlValue::Blob(bytes) => ValueRef::Blob(bytes),
            };
            statement.raw_bind_parameter(index, ToSqlOutput::Borrowed(value)).map_err(failed)?;
        }
        Ok(statement)
    }

    /// A handle that interrupts queries of this reader.
    pub fn interrupter(&self) -> Interrupter {
        Interrupter(self.connection.get_interrupt_handle())
    }

    /// The error with its place in `sql`.
    fn explain(&self, error: Error, sql: &str) -> QueryError {
        match error {
            Error::MultipleStatement => QueryError::Several,
            // SQLite reports a forbidden function with this message and without a specific error
            // code.
            Error::SqlInputError { msg, .. } if msg.starts_with("not authorized") => {
                QueryError::NotAllowed
            }
            Error::SqlInputError { msg, .. } | Error::SqliteFailure(_, Some(msg))
                if msg.starts_with(NO_SUCH_TABLE) =>
            {
                let name = msg[NO_SUCH_TABLE.len()..].to_owned();
                match VIEWS.iter().any(|view| view.eq_ignore_ascii_case(&name)) {
                    true => QueryError::LaterView { view: name },
                    false => QueryError::NoSuchTable { name },
                }
            }
            Error::SqlInputError { msg, offset, .. } => {
                let (line, column, text) = place(sql, usize::try_from(offset).unwrap_or(0));
                let is_of_column = msg.starts_with(NO_SUCH_COLUMN);
                let help = if is_of_column { self.columns_of_views_in(sql) } else { String::new() };
                QueryError::Sql { message: msg, line, column, text, help }
            }
            other if is_damage(&other) => QueryError::Damaged { reason: other.to_string() },
            other => match other.sqlite_error_code() {
                Some(ErrorCode::OperationInterrupted) => QueryError::Interrupted,
                Some(ErrorCode::OutOfMemory | ErrorCode::TooBig) => QueryError::TooLarge,
                Some(ErrorCode::AuthorizationForStatementDenied | ErrorCode::ReadOnly) => {
                    QueryError::NotAllowed
                }
                _ => QueryError::Sqlite(other),
            },
        }
    }

    /// The columns of each view in the query, one line per view.
    fn columns_of_views_in(&self, sql: &str) -> String {
        let is_name = |c: char| c.is_ascii_alphanumeric() || c == '_';
        let is_in_query =
            |view: &&str| sql.split(|c| !is_name(c)).any(|word| word.eq_ignore_ascii_case(view));
        let columns = |view: &str| {
            let all = self.connection.prepare(&format!("SELECT * FROM {view}")).ok()?;
            Some(format!(
                "\nthe view {view} has {}",
                all.column_names().collect::<Vec<_>>().join(", ")
            ))
        };
        VIEWS.into_iter().filter(is_in_query).filter_map(columns).collect()
    }
}

fn is_empty(statement: &Statement<'_>) -> bool {
    statement.expanded_sql().is_none()
}

fn values<'r>(row: &'r Row<'_>, columns: usize) -> rusqlite::Result<Vec<SqlValue<'r>>> {
    (0..columns)
        .map(|column| {
            Ok(match row.get_ref(column)? {
                ValueRef::Null => SqlValue::Null,
                ValueRef::Integer(whole) => SqlValue::Integer(whole),
                ValueRef::Real(real) => SqlValue::Real(real),
                ValueRef::Text(bytes) => {
                    std::str::from_utf8(bytes).map_or(SqlValue::Blob(bytes), SqlValue::Text)
                }
                ValueRef::Blob(bytes) => SqlValue::Blob(bytes),
            })
        })
        .collect()
}

/// The beginning of SQLite's message about an unknown table or view.
const NO_SUCH_TABLE: &str = "no such table: ";
/// The beginning of SQLite's message about an unknown column.
const NO_SUCH_COLUMN: &str = "no such column: ";

/// The line and column, from 1, of a byte of a text, and the text of that line.
fn place(text: &str, byte: usize) -> (usize, usize, String) {
    let byte = (0..=byte.min(text.len())).rev().find(|&at| text.is_char_boundary(at)).unwrap_or(0);
    let before = &text[..byte];
    let line_start = before.rfind('\n').map_or(0, |at| at + 1);
    let line = 1 + before.matches('\n').count();
    let column = 1 + text[line_start..byte].chars().count();
    (line, column, text[line_start..].lines().next().unwrap_or_default().replace('\t', " "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_counts_lines_and_characters_from_one() {
        assert_eq!(place("SELECT x", 7), (1, 8, "SELECT x".into()));
        assert_eq!(place("SELECT\n'é', x\nFROM", 13), (2, 6, "'é', x".into()));
        assert_eq!(place("", 5), (1, 1, String::new()));
    }
}
