//! Queries of the user: one statement that reads this file and nothing else.

use std::ops::ControlFlow;

use rusqlite::functions::{Aggregate, Context, FunctionFlags};
use rusqlite::hooks::{AuthAction, AuthContext, Authorization};
use rusqlite::limits::Limit;
use rusqlite::types::ValueRef;
use rusqlite::{Connection, Error, ErrorCode, InterruptHandle, Row, Statement};

use super::error::is_damage;
use super::{QueryError, Reader};

/// The public views, which `docs/store.md` describes.
pub const VIEWS: [&str; 6] =
    ["run_summary", "parameter", "metric", "learning_curve", "evaluation_episode", "action_choice"];

/// A value of an answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value<'a> {
    /// No value.
    Null,
    /// A whole number.
    Integer(i64),
    /// A number with a fraction.
    Real(f64),
    /// Text.
    Text(&'a str),
    /// Bytes; also a text that is not UTF-8.
    Blob(&'a [u8]),
}

/// A part of the answer to a query, in the order they come.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Answer<'a> {
    /// The names of the columns, at least one; comes first, once.
    Columns(&'a [&'a str]),
    /// A row, with a value for each column.
    Row(&'a [Value<'a>]),
}

/// Stops the query that a [`Reader`] is answering, from any thread.
pub struct Interrupter(InterruptHandle);

impl Interrupter {
    /// Makes the query under way, if any, end with [`QueryError::Interrupted`].
    pub fn interrupt(&self) {
        self.0.interrupt();
    }
}

