//! Migrating a file to the schema of this release.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process;

use rusqlite::{Connection, OpenFlags, Transaction, TransactionBehavior};

use super::error::StoreError;
use super::place::beside;
use super::transaction::commit;
use super::view;
use crate::job::counted;

/// Marks a SQLite file as a store: the letters `JITA`.
pub(super) const APPLICATION_ID: u32 = 0x4A49_5441;

/// A migration from one version of the schema to the next.
#[derive(Clone, Copy, Debug)]
pub(super) struct Migration {
    /// The name of its file in `migrations/`, without the extension.
    pub(super) name: &'static str,
    /// Its statements.
    pub(super) sql: &'static str,
}

/// All migrations; the first one creates version 1.
pub(super) const MIGRATIONS: &[Migration] = &[
    Migration {
        name: "0001_create_store",
        sql: include_str!("../../migrations/0001_create_store.sql"),
    },
    Migration {
        name: "0002_weights_by_algorithm",
        sql: include_str!("../../migrations/0002_weights_by_algorithm.sql"),
    },
    Migration {
        name: "0003_implied_parameters",
        sql: include_str!("../../migrations/0003_implied_parameters.sql"),
    },
    Migration {
        name: "0004_record_decisions",
        sql: include_str!("../../migrations/0004_record_decisions.sql"),
    },
    Migration {
        name: "0005_summarise_arms",
        sql: include_str!("../../migrations/0005_summarise_arms.sql"),
    },
    Migration {
        name: "0006_record_participants",
        sql: include_str!("../../migrations/0006_record_participants.sql"),
    },
    Migration {
        name: "0007_outside_programs",
        sql: include_str!("../../migrations/0007_outside_programs.sql"),
    },
    Migration {
        name: "0008_keep_manifests",
        sql: include_str!("../../migrations/0008_keep_manifests.sql"),
    },
    Migration {
        name: "0009_record_choices",
        sql: include_str!("../../migrations/0009_record_choices.sql"),
    },
    Migration {
        name: "0010_show_conflicts_and_machines",
        sql: include_str!("../../migrations/0010_show_conflicts_and_machines.sql"),
    },
    Migration {
        name: "0011_log_commands",
        sql: include_str!("../../migrations/0011_log_commands.sql"),
    },
    Migration {
        name: "0012_other_families",
        sql: include_str!("../../migrations/0012_other_families.sql"),
    },
    Migration {
        name: "0013_leave_out_episodes",
        sql: include_str!("../../migrations/0013_leave_out_episodes.sql"),
    },
    Migration {
        name: "0014_record_estimates",
        sql: include_str!("../../migrations/0014_record_estimates.sql"),
    },
    Migration {
        name: "0015_record_endings",
        sql: include_str!("../../migrations/0015_record_endings.sql"),
    },
    Migration {
        name: "0016_record_posteriors",
        sql: include_str!("../../migrations/0016_record_posteriors.sql"),
    },
    Migration {
        name: "0017_declare_estimates",
        sql: include_str!("../../migrations/0017_declare_estimates.sql"),
    },
    Migration {
        name: "0018_keep_filters_and_programs",
        sql: include_str!("../../migrations/0018_keep_filters_and_programs.sql"),
    },
    Migration {
        name: "0019_record_people",
        sql: include_str!("../../migrations/0019_record_people.sql"),
    },
    Migration {
        name: "0020_weigh_estimates",
        sql: include_str!("../../migrations/0020_weigh_estimates.sql"),
    },
];

/// The version of the schema that this program writes.
pub const SCHEMA_VERSION: u32 = MIGRATIONS.len() as u32;

/// The oldest version that this program reads without migrating it. Later migrations change no table that
/// readers use, and add views, columns of views, and NULL for the standard deviation of one episode.
pub(super) const OLDEST_READABLE: u32 = 1;

/// Applies the migrations that the file lacks, all or none of them.
///
/// A file that already has a schema is first copied to `<file>.v<version>.bak`, or to a name with a number
/// before the extension if that copy already exists.
pub(super) fn migrate(
    connection: &mut Connection,
    path: &Path,
    migrations: &'static [Migration],
) -> Result<(), StoreError> {
    let failed = |source| StoreError::sqlite(path, "open the store", source);
    let found = version(connection).map_err(failed)?;
    if found >= migrations.len() {
        return Ok(());
    }
    let action = if found == 0 { "create the store" } else { "migrate the store" };
    let failed = |source| StoreError::sqlite(path, action, source);
    // A migration may rebuild a table that others refer to; references are checked at its end. The setting
    // has no effect inside a transaction.
    connection.execute_batch("PRAGMA foreign_keys = OFF").map_err(failed)?;
    let result = migrate_locked(connection, (path, action), migrations, back_up);
    connection.execute_batch("PRAGMA foreign_keys = ON").map_err(failed)?;
    result
}

