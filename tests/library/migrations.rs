//! The migrations, replayed on a store with data: sample rows of each version
//! (`tests/data/migrations/NNNN.sql`) follow its migration, and the next migration must handle these
//! rows.

use std::fs;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use jitai::store::{Answer, Reader, SCHEMA_VERSION, Store};
use rusqlite::Connection;

/// The files of the migrations, in order.
fn migrations() -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> = fs::read_dir(root().join("migrations"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|ending| ending == "sql"))
        .collect();
    files.sort();
    files
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// A store that began at version 1 and went through every version up to `last`, with sample rows of
/// each version.
fn replay(path: &Path, last: usize) -> Connection {
    let connection = Connection::open(path).unwrap();
    connection.execute_batch("PRAGMA journal_mode = WAL").unwrap();
    for (version, migration) in (1..=last).zip(migrations()) {
        let sample = root().join(format!("tests/data/migrations/{version:04}.sql"));
        connection
            .execute_batch(&format!(
                "PRAGMA foreign_keys = OFF; BEGIN;
                 {}
                 PRAGMA application_id = {}; PRAGMA user_version = {version}; COMMIT;
                 PRAGMA foreign_keys = ON;
                 {}",
                fs::read_to_string(&migration).unwrap(),
                i32::from_be_bytes(*b"JITA"),
                fs::read_to_string(&sample)
                    .unwrap_or_else(|error| panic!("{}: {error}", sample.display())),
            ))
            .unwrap_or_else(|error| panic!("{}: {error}", migration.display()));
    }
    connection
}

/// A migration killed at any of its writes leaves an incomplete write-ahead log beside the file.
#[test]
fn a_migration_that_was_interrupted_is_undone_and_done_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.sqlite");
    drop(replay(&path, SCHEMA_VERSION as usize));
    drop(Store::open(&path).unwrap());
    let connection = Connection::open(&path).unwrap();
    connection.execute_batch("PRAGMA wal_autocheckpoint = 0").unwrap();
    let (main, before) = (fs::read(&path).unwrap(), schema(&connection));
    connection
        .execute_batch(
            "BEGIN; CREATE TABLE next (id INTEGER PRIMARY KEY, note TEXT) STRICT;
             INSERT INTO next (note) SELECT canonical FROM job; DROP VIEW metric; COMMIT",
        )
        .unwrap();
    let log = fs::read(folder.path().join("a.sqlite-wal")).unwrap();
    // Without its last bytes, the log does not contain the end of the transaction.
    for cut in (0..log.len()).step_by(509).chain([log.len() - 1]) {
        let copy = folder.path().join(format!("cut-{cut}.sqlite"));
        fs::write(&copy, &main).unwrap();
        fs::write(folder.path().join(format!("cut-{cut}.sqlite-wal")), &log[..cut]).unwrap();
        drop(Store::open(&copy).unwrap());
        let opened = Connection::open(&copy).unwrap();
        check(&opened);
        assert_eq!(schema(&opened), before, "cut to {cut} bytes");
    }
}

/// The rows of a view come from its file in `migrations/views/`, whatever the store has under its name.
#[test]
fn a_view_with_another_text_is_made_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.sqlite");
    drop(replay(&path, SCHEMA_VERSION as usize));
    drop(Store::open(&path).unwrap());
    let count = |path: &Path| {
        let mut counts = Vec::new();
        let sql =
            "SELECT (SELECT count(*) FROM metric), (SELECT count(episode) FROM evaluation_episode)";
        let see = |answer: Answer<'_>| {
            if let Answer::Row(values) = answer {
                counts.push(format!("{values:?}"));
            }
            ControlFlow::Continue(())
        };
        Reader::open(path).unwrap().query(sql, see).unwrap();
        counts
    };
    let connection = Connection::open(&path).unwrap();
    let (before, counted) = (schema(&connection), count(&path));
    connection
        .execute_batch(
            "DROP VIEW metric; CREATE VIEW metric AS SELECT 1 AS job_key WHERE 0;
             DROP VIEW evaluation_episode; PRAGMA wal_checkpoint(TRUNCATE)",
        )
        .unwrap();
    let changed = schema(&connection);
    assert_eq!(count(&path), counted);
    assert_eq!(schema(&connection), changed, "a reader writes nothing");
    drop(Store::open(&path).unwrap());
    assert_eq!(schema(&connection), before);
}