impl Reader {
    /// Answers a query, part by part, until its end or until `hear` breaks off.
    ///
    /// **Errors**: the SQL is faulty, is not exactly one statement, would do something else than
    /// read this store, or was interrupted. `hear` may have heard parts of the answer by then.
    pub fn query(
        &self,
        sql: &str,
        mut hear: impl FnMut(Answer<'_>) -> ControlFlow<()>,
    ) -> Result<(), QueryError> {
        let mut statement =
            self.connection.prepare(sql).map_err(|error| self.explain(error, sql))?;
        let columns = statement.column_count();
        if columns == 0 {
            // Statements that answer nothing: none at all, or one that is meant to act.
            return Err(if is_empty(&statement) {
                QueryError::Empty
            } else {
                QueryError::NotAllowed
            });
        }
        if !statement.readonly() {
            return Err(QueryError::NotAllowed);
        }
        if hear(Answer::Columns(&statement.column_names().collect::<Vec<_>>())).is_break() {
            return Ok(());
        }
        let mut rows = statement.query([]).map_err(|error| self.explain(error, sql))?;
        while let Some(row) = rows.next().map_err(|error| self.explain(error, sql))? {
            let values = values(row, columns).map_err(|error| self.explain(error, sql))?;
            if hear(Answer::Row(&values)).is_break() {
                break;
            }
        }
        Ok(())
    }

    /// A handle that stops queries of this reader.
    pub fn interrupter(&self) -> Interrupter {
        Interrupter(self.connection.get_interrupt_handle())
    }

    /// The error in words for whoever wrote `sql`.
    fn explain(&self, error: Error, sql: &str) -> QueryError {
        match error {
            Error::MultipleStatement => QueryError::Several,
            // What SQLite says, without a code of its own, of a function that is not allowed.
            Error::SqlInputError { msg, .. } if msg.starts_with("not authorized") => {
                QueryError::NotAllowed
            }
            Error::SqlInputError { msg, .. } | Error::SqliteFailure(_, Some(msg))
                if msg.starts_with(NO_SUCH_TABLE) =>
            {
                QueryError::NoSuchTable { name: msg[NO_SUCH_TABLE.len()..].to_owned() }
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

    /// The columns of each view that the query names, a line a view.
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

fn values<'r>(row: &'r Row<'_>, columns: usize) -> rusqlite::Result<Vec<Value<'r>>> {
    (0..columns)
        .map(|column| {
            Ok(match row.get_ref(column)? {
                ValueRef::Null => Value::Null,
                ValueRef::Integer(whole) => Value::Integer(whole),
                ValueRef::Real(real) => Value::Real(real),
                ValueRef::Text(bytes) => {
                    std::str::from_utf8(bytes).map_or(Value::Blob(bytes), Value::Text)
                }
                ValueRef::Blob(bytes) => Value::Blob(bytes),
            })
        })
        .collect()
}

/// Adds what SQL lacks for means and deviations.
pub(super) fn add_functions(connection: &Connection) -> rusqlite::Result<()> {
    let flags = FunctionFlags::SQLITE_UTF8
        | FunctionFlags::SQLITE_DETERMINISTIC
        | FunctionFlags::SQLITE_INNOCUOUS;
    // Like that of the sqlite3 shell: NULL for what has no root.
    connection.create_scalar_function("sqrt", 1, flags, |context| {
        Ok(number(context).map(f64::sqrt).filter(|root| !root.is_nan()))
    })?;
    connection.create_aggregate_function("stddev", 1, flags, StandardDeviation)
}

/// The only argument of a function, if it is a number.
fn number(context: &Context<'_>) -> Option<f64> {
    match context.get_raw(0) {
        ValueRef::Integer(whole) => Some(whole as f64),
        ValueRef::Real(real) => Some(real),
        ValueRef::Null | ValueRef::Text(_) | ValueRef::Blob(_) => None,
    }
}

/// The standard deviation (n - 1) of the numbers met; NULL of fewer than two, as in PostgreSQL.
///
/// **Source**: Welford, "Note on a method for calculating corrected sums of squares and products",
/// 1962.
struct StandardDeviation;

/// How many numbers were met, their mean, and the sum of squares about it.
#[derive(Default)]
struct Squares {
    n: f64,
    mean: f64,
    sum: f64,
}

impl Aggregate<Squares, Option<f64>> for StandardDeviation {
    fn init(&self, _: &mut Context<'_>) -> rusqlite::Result<Squares> {
        Ok(Squares::default())
    }

    fn step(&self, context: &mut Context<'_>, squares: &mut Squares) -> rusqlite::Result<()> {
        if let Some(number) = number(context) {
            squares.n += 1.0;
            let apart = number - squares.mean;
            squares.mean += apart / squares.n;
            squares.sum += apart * (number - squares.mean);
        }
        Ok(())
    }

    fn finalize(
        &self,
        _: &mut Context<'_>,
        squares: Option<Squares>,
    ) -> rusqlite::Result<Option<f64>> {
        let squares = squares.filter(|squares| squares.n > 1.0);
        Ok(squares.map(|squares| (squares.sum / (squares.n - 1.0)).sqrt()))
    }
}

/// Makes the connection refuse every statement that does not merely read the store, and those that
/// would fill the memory with one value or many.
pub(super) fn allow_reading_only(connection: &mut Connection) -> rusqlite::Result<()> {
    connection.set_limit(Limit::SQLITE_LIMIT_LENGTH, LONGEST_VALUE)?;
    connection.set_limit(Limit::SQLITE_LIMIT_ATTACHED, 0)?;
    // Of all connections of the process together; what is sorted goes to a file long before.
    connection.pragma_update(None, "hard_heap_limit", MOST_MEMORY)?;
    connection.authorizer(Some(authorize))
}

/// Bytes of a value, a row or the SQL itself, at most; the weights of the largest network are 80 MB.
const LONGEST_VALUE: i32 = 128 << 20;
/// Bytes that SQLite may hold, at most.
const MOST_MEMORY: i64 = 768 << 20;

fn authorize(context: AuthContext<'_>) -> Authorization {
    let allowed = match context.action {
        AuthAction::Select | AuthAction::Read { .. } | AuthAction::Recursive => true,
        AuthAction::Function { function_name } => !ACTING_FUNCTIONS.contains(&function_name),
        AuthAction::Pragma { pragma_name, .. } => DESCRIBING_PRAGMAS.contains(&pragma_name),
        _ => false,
    };
    if allowed { Authorization::Allow } else { Authorization::Deny }
}

/// Functions, of SQLite itself or of its usual extensions, that reach outside the store.
const ACTING_FUNCTIONS: &[&str] =
    &["load_extension", "readfile", "writefile", "edit", "fts3_tokenizer"];

/// Pragmas that describe tables and change nothing, whatever their argument.
const DESCRIBING_PRAGMAS: &[&str] =
    &["table_info", "table_xinfo", "table_list", "index_list", "index_info", "foreign_key_list"];

/// How SQLite begins to say that there is no table or view of a name.
const NO_SUCH_TABLE: &str = "no such table: ";
/// The same of a column.
const NO_SUCH_COLUMN: &str = "no such column: ";

/// Line and column, from 1, of a byte of a text, and that line.
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
