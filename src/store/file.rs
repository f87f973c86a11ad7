//! Opening the file: what may be opened, and how a connection is set up.
//!
//! A file of another program or of a newer release is recognised before anything is written to it.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use rusqlite::config::DbConfig;
use rusqlite::{Connection, ErrorCode, OpenFlags};

use super::beside::beside;
use super::error::StoreError;
use super::migrate::{self, APPLICATION_ID, OLDEST_READABLE, SCHEMA_VERSION};
use super::{implied, mount, sandbox, schema};
use crate::plan;

/// Prepared statements that a connection caches; storing a run uses about thirty.
const STATEMENTS_KEPT: usize = 64;

/// How long a connection waits for a lock. This program holds it for less than a second at a time;
/// other programs may hold it longer.
const BUSY_TIMEOUT: Duration = Duration::from_secs(60);

/// How long a reader waits for an empty file to become a store.
const BEING_MADE: Duration = Duration::from_millis(500);

/// What is at a path.
enum Presence {
    Absent,
    Blank,
    Database,
}

/// A writing connection to the store at `path`, which is made or migrated as needed, and the
/// absolute path.
pub(super) fn open_writer(path: &Path) -> Result<(Connection, PathBuf), StoreError> {
    let path = absolute(path)?;
    look(&path)?;
    if let Some(kind) = mount::network_file_system(&path) {
        return Err(StoreError::Network { path, kind });
    }
    let flags = OpenFlags::SQLITE_OPEN_READ_WRITE
        | OpenFlags::SQLITE_OPEN_CREATE
        | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let action = "open the store";
    let mut connection = Connection::open_with_flags(&path, flags)
        .map_err(|source| StoreError::sqlite(&path, action, source))?;
    // Closing must not touch the file before it is known to be ours.
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
    implied::declare(&mut connection, &path, &plan::implied_parameters())?;
    Ok((connection, path))
}

/// A reading connection to the store at `path`, and the absolute path. The caller checks the
/// schema.
pub(super) fn open_reader(path: &Path) -> Result<(Connection, PathBuf), StoreError> {
    let path = absolute(path)?;
    let asked = Instant::now();
    loop {
        match look(&path)? {
            Presence::Absent => return Err(StoreError::Missing { path }),
            // A store that another process has just begun to make.
            Presence::Blank if asked.elapsed() < BEING_MADE => thread::sleep(BEING_MADE / 50),
            Presence::Blank => return Err(StoreError::Empty { path }),
            Presence::Database => break,
        }
    }
    let action = "open the store";
    let connection = match is_sealed(&path) {
        true => connect_immutable(&path),
        false => connect_reader(&path).or_else(|error| match error.sqlite_error_code() {
            Some(ErrorCode::CannotOpen | ErrorCode::ReadOnly) if at_rest(&path) => {
                connect_immutable(&path)
            }
            _ => Err(error),
        }),
    };
    let connection = connection.map_err(|source| StoreError::sqlite(&path, action, source))?;
    let mut found = identify(&connection, &path)?;
    // Its tables come with the first transaction.
    while found == 0 && asked.elapsed() < BEING_MADE {
        thread::sleep(BEING_MADE / 50);
        found = identify(&connection, &path)?;
    }
    match found {
        0 => Err(StoreError::Missing { path }),
        found if found < OLDEST_READABLE => {
            Err(StoreError::Older { path, found, known: SCHEMA_VERSION })
        }
        _ => Ok((connection, path)),
    }
}

/// A connection that reads whatever can be read of a damaged store.
///
/// **Errors**: [`StoreError::Damaged`] if its header or schema cannot be read; it is no regular
/// file, or a store of a newer release.
pub(super) fn open_damaged(path: &Path) -> Result<Connection, StoreError> {
    let path = absolute(path)?;
    match look(&path) {
        Ok(Presence::Absent) => return Err(StoreError::Missing { path }),
        Ok(Presence::Blank) => return Err(StoreError::Empty { path }),
        Ok(Presence::Database) => {}
        // One changed byte of the header makes a store look like any of these.
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
            // Without it SQLite reads nothing of a file that is shorter than its header says.
            connection.execute_batch("PRAGMA writable_schema = ON; PRAGMA query_only = ON")
        })
        .and_then(|()| schema::faults(&connection))
        .map_err(damaged)?;
    match ready.into_iter().next() {
        None => Ok(connection),
        Some(reason) => Err(StoreError::Damaged { path, reason }),
    }
}

/// Fails unless the file still has the schema of this program.
pub(super) fn require_current(connection: &Connection, path: &Path) -> Result<(), StoreError> {
    match identify(connection, path)? {
        SCHEMA_VERSION => Ok(()),
        found => Err(StoreError::Older { path: path.to_owned(), found, known: SCHEMA_VERSION }),
    }
}

/// `path` from the root, so that SQLite never takes it for a URI or a name with a meaning.
fn absolute(path: &Path) -> Result<PathBuf, StoreError> {
    std::path::absolute(path).map_err(|error| StoreError::CannotOpen {
        path: path.to_owned(),
        reason: error.to_string(),
    })
}