/// Makes the views of a file of the newest version again whose texts differ. The caller has judged the schema: a damaged
/// file is not written.
pub(super) fn renew_views(connection: &mut Connection, path: &Path) -> Result<(), StoreError> {
    let mut renew = || {
        if version(connection)? != SCHEMA_VERSION as usize || view::outdated(connection)?.is_empty()
        {
            return Ok(());
        }
        let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
        view::renew(&transaction)?;
        commit(transaction)
    };
    renew().map_err(|source| StoreError::sqlite(path, "open the store", source))
}

/// Applies the migrations that a private copy of the store at `path` lacks.
pub(super) fn migrate_copy(copy: &mut Connection, path: &Path) -> Result<(), StoreError> {
    let action = "migrate a copy of the store";
    copy.execute_batch("PRAGMA foreign_keys = OFF")
        .map_err(|source| StoreError::sqlite(path, action, source))?;
    migrate_locked(copy, (path, action), MIGRATIONS, |_, _| Ok(()))
}

/// Migrates in one transaction. Calls `back_up` with the version of a file that will be migrated.
fn migrate_locked(
    connection: &mut Connection,
    (path, action): (&Path, &'static str),
    migrations: &'static [Migration],
    back_up: impl FnOnce(&Path, usize) -> Result<(), StoreError>,
) -> Result<(), StoreError> {
    let failed = |source| StoreError::sqlite(path, action, source);
    let transaction =
        connection.transaction_with_behavior(TransactionBehavior::Immediate).map_err(failed)?;
    // Read again under the lock, because another process may have migrated the file meanwhile.
    let found = version(&transaction).map_err(failed)?;
    if found > 0 && found < migrations.len() {
        back_up(path, found)?;
    }
    for migration in migrations.iter().skip(found) {
        apply(&transaction, migration).map_err(|reason| StoreError::Migration {
            path: path.to_owned(),
            migration: migration.name,
            reason,
        })?;
    }
    let target = migrations.len().max(found);
    if target == SCHEMA_VERSION as usize {
        view::renew(&transaction).map_err(failed)?;
    }
    transaction
        .execute_batch(&format!(
            "PRAGMA application_id = {APPLICATION_ID}; PRAGMA user_version = {target};"
        ))
        .and_then(|()| commit(transaction))
        .map_err(failed)
}

/// The version of the schema that the file declares.
pub(super) fn version(connection: &Connection) -> rusqlite::Result<usize> {
    connection.query_row("PRAGMA user_version", [], |row| row.get::<_, u32>(0)).map(|v| v as usize)
}

fn apply(transaction: &Transaction<'_>, migration: &Migration) -> Result<(), String> {
    transaction.execute_batch(migration.sql).map_err(|error| error.to_string())?;
    let dangling = transaction
        .query_row("SELECT count(*) FROM pragma_foreign_key_check", [], |row| row.get::<_, i64>(0))
        .map_err(|error| error.to_string())?;
    if dangling > 0 {
        let verb = if dangling == 1 { "refers" } else { "refer" };
        return Err(format!("{} {verb} to missing rows", counted(dangling, "row")));
    }
    Ok(())
}

/// Copies the last committed state of the store. The caller holds the write lock, so nothing can be committed
/// between the copy and the migration.
fn back_up(path: &Path, version: usize) -> Result<(), StoreError> {
    let backup = unused(path, version);
    // A copy under the final name is always complete.
    let partial = beside(path, &format!(".v{version}.bak.{}", process::id()));
    let copied = copy(path, &partial)
        .and_then(|()| fs::rename(&partial, &backup).map_err(|error| error.to_string()));
    copied.map_err(|reason| {
        // The error takes precedence; the next attempt overwrites a leftover file.
        let _ = fs::remove_file(&partial);
        StoreError::Backup { path: path.to_owned(), backup, reason }
    })
}

/// The first unused name for a backup.
fn unused(path: &Path, version: usize) -> PathBuf {
    let mut backup = beside(path, &format!(".v{version}.bak"));
    let mut number = 2;
    while backup.symlink_metadata().is_ok() {
        backup = beside(path, &format!(".v{version}.{number}.bak"));
        number += 1;
    }
    backup
}

fn copy(path: &Path, target: &Path) -> Result<(), String> {
    if target.exists() {
        fs::remove_file(target).map_err(|error| error.to_string())?;
    }
    let name = target.to_str().ok_or("the path is not UTF-8")?;
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    Connection::open_with_flags(path, flags)
        .and_then(|source| source.execute("VACUUM INTO ?1", [name]))
        .map_err(|error| error.to_string())?;
    File::open(target).and_then(|file| file.sync_all()).map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    const FIRST: Migration = Migration {
        name: "0001_create",
        sql: "CREATE TABLE parent (id INTEGER PRIMARY KEY) STRICT;
              CREATE TABLE child (parent INTEGER REFERENCES parent (id)) STRICT;",
    };
    const REBUILD: Migration = Migration {
        name: "0002_rebuild_parent",
        sql: "CREATE TABLE new (id INTEGER PRIMARY KEY, note TEXT) STRICT;
              INSERT INTO new (id) SELECT id FROM parent;
              DROP TABLE parent;
              ALTER TABLE new RENAME TO parent;",
    };
    const LOSSY: Migration = Migration { name: "0002_lose", sql: "DELETE FROM parent;" };
    const FAULTY: Migration =
        Migration { name: "0002_fault", sql: "CREATE TABLE extra (id INTEGER); SELECT absent;" };

    /// A store of version 1 with a parent and its child.
    fn version_one() -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.sqlite");
        let mut connection = Connection::open(&path).unwrap();
        connection.execute_batch("PRAGMA journal_mode = WAL; PRAGMA foreign_keys = ON;").unwrap();
        migrate(&mut connection, &path, &[FIRST]).unwrap();
        connection
            .execute_batch("INSERT INTO parent VALUES (1); INSERT INTO child VALUES (1);")
            .unwrap();
        (folder, path)
    }

    fn count(connection: &Connection, table: &str) -> i64 {
        connection
            .query_row(&format!("SELECT count(*) FROM {table}"), [], |row| row.get(0))
            .unwrap()
    }

    #[test]
    fn an_older_file_is_copied_and_then_migrated() {
        let (_folder, path) = version_one();
        let mut connection = Connection::open(&path).unwrap();
        migrate(&mut connection, &path, &[FIRST, REBUILD]).unwrap();
        assert_eq!(version(&connection).unwrap(), 2);
        assert_eq!(count(&connection, "parent WHERE note IS NULL"), 1);
        assert!(connection.execute_batch("INSERT INTO child VALUES (7)").is_err());

        let backup = Connection::open(beside(&path, ".v1.bak")).unwrap();
        assert_eq!(version(&backup).unwrap(), 1);
        assert_eq!(count(&backup, "child"), 1);
        assert!(backup.execute_batch("SELECT note FROM parent").is_err());
    }

    #[test]
    fn a_migration_that_fails_leaves_the_file_as_it_was() {
        for (faulty, expected) in [(FAULTY, "no such column"), (LOSSY, "1 row refers")] {
            let (_folder, path) = version_one();
            let mut connection = Connection::open(&path).unwrap();
            let steps: &'static [Migration] = Box::leak(Box::new([FIRST, faulty]));
            let error = migrate(&mut connection, &path, steps).unwrap_err().to_string();
            assert!(error.contains(faulty.name) && error.contains(expected), "{error}");
            assert_eq!(version(&connection).unwrap(), 1);
            assert_eq!(count(&connection, "parent"), 1);
            assert_eq!(count(&connection, "sqlite_schema WHERE name = 'extra'"), 0);
        }
    }

    #[test]
    fn an_earlier_backup_is_kept() {
        let (_folder, path) = version_one();
        fs::write(beside(&path, ".v1.bak"), "precious").unwrap();
        fs::write(beside(&path, ".v1.2.bak"), "too").unwrap();
        let mut connection = Connection::open(&path).unwrap();
        migrate(&mut connection, &path, &[FIRST, REBUILD]).unwrap();
        assert_eq!(fs::read(beside(&path, ".v1.bak")).unwrap(), b"precious");
        assert_eq!(fs::read(beside(&path, ".v1.2.bak")).unwrap(), b"too");
        let backup = Connection::open(beside(&path, ".v1.3.bak")).unwrap();
        assert_eq!((version(&backup).unwrap(), count(&backup, "child")), (1, 1));
    }

    #[test]
    fn a_file_that_is_up_to_date_is_not_copied() {
        let (_folder, path) = version_one();
        let mut connection = Connection::open(&path).unwrap();
        migrate(&mut connection, &path, &[FIRST]).unwrap();
        assert!(!beside(&path, ".v1.bak").exists());
    }

    #[test]
    fn without_a_backup_nothing_is_migrated() {
        let (_folder, path) = version_one();
        fs::create_dir(beside(&path, &format!(".v1.bak.{}", process::id()))).unwrap();
        let mut connection = Connection::open(&path).unwrap();
        let error = migrate(&mut connection, &path, &[FIRST, REBUILD]).unwrap_err();
        assert!(matches!(error, StoreError::Backup { .. }), "{error}");
        assert_eq!(version(&connection).unwrap(), 1);
    }
}
