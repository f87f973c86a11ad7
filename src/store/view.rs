//! The public views: a file each in `migrations/views/`, made again in a store whose text differs.
//!
//! Migrations change tables and drop the views that a change breaks. They make no views: whoever opens a store for
//! writing does. A reader makes its own.

use rusqlite::Connection;

macro_rules! views {
    ($($name:literal)*) => {
        [$(($name, include_str!(concat!("../../migrations/views/", $name, ".sql")))),*]
    };
}

/// The name of every view, with the statement that makes it.
pub(super) static VIEWS: [(&str, &str); 15] = views!(
    "action_choice" "arm_summary" "conflict" "decision" "estimate" "evaluation_episode" "every_estimate"
    "learning_curve" "manifest" "metric" "parameter" "participant" "person_posterior" "posterior"
    "run_summary"
);

/// The text that SQLite keeps of such a statement.
pub(super) fn kept(sql: &str) -> &str {
    sql.trim_end().trim_end_matches(';')
}

/// The names of the views that the file lacks or has with another text.
pub(super) fn outdated(connection: &Connection) -> rusqlite::Result<Vec<&'static str>> {
    let mut text = connection.prepare_cached(
        "SELECT 1 FROM sqlite_schema WHERE type = 'view' AND name = ?1 AND sql = ?2",
    )?;
    let mut names = Vec::new();
    for (name, sql) in VIEWS {
        if !text.exists([name, kept(sql)])? {
            names.push(name);
        }
    }
    Ok(names)
}

/// Makes the views that a file of the newest version lacks or has with another text, for this connection alone, in which
/// they stand before the views of the file. Afterwards the connection only reads.
pub(super) fn renew_for_reading(connection: &Connection) -> rusqlite::Result<()> {
    let outdated = outdated(connection)?;
    if outdated.is_empty() {
        return Ok(());
    }
    connection.execute_batch("PRAGMA query_only = OFF")?;
    for (_, sql) in VIEWS.iter().filter(|(name, _)| outdated.contains(name)) {
        connection.execute_batch(&sql.replacen("CREATE VIEW", "CREATE TEMP VIEW", 1))?;
    }
    connection.execute_batch("PRAGMA query_only = ON")
}

/// Makes the views that the file lacks or has with another text. The caller has begun a transaction.
pub(super) fn renew(connection: &Connection) -> rusqlite::Result<()> {
    let outdated = outdated(connection)?;
    for (name, sql) in VIEWS.iter().filter(|(name, _)| outdated.contains(name)) {
        connection.execute_batch(&format!("DROP VIEW IF EXISTS {name}; {sql}"))?;
    }
    Ok(())
}