/// What is at `path`, without a lock and without a file beside it.
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
    // By SQLite, not by reading the file: POSIX drops every lock of a process on a file as soon as
    // any descriptor of it is closed, and only SQLite knows which of its locks that would cost.
    match header(path) {
        Ok((application_id, version)) => {
            judge(application_id, version, path).map(|()| Presence::Database)
        }
        // A writer may be moving pages from the log into the file: for a moment the header counts
        // more pages than there are. Whoever opens the file with its locks sees what it is.
        Err(error) if error.sqlite_error_code() == Some(ErrorCode::DatabaseCorrupt) => {
            Ok(Presence::Database)
        }
        Err(source) => Err(StoreError::sqlite(path, "open the store", source)),
    }
}

/// Application id and schema version in the file itself, whatever its log says.
fn header(path: &Path) -> rusqlite::Result<(u32, u32)> {
    let connection = open_immutable(path)?;
    let number = |name| connection.pragma_query_value(None, name, |row| row.get(0));
    Ok((number("application_id")?, number("user_version")?))
}

/// Nothing is at `path`; fails if its folder is missing, too.
fn absent(path: &Path) -> Result<Presence, StoreError> {
    match path.parent() {
        Some(folder) if !folder.is_dir() => {
            Err(StoreError::MissingFolder { path: path.to_owned(), folder: folder.to_owned() })
        }
        _ => Ok(Presence::Absent),
    }
}

/// Fails unless a file with these numbers is a store of this release or an earlier one, or so new
/// that it has no numbers yet.
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

/// The schema version of the file, 0 for an empty one.
fn identify(connection: &Connection, path: &Path) -> Result<u32, StoreError> {
    // One statement sees one state of the file, however many processes are making it right now.
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
    // Else SQLite compiles a kept statement again at each use, for the plan might depend on a bound
    // value: half of what storing a short job takes.
    connection.set_db_config(DbConfig::SQLITE_DBCONFIG_ENABLE_QPSG, true)?;
    connection.set_db_config(DbConfig::SQLITE_DBCONFIG_DQS_DML, false)?;
    connection.set_db_config(DbConfig::SQLITE_DBCONFIG_DEFENSIVE, true)?;
    // A page whose rows do not fit into it is seen when it is read.
    connection.pragma_update(None, "cell_size_check", true)
}

/// Whether the file now has a write-ahead log.
fn use_write_ahead_log(connection: &Connection) -> rusqlite::Result<bool> {
    let deadline = Instant::now() + BUSY_TIMEOUT;
    loop {
        let mode =
            connection.query_row("PRAGMA journal_mode = WAL", [], |row| row.get::<_, String>(0));
        match mode {
            // SQLite does not wait by itself for another process that is changing the mode.
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
    // With a write-ahead log, NORMAL loses nothing when the process is killed and at most the last
    // transactions when the power fails; ends of runs are written with FULL. The cache keeps the
    // index of job keys in memory while a million of them are registered, and the log is copied
    // into the file every 64 MiB, so that pages written again and again are copied once.
    connection.execute_batch(
        "PRAGMA synchronous = NORMAL;
         PRAGMA foreign_keys = ON;
         PRAGMA cache_size = -65536;
         PRAGMA wal_autocheckpoint = 16384;
         PRAGMA journal_size_limit = 67108864;",
    )
}

/// A reading connection to a store that this process has open already.
pub(super) fn connect_reader(path: &Path) -> rusqlite::Result<Connection> {
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let connection = Connection::open_with_flags(path, flags)?;
    configure_reader(&connection)?;
    Ok(connection)
}

/// Whether a store never changes again: no process may write to its file, and all of it is in the
/// file. It is read without a lock and without a file beside it, even from a shared folder.
fn is_sealed(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|metadata| metadata.permissions().readonly()) && at_rest(path)
}

/// Whether no log of changes lies beside the store: then all of it is in its one file.
fn at_rest(path: &Path) -> bool {
    fs::metadata(beside(path, "-wal")).map_or(true, |metadata| metadata.len() == 0)
}

/// A connection that asks for no lock and no file beside the store: for folders in which this
/// process cannot make the files that readers share with a writer.
fn connect_immutable(path: &Path) -> rusqlite::Result<Connection> {
    let connection = open_immutable(path)?;
    configure_reader(&connection)?;
    Ok(connection)
}

fn open_immutable(path: &Path) -> rusqlite::Result<Connection> {
    let mut uri = String::from("file:");
    for byte in path.as_os_str().as_encoded_bytes() {
        match byte {
            b'/' | b'.' | b'-' | b'_' | b'0'..=b'9' | b'a'..=b'z' | b'A'..=b'Z' => {
                uri.push(char::from(*byte));
            }
            other => uri.push_str(&format!("%{other:02x}")),
        }
    }
    uri.push_str("?immutable=1");
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
    // The first read is what finds out whether the log beside the file can be used.
    connection.query_row("SELECT count(*) FROM sqlite_schema", [], |_| Ok(()))
}
