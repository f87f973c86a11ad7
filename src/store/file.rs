//! Opening the file: checks of what may be opened, and the set-up of connections.
//!
//! A file of another program or of a newer release is recognised before anything is written to it.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use rusqlite::config::DbConfig;
use rusqlite::{Connection, ErrorCode, OpenFlags};

use super::error::StoreError;
use super::migrate::{self, APPLICATION_ID, OLDEST_READABLE, SCHEMA_VERSION};
use super::place::{beside, require_one_name, resolve};
use super::{implied, mount, sandbox, schema};
use crate::job;

/// The number of prepared statements that a connection caches; storing a run uses about thirty.
const STATEMENTS_KEPT: usize = 64;

/// How long a connection waits for a lock. This program holds it for less than a second at a time;
/// other programs may hold it longer.
const BUSY_TIMEOUT: Duration = Duration::from_secs(60);

/// How long a reader waits for an empty file to become a store.
const BEING_MADE: Duration = Duration::from_millis(500);

/// The kind of file at a path.
enum Presence {
    Absent,
    Blank,
    Database,
}

/// A writing connection to the store at `path`, which is created or migrated as needed, and the name of
/// its file.
pub(super) fn open_writer(path: &Path) -> Result<(Connection, PathBuf), StoreError> {
    let path = resolve(path)?;
    look(&path)?;
    require_one_name(&path)?;
    if let Some(kind) = mount::network_file_system(&path) {
        return Err(StoreError::Network { path, kind });
    }
    let flags = OpenFlags::SQLITE_OPEN_READ_WRITE
        | OpenFlags::SQLITE_OPEN_CREATE
        | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let action = "open the store";
    let mut connection = Connection::open_with_flags(&path, flags)
        .map_err(|source| StoreError::sqlite(&path, action, source))?;
    // Closing must not change the file before it is known to be a store.
    set_up(&connection, DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE)
        .and_then(|()| connection.is_readonly("main"))
        .map_err(|source| StoreError::sqlite(&path, action, source))
        .and_then(|fixed| match fixed {
            true => Err(StoreError::ReadOnly { path: path.clone() }),
            false => identify(&connection, &path),
        })?;
    let logged = use_write_ahead_log(&connection)
        .and_then(|logged| configure_writer(&connection).map(|()| logged))
        .map_err(|source| StoreError::sqlite(&path, action, source))?;
    if !logged {
        return Err(StoreError::NoSharing { path });
    }
    migrate::migrate(&mut connection, &path, migrate::MIGRATIONS)?;
    schema::require(&connection, &path)?;
    migrate::renew_views(&mut connection, &path)?;
    implied::declare(&mut connection, &path, &job::implied_parameters())?;
    Ok((connection, path))
}

/// A reading connection to the store at `path`, and the name of its file. The caller checks the schema.
pub(super) fn open_reader(path: &Path) -> Result<(Connection, PathBuf), StoreError> {
    let path = resolve(path)?;
    require_one_log(&path)?;
    Ok((open_reader_at(&path)?, path))
}

/// Like [`open_reader`], for the resolved name of a file that is known to have no log under another name.
pub(super) fn open_reader_at(path: &Path) -> Result<Connection, StoreError> {
    let asked = Instant::now();
    loop {
        match look(path)? {
            Presence::Absent => return Err(StoreError::Missing { path: path.to_owned() }),
            // Another process has just begun to create the store.
            Presence::Blank if asked.elapsed() < BEING_MADE => thread::sleep(BEING_MADE / 50),
            Presence::Blank => return Err(StoreError::Empty { path: path.to_owned() }),
            Presence::Database => break,
        }
    }
    let action = "open the store";
    let connection = match is_sealed(path) {
        true => connect_immutable(path),
        false => connect_reader(path).or_else(|error| match error.sqlite_error_code() {
            Some(ErrorCode::CannotOpen | ErrorCode::ReadOnly) if at_rest(path) => {
                connect_immutable(path)
            }
            _ => Err(error),
        }),
    };
    let connection = connection.map_err(|source| StoreError::sqlite(path, action, source))?;
    let mut found = identify(&connection, path)?;
    // The tables appear with the first transaction.
    while found == 0 && asked.elapsed() < BEING_MADE {
        thread::sleep(BEING_MADE / 50);
        found = identify(&connection, path)?;
    }
    let path = || path.to_owned();
    match found {
        0 => Err(StoreError::Missing { path: path() }),
        found if found < OLDEST_READABLE => {
            Err(StoreError::Older { path: path(), found, known: SCHEMA_VERSION })
        }
        _ => Ok(connection),
    }
}

