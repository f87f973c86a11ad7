//! The stores that a merge reads: named files, and the stores in named folders.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use crate::store::error::StoreError;

/// The folder of a submission that holds its parts.
const PARTS: &str = "parts";

/// The stores that `from` names, in order and without duplicates, to be merged into the store at `into`. A
/// folder stands for all files in it and in its subfolder `parts` whose names end in `.sqlite`, sorted by
/// name, except `into`.
///
/// **Errors**: a path does not exist, a folder cannot be read, or `into` itself is named.
pub fn stores_of(from: &[PathBuf], into: &Path) -> Result<Vec<PathBuf>, StoreError> {
    let place = |path: &Path| path.canonicalize().ok();
    let target = place(into);
    let mut places = Vec::new();
    let mut stores = Vec::new();
    for path in from {
        let found = if path.is_dir() {
            let in_folder = stores_in(path)?;
            in_folder
                .into_iter()
                .filter(|store| target.is_none() || place(store) != target)
                .collect()
        } else if target.is_some() && place(path) == target {
            return Err(StoreError::MergeIntoItself { path: path.clone() });
        } else {
            vec![path.clone()]
        };
        for store in found {
            let place = place(&store).unwrap_or_else(|| store.clone());
            if !places.contains(&place) {
                places.push(place);
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
    if parts.is_dir() {
        stores.extend(listed(&parts)?);
    }
    Ok(stores)
}

fn listed(folder: &Path) -> Result<Vec<PathBuf>, StoreError> {
    let read = || -> io::Result<Vec<PathBuf>> {
        let mut stores = Vec::new();
        for entry in fs::read_dir(folder)? {
            let path = entry?.path();
            if path.extension().is_some_and(|extension| extension == "sqlite") && path.is_file() {
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
    fn a_store_is_not_merged_into_itself() {
        let folder = tempfile::tempdir().unwrap();
        let into = folder.path().join("a.sqlite");
        fs::write(&into, "").unwrap();
        let other_spelling = folder.path().join(".").join("a.sqlite");
        let error = stores_of(&[other_spelling], &into).unwrap_err();
        assert!(matches!(error, StoreError::MergeIntoItself { .. }), "{error}");
    }
}
