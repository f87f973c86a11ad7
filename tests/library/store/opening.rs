//! Files that can be opened as stores, and files that are rejected without a trace.

use std::fs;
use std::path::{Path, PathBuf};
use std::thread;

use jitai::store::{Reader, SCHEMA_VERSION, Store, StoreError};
use rusqlite::Connection;

use super::sample::{Sample, completed, dqn, experiment, raw};

fn refused(path: &Path, expected: &str) {
    let write = Store::open(path).unwrap_err().to_string();
    let read = Reader::open(path).unwrap_err().to_string();
    for error in [write, read] {
        assert!(error.contains(expected), "{error}");
        assert!(error.contains(path.to_str().unwrap()), "{error}");
    }
}

/// The names and bytes of everything in a folder.
fn contents(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut files: Vec<_> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .map(|path| (path.clone(), fs::read(path).unwrap()))
        .collect();
    files.sort();
    files
}

#[test]
fn a_store_of_a_newer_release_is_left_untouched() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.sqlite");
    drop(Store::open(&path).unwrap());
    raw(&path).execute_batch(&format!("PRAGMA user_version = {}", SCHEMA_VERSION + 1)).unwrap();
    let before = contents(folder.path());
    assert_eq!(before.len(), 1);
    refused(&path, &format!("schema version {}", SCHEMA_VERSION + 1));
    assert_eq!(contents(folder.path()), before);
}

#[test]
fn a_store_whose_newer_version_is_still_in_the_log_is_left_untouched() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.sqlite");
    drop(Store::open(&path).unwrap());
    let newer = raw(&path);
    newer.execute_batch(&format!("PRAGMA user_version = {}", SCHEMA_VERSION + 1)).unwrap();
    let before = contents(folder.path());
    refused(&path, &format!("schema version {}", SCHEMA_VERSION + 1));
    // The index of the log (-shm) contains locks and is not part of the data.
    let data = |files: Vec<(PathBuf, Vec<u8>)>| -> Vec<_> {
        files.into_iter().filter(|(path, _)| !path.to_str().unwrap().ends_with("-shm")).collect()
    };
    assert_eq!(data(contents(folder.path())), data(before));
}

#[test]
fn a_store_that_was_migrated_under_a_running_program_is_not_written() {
    let mut sample = Sample::with(&[dqn(0.4, 1)]);
    let claim = sample.claim(&dqn(0.4, 1));
    sample.raw().execute_batch(&format!("PRAGMA user_version = {}", SCHEMA_VERSION + 1)).unwrap();
    let error = sample.store.finish(&claim, &completed(), 1.0).unwrap_err();
    assert!(matches!(error, StoreError::Newer { .. }), "{error}");
}

#[test]
fn a_damaged_store_is_left_untouched_although_its_views_differ() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.sqlite");
    drop(Store::open(&path).unwrap());
    let raw = Connection::open(&path).unwrap();
    raw.execute_batch("DROP VIEW metric").unwrap();
    let trigger = "SELECT name FROM sqlite_schema WHERE type = 'trigger' ORDER BY name LIMIT 1";
    let trigger: String = raw.query_row(trigger, [], |row| row.get(0)).unwrap();
    raw.execute_batch(&format!("DROP TRIGGER {trigger}")).unwrap();
    drop(raw);
    let before = contents(folder.path());
    let error = Store::open(&path).unwrap_err();
    assert!(matches!(error, StoreError::Damaged { .. }), "{error}");
    assert_eq!(contents(folder.path()), before);
}

#[test]
fn a_database_of_another_program_is_left_untouched() {
    for schema in [
        "CREATE TABLE note (text TEXT)",
        "PRAGMA application_id = 1234; CREATE TABLE note (text TEXT)",
        "PRAGMA user_version = 1",
        "PRAGMA journal_mode = WAL; CREATE TABLE note (text TEXT)",
    ] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notes.sqlite");
        Connection::open(&path).unwrap().execute_batch(schema).unwrap();
        let before = contents(folder.path()).remove(0);
        refused(&path, "a SQLite file of another program");
        assert_eq!(contents(folder.path()).remove(0), before, "{schema}");
    }
}

