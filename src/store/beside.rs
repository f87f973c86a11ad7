//! Names of the files beside a store.

use std::path::{Path, PathBuf};

/// `path` with an appended ending, as SQLite names its own additional files.
pub(super) fn beside(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(ending);
    PathBuf::from(name)
}
