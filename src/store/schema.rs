//! Whether the tables, views, indexes and triggers of a file are those that the migrations make.
//!
//! A view with a changed letter would answer wrongly, and a changed trigger would let through what it
//! exists to refuse. So the schema of a file is compared with the expected one when it is opened.

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

/// A table, view, index or trigger.
#[derive(Debug, PartialEq, Eq)]
struct Part {
    kind: String,
    name: String,
    sql: String,
}

/// Fails if a part of the schema is missing or changed. Parts that others have added are allowed.
pub(super) fn require(connection: &Connection, path: &Path) -> Result<(), StoreError> {
    match faults(connection) {
        Ok(faults) => match faults.into_iter().next() {
            None => Ok(()),
            Some(reason) => Err(StoreError::Damaged { path: path.to_owned(), reason }),
        },
        Err(source) => Err(StoreError::sqlite(path, "read the schema", source)),
    }
}

/// What is wrong with the schema of the file, given the version that the file says it has: a line
/// for each part.
pub(super) fn faults(connection: &Connection) -> rusqlite::Result<Vec<String>> {
    let version: usize =
        connection.query_row("PRAGMA user_version", [], |row| row.get::<_, u32>(0))? as usize;
    // A damaged version is one that does not exist, or leads to faults.
    let expected = VERSIONS.get(version.wrapping_sub(1)).or(VERSIONS.last());
    let found = parts(connection)?;
    let found: HashMap<&str, &Part> = found.iter().map(|part| (part.name.as_str(), part)).collect();
    let fault = |expected: &Part| {
        let Part { kind, name, .. } = expected;
        match found.get(name.as_str()) {
            None => Some(format!("its {kind} `{name}` is missing")),
            Some(part) if *part != expected => {
                Some(format!("its {kind} `{name}` is not as it was made"))
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
