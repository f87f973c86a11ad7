//! Statements on both ends of a copy: a source that may be damaged, and a target with constraints.

use rusqlite::types::Value;
use rusqlite::{Connection, ErrorCode, OptionalExtension, params_from_iter};

/// The row of a query on the source; `None` if there is no row or it cannot be read.
pub(super) fn read_row<const COLUMNS: usize>(
    from: &Connection,
    sql: &str,
    id: i64,
) -> Option<[Value; COLUMNS]> {
    read_rows(from, sql, &[Value::Integer(id)])?.pop()
}

/// The rows of a query on the source; `None` if a row cannot be read.
pub(super) fn read_rows<const COLUMNS: usize>(
    from: &Connection,
    sql: &str,
    parameters: &[Value],
) -> Option<Vec<[Value; COLUMNS]>> {
    let mut statement = from.prepare_cached(sql).ok()?;
    let rows = statement.query_map(params_from_iter(parameters), |row| {
        let mut values = [const { Value::Null }; COLUMNS];
        for (column, value) in values.iter_mut().enumerate() {
            *value = row.get(column)?;
        }
        Ok(values)
    });
    rows.ok()?.collect::<rusqlite::Result<_>>().ok()
}

/// The values of all rows of a query on the source, in sequence; `None` if a row cannot be read.
pub(super) fn read_values(from: &Connection, sql: &str, id: i64) -> Option<Vec<Value>> {
    let mut statement = from.prepare_cached(sql).ok()?;
    let columns = statement.column_count();
    let mut rows = statement.query([id]).ok()?;
    let mut values = Vec::new();
    while let Some(row) = rows.next().ok()? {
        for column in 0..columns {
            values.push(row.get(column).ok()?);
        }
    }
    Some(values)
}

/// The first id that a query on the target finds.
pub(super) fn find(
    target: &Connection,
    sql: &str,
    values: &[Value],
) -> rusqlite::Result<Option<i64>> {
    let mut statement = target.prepare_cached(sql)?;
    statement.query_row(params_from_iter(values), |row| row.get(0)).optional()
}

/// Whether the target accepted a row.
#[derive(Clone, Copy)]
pub(super) enum Written {
    Yes,
    /// A constraint of the schema rejected it.
    Refused,
}

/// Executes a statement that writes to the target.
pub(super) fn write(target: &Connection, sql: &str, values: &[Value]) -> rusqlite::Result<Written> {
    let rows = target.prepare_cached(sql)?.execute(params_from_iter(values));
    written(rows)
}

/// Whether the target accepted a statement, according to the statement's result.
pub(super) fn written<T>(result: rusqlite::Result<T>) -> rusqlite::Result<Written> {
    match result {
        Ok(_) => Ok(Written::Yes),
        Err(error) => match error.sqlite_error_code() {
            Some(ErrorCode::ConstraintViolation | ErrorCode::TypeMismatch) => Ok(Written::Refused),
            _ => Err(error),
        },
    }
}