/// A connection that reads as much as possible of a damaged store.
///
/// **Errors**: [`StoreError::Damaged`] if its header or schema cannot be read; the path is not a regular
/// file, or is a store of a newer release.
pub(super) fn open_damaged(path: &Path) -> Result<Connection, StoreError> {
    let path = resolve(path)?;
    require_one_log(&path)?;
    match look(&path) {
        Ok(Presence::Absent) => return Err(StoreError::Missing { path }),
        Ok(Presence::Blank) => return Err(StoreError::Empty { path }),
        Ok(Presence::Database) => {}
        // A single changed byte in the header can make a store look like another kind of file.
        Err(
            StoreError::NotAStore { .. } | StoreError::Foreign { .. } | StoreError::Sqlite { .. },
        ) if path.is_file() => {}
        Err(error) => return Err(error),
    }
    let damaged = |error: rusqlite::Error| StoreError::Damaged {
        path: path.clone(),
        reason: error.to_string(),
    };
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let connection = Connection::open_with_flags(&path, flags).map_err(damaged)?;
    let ready = connection
        .busy_timeout(BUSY_TIMEOUT)
        .and_then(|()| {
            connection.set_prepared_statement_cache_capacity(STATEMENTS_KEPT);
            connection.set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, true)?;
            connection.set_db_config(DbConfig::SQLITE_DBCONFIG_ENABLE_QPSG, true)?;
            connection.set_db_config(DbConfig::SQLITE_DBCONFIG_TRUSTED_SCHEMA, false)?;
            // Otherwise SQLite reads nothing from a file that is shorter than its header says.
            connection.execute_batch("PRAGMA writable_schema = ON; PRAGMA query_only = ON")
        })
        .and_then(|()| schema::faults(&connection))
        .map_err(damaged)?;
    match ready.into_iter().next() {
        None => Ok(connection),
        Some(reason) => Err(StoreError::Damaged { path, reason }),
    }
}

/// Fails unless the file still has this program's schema version.
pub(super) fn require_current(connection: &Connection, path: &Path) -> Result<(), StoreError> {
    match identify(connection, path)? {
        SCHEMA_VERSION => Ok(()),
        found => Err(StoreError::Older { path: path.to_owned(), found, known: SCHEMA_VERSION }),
    }
}

/// Fails if the file has another name, under which transactions may lie in another log. A file whose header
/// says that it has no write-ahead log, such as a sealed store, is read under any name.
fn require_one_log(path: &Path) -> Result<(), StoreError> {
    let named = require_one_name(path);
    if named.is_err() && at_rest(path) && has_no_log(path) { Ok(()) } else { named }
}

