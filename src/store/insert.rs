//! Insertion of many rows with few statements.

use rusqlite::types::Value;
use rusqlite::{Connection, params_from_iter};

/// The lowest bit of the run in the row ids of recorded decisions and participants.
pub(super) const RUN: u32 = 39;

/// The number of rows per statement. The overhead of a statement equals the cost of three rows.
pub(super) const ROWS: usize = 32;

/// Inserts the rows of another store's run as rows of run `own`. Their row ids, in the first column, lack the
/// run, which belongs in the bits above.
pub(super) fn insert_renumbered<const COLUMNS: usize>(
    target: &Connection,
    table: &str,
    own: i64,
    values: &[Value],
) -> rusqlite::Result<()> {
    let rows = values.as_chunks::<COLUMNS>().0.iter().map(|row| {
        let mut row = row.clone();
        row[0] = match row[0] {
            Value::Integer(id) => Value::Integer(id | own << RUN),
            // The table rejects such a row.
            _ => Value::Null,
        };
        row
    });
    insert_rows(target, table, rows)
}

/// Inserts rows into a table: [`ROWS`] per statement, and the remaining rows one by one.
pub(super) fn insert_rows<const COLUMNS: usize>(
    connection: &Connection,
    table: &str,
    rows: impl Iterator<Item = [Value; COLUMNS]>,
) -> rusqlite::Result<()> {
    let row = format!("({})", ["?"; COLUMNS].join(", "));
    let sql =
        |rows: usize| format!("INSERT INTO {table} VALUES {}", vec![row.as_str(); rows].join(", "));
    let mut waiting: Vec<[Value; COLUMNS]> = Vec::with_capacity(ROWS);
    let mut many = None;
    for row in rows {
        waiting.push(row);
        if waiting.len() == ROWS {
            let many = match &mut many {
                Some(many) => many,
                none => none.insert(connection.prepare_cached(&sql(ROWS))?),
            };
            many.execute(params_from_iter(waiting.drain(..).flatten()))?;
        }
    }
    let mut one = connection.prepare_cached(&sql(1))?;
    for row in waiting {
        one.execute(params_from_iter(row))?;
    }
    Ok(())
}
