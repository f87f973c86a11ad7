//! Comparison of a file's tables, views, indexes and triggers with the schema of the migrations.
//!
//! A view with a changed letter would return wrong rows, and a changed trigger would accept what it should
//! reject. The schema of a file is therefore compared with the expected schema when the file is opened.

use std::collections::HashMap;
use std::path::Path;
use std::sync::LazyLock;

use data_encoding::HEXLOWER;
use rusqlite::Connection;
use sha2::{Digest, Sha256};

use super::error::StoreError;
use super::migrate::MIGRATIONS;
use super::view;

/// The digests of the tables, indexes and triggers of every version, from 1: a file that has one is as expected, which
/// saves running all migrations whenever a file is opened. A test compares them with the migrations.
const DIGESTS: [&str; MIGRATIONS.len()] = [
    "cc56d00666fea6b91c4b0d24c1bf6a76ffe808ea86951b7e778585ca7482af25",
    "9244d71655f35f4afe71168fd73e2765d240132d94b86d2047654097bd8021ad",
    "16ccfa9a8552c7466f2d9d3fc5f1d6df411b37ecc77a057dc0d979a2f4cdf45c",
    "029bd47a4bd3b7166b55632099057957466da48998db92e971231175214cd90b",
    "6fc17432417e7db982640affe459dacab190dc63216f7808e63fa7691fc8d07c",
    "9491fa8707ec99aaeb11f1757366ed94357cb4399c2112aba00a88ca58a68ba6",
    "9491fa8707ec99aaeb11f1757366ed94357cb4399c2112aba00a88ca58a68ba6",
    "3501b56429f325ba3530d423eeed50b6a6b07da2f6870fdd71c94e3f6d18812f",
    "ddc1b3f96106d646ac9a17b16b10145f4b50f617d1e85491f776adb0a48fcf1b",
    "1ae200593e98441ee02b7ffdea8c5dbee2490da5fbbd4b4011b8f712e1835f79",
    "8b5d3b31f2918084425fd50da52f612c745ea93cc8bfbeb3c81a3222e7e4d0a4",
    "753fda9fdd4ba354fde33288419dd40048a0eeccbdb62e0c686ec7955bc66c57",
    "4ceaa35528d22fe2e04dd3566b61f50d6c5970838dfbc3bba807ccf598cad43e",
    "7cadc21ca82dd3860dc327ad64d282a1c84b275a0b0f5dac3f373d3210588f18",
    "4b77d6c286b0431f5a81f5c4e1164f51aacc610abf21f8e58644fb2656bd38c3",
    "63eb0a651d46e36d5a7e9610cd807a6c9dc4a7008975f7ccd5e109fb84976ee3",
    "7c9482157bd23b86710a785ae69e4f506aeefafe3e36f7f0dadf95b0543bc7c9",
    "eefaff41e77bf59d193552fcc36c3f2766412fd4cc72589f35f0f33cebdcf649",
];

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
    let found = parts(connection)?;
    let is_newest = version == MIGRATIONS.len();
    let are_views_known = is_newest && view::outdated(connection)?.is_empty();
    let of_tables = DIGESTS.get(version.wrapping_sub(1));
    if are_views_known && of_tables.is_some_and(|expected| *expected == digest(&found)) {
        return Ok(Vec::new());
    }
    // A damaged version number either does not exist or leads to faults.
    let expected = VERSIONS.get(version.wrapping_sub(1)).or(VERSIONS.last());
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
    let mut all: Vec<_> = MIGRATIONS
        .iter()
        .map(|migration| migrate(migration.sql))
        .collect::<rusqlite::Result<_>>()?;
    view::renew(&connection)?;
    all.pop();
    all.push(parts(&connection)?);
    Ok(all)
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
    let parts = parts.iter().filter(|part| part.kind != "view");
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
    fn the_digests_are_those_of_the_migrations() {
        let digests: Vec<String> = VERSIONS.iter().map(|parts| digest(parts)).collect();
        assert_eq!(digests, DIGESTS);
    }
}
