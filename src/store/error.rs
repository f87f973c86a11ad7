//! What can go wrong with the store, in words that say what to do.

use std::path::{Path, PathBuf};

use rusqlite::ErrorCode;

use crate::plan::JobKey;

const NO_SQLITE_FILE: &str = "no SQLite file, so it cannot be a store, or no longer (`jitai doctor \
     --salvage NEW` writes what is left of one to a new store)";

/// Why the store could not do what it was asked.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StoreError {
    /// Nothing to read is there.
    #[error(
        "there is no store at `{}`; `jitai run` makes one, and --store names another",
        .path.display()
    )]
    Missing {
        /// Where it was looked for.
        path: PathBuf,
    },
    /// The file is there and has nothing in it.
    #[error(
        "`{}` is an empty file; `jitai run` makes a store of it, and --store names another",
        .path.display()
    )]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// The folder that should hold the store does not exist.
    #[error(
        "there is no folder `{}` for a store at `{}`; make it first, or --store names another",
        .folder.display(), .path.display()
    )]
    MissingFolder {
        /// The store's path.
        path: PathBuf,
        /// The folder that is missing.
        folder: PathBuf,
    },
    /// The path leads to something that is no SQLite file.
    #[error("`{}` is {what}; name another file with --store", .path.display())]
    NotAStore {
        /// The path.
        path: PathBuf,
        /// What is there.
        what: &'static str,
    },
    /// The file is a SQLite database of another program.
    #[error(
        "`{}` is a SQLite file that jitai did not make; it is left untouched, name another file \
         with --store",
        .path.display()
    )]
    Foreign {
        /// The path.
        path: PathBuf,
    },
    /// The store was written by a newer release.
    #[error(
        "`{}` has schema version {found}, and this jitai knows versions up to {known}; it is left \
         untouched, use the newer jitai that wrote it",
        .path.display()
    )]
    Newer {
        /// The path.
        path: PathBuf,
        /// The file's schema version.
        found: u32,
        /// The newest version known here.
        known: u32,
    },
    /// A key has another value `before` than the program declared that wrote the store.
    #[error(
        "in `{}` a job without `{parameter}` stands for {stored}, and this jitai declares another \
         value; it is left untouched, use the jitai that wrote it",
        .path.display()
    )]
    Reinterpreted {
        /// The path.
        path: PathBuf,
        /// The parameter's dotted name.
        parameter: String,
        /// The value in the store, as SQL writes it.
        stored: String,
    },
    /// The store was written by an older release, and is opened for reading only.
    #[error(
        "`{}` has schema version {found}, and this jitai reads version {known}; `jitai run` \
         migrates it, after a backup copy",
        .path.display()
    )]
    Older {
        /// The path.
        path: PathBuf,
        /// The file's schema version.
        found: u32,
        /// The version read here.
        known: u32,
    },
    /// The file or its folder cannot be opened as asked.
    #[error(
        "cannot open `{}`: {reason}; check the rights of the file and its folder",
        .path.display()
    )]
    CannotOpen {
        /// The path.
        path: PathBuf,
        /// What the system said.
        reason: String,
    },
    /// The file can be read but not written.
    #[error(
        "`{}` cannot be written; check the rights of the file and its folder, or name another \
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
    /// The file lies on another machine.
    #[error(
        "`{}` lies on a network file system ({kind}), where SQLite cannot rely on locks; put the \
         store on a local disk, and copy it when its jobs have run",
        .path.display()
    )]
    Network {
        /// The path.
        path: PathBuf,
        /// The kind of file system.
        kind: String,
    },
    /// The disk refuses to read or write.
    #[error(
        "failed to {action} in `{}`: {reason}; see whether its disk is full or failing, or \
         files are limited in size (ulimit -f); nothing is half written, and the same command goes on",
        .path.display()
    )]
    Disk {
        /// The path.
        path: PathBuf,
        /// What was to be done.
        action: &'static str,
        /// What SQLite said.
        reason: String,
    },
    /// Another process holds the write lock for too long.
    #[error(
        "failed to {action}: another process has held `{}` for over a minute; let it end, then \
         try again",
        .path.display()
    )]
    Busy {
        /// The path.
        path: PathBuf,
        /// What was to be done.
        action: &'static str,
    },
    /// The backup copy before a migration could not be made; the store is untouched.
    #[error(
        "failed to copy `{}` to `{}` before migrating it: {reason}; make room or give rights, \
         then try again",
        .path.display(), .backup.display()
    )]
    Backup {
        /// The path.
        path: PathBuf,
        /// Where the copy was to be.
        backup: PathBuf,
        /// What the system said.
        reason: String,
    },
    /// A migration failed and was rolled back.
    #[error(
        "failed to migrate `{}` ({migration}): {reason}; the store is as it was, keep using the \
         jitai that wrote it",
        .path.display()
    )]
    Migration {
        /// The path.
        path: PathBuf,
        /// The migration's name.
        migration: &'static str,
        /// What was wrong.
        reason: String,
    },
    /// Another manifest took the experiment's name while this one was being registered.
    #[error(
        "another process is registering another manifest as `{name}`; give each experiment a name \
         of its own, or wait until that process has ended"
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
    /// The run was taken over, so its outcome is not written.
    #[error("the run of job {key} was taken over by another process; nothing was stored")]
    ClaimLost {
        /// The job.
        key: JobKey,
    },
    /// A text is not the beginning of a job key.
    #[error("`{text}` is not a job key; a key or its beginning has 1 to 32 digits of 0-9 and a-f")]
    NotAKey {
        /// The text.
        text: String,
    },
    /// No job has a key that begins so.
    #[error("no job's key begins with `{prefix}`; `jitai plan --jobs` lists the keys")]
    NoSuchJob {
        /// The beginning asked for.
        prefix: String,
    },
    /// Jobs have keys that begin so, but none has a completed run.
    #[error("job {key} has no completed run; `jitai run` its manifest first")]
    NotCompleted {
        /// The first such job's key.
        key: String,
    },
    /// Several completed jobs have keys that begin so.
    #[error(
        "`{prefix}` begins the keys of several completed jobs ({}, …); give more digits",
        .keys.join(", ")
    )]
    AmbiguousKey {
        /// The beginning asked for.
        prefix: String,
        /// Some of the keys.
        keys: Vec<String>,
    },
    /// A stored job has a form that this release cannot read.
    #[error("job {key} was stored by another release and cannot be read by this one: {reason}")]
    UnreadableJob {
        /// The job.
        key: String,
        /// What was wrong with it.
        reason: String,
    },
    /// The file is not as it was written.
    #[error(
        "`{}` is damaged: {reason}; `jitai doctor` says what can be saved",
        .path.display()
    )]
    Damaged {
        /// The path.
        path: PathBuf,
        /// What was seen.
        reason: String,
    },
    /// The disk is full.
    #[error(
        "failed to {action}: no room is left for `{}`; make room, and the same command goes on",
        .path.display()
    )]
    Full {
        /// The path.
        path: PathBuf,
        /// What was to be done.
        action: &'static str,
    },
    /// The file that a salvage is to write is there already.
    #[error("`{}` is there already; a salvage writes a new file, name another", .path.display())]
    InTheWay {
        /// The path.
        path: PathBuf,
    },
    /// A path that names no store to merge.
    #[error("cannot merge `{}`: {reason}; nothing was merged", .path.display())]
    NotMergeable {
        /// The path.
        path: PathBuf,
        /// What is there.
        reason: String,
    },
    /// A store was to be merged into itself.
    #[error(
        "`{}` is the store that --store names; name other stores to merge into it",
        .path.display()
    )]
    MergeIntoItself {
        /// The store.
        path: PathBuf,
    },
    /// A salvage found nothing.
    #[error("nothing in `{}` can be read as a store, so nothing was written", .path.display())]
    NothingToSave {
        /// The path.
        path: PathBuf,
    },
    /// SQLite failed.
    #[error("failed to {action} in `{}`: {source}", .path.display())]
    Sqlite {
        /// The path.
        path: PathBuf,
        /// What was to be done.
        action: &'static str,
        /// What SQLite said.
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

/// Whether an error of SQLite, or of reading a value, says that the file is not as it was written.
pub(super) fn is_damage(error: &rusqlite::Error) -> bool {
    use rusqlite::Error;
    match error {
        // The tables are strict, so a value of another type or form was not written by anybody.
        Error::InvalidColumnType(..)
        | Error::FromSqlConversionFailure(..)
        | Error::IntegralValueOutOfRange(..)
        | Error::Utf8Error(..) => true,
        other => other.sqlite_error_code() == Some(ErrorCode::DatabaseCorrupt),
    }
}

/// A failure inside a transaction, before the path and the action are known.
#[derive(Debug)]
pub(super) enum Fault {
    /// SQLite failed.
    Sqlite(rusqlite::Error),
    /// The store refuses, for a reason of its own.
    Refused(StoreError),
}

impl Fault {
    pub(super) fn at(self, path: &Path, action: &'static str) -> StoreError {
        match self {
            Fault::Sqlite(source) => StoreError::sqlite(path, action, source),
            Fault::Refused(error) => error,
        }
    }
}

impl From<rusqlite::Error> for Fault {
    fn from(error: rusqlite::Error) -> Self {
        Fault::Sqlite(error)
    }
}

impl From<StoreError> for Fault {
    fn from(error: StoreError) -> Self {
        Fault::Refused(error)
    }
}
