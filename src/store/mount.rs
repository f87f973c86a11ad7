//! Detection of network file systems, on which a store cannot work.
//!
//! A write-ahead log is shared through memory, which processes on two machines do not have in common. Over a
//! network, the locks that SQLite relies on may be granted twice or not at all.

use std::fs;
use std::path::{Path, PathBuf};

/// Names of network file systems, as in `/proc/mounts`.
const OVER_A_NETWORK: [&str; 21] = [
    "9p",
    "afs",
    "beegfs",
    "ceph",
    "cifs",
    "davfs",
    "fuse.beegfs",
    "fuse.ceph",
    "fuse.gcsfuse",
    "fuse.glusterfs",
    "fuse.juicefs",
    "fuse.rclone",
    "fuse.s3fs",
    "fuse.sshfs",
    "gpfs",
    "lustre",
    "ncpfs",
    "nfs",
    "nfs4",
    "smb3",
    "smbfs",
];

/// The name of the network file system that holds `path`; `None` for a local file system, or if the system
/// has no list of mounts.
pub(super) fn network_file_system(path: &Path) -> Option<String> {
    let mounts = fs::read_to_string("/proc/self/mounts").ok()?;
    // The store itself may not exist yet.
    let folder = path.ancestors().skip(1).find_map(|folder| folder.canonicalize().ok())?;
    let place = path.canonicalize().unwrap_or(folder);
    let kind = kind_of(&mounts, &place)?;
    OVER_A_NETWORK.contains(&kind).then(|| kind.to_owned())
}

/// The type of the file system that holds `place`, from the lines of `/proc/mounts` (fstab(5)).
fn kind_of<'m>(mounts: &'m str, place: &Path) -> Option<&'m str> {
    mounts
        .lines()
        .filter_map(|line| {
            let mut fields = line.split(' ').skip(1);
            Some((unescaped(fields.next()?), fields.next()?))
        })
        .filter(|(point, _)| place.starts_with(point))
        // Of two mounts at the same place, the later one covers the earlier one.
        .max_by_key(|(point, _)| point.components().count())
        .map(|(_, kind)| kind)
}

/// A mount point with its octal escapes replaced.
fn unescaped(point: &str) -> PathBuf {
    let escapes = [("\\040", " "), ("\\011", "\t"), ("\\012", "\n"), ("\\134", "\\")];
    escapes.iter().fold(point.to_owned(), |text, (code, plain)| text.replace(code, plain)).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOUNTS: &str = "/dev/sda1 / ext4 rw,relatime 0 0
server:/home /home nfs4 rw,vers=4.2 0 0
/dev/sdb1 /home/me/local\\040disk xfs rw 0 0
me@server: /mnt/remote fuse.sshfs rw 0 0
tmpfs /home/tmp tmpfs rw 0 0
server:/tmp /home/tmp nfs rw 0 0
";

    #[test]
    fn a_path_lies_on_the_innermost_and_latest_mount() {
        for (path, kind) in [
            ("/var/a.sqlite", "ext4"),
            ("/homely/a.sqlite", "ext4"),
            ("/home/me/a.sqlite", "nfs4"),
            ("/home/me/local disk/a.sqlite", "xfs"),
            ("/mnt/remote/deep/a.sqlite", "fuse.sshfs"),
            ("/home/tmp/a.sqlite", "nfs"),
        ] {
            assert_eq!(kind_of(MOUNTS, Path::new(path)), Some(kind), "{path}");
        }
        assert_eq!(kind_of("", Path::new("/a")), None);
    }

    #[test]
    fn the_folder_of_temporary_files_is_local() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(network_file_system(&folder.path().join("absent/a.sqlite")), None);
    }
}
