//! Full disks.

use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::thread;
use std::time::Duration;

use tempfile::TempDir;

use super::cluster::{Lab, is_tried, until};
use crate::support::{Effort, manifest};

/// A disk of a few megabytes, which a cluster that starts later may use.
struct SmallDisk {
    folder: TempDir,
}

impl SmallDisk {
    fn of(megabytes: u32) -> SmallDisk {
        let folder = tempfile::tempdir().unwrap();
        let size = format!("size={megabytes}m");
        let mut mount = Command::new("mount");
        mount.args(["-t", "tmpfs", "-o", &size, "tmpfs"]).arg(folder.path());
        assert!(mount.status().unwrap().success());
        SmallDisk { folder }
    }

    fn path(&self) -> &Path {
        self.folder.path()
    }

    fn filler(&self) -> PathBuf {
        self.path().join("filler")
    }

    /// Fills the disk to the last byte.
    fn fill(&self) {
        let mut file = File::create(self.filler()).unwrap();
        while file.write(&[0; 4096]).is_ok_and(|written| written > 0) {}
    }

    fn free(&self) {
        fs::remove_file(self.filler()).unwrap();
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        // The unmount is lazy, because a task of a failed test may still use the disk.
        let _ = Command::new("umount").arg("--lazy").arg(self.path()).status();
    }
}

#[test]
fn the_shared_folder_full_while_a_part_is_handed_in() {
    if !is_tried() {
        return;
    }
    let disk = SmallDisk::of(8);
    let profile = format!("folder = \"{}\"", disk.path().display());
    let manifest = manifest("full", "0.6", "2", Effort::Short);
    let Some(lab) = Lab::in_three_chunks(&manifest, &profile) else { return };
    // No task runs before the disk is full.
    lab.cluster.slurm("scontrol", &["update", "partition=main", "state=down"]);
    lab.submit(&[]).succeeded();
    for chunk in 0..3 {
        let log = lab.submission().join(format!("logs/{chunk}.log"));
        fs::write(&log, "the first lines of this log have their place\n").unwrap();
    }
    disk.fill();
    lab.cluster.slurm("scontrol", &["update", "partition=main", "state=up"]);
    until("a hand-in has failed", || lab.logs().contains("failed to hand in"));
    assert!(lab.logs().contains("No space left on device"), "{}", lab.logs());
    assert!(lab.parts().is_empty());
    thread::sleep(Duration::from_secs(1));
    disk.free();
    lab.finish();
    assert_eq!((lab.submissions().len(), lab.parts().len()), (1, 3));
}

#[test]
fn scratch_full() {
    if !is_tried() {
        return;
    }
    let disk = SmallDisk::of(4);
    let profile = format!("scratch = \"{}\"", disk.path().display());
    let manifest = manifest("full", "0.6", "2", Effort::Short);
    let Some(lab) = Lab::in_three_chunks(&manifest, &profile) else { return };
    disk.fill();
    lab.submit(&["--wait"]).ended(3).says("its task failed: ").says("log: ");
    assert_eq!(lab.submissions()[0]["state"], "lost");
    assert!(lab.logs().contains("error: "), "{}", lab.logs());
    assert_eq!(lab.submissions().len(), 1, "a task that says why it failed is not tried at once");
    disk.free();
    lab.finish();
    assert_eq!(lab.submissions().len(), 2);
}
