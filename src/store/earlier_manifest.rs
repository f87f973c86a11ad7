//! The earlier texts of experiments' manifests.

use rusqlite::types::Value;
use rusqlite::{Connection, params};
use sha2::{Digest, Sha256};

use super::error::StoreError;
use super::read::Reader;
use super::schema::has_table;

/// A text that an experiment's manifest has or had.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UsedManifest {
    /// The time of its first run: UTC, ISO 8601.
    pub from: String,
    /// The time when another text replaced it; `None` for the current text.
    pub until: Option<String>,
    /// The text of the file as it was read.
    pub text: String,
}

impl Reader {
    /// All texts of an experiment's manifest, in the order in which they were replaced, the current one last;
    /// empty for an unknown experiment. Instants do not give this order, because a clock can be set back.
    pub fn used_manifests(&self, experiment: &str) -> Result<Vec<UsedManifest>, StoreError> {
        self.read("read the manifests of an experiment", |connection| {
            if !are_known(connection)? {
                return Ok(Vec::new());
            }
            let mut statement = connection.prepare_cached(
                "SELECT used_from, used_until, manifest FROM (
                    SELECT earlier.id AS id, used_from, used_until, earlier.manifest AS manifest
                    FROM earlier_manifest AS earlier
                    JOIN experiment ON experiment.id = earlier.experiment WHERE name = ?1
                    UNION ALL
                    SELECT NULL, updated_at, NULL, manifest FROM experiment WHERE name = ?1)
                 ORDER BY id IS NULL, id",
            )?;
            let rows = statement.query_map([experiment], |row| {
                Ok(UsedManifest { from: row.get(0)?, until: row.get(1)?, text: row.get(2)? })
            })?;
            Ok(rows.collect::<rusqlite::Result<_>>()?)
        })
    }
}

/// Whether the file has the table of earlier manifests, which stores of earlier releases lack.
pub(super) fn are_known(connection: &Connection) -> rusqlite::Result<bool> {
    has_table(connection, "earlier_manifest")
}

/// Stores an experiment's current text, before another one replaces it at the instant `until`.
pub(super) fn keep(connection: &Connection, experiment: &str, until: &str) -> rusqlite::Result<()> {
    let (id, text, from): (i64, String, String) = connection.query_row(
        "SELECT id, manifest, updated_at FROM experiment WHERE name = ?1",
        [experiment],
        |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)),
    )?;
    let sha256 = digest(experiment, &text, &from, until);
    connection.execute(
        "INSERT INTO earlier_manifest (experiment, manifest, used_from, used_until, sha256)
         VALUES (?1, ?2, ?3, ?4, ?5)",
        params![id, text, from, until, sha256],
    )?;
    Ok(())
}

/// The texts of an experiment that match their digests: `manifest`, `used_from`, `used_until` and `sha256`.
pub(super) fn intact(
    connection: &Connection,
    experiment: i64,
) -> rusqlite::Result<Vec<[Value; 4]>> {
    let mut statement = connection.prepare_cached(
        "SELECT name, earlier.manifest, used_from, used_until, sha256
         FROM experiment JOIN earlier_manifest AS earlier ON earlier.experiment = experiment.id
         WHERE experiment.id = ?1 ORDER BY earlier.id",
    )?;
    let rows = statement.query_map([experiment], |row| {
        let values = [row.get(1)?, row.get(2)?, row.get(3)?, row.get(4)?];
        Ok(is_intact(row)?.then_some(values))
    })?;
    rows.filter_map(Result::transpose).collect()
}

/// Copies texts that the experiment lacks.
pub(super) fn copy(
    connection: &Connection,
    experiment: i64,
    texts: &[[Value; 4]],
) -> rusqlite::Result<()> {
    let mut insert = connection.prepare_cached(
        "INSERT INTO earlier_manifest (experiment, manifest, used_from, used_until, sha256)
         SELECT ?1, ?2, ?3, ?4, ?5 WHERE NOT EXISTS (SELECT 1 FROM earlier_manifest
            WHERE experiment = ?1 AND sha256 = ?5)",
    )?;
    for [text, from, until, sha256] in texts {
        insert.execute(params![experiment, text, from, until, sha256])?;
    }
    Ok(())
}

/// The experiments with a text that does not match its digest.
pub(super) fn damaged(connection: &Connection) -> rusqlite::Result<Vec<String>> {
    if !are_known(connection)? {
        return Ok(Vec::new());
    }
    let mut statement = connection.prepare(
        "SELECT name, earlier.manifest, used_from, used_until, sha256
         FROM earlier_manifest AS earlier LEFT JOIN experiment ON earlier.experiment = experiment.id",
    )?;
    let rows = statement.query_map([], |row| {
        let name = row.get_ref(0)?.as_str_or_null()?.unwrap_or("?").to_owned();
        Ok((!is_intact(row).unwrap_or(false)).then_some(name))
    })?;
    rows.filter_map(Result::transpose).collect()
}

/// Whether a row of `name`, `manifest`, `used_from`, `used_until` and `sha256` matches its digest.
fn is_intact(row: &rusqlite::Row<'_>) -> rusqlite::Result<bool> {
    let text = |column: usize| Ok::<_, rusqlite::Error>(row.get_ref(column)?.as_str()?);
    let digest = digest(text(0)?, text(1)?, text(2)?, text(3)?);
    Ok(row.get_ref(4)?.as_blob()? == digest)
}

fn digest(experiment: &str, text: &str, from: &str, until: &str) -> [u8; 32] {
    let mut hasher = Sha256::new();
    hasher.update("jitai manifest 1\n");
    for part in [experiment, from, until, text] {
        hasher.update((part.len() as u64).to_le_bytes());
        hasher.update(part);
    }
    hasher.finalize().into()
}
