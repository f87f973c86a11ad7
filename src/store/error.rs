//! Errors of the store; every message says what to do.

use std::io;
use std::path::{Path, PathBuf};

use rusqlite::ErrorCode;

use crate::job::JobKey;

const NO_SQLITE_FILE: &str = "not a SQLite file (if it was a store, `jitai doctor --salvage NEW` \
     copies its intact runs to a new store)";

/// Why an operation on the store failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StoreError {
    /// The system started no thread.
    #[error("failed to start a thread: {0}; end other programs or raise the limit on threads")]
    NoThread(#[source] io::Error),
    /// The file does not exist.
    #[error(
        "there is no store at `{}`; create it with `jitai run`, or name another store with --store",
        .path.display()
    )]
    Missing {
        /// The path.
        path: PathBuf,
    },
    /// The file is empty.
    #[error(
        "`{}` is an empty file; `jitai run` turns it into a store; --store names another store",
        .path.display()
    )]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// The folder that should hold the store does not exist.
    #[error(
        "there is no folder `{}` for a store at `{}`; create it first, or name another store with \
         --store",
        .folder.display(), .path.display()
    )]
    MissingFolder {
        /// The store's path.
        path: PathBuf,
        /// The missing folder.
        folder: PathBuf,
    },
    /// The path is not a SQLite file.
    #[error("`{}` is {what}; name another file with --store", .path.display())]
    NotAStore {
        /// The path.
        path: PathBuf,
        /// What the path is.
        what: &'static str,
    },
    /// The file is a SQLite database of another program.
    #[error(
        "`{}` is a SQLite file of another program; it was not changed; name another file with --store",
        .path.display()
    )]
    Foreign {
        /// The path.
        path: PathBuf,
    },
    /// The store was written by a newer release.
    #[error(
        "`{}` has schema version {found}, but this jitai supports versions up to {known}; it was not \
         changed; use the newer jitai that wrote it",
        .path.display()
    )]
    Newer {
        /// The path.
        path: PathBuf,
        /// The file's schema version.
        found: u32,
        /// The newest version that this program supports.
        known: u32,
    },
    /// A key declares another value `before` than the program that wrote the store.
    #[error(
        "in `{}`, jobs without `{parameter}` mean {stored}, but this jitai declares another value; \
         it was not changed; use the jitai that wrote it",
        .path.display()
    )]
    Reinterpreted {
        /// The path.
        path: PathBuf,
        /// The parameter's dotted name.
        parameter: String,
        /// The value in the store, as an SQL literal.
        stored: String,
    },
    /// The store was written by an older release, and is opened for reading only.
    #[error(
        "`{}` has schema version {found}, but this jitai reads version {known}; `jitai run` makes a \
         backup copy and migrates it",
        .path.display()
    )]
    Older {
        /// The path.
        path: PathBuf,
        /// The file's schema version.
        found: u32,
        /// The version that this program reads.
        known: u32,
    },
    /// The file or its folder cannot be opened.
    #[error(
        "cannot open `{}`: {reason}; check the path, and the permissions of the file and its folder",
        .path.display()
    )]
    CannotOpen {
        /// The path.
        path: PathBuf,
        /// The error of the system.
        reason: String,
    },
    /// The file can be read but not written.
    #[error(
        "`{}` cannot be written; check the permissions of the file and its folder, or name another \
         file with --store",
        .path.display()
    )]
    ReadOnly {
        /// The path.
        path: PathBuf,
    },
    /// The file system cannot share a database between processes.
    #[error(
        "the file system of `{}` cannot keep a write-ahead log; put the store on a local disk",
        .path.display()
    )]
    NoSharing {
        /// The path.
        path: PathBuf,
    },
    /// The file is on a network file system.
    #[error(
        "`{}` is on a network file system ({kind}), where SQLite cannot rely on locks; put the \
         store on a local disk, and copy it there when its jobs have run",
        .path.display()
    )]
    Network {
        /// The path.
        path: PathBuf,
        /// The kind of file system.
        kind: String,
    },
    /// Reading from or writing to the disk failed.
    #[error(
        "failed to {action} in `{}`: {reason}; check for a full or failing disk, or a limit on file \
         sizes (ulimit -f); the store is consistent, so run the same command to resume",
        .path.display()
    )]
    Disk {
        /// The path.
        path: PathBuf,
        /// The operation that failed.
        action: &'static str,
        /// SQLite's message.
        reason: String,
    },
    /// Another process holds the write lock for too long.
    #[error(
        "failed to {action}: another process has locked `{}` for over a minute; wait for it to end, \
         then try again",
        .path.display()
    )]
    Busy {
        /// The path.
        path: PathBuf,
        /// The operation that failed.
        action: &'static str,
    },
    /// The backup copy before a migration could not be made; the store is untouched.
    #[error(
        "failed to copy `{}` to `{}` before the migration: {reason}; free disk space or fix the \
         permissions, then try again",
        .path.display(), .backup.display()
    )]
    Backup {
        /// The path.
        path: PathBuf,
        /// The path of the copy.
        backup: PathBuf,
        /// The error of the system.
        reason: String,
    },
    /// A migration failed and was rolled back.
    #[error(
        "failed to migrate `{}` ({migration}): {reason}; the store was not changed; keep using the \
         jitai that wrote it",
        .path.display()
    )]
    Migration {
        /// The path.
        path: PathBuf,
        /// The migration's name.
        migration: &'static str,
        /// The reason.
        reason: String,
    },
    /// Another manifest took the experiment's name while this one was being registered.
    #[error(
        "another process is registering a different manifest as `{name}`; give each experiment its \
         own name, or wait until that process has ended"
    )]
    Contested {
        /// The experiment's name.
        name: String,
    },
    /// A job was claimed that no experiment has registered.
    #[error("job {key} is in no experiment of the store; register its manifest first")]
    UnknownJob {
        /// The job.
        key: JobKey,
    },
    /// Another process took over the run, so its outcome was not stored.
    #[error("the run of job {key} was taken over by another process; nothing was stored")]
    ClaimLost {
        /// The job.
        key: JobKey,
    },
    /// A text is not a prefix of a job key.
    #[error("`{text}` is not a job key or prefix of one; expected 1 to 32 digits of 0-9 and a-f")]
    NotAKey {
        /// The text.
        text: String,
    },
    /// No job key has the prefix.
    #[error("no job key begins with `{prefix}`; `jitai plan --jobs` lists the keys")]
    NoSuchJob {
        /// The prefix.
        prefix: String,
    },
    /// Job keys have the prefix, but none of the jobs has a completed run.
    #[error("job {key} has no completed run; run its manifest first (`jitai run`)")]
    NotCompleted {
        /// The first such job's key.
        key: String,
    },
    /// Several completed jobs have keys with the prefix.
    #[error(
        "`{prefix}` is a prefix of several completed jobs' keys ({}, …); give more digits",
        .keys.join(", ")
    )]
    AmbiguousKey {
        /// The prefix.
        prefix: String,
        /// Some of the keys.
        keys: Vec<String>,
    },
    /// A stored job has a form that this release cannot read.
    #[error("job {key} was stored by another release and cannot be read by this one: {reason}")]
    UnreadableJob {
        /// The job.
        key: String,
        /// The reason.
        reason: String,
    },
    /// The file has several names, each of which would have a write-ahead log of its own.
    #[error(
        "`{}` has {names} names (hard links), and SQLite keeps a separate write-ahead log for each; \
         keep the name that has a file ending in -wal beside it, or any if none has, and delete the \
         others",
        .path.display()
    )]
    HardLinked {
        /// The path.
        path: PathBuf,
        /// The number of names.
        names: u64,
    },
    /// The file is a mount point, so its write-ahead log lies beside another name.
    #[error(
        "`{}` is mounted as a single file, without the write-ahead log that lies beside the original; \
         mount the folder of the store instead",
        .path.display()
    )]
    MountedAlone {
        /// The path.
        path: PathBuf,
    },
    /// The content of the file is damaged.
    #[error(
        "`{}` is damaged: {reason}; `jitai doctor` reports which runs are intact",
        .path.display()
    )]
    Damaged {
        /// The path.
        path: PathBuf,
        /// The damage.
        reason: String,
    },
    /// The disk is full.
    #[error(
        "failed to {action}: the disk of `{}` is full; free disk space and run the same command \
         to resume",
        .path.display()
    )]
    Full {
        /// The path.
        path: PathBuf,
        /// The operation that failed.
        action: &'static str,
    },
    /// The output file of a salvage already exists.
    #[error("`{}` already exists; name a new file for the salvaged store", .path.display())]
    InTheWay {
        /// The path.
        path: PathBuf,
    },
    /// A path cannot be merged, because it is not a store.
    #[error("cannot merge `{}`: {reason}; nothing was merged", .path.display())]
    NotMergeable {
        /// The path.
        path: PathBuf,
        /// Why it cannot be merged.
        reason: String,
    },
    /// A store was to be merged into itself.
    #[error(
        "`{}` is the target store (--store); name other stores to merge into it",
        .path.display()
    )]
    MergeIntoItself {
        /// The store.
        path: PathBuf,
    },
    /// A salvage found no readable data.
    #[error("`{}` has no readable store data; nothing was written", .path.display())]
    NothingToSave {
        /// The path.
        path: PathBuf,
    },
    /// SQLite failed.
    #[error("failed to {action} in `{}`: {source}", .path.display())]
    Sqlite {
        /// The path.
        path: PathBuf,
        /// The operation that failed.
        action: &'static str,
        /// SQLite's error.
        source: rusqlite::Error,
    },
}

