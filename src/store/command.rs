//! The commands that changed a store, each recorded with its first change.

use rusqlite::{Connection, params};

use super::schema::has_table;
use super::transaction::NOW;

/// A command of a user.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Command {
    /// Its words, quoted for a shell.
    pub words: String,
    /// Its working folder, from which relative paths start.
    pub folder: String,
    /// The name of its machine.
    pub host: String,
    /// The release of jitai.
    pub code_version: String,
    /// The revision of jitai.
    pub git_revision: String,
}

/// Records a command.
pub(super) fn record(connection: &Connection, command: &Command) -> rusqlite::Result<()> {
    let Command { words, folder, host, code_version, git_revision } = command;
    connection.execute(
        &format!(
            "INSERT INTO recorded_command
                (changed_at, command, folder, host, code_version, git_revision)
             VALUES ({NOW}, ?1, ?2, ?3, ?4, ?5)"
        ),
        params![words, folder, host, code_version, git_revision],
    )?;
    Ok(())
}

/// The recorded commands, each with the time of its first change, the earliest first. Stores of earlier
/// versions have none.
pub(super) fn recorded(connection: &Connection) -> rusqlite::Result<Vec<(String, Command)>> {
    if !has_table(connection, "recorded_command")? {
        return Ok(Vec::new());
    }
    let mut statement = connection.prepare_cached(
        "SELECT changed_at, command, folder, host, code_version, git_revision
         FROM recorded_command ORDER BY id",
    )?;
    let rows = statement.query_map([], |row| {
        let (words, folder, host) = (row.get(1)?, row.get(2)?, row.get(3)?);
        let (code_version, git_revision) = (row.get(4)?, row.get(5)?);
        Ok((row.get(0)?, Command { words, folder, host, code_version, git_revision }))
    })?;
    rows.collect()
}
