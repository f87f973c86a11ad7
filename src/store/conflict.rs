//! Results that merges did not copy, because the store had other results of the job: the view `conflict`.

use rusqlite::Connection;

use super::schema::has_table;

/// The columns of a conflict after its job.
pub(super) const COLUMNS: &str =
    "results_sha256, found_at, source, host, processor, code_version, git_revision";

/// Whether the file has the table of conflicts, which stores of earlier releases lack.
pub(super) fn are_known(connection: &Connection) -> rusqlite::Result<bool> {
    has_table(connection, "recorded_conflict")
}