impl StoreError {
    pub(super) fn sqlite(path: &Path, action: &'static str, source: rusqlite::Error) -> Self {
        let path = path.to_owned();
        if is_damage(&source) {
            return StoreError::Damaged { path, reason: source.to_string() };
        }
        match source.sqlite_error_code() {
            Some(ErrorCode::DiskFull) => StoreError::Full { path, action },
            Some(ErrorCode::SystemIoFailure) => {
                StoreError::Disk { path, action, reason: source.to_string() }
            }
            Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked) => {
                StoreError::Busy { path, action }
            }
            Some(ErrorCode::ReadOnly) => StoreError::ReadOnly { path },
            Some(ErrorCode::CannotOpen | ErrorCode::PermissionDenied) => {
                StoreError::CannotOpen { path, reason: source.to_string() }
            }
            Some(ErrorCode::NotADatabase) => StoreError::NotAStore { path, what: NO_SQLITE_FILE },
            _ => StoreError::Sqlite { path, action, source },
        }
    }
}

/// Whether an error of SQLite, or of reading a value, indicates a damaged file.
pub(super) fn is_damage(error: &rusqlite::Error) -> bool {
    use rusqlite::Error;
    match error {
        // The tables are strict, so no program writes a value of another type or form.
        Error::InvalidColumnType(..)
        | Error::FromSqlConversionFailure(..)
        | Error::IntegralValueOutOfRange(..)
        | Error::Utf8Error(..) => true,
        other => other.sqlite_error_code() == Some(ErrorCode::DatabaseCorrupt),
    }
}

/// A failure inside a transaction, before the path and the action are known.
#[derive(Debug)]
pub(super) enum StoreFault {
    /// SQLite failed.
    Sqlite(rusqlite::Error),
    /// The store rejects the operation.
    Refused(StoreError),
}

impl StoreFault {
    pub(super) fn at(self, path: &Path, action: &'static str) -> StoreError {
        match self {
            StoreFault::Sqlite(source) => StoreError::sqlite(path, action, source),
            StoreFault::Refused(error) => error,
        }
    }
}

impl From<rusqlite::Error> for StoreFault {
    fn from(error: rusqlite::Error) -> Self {
        StoreFault::Sqlite(error)
    }
}

impl From<StoreError> for StoreFault {
    fn from(error: StoreError) -> Self {
        StoreFault::Refused(error)
    }
}