#[test]
fn what_is_no_database_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        fs::write(&path, bytes).unwrap();
        path
    };
    let message = "; name another file with --store";
    refused(&file("notes.txt", b"hello"), message);
    refused(&file("long.txt", &[b'x'; 5000]), message);
    refused(&file("cut.sqlite", b"SQLite format 3\0"), message);
    refused(folder.path(), "is a folder, not a store");
    refused(&folder.path().join("absent/a.sqlite"), "create it first");
    refused(Path::new("/dev/null"), "is a device or pipe, not a store");
    assert_eq!(fs::read(folder.path().join("notes.txt")).unwrap(), b"hello");
}

#[test]
fn a_store_that_gets_a_second_name_while_it_is_open_stays_usable_under_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let (path, link) = (folder.path().join("a.sqlite"), folder.path().join("link.sqlite"));
    std::os::unix::fs::symlink("a.sqlite", &link).unwrap();
    let mut store = Store::open(&link).unwrap();
    assert_eq!(store.path(), path.canonicalize().unwrap());
    let second = folder.path().join("second.sqlite");
    fs::hard_link(&path, &second).unwrap();
    store.register(&experiment("sweep"), [("dqn", dqn(0.4, 1))]).unwrap();
    assert_eq!(store.reader().unwrap().experiment_counts().unwrap()[0].counts.pending, 1);
    for other in [&path, &link, &second] {
        assert!(matches!(Store::open(other), Err(StoreError::HardLinked { names: 2, .. })));
        assert!(matches!(Reader::open(other), Err(StoreError::HardLinked { names: 2, .. })));
    }
    drop(store);
    fs::remove_file(&second).unwrap();
    assert_eq!(Reader::open(&link).unwrap().experiment_counts().unwrap()[0].counts.pending, 1);
}

#[cfg(target_os = "linux")]
#[test]
fn a_place_that_cannot_be_written_is_refused() {
    let error = Store::open(Path::new("/proc/jitai.sqlite")).unwrap_err().to_string();
    assert!(error.starts_with("cannot open `/proc/jitai.sqlite`: "), "{error}");
    assert!(error.ends_with("the permissions of the file and its folder"), "{error}");
}

#[test]
fn a_reader_never_makes_a_store() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.sqlite");
    assert!(matches!(Reader::open(&path), Err(StoreError::Missing { .. })));
    assert!(!path.exists());
    fs::write(&path, b"").unwrap();
    assert!(matches!(Reader::open(&path), Err(StoreError::Empty { .. })));
    drop(Store::open(&path).unwrap());
    Reader::open(&path).unwrap();
}

#[test]
fn a_name_is_never_taken_for_an_address() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["file:a?mode=memory", ":memory:", "a b%20#?.sqlite"] {
        let path = folder.path().join(name);
        drop(Store::open(&path).unwrap());
        assert!(path.is_file(), "{name}");
        Reader::open(&path).unwrap();
    }
}

#[test]
fn many_that_open_a_new_store_at_once_make_it_once() {
    for _ in 0..5 {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.sqlite");
        thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| Store::open(&path).unwrap());
            }
        });
        Reader::open(&path).unwrap();
    }
}

#[test]
fn a_closed_store_is_one_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.sqlite");
    drop(Store::open(&path).unwrap());
    assert_eq!(contents(folder.path()).len(), 1);
}

#[test]
fn a_reader_does_not_wait_for_a_writer() {
    let sample = Sample::with(&[dqn(0.4, 1)]);
    let writer = sample.raw();
    writer.execute_batch("BEGIN IMMEDIATE; DELETE FROM experiment_job;").unwrap();
    let reader = Reader::open(&sample.path).unwrap();
    assert_eq!(reader.experiment_counts().unwrap()[0].counts.pending, 1);
    writer.execute_batch("COMMIT").unwrap();
    assert_eq!(reader.experiment_counts().unwrap()[0].counts.pending, 0);
}
