//! The stores that a merge reads: named files, and the stores in named folders.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use crate::store::error::StoreError;
use crate::store::place::resolve;

/// The folder of a submission that holds its parts.
const PARTS: &str = "parts";

/// The stores that `from` names, in order and without duplicates, to be merged into the store at `into`. A
/// folder stands for all files in it and in its subfolder `parts` whose names end in `.sqlite`, sorted by
/// name, except `into`. A link to a missing file is listed too, so that opening it fails.
///
/// **Errors**: links lead in a circle, a folder cannot be read, or `into` itself is named.
pub fn stores_of(from: &[PathBuf], into: &Path) -> Result<Vec<PathBuf>, StoreError> {
    let target = resolve(into)?;
    let mut resolved = Vec::new();
    let mut stores = Vec::new();
    for path in from {
        let found = if path.is_dir() {
            stores_in(path)?
        } else if resolve(path)? == target {
            return Err(StoreError::MergeIntoItself { path: path.clone() });
        } else {
            vec![path.clone()]
        };
        for store in found {
            let path = resolve(&store)?;
            if path != target && !resolved.contains(&path) {
                resolved.push(path);
                stores.push(store);
            }
        }
    }
    Ok(stores)
}

/// The stores in a folder and in its subfolder of parts.
fn stores_in(folder: &Path) -> Result<Vec<PathBuf>, StoreError> {
    let mut stores = listed(folder)?;
    let parts = folder.join(PARTS);
    // A link to a missing folder cannot be listed, which is an error.
    if parts.is_dir() || parts.is_symlink() {
        stores.extend(listed(&parts)?);
    }
    Ok(stores)
}

fn listed(folder: &Path) -> Result<Vec<PathBuf>, StoreError> {
    let read = || -> io::Result<Vec<PathBuf>> {
        let mut stores = Vec::new();
        for entry in fs::read_dir(folder)? {
            let path = entry?.path();
            if path.extension().is_some_and(|extension| extension == "sqlite") && !path.is_dir() {
                stores.push(path);
            }
        }
        stores.sort();
        Ok(stores)
    };
    read().map_err(|error| StoreError::NotMergeable {
        path: folder.to_owned(),
        reason: error.to_string(),
    })
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    #[test]
    fn a_folder_stands_for_the_stores_in_it_and_in_its_parts() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::create_dir(path("parts")).unwrap();
        fs::create_dir(path("folder.sqlite")).unwrap();
        let parts = ["parts/2.sqlite", "parts/1.sqlite", "parts/3.sqlite.partial"];
        for name in ["b.sqlite", "a.sqlite", "into.sqlite", "b.sqlite-wal"].iter().chain(&parts) {
            fs::write(path(name), "").unwrap();
        }
        let all = ["a.sqlite", "b.sqlite", "parts/1.sqlite", "parts/2.sqlite"];
        let from = [folder.path().to_owned(), path("parts/1.sqlite")];
        assert_eq!(stores_of(&from, &path("into.sqlite")).unwrap(), all.map(path));
        let first = [path("parts/2.sqlite"), folder.path().to_owned()];
        assert_eq!(stores_of(&first, &path("into.sqlite")).unwrap()[0], path("parts/2.sqlite"));
    }

    #[test]
    fn what_a_folder_cannot_give_is_not_skipped() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let into = path("into.sqlite");
        let list = || stores_of(&[folder.path().to_owned()], &into);
        symlink("/gone/a.sqlite", path("a.sqlite")).unwrap();
        assert_eq!(list().unwrap(), [path("a.sqlite")]);
        symlink("b.sqlite", path("b.sqlite")).unwrap();
        assert!(matches!(list(), Err(StoreError::CannotOpen { .. })));
        fs::remove_file(path("b.sqlite")).unwrap();
        symlink("/gone/parts", path("parts")).unwrap();
        assert!(matches!(list(), Err(StoreError::NotMergeable { .. })));
    }

    #[test]
    fn a_store_is_not_merged_into_itself() {
        let folder = tempfile::tempdir().unwrap();
        let into = folder.path().join("a.sqlite");
        fs::write(&into, "").unwrap();
        let link = folder.path().join("link.sqlite");
        symlink("a.sqlite", &link).unwrap();
        for other_name in [folder.path().join(".").join("a.sqlite"), link] {
            let error = stores_of(&[other_name], &into).unwrap_err();
            assert!(matches!(error, StoreError::MergeIntoItself { .. }), "{error}");
        }
    }
}
