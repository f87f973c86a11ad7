//! Full or read-only disks: one clear message, no partly written data, and the sweep resumes once there
//! is space.

use std::fs;
use std::process::Command;

use crate::support::{Effort, Folder, assert_same_rows, left_out, manifest};

/// An in-memory file system mounted on a folder; unmounted at the end.
struct Disk<'a>(&'a Folder);

impl<'a> Disk<'a> {
    /// A disk mounted at `disk` with these options; `None`, as a part left out, if this process must
    /// not mount file systems.
    fn mount(folder: &'a Folder, options: &str) -> Option<Disk<'a>> {
        fs::create_dir_all(folder.path("disk")).unwrap();
        let mount = Command::new("mount")
            .args(["-t", "tmpfs", "-o", options, "tmpfs"])
            .arg(folder.path("disk"))
            .output();
        let why = match mount {
            Ok(output) if output.status.success() => return Some(Disk(folder)),
            Ok(output) => String::from_utf8_lossy(&output.stderr).trim().to_owned(),
            Err(error) => format!("no mount command: {error}"),
        };
        left_out("a disk of its own", &why);
        None
    }

    fn remount(&self, options: &str) {
        let options = format!("remount,{options}");
        let place = self.0.path("disk");
        let mounted = Command::new("mount").args(["-o", &options]).arg(place).status().unwrap();
        assert!(mounted.success());
    }
}

impl Drop for Disk<'_> {
    fn drop(&mut self) {
        // The folder below is removed in any case; a mount that remains is visible to the user.
        let _ = Command::new("umount").arg(self.0.path("disk")).status();
    }
}

const RUN: [&str; 7] =
    ["run", "sweep.toml", "--store", "disk/jitai.sqlite", "--quiet", "--workers", "2"];

#[test]
fn a_disk_that_fills_in_the_middle_of_a_sweep_costs_nothing_but_the_time_to_make_room() {
    let text = manifest("sweep", "[0.4, 0.6]", "20", Effort::Trivial);
    let folder = Folder::with(&text);
    let Some(disk) = Disk::mount(&folder, "size=700k") else { return };
    let mut sizes = vec![];
    for kilobytes in [700, 900, 1200, 1500] {
        disk.remount(&format!("size={kilobytes}k"));
        let full = folder.jitai(RUN).ended(3);
        assert_eq!(full.stderr.lines().count(), 1, "{}", full.stderr);
        assert!(full.stderr.starts_with("error: failed to "), "{}", full.stderr);
        assert!(full.stderr.contains("run the same command to resume"), "{}", full.stderr);
        sizes.push(kilobytes);
    }
    disk.remount("size=50m");
    let doctor = ["doctor", "--store", "disk/jitai.sqlite"];
    folder.jitai(doctor).succeeded().prints("is healthy");
    folder.jitai(RUN).succeeded();
    fs::copy(folder.path("disk/jitai.sqlite"), folder.path("jitai.sqlite")).unwrap();
    let once = "SELECT count(*) FROM run WHERE status = 'completed'";
    assert_eq!(folder.number(once), 80);
    assert_same_rows(&folder.dump(), &Folder::completed(&text).dump());
    println!("filled at {sizes:?} kB");
}

#[test]
fn a_limit_on_the_size_of_files_is_reported_and_costs_nothing() {
    let text = manifest("sweep", "[0.4, 0.6]", "20", Effort::Trivial);
    let folder = Folder::with(&text);
    for blocks in [8, 50, 400] {
        let limited = format!("ulimit -f {blocks} && exec \"$0\" run sweep.toml --quiet");
        let jitai = env!("CARGO_BIN_EXE_jitai");
        let ended = folder.command_of("sh", ["-c", &limited, jitai]).output().unwrap();
        let told = String::from_utf8(ended.stderr).unwrap();
        assert_eq!(ended.status.code(), Some(3), "{blocks}: {told}");
        assert_eq!(told.lines().count(), 1, "{told}");
        assert!(told.contains("ulimit -f") || told.contains("is full; free disk space"), "{told}");
    }
    folder.jitai(["run", "sweep.toml", "--quiet"]).succeeded();
    assert_same_rows(&folder.dump(), &Folder::completed(&text).dump());
}

#[test]
fn a_disk_that_cannot_be_written_is_refused_before_any_training() {
    let folder = Folder::with(&manifest("sweep", "0.6", "1", Effort::Trivial));
    let Some(disk) = Disk::mount(&folder, "size=10m") else { return };
    disk.remount("ro");
    folder.jitai(RUN).ended(3).says("disk/jitai.sqlite").says("the permissions of the file");
    disk.remount("rw");
    folder.jitai(RUN).succeeded();
    disk.remount("ro");
    folder
        .jitai(RUN)
        .ended(3)
        .says("`")
        .says("cannot be written; check the permissions of the file");
    // Completed runs can still be read.
    folder.jitai(["status", "--store", "disk/jitai.sqlite"]).succeeded().prints("sweep");
    folder.jitai(["doctor", "--store", "disk/jitai.sqlite"]).succeeded();
}

#[test]
fn a_store_that_is_a_folder_or_in_none_is_refused_before_any_training() {
    let folder = Folder::with(&manifest("sweep", "0.6", "1", Effort::Trivial));
    let run = |store: &str| folder.jitai(["run", "sweep.toml", "--store", store]).ended(3);
    fs::create_dir(folder.path("results")).unwrap();
    run("results").says("results` is a folder, not a store; name another file with --store");
    run("absent/jitai.sqlite").says("there is no folder").says("absent` for a store at `");
    run("/dev/null").says("is a device or pipe, not a store");
}