/// Determines the kind of file at `path`, without a lock or additional files.
fn look(path: &Path) -> Result<Presence, StoreError> {
    let not_a_store = |what| StoreError::NotAStore { path: path.to_owned(), what };
    let cannot_open = |error: std::io::Error| StoreError::CannotOpen {
        path: path.to_owned(),
        reason: error.to_string(),
    };
    match fs::metadata(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return absent(path),
        Err(error) => return Err(cannot_open(error)),
        Ok(metadata) if metadata.is_dir() => return Err(not_a_store("a folder, not a store")),
        Ok(metadata) if !metadata.is_file() => {
            return Err(not_a_store("a device or pipe, not a store"));
        }
        Ok(_) => {}
    }
    if fs::metadata(path).map_err(cannot_open)?.len() == 0 {
        return Ok(Presence::Blank);
    }
    // The header is read through SQLite. Closing any descriptor of a file releases all POSIX locks of the
    // process on that file, and only SQLite tracks which locks that would release.
    match header(path) {
        Ok((application_id, version)) => {
            judge(application_id, version, path).map(|()| Presence::Database)
        }
        // A writer may be moving pages from the log into the file: for a moment the header counts
        // more pages than the file has. A connection that takes the locks reads the file correctly.
        Err(error) if error.sqlite_error_code() == Some(ErrorCode::DatabaseCorrupt) => {
            Ok(Presence::Database)
        }
        Err(source) => Err(StoreError::sqlite(path, "open the store", source)),
    }
}

/// The application id and schema version in the file itself, without its write-ahead log.
fn header(path: &Path) -> rusqlite::Result<(u32, u32)> {
    let connection = open_uri(path, IMMUTABLE)?;
    let number = |name| connection.pragma_query_value(None, name, |row| row.get(0));
    Ok((number("application_id")?, number("user_version")?))
}

/// The result for a missing file; fails if its folder is missing, too.
fn absent(path: &Path) -> Result<Presence, StoreError> {
    match path.parent() {
        Some(folder) if !folder.is_dir() => {
            Err(StoreError::MissingFolder { path: path.to_owned(), folder: folder.to_owned() })
        }
        _ => Ok(Presence::Absent),
    }
}

/// Fails unless a file with these numbers is a store of this or an earlier release, or a new file without
/// numbers.
fn judge(application_id: u32, version: u32, path: &Path) -> Result<(), StoreError> {
    match (application_id, version) {
        (0, 0) => Ok(()),
        (APPLICATION_ID, 1..) if version > SCHEMA_VERSION => {
            Err(StoreError::Newer { path: path.to_owned(), found: version, known: SCHEMA_VERSION })
        }
        (APPLICATION_ID, 1..) => Ok(()),
        _ => Err(StoreError::Foreign { path: path.to_owned() }),
    }
}

/// The schema version of the file; 0 for an empty file.
fn identify(connection: &Connection, path: &Path) -> Result<u32, StoreError> {
    // A single statement sees a consistent state, even while other processes are creating the store.
    let (application_id, version, named) = connection
        .prepare_cached(
            "SELECT application_id, user_version, EXISTS (SELECT 1 FROM sqlite_schema)
             FROM pragma_application_id, pragma_user_version",
        )
        .and_then(|mut statement| {
            statement.query_row([], |row| {
                Ok((row.get::<_, u32>(0)?, row.get::<_, u32>(1)?, row.get::<_, bool>(2)?))
            })
        })
        .map_err(|source| StoreError::sqlite(path, "open the store", source))?;
    judge(application_id, version, path)?;
    if version == 0 && named {
        return Err(StoreError::Foreign { path: path.to_owned() });
    }
    Ok(version)
}

fn set_up(connection: &Connection, flag: DbConfig) -> rusqlite::Result<()> {
    connection.busy_timeout(BUSY_TIMEOUT)?;
    connection.set_prepared_statement_cache_capacity(STATEMENTS_KEPT);
    connection.set_db_config(flag, true)?;
    // Otherwise SQLite recompiles a cached statement at every use, because its plan might depend on a bound
    // value. This would take half the time of storing a short job.
    connection.set_db_config(DbConfig::SQLITE_DBCONFIG_ENABLE_QPSG, true)?;
    connection.set_db_config(DbConfig::SQLITE_DBCONFIG_DQS_DML, false)?;
    connection.set_db_config(DbConfig::SQLITE_DBCONFIG_DEFENSIVE, true)?;
    // Detects a page whose cells exceed it as soon as the page is read.
    connection.pragma_update(None, "cell_size_check", true)
}

