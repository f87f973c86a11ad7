//! Comparison of a file's tables, views, indexes and triggers with the schema of the migrations.
//!
//! A changed trigger would accept what it should reject. The schema of a file is therefore compared with the expected
//! schema when the file is opened. Only views are made again instead, if the file has the newest version.

use std::collections::HashMap;
use std::path::Path;
use std::sync::LazyLock;

use data_encoding::HEXLOWER;
use rusqlite::Connection;
use sha2::{Digest, Sha256};

use super::error::StoreError;
use super::migrate::{MIGRATIONS, version};

/// The digest of the tables, indexes and triggers of the newest version: a file that has it is as expected, which saves
/// running all migrations whenever a file is opened. A test compares it with the migrations.
const DIGEST: &str = "f7c67026fc75468e3c99ae04f83df059b66e9a525fe2dd501032f06f5b5e39da";

/// The first version whose views come from files of their own, and not from migrations.
const OWN_VIEWS: usize = 18;

/// The parts of the schema of every version, from 1, in the order of their names.
static VERSIONS: LazyLock<Vec<Vec<Part>>> = LazyLock::new(|| {
    versions().expect("the migrations make a schema, as every test of the store shows")
});

/// Whether the file has a table, which stores of earlier versions may lack.
pub(super) fn has_table(connection: &Connection, name: &str) -> rusqlite::Result<bool> {
    connection.prepare_cached("SELECT 1 FROM sqlite_schema WHERE name = ?1")?.exists([name])
}

/// Whether a table or view has a column, which stores of earlier versions may lack.
pub(super) fn has_column(connection: &Connection, of: &str, name: &str) -> rusqlite::Result<bool> {
    let named = "SELECT 1 FROM pragma_table_info(?1) WHERE name = ?2";
    connection.prepare_cached(named)?.exists([of, name])
}

/// A table, view, index or trigger.
#[derive(Debug, PartialEq, Eq)]
struct Part {
    kind: String,
    name: String,
    sql: String,
}

impl Part {
    fn is_view(&self) -> bool {
        self.kind == "view"
    }
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
    let version = version(connection)?;
    let found = parts(connection)?;
    let is_newest = version == MIGRATIONS.len();
    if is_newest && digest(&found) == DIGEST {
        return Ok(Vec::new());
    }
    // A damaged version number either does not exist or leads to faults.
    let expected = VERSIONS.get(version.wrapping_sub(1)).or(VERSIONS.last());
    let has_own_views = version >= OWN_VIEWS;
    let expected = expected.into_iter().flatten().filter(|part| !(has_own_views && part.is_view()));
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
    Ok(expected.filter_map(fault).collect())
}

fn versions() -> rusqlite::Result<Vec<Vec<Part>>> {
    let connection = Connection::open_in_memory()?;
    let migrate = |sql| connection.execute_batch(sql).and_then(|()| parts(&connection));
    MIGRATIONS.iter().map(|migration| migrate(migration.sql)).collect()
}

/// The parts of a schema in the order of their names, without the tables that SQLite adds for itself.
fn parts(connection: &Connection) -> rusqlite::Result<Vec<Part>> {
    let mut statement = connection.prepare_cached(
        "SELECT type, name, sql FROM sqlite_schema
         WHERE sql IS NOT NULL AND name NOT GLOB 'sqlite_*' ORDER BY name",
    )?;
    let rows = statement
        .query_map([], |row| Ok(Part { kind: row.get(0)?, name: row.get(1)?, sql: row.get(2)? }))?;
    rows.collect()
}

/// The digest of the parts of a schema that are no views, in hexadecimal digits.
fn digest(parts: &[Part]) -> String {
    let mut digest = Sha256::new();
    let parts = parts.iter().filter(|part| !part.is_view());
    for text in parts.flat_map(|Part { kind, name, sql }| [kind, name, sql]) {
        digest.update(text);
        // No text has a byte 0.
        digest.update([0]);
    }
    HEXLOWER.encode(&digest.finalize())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_digest_is_that_of_the_migrations() {
        assert_eq!(digest(VERSIONS.last().unwrap()), DIGEST);
    }
}
