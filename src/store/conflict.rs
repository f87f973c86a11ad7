//! Results that merges did not copy, because the store had other results of the job: the view `conflict`.

use rusqlite::Connection;

/// The columns of a conflict after its job.
pub(super) const COLUMNS: &str =
    "results_sha256, found_at, source, host, processor, code_version, git_revision";

/// Whether the file has the table of conflicts, which stores of earlier releases lack.
pub(super) fn are_known(connection: &Connection) -> rusqlite::Result<bool> {
    let table = "SELECT 1 FROM sqlite_schema WHERE name = 'recorded_conflict'";
    connection.prepare_cached(table)?.exists([])
}