/// Stores that earlier versions and releases wrote, in `tests/data/stores/`, and a store of
/// this version, which the test creates.
#[test]
fn the_stores_of_all_versions_are_migrated_after_a_backup_and_read() {
    let folder = tempfile::tempdir().unwrap();
    let newest = folder.path().join("newest.sqlite");
    drop(replay(&newest, SCHEMA_VERSION as usize));
    let written = fs::read_dir(root().join("tests/data/stores")).unwrap();
    let mut stores: Vec<PathBuf> = written.map(|entry| entry.unwrap().path()).collect();
    stores.retain(|path| path.extension().is_some_and(|ending| ending == "sqlite"));
    assert!(!stores.is_empty());
    stores.push(newest);
    for store in stores {
        let path = folder.path().join("a.sqlite");
        fs::copy(&store, &path).unwrap();
        let version: u32 = Connection::open(&path)
            .unwrap()
            .query_row("PRAGMA user_version", [], |row| row.get(0))
            .unwrap();
        drop(Store::open(&path).unwrap());
        let backup = folder.path().join(format!("a.sqlite.v{version}.bak"));
        assert_eq!(backup.exists(), version < SCHEMA_VERSION, "{}", store.display());
        check(&Connection::open(&path).unwrap());
        assert!(!Reader::open(&path).unwrap().experiment_counts().unwrap().is_empty());
        fs::remove_file(&path).unwrap();
    }
}

fn check(connection: &Connection) {
    let dangling: i64 = connection
        .query_row("SELECT count(*) FROM pragma_foreign_key_check", [], |row| row.get(0))
        .unwrap();
    assert_eq!(dangling, 0);
    let integrity: String =
        connection.query_row("PRAGMA integrity_check", [], |row| row.get(0)).unwrap();
    assert_eq!(integrity, "ok");
}

fn schema(connection: &Connection) -> Vec<(String, Option<String>)> {
    let mut statement =
        connection.prepare("SELECT name, sql FROM sqlite_schema ORDER BY name").unwrap();
    let rows = statement.query_map([], |row| Ok((row.get(0)?, row.get(1)?))).unwrap();
    rows.collect::<rusqlite::Result<_>>().unwrap()
}

#[test]
fn migrations_are_numbered_from_one_and_all_are_compiled_in() {
    let files = migrations();
    assert_eq!(files.len(), SCHEMA_VERSION as usize);
    for (number, file) in (1..).zip(&files) {
        let name = file.file_stem().unwrap().to_str().unwrap();
        assert!(name.starts_with(&format!("{number:04}_")), "{name}");
    }
}

#[test]
fn every_earlier_version_with_its_rows_becomes_the_newest() {
    let folder = tempfile::tempdir().unwrap();
    let fresh = folder.path().join("fresh.sqlite");
    drop(Store::open(&fresh).unwrap());
    let expected = schema(&Connection::open(&fresh).unwrap());

    for last in 1..=SCHEMA_VERSION as usize {
        let path = folder.path().join(format!("from-{last}.sqlite"));
        check(&replay(&path, last));
        drop(Store::open(&path).unwrap());
        let connection = Connection::open(&path).unwrap();
        check(&connection);
        assert_eq!(schema(&connection), expected, "from version {last}");
    }
}

#[test]
fn the_rows_of_the_first_version_still_say_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.sqlite");
    drop(replay(&path, 1));
    drop(Store::open(&path).unwrap());

    let reader = Reader::open(&path).unwrap();
    let counts = reader.experiment_counts().unwrap().remove(0).counts;
    assert_eq!((counts.completed, counts.failed, counts.interrupted), (1, 1, 1));
    let failed = reader.failed_jobs().unwrap().remove(0);
    assert_eq!(failed.failure.message, "the loss is not a number");

    let lines = |sql: &str| {
        let connection = Connection::open(&path).unwrap();
        let mut statement = connection.prepare(sql).unwrap();
        let rows = statement.query_map([], |row| row.get::<_, String>(0)).unwrap();
        rows.collect::<rusqlite::Result<Vec<_>>>().unwrap()
    };
    assert_eq!(
        lines(
            "SELECT concat_ws(' ', agent, scenario, sigma, seed, status, attempt, mean_return)
             FROM run_summary WHERE experiment = 'quickstart' ORDER BY job_key, attempt"
        ),
        [
            "dqn P-H-D 0.4 1 completed 1 2583.5",
            "reinforce L-T 0.6 2 failed 1",
            "reinforce L-T 0.6 3 interrupted 1",
            "reinforce L-T 0.6 3 interrupted 2",
        ]
    );
    assert_eq!(
        lines("SELECT concat_ws(' ', episode, metric, value) FROM learning_curve ORDER BY 1"),
        ["10 mean_return 1200.0", "20 mean_return 1300.5"]
    );
    assert_eq!(
        lines(
            "SELECT concat_ws(' ', episode, total_reward, length, disengaged)
             FROM evaluation_episode ORDER BY 1"
        ),
        ["1 2500.0 50 0", "2 310.0 7 1"]
    );
    assert_eq!(
        lines(
            "SELECT concat_ws(' ', p_low, p_high, context, action, count)
             FROM action_choice ORDER BY 1"
        ),
        ["0.0 0.1 1 3 40", "0.9 1.0 0 2 17"]
    );
}