/// Switches to a write-ahead log; returns whether the file has one now.
fn use_write_ahead_log(connection: &Connection) -> rusqlite::Result<bool> {
    let deadline = Instant::now() + BUSY_TIMEOUT;
    loop {
        let mode =
            connection.query_row("PRAGMA journal_mode = WAL", [], |row| row.get::<_, String>(0));
        match mode {
            // SQLite does not itself wait for another process that is changing the mode.
            Err(error)
                if error.sqlite_error_code() == Some(ErrorCode::DatabaseBusy)
                    && Instant::now() < deadline =>
            {
                thread::sleep(Duration::from_millis(20));
            }
            other => return other.map(|mode| mode == "wal"),
        }
    }
}

fn configure_writer(connection: &Connection) -> rusqlite::Result<()> {
    connection.set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, false)?;
    // With a write-ahead log, NORMAL loses nothing if the process is killed, and at most the last
    // transactions in a power failure; ends of runs are written with FULL. The cache holds the index of job
    // keys while a million of them are registered. The log is checkpointed every 64 MiB, so that pages that
    // change often are copied once.
    connection.execute_batch(
        "PRAGMA synchronous = NORMAL;
         PRAGMA foreign_keys = ON;
         PRAGMA cache_size = -65536;
         PRAGMA wal_autocheckpoint = 16384;
         PRAGMA journal_size_limit = 67108864;",
    )
}

/// A reading connection to a store that this process has already opened.
pub(super) fn connect_reader(path: &Path) -> rusqlite::Result<Connection> {
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let connection = Connection::open_with_flags(path, flags)?;
    configure_reader(&connection)?;
    Ok(connection)
}

/// Whether a store is sealed: no process may write to its file, and all data is in the file. A sealed store
/// is read without locks and without additional files, even from a shared folder.
fn is_sealed(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|metadata| metadata.permissions().readonly()) && at_rest(path)
}

/// Whether there is no write-ahead log with data, so that all data is in the one file.
fn at_rest(path: &Path) -> bool {
    fs::metadata(beside(path, "-wal")).map_or(true, |metadata| metadata.len() == 0)
}

/// Whether the header says that the file has no write-ahead log. Without locks, SQLite cannot open a log.
fn has_no_log(path: &Path) -> bool {
    let opened = open_uri(path, "mode=ro&nolock=1");
    opened.and_then(|file| file.query_row("SELECT 1 FROM sqlite_schema", [], |_| Ok(()))).is_ok()
}

/// A connection without locks and additional files, for folders in which this process cannot create the files
/// that readers share with a writer.
fn connect_immutable(path: &Path) -> rusqlite::Result<Connection> {
    let connection = open_uri(path, IMMUTABLE)?;
    configure_reader(&connection)?;
    Ok(connection)
}

/// Reads a file that no process changes.
const IMMUTABLE: &str = "immutable=1";

fn open_uri(path: &Path, settings: &str) -> rusqlite::Result<Connection> {
    let mut uri = String::from("file:");
    for byte in path.as_os_str().as_encoded_bytes() {
        match byte {
            b'/' | b'.' | b'-' | b'_' | b'0'..=b'9' | b'a'..=b'z' | b'A'..=b'Z' => {
                uri.push(char::from(*byte));
            }
            other => uri.push_str(&format!("%{other:02x}")),
        }
    }
    uri.push_str(&format!("?{settings}"));
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY
        | OpenFlags::SQLITE_OPEN_NO_MUTEX
        | OpenFlags::SQLITE_OPEN_URI;
    Connection::open_with_flags(uri, flags)
}

fn configure_reader(connection: &Connection) -> rusqlite::Result<()> {
    set_up(connection, DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE)?;
    connection.set_db_config(DbConfig::SQLITE_DBCONFIG_TRUSTED_SCHEMA, false)?;
    sandbox::add_functions(connection)?;
    connection.execute_batch("PRAGMA query_only = ON")?;
    // The first read determines whether the write-ahead log can be used.
    connection.query_row("SELECT count(*) FROM sqlite_schema", [], |_| Ok(()))
}
