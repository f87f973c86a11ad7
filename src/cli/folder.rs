//! The output folder, the argument of `--out`.

use std::fs::{self, File};
use std::path::Path;

use crate::cli::Error;
use crate::report::write_whole;

/// Creates the output folder and checks that it is writable, before any long computation.
///
/// **Errors**: the path is a file, or the folder is not writable.
pub(super) fn make(folder: &Path) -> Result<(), Error> {
    let shown = folder.display();
    if folder.is_file() {
        return Err(Error::Usage(format!("--out: `{shown}` is a file; name a folder")));
    }
    let tried = folder.join("jitai.partial");
    let made = fs::create_dir_all(folder).and_then(|()| File::create(&tried));
    made.and_then(|_| fs::remove_file(&tried)).map_err(|source| Error::Io {
        what: format!("write to the folder `{shown}` (name another with --out)"),
        source,
    })
}

/// Writes a file, whole or not at all.
///
/// **Errors**: the system refuses.
pub(super) fn write(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    let failure = |source| Error::Io { what: format!("write `{}`", path.display()), source };
    write_whole(path, bytes).map_err(failure)
}
