//! The folder of `--out`.

use std::fs::{self, File};
use std::path::Path;

use crate::cli::Error;

/// Makes the folder that files are to be written to, and tries it, before anything long begins.
///
/// **Errors**: it is a file, or nothing can be written there.
pub(super) fn make(folder: &Path) -> Result<(), Error> {
    let shown = folder.display();
    if folder.is_file() {
        return Err(Error::Usage(format!(
            "--out: `{shown}` is a file, not a folder; name another"
        )));
    }
    let tried = folder.join("jitai.partial");
    let made = fs::create_dir_all(folder).and_then(|()| File::create(&tried));
    made.and_then(|_| fs::remove_file(&tried)).map_err(|source| Error::Io {
        what: format!("write to the folder `{shown}` (name another with --out)"),
        source,
    })
}
