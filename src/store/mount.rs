//! Detection of mounts on which a store cannot work: network file systems, and mounts of a single file.
//!
//! A write-ahead log is shared through memory, which processes on two machines do not have in common. Over a
//! network, the locks that SQLite relies on may be granted twice or not at all. A single file that is
//! mounted at another place has no log beside it there.

use std::ffi::OsString;
use std::fs;
use std::os::unix::ffi::OsStringExt;
use std::path::{Path, PathBuf};

/// The list of mounts on Linux; other systems have none.
const MOUNTS: &str = "/proc/self/mounts";

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
    let mounts = fs::read(MOUNTS).ok()?;
    // The store itself may not exist yet.
    let folder = path.ancestors().skip(1).find_map(|folder| folder.canonicalize().ok())?;
    let place = path.canonicalize().unwrap_or(folder);
    let kind = kind_of(&mounts, &place)?;
    OVER_A_NETWORK.contains(&kind.as_str()).then_some(kind)
}

/// Whether the file at `path`, which is resolved, is a mount point itself; `false` if the system has no list
/// of mounts.
pub(super) fn is_mounted_alone(path: &Path) -> bool {
    fs::read(MOUNTS).is_ok_and(|mounts| points(&mounts).any(|(point, _)| point == path))
}

/// The mount points and the types of their file systems, from the lines of `/proc/mounts` (fstab(5)).
fn points(mounts: &[u8]) -> impl Iterator<Item = (PathBuf, String)> {
    mounts.split(|byte| *byte == b'\n').filter_map(|line| {
        let mut fields = line.split(|byte| *byte == b' ').skip(1);
        let point = unescaped(fields.next()?);
        Some((point, String::from_utf8_lossy(fields.next()?).into_owned()))
    })
}

/// The type of the file system that holds `place`.
fn kind_of(mounts: &[u8], place: &Path) -> Option<String> {
    points(mounts)
        .filter(|(point, _)| place.starts_with(point))
        // Of two mounts at the same place, the later one covers the earlier one.
        .max_by_key(|(point, _)| point.components().count())
        .map(|(_, kind)| kind)
}

/// A mount point with its escapes replaced: a backslash and three octal digits.
fn unescaped(mut point: &[u8]) -> PathBuf {
    let mut plain = Vec::new();
    while let [first, rest @ ..] = point {
        let code = rest.get(..3).and_then(|code| std::str::from_utf8(code).ok());
        match code.and_then(|code| u8::from_str_radix(code, 8).ok()) {
            Some(byte) if *first == b'\\' => {
                plain.push(byte);
                point = &rest[3..];
            }
            _ => {
                plain.push(*first);
                point = rest;
            }
        }
    }
    OsString::from_vec(plain).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOUNTS: &[u8] = b"/dev/sda1 / ext4 rw,relatime 0 0
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
            assert_eq!(kind_of(MOUNTS, Path::new(path)).as_deref(), Some(kind), "{path}");
        }
        assert_eq!(kind_of(b"", Path::new("/a")), None);
    }

    #[test]
    fn mount_points_are_read_with_their_escapes() {
        let line = b"/dev/sda1 /a\\040b\\134040\\012\xff/s.sqlite ext4 rw 0 0\n";
        let point = OsString::from_vec(b"/a b\\040\n\xff/s.sqlite".to_vec());
        assert_eq!(points(line).collect::<Vec<_>>(), [(point.into(), "ext4".to_owned())]);
    }

    #[test]
    fn the_folder_of_temporary_files_is_local() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(network_file_system(&folder.path().join("absent/a.sqlite")), None);
    }
}
