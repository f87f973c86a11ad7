//! The digest of a run's results, or of its failure, as they were stored.
//!
//! SQLite checks that a file is well formed, but not that a number in it is the number that was written. The
//! transaction that completes a run therefore stores a SHA-256 of its results, computed from the rows in the
//! file. A later check thus detects any changed byte of the results.

use rusqlite::types::ValueRef;
use rusqlite::{Connection, Params};
use sha2::{Digest, Sha256};

use super::tables::{InDigest, ResultTable, digested};

/// The ids of metrics by name. Reads the table, as readers of the names do, and not its index, because damage
/// may affect only one of the two.
const METRIC_IDS: &str = "SELECT id FROM metric_name NOT INDEXED ORDER BY name";

/// What a digest covers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum DigestForm {
    /// All results.
    Whole,
    /// All but the tables for any environment: the form of release 0.1.0 for trials in the family `step_count`.
    WithoutSteps,
}

/// The digest of a run's results and its job's key. Equal results of the same job have the same digest in
/// every store.
pub(super) fn of_run(connection: &Connection, run: i64) -> rusqlite::Result<[u8; 32]> {
    of_run_in(connection, run, DigestForm::Whole)
}

/// The form in which a run's results have this digest; `None` if they have another digest.
pub(super) fn form_of(
    connection: &Connection,
    run: i64,
    stored: Option<[u8; 32]>,
) -> rusqlite::Result<Option<DigestForm>> {
    if stored == Some(of_run(connection, run)?) {
        return Ok(Some(DigestForm::Whole));
    }
    let is_earlier = may_leave_out_steps(connection, run)?
        && stored == Some(of_run_in(connection, run, DigestForm::WithoutSteps)?);
    Ok(is_earlier.then_some(DigestForm::WithoutSteps))
}

/// Whether the digest of a run can have the form [`DigestForm::WithoutSteps`].
pub(super) fn may_leave_out_steps(connection: &Connection, run: i64) -> rusqlite::Result<bool> {
    connection
        .prepare_cached(
            "SELECT json_type(job.canonical, '$.environment.family') IS NULL
                AND json_type(job.canonical, '$.trial') IS NOT NULL
             FROM run JOIN job ON job.id = run.job WHERE run.id = ?1",
        )?
        .query_row([run], |row| row.get(0))
}

/// The digest of a run's results in a form.
pub(super) fn of_run_in(
    connection: &Connection,
    run: i64,
    form: DigestForm,
) -> rusqlite::Result<[u8; 32]> {
    let mut digest = ResultsDigest::new(&key_of(connection, run)?);
    for (table, statements) in digested() {
        if !digest.begin(table, form) || !table.is_in(connection)? {
            continue;
        }
        match table.is_by_metric {
            false => add_rows(&mut digest, connection, &statements.select, [run])?,
            // The rows of one metric are in order in the file, whereas SQLite would have to sort all of them.
            true => {
                let mut metrics = connection.prepare_cached(METRIC_IDS)?;
                for metric in metrics.query_map([], |row| row.get::<_, i64>(0))? {
                    add_rows(&mut digest, connection, &statements.of_metric, [run, metric?])?;
                }
            }
        }
    }
    Ok(digest.finish())
}

/// The digest of a run's results while it is being computed. Tables and rows are added in the order of
/// [`of_run`].
pub(super) struct ResultsDigest(Sha256);

impl ResultsDigest {
    /// Starts the digest of a run of the job with this key.
    pub(super) fn new(key: &str) -> Self {
        let mut hasher = Sha256::new();
        hasher.update("jitai results 1\n");
        hasher.update(key);
        ResultsDigest(hasher)
    }

    /// Begins the next table; false if the digest does not cover it in this form.
    pub(super) fn begin(&mut self, table: &ResultTable, form: DigestForm) -> bool {
        match table.digest {
            InDigest::Marked => self.0.update("\n"),
            InDigest::Unmarked => {}
            InDigest::UnmarkedSince => return form == DigestForm::Whole,
            InDigest::No => return false,
        }
        true
    }

    /// Adds a value with its type and length, so that different rows never give the same bytes.
    pub(super) fn add(&mut self, value: ValueRef<'_>) {
        let hasher = &mut self.0;
        match value {
            ValueRef::Null => hasher.update("n"),
            ValueRef::Integer(whole) => add(hasher, "i", &whole.to_le_bytes()),
            ValueRef::Real(real) => add(hasher, "r", &real.to_bits().to_le_bytes()),
            ValueRef::Text(bytes) => add_sized(hasher, "t", bytes),
            ValueRef::Blob(bytes) => add_sized(hasher, "b", bytes),
        }
    }

    /// The digest.
    pub(super) fn finish(self) -> [u8; 32] {
        self.0.finalize().into()
    }
}

/// The digest of a run's failure and its job's key.
pub(super) fn of_failure(
    connection: &Connection,
    run: i64,
    (kind, message, episode): (&str, &str, i64),
) -> rusqlite::Result<[u8; 32]> {
    let mut hasher = Sha256::new();
    hasher.update("jitai failure 1\n");
    hasher.update(key_of(connection, run)?);
    add_sized(&mut hasher, "t", kind.as_bytes());
    add_sized(&mut hasher, "t", message.as_bytes());
    add(&mut hasher, "i", &episode.to_le_bytes());
    Ok(hasher.finalize().into())
}

/// The key of a run's job.
fn key_of(connection: &Connection, run: i64) -> rusqlite::Result<String> {
    connection
        .prepare_cached("SELECT key FROM run JOIN job ON job.id = run.job WHERE run.id = ?1")?
        .query_row([run], |row| row.get(0))
}

/// Adds the rows of a statement.
fn add_rows(
    digest: &mut ResultsDigest,
    connection: &Connection,
    sql: &str,
    parameters: impl Params,
) -> rusqlite::Result<()> {
    let mut statement = connection.prepare_cached(sql)?;
    let columns = statement.column_count();
    let mut rows = statement.query(parameters)?;
    while let Some(row) = rows.next()? {
        for column in 0..columns {
            digest.add(row.get_ref(column)?);
        }
    }
    Ok(())
}

fn add(hasher: &mut Sha256, kind: &str, bytes: &[u8]) {
    hasher.update(kind);
    hasher.update(bytes);
}

fn add_sized(hasher: &mut Sha256, kind: &str, bytes: &[u8]) {
    add(hasher, kind, &(bytes.len() as u64).to_le_bytes());
    hasher.update(bytes);
}

#[cfg(test)]
mod tests {
    use rusqlite::StatementStatus;

    use super::*;
    use crate::store::Store;
    use crate::store::tables::Statements;

    #[test]
    fn a_kept_statement_is_compiled_once_whatever_is_bound_to_it() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(&folder.path().join("jitai.sqlite")).unwrap();
        for run in 0..3 {
            for (_, statements) in digested() {
                let mut digest = ResultsDigest::new("");
                add_rows(&mut digest, &store.connection, &statements.select, [run]).unwrap();
            }
        }
        for (_, Statements { select: sql, .. }) in digested() {
            let statement = store.connection.prepare_cached(sql).unwrap();
            assert_eq!(statement.get_status(StatementStatus::Run), 3, "{sql}");
            assert_eq!(statement.get_status(StatementStatus::RePrepare), 0, "{sql}");
        }
    }
}
