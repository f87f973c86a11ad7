//! Whether the tables, views, indexes and rules of a file are those that the migrations make.
//!
//! A changed letter in a view would answer wrongly, and one in a rule would let through what it is
//! there to refuse; so the file is compared with what it should be whenever it is opened.

use std::collections::HashMap;
use std::path::Path;
use std::sync::LazyLock;

use rusqlite::Connection;

use super::{StoreError, migrate};

/// What the schema of this release consists of: of each part its kind, its name and its SQL.
static EXPECTED: LazyLock<Vec<Part>> = LazyLock::new(|| {
    migrate::newest()
        .and_then(|connection| parts(&connection))
        .expect("the migrations make a schema, as every test of the store shows")
});

/// A table, view, index or trigger.
#[derive(Debug, PartialEq, Eq)]
struct Part {
    kind: String,
    name: String,
    sql: String,
}

/// Fails if a part of the schema is missing or not as it was made; what others have added is no
/// fault.
pub(super) fn require(connection: &Connection, path: &Path) -> Result<(), StoreError> {
    match faults(connection) {
        Ok(faults) => match faults.into_iter().next() {
            None => Ok(()),
            Some(reason) => Err(StoreError::Damaged { path: path.to_owned(), reason }),
        },
        Err(source) => Err(StoreError::sqlite(path, "read the schema", source)),
    }
}

/// What is wrong with the schema of the file, a line a part.
pub(super) fn faults(connection: &Connection) -> rusqlite::Result<Vec<String>> {
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
    Ok(EXPECTED.iter().filter_map(fault).collect())
}

fn parts(connection: &Connection) -> rusqlite::Result<Vec<Part>> {
    let mut statement = connection
        .prepare_cached("SELECT type, name, sql FROM sqlite_schema WHERE sql IS NOT NULL")?;
    let rows = statement
        .query_map([], |row| Ok(Part { kind: row.get(0)?, name: row.get(1)?, sql: row.get(2)? }))?;
    rows.collect()
}
