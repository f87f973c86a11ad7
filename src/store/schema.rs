//! Comparison of a file's tables, views, indexes and triggers with the schema of the migrations.
//!
//! A view with a changed letter would return wrong rows, and a changed trigger would accept what it should
//! reject. The schema of a file is therefore compared with the expected schema when the file is opened.

use std::collections::HashMap;
use std::path::Path;
use std::sync::LazyLock;

use rusqlite::Connection;

use super::error::StoreError;
use super::migrate::MIGRATIONS;

/// The parts of the schema of every version, from 1.
static VERSIONS: LazyLock<Vec<Vec<Part>>> = LazyLock::new(|| {
    versions().expect("the migrations make a schema, as every test of the store shows")
});

/// Whether the file has a table, which stores of earlier versions may lack.
pub(super) fn has_table(connection: &Connection, name: &str) -> rusqlite::Result<bool> {
    connection.prepare_cached("SELECT 1 FROM sqlite_schema WHERE name = ?1")?.exists([name])
}

/// A table, view, index or trigger.
#[derive(Debug, PartialEq, Eq)]
struct Part {
    kind: String,
    name: String,
    sql: String,
}

/// Fails if a part of the schema is missing or changed. Additional parts are allowed.
pub(super) fn require(connection: &Connection, path: &Path) -> Result<(), StoreError> {
    match faults(connection) {
        Ok(faults) => match faults.into_iter().next() {
            None => Ok(()),
            Some(reason) => Err(StoreError::Damaged { path: path.to_owned(), reason }),
        },
        Err(source) => Err(StoreError::sqlite(path, "read the schema", source)),
    }
}

/// The faults in the schema of the file, given its declared version: one line per part.
pub(super) fn faults(connection: &Connection) -> rusqlite::Result<Vec<String>> {
    let version: usize =
        connection.query_row("PRAGMA user_version", [], |row| row.get::<_, u32>(0))? as usize;
    // A damaged version number either does not exist or leads to faults.
    let expected = VERSIONS.get(version.wrapping_sub(1)).or(VERSIONS.last());
    let found = parts(connection)?;
    let found: HashMap<&str, &Part> = found.iter().map(|part| (part.name.as_str(), part)).collect();
    let fault = |expected: &Part| {
        let Part { kind, name, .. } = expected;
        match found.get(name.as_str()) {
            None => Some(format!("its {kind} `{name}` is missing")),
            Some(part) if *part != expected => {
                Some(format!("its {kind} `{name}` has been changed"))
            }
            Some(_) => None,
        }
    };
    Ok(expected.into_iter().flatten().filter_map(fault).collect())
}

fn versions() -> rusqlite::Result<Vec<Vec<Part>>> {
    let connection = Connection::open_in_memory()?;
    let migrate = |sql| connection.execute_batch(sql).and_then(|()| parts(&connection));
    MIGRATIONS.iter().map(|migration| migrate(migration.sql)).collect()
}

fn parts(connection: &Connection) -> rusqlite::Result<Vec<Part>> {
    let mut statement = connection
        .prepare_cached("SELECT type, name, sql FROM sqlite_schema WHERE sql IS NOT NULL")?;
    let rows = statement
        .query_map([], |row| Ok(Part { kind: row.get(0)?, name: row.get(1)?, sql: row.get(2)? }))?;
    rows.collect()
}
