//! Names of the files that lie beside a store.

use std::path::{Path, PathBuf};

/// `path` with an ending behind it, as SQLite names the files beside its own.
pub(super) fn beside(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(ending);
    PathBuf::from(name)
}
