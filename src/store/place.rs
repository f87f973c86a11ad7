//! Where a store is: the one name of its file, and the names of what lies beside the file.
//!
//! SQLite puts the write-ahead log of a file beside the name under which the file was opened. Two names
//! would therefore have two logs, and readers of one name would miss the transactions in the other's log.
//! Symbolic links lead to one name ([`resolve`]). A second hard link, or a mount of the file alone, cannot
//! be resolved, so such a file is rejected unless it cannot have a log ([`require_one_name`]).

use std::fs::{self, Metadata};
use std::io::{self, ErrorKind};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use super::error::StoreError;
use super::mount;

/// The maximum number of links that lead to a file that does not exist; the number of Linux.
const MOST_LINKS: usize = 40;

/// `path` with an appended ending, as SQLite names its own additional files. `path` is resolved.
pub fn beside(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(ending);
    PathBuf::from(name)
}

/// The one name of the file at `path`: absolute and without symbolic links. The file need not exist; a link
/// to a missing file gives the name that the file would have. An absolute path is never interpreted by
/// SQLite as a URI or a special name.
///
/// **Errors**: links lead in a circle, or a folder cannot be searched.
pub fn resolve(path: &Path) -> Result<PathBuf, StoreError> {
    follow(path).map_err(|error| StoreError::CannotOpen {
        path: path.to_owned(),
        reason: error.to_string(),
    })
}

fn follow(path: &Path) -> io::Result<PathBuf> {
    let mut place = std::path::absolute(path)?;
    for _ in 0..MOST_LINKS {
        match place.canonicalize() {
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            found => return found,
        }
        let (Some(folder), Some(name)) = (place.parent(), place.file_name()) else { break };
        place = match fs::read_link(&place) {
            Ok(target) => folder.join(target),
            // A missing folder is reported with the path as it was given.
            Err(_) => return Ok(folder.canonicalize().map_or(place.clone(), |it| it.join(name))),
        };
    }
    place.canonicalize()
}

/// Fails if the file at `path`, which is resolved, has another name with a write-ahead log of its own.
///
/// **Errors**: the file has several hard links, or is a mount point itself.
pub fn require_one_name(path: &Path) -> Result<(), StoreError> {
    // What is not a file, or cannot be looked at, is reported when it is opened.
    let names = fs::metadata(path).ok().filter(Metadata::is_file).map_or(0, |file| file.nlink());
    match names {
        2.. => Err(StoreError::HardLinked { path: path.to_owned(), names }),
        1 if mount::is_mounted_alone(path) => {
            Err(StoreError::MountedAlone { path: path.to_owned() })
        }
        0 | 1 => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    #[test]
    fn links_lead_to_one_name_whether_or_not_the_file_exists() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().canonicalize().unwrap();
        let path = |name: &str| root.join(name);
        for name in ["real", "links", "real/deep"] {
            fs::create_dir(path(name)).unwrap();
        }
        symlink("../real/s.sqlite", path("links/relative.sqlite")).unwrap();
        symlink("relative.sqlite", path("links/chain.sqlite")).unwrap();
        symlink(path("links/chain.sqlite"), path("absolute.sqlite")).unwrap();
        symlink("real", path("folder")).unwrap();
        symlink("real/deep", path("deep")).unwrap();
        let names = [
            "real/s.sqlite",
            "links/relative.sqlite",
            "links/chain.sqlite",
            "absolute.sqlite",
            "folder/s.sqlite",
            "real/../links/./chain.sqlite",
            // The parent of the folder to which the link leads.
            "deep/../s.sqlite",
        ];
        let check = || {
            for name in names {
                assert_eq!(resolve(&path(name)).unwrap(), path("real/s.sqlite"), "{name}");
            }
        };
        check();
        fs::write(path("real/s.sqlite"), "").unwrap();
        check();
        symlink(path("gone/s.sqlite"), path("lost.sqlite")).unwrap();
        assert_eq!(resolve(&path("lost.sqlite")).unwrap(), path("gone/s.sqlite"));
    }

    #[test]
    fn links_in_a_circle_lead_nowhere() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        symlink("b.sqlite", path("a.sqlite")).unwrap();
        symlink("a.sqlite", path("b.sqlite")).unwrap();
        let error = resolve(&path("a.sqlite")).unwrap_err().to_string();
        assert!(error.contains("Too many levels of symbolic links"), "{error}");
    }

    #[test]
    fn a_second_hard_link_is_a_second_name() {
        let folder = tempfile::tempdir().unwrap();
        let (one, two) = (folder.path().join("one.sqlite"), folder.path().join("two.sqlite"));
        fs::write(&one, "").unwrap();
        require_one_name(&one).unwrap();
        fs::hard_link(&one, &two).unwrap();
        for path in [&one, &two] {
            let error = require_one_name(path).unwrap_err().to_string();
            assert!(error.contains("has 2 names (hard links)"), "{error}");
        }
        fs::remove_file(&one).unwrap();
        require_one_name(&two).unwrap();
        // A folder has a link in each of its subfolders.
        require_one_name(folder.path()).unwrap();
    }
}
