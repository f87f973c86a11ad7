//! Insertion of many rows with few statements.

use rusqlite::types::Value;
use rusqlite::{Connection, params_from_iter};

use super::tables::ROWS;

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
